"""The explorer in a notebook: ipywidgets around the picture."""

import asyncio
import contextlib
import html
import time
from typing import Any

import ipywidgets
import numpy as np

from vibrojax.ensemble.ranges import Range
from vibrojax.explorer.live_curve import MOST_QUICK_POINTS, LiveCurve, highest_stable
from vibrojax.explorer.sliders import is_logarithmic
from vibrojax.results.variables import axis_unit, with_unit

STEPS = 100
"""Steps of a slider over its range."""
HOVER = 40
"""Milliseconds between two looks at where the mouse is."""
REST = 0.25
"""Seconds after which the sliders rest."""
HELP = (
    "Move over the curve to see the orbit under the cursor, or slide along it here. "
    "&#9654; forward sweep, &#9655; (hollow, to the left) backward sweep; solid stable, dashed "
    "unstable."
)


class Panel:
    """Sliders and picture of an `Explorer`, and what they say."""

    def __init__(self, explorer: Any):
        self._explorer = explorer
        self._picture = explorer.picture()
        self._sliders = {name: _slider(name, s) for name, s in explorer.sliders.items()}
        self._image = ipywidgets.Image(
            format="png", layout={"width": "100%", "max_width": "1100px"}
        )
        self._along = ipywidgets.FloatSlider(
            min=0.0, max=1.0, step=0.005, description="along the curve", readout=False, **_wide()
        )
        self._words = ipywidgets.HTML()
        self._at: int | None = None
        self._place: tuple[float, float] | None = None
        """Frequency and response of the orbit shown, to find it again on the next curve."""
        for slider in self._sliders.values():
            slider.observe(self._moved, "value")
        self._along.observe(self._slid, "value")
        self._busy = False
        self._winds, self._later = False, None
        self._make_room()
        grid = ipywidgets.GridBox(
            list(self._sliders.values()),
            layout={"grid_template_columns": "repeat(2, minmax(300px, 540px))"},
        )
        self.box = ipywidgets.VBox([grid, self._image, self._along, self._words])
        self._watch()
        self._moved(None)

    @property
    def values(self) -> dict[str, float]:
        """What the sliders show."""
        return {name: float(slider.value) for name, slider in self._sliders.items()}

    def _make_room(self) -> None:
        """Let the axes hold the curves at the ends of all sliders, so that they stay still."""
        start = {name: slider.start for name, slider in self._explorer.sliders.items()}
        for name, slider in self._explorer.sliders.items():
            for end in (slider.low, slider.high):
                at = start | {name: end}
                self._picture.make_room(self._explorer.quick_curve(False, **at))

    def _watch(self) -> None:
        """Follow the mouse, where ipyevents is installed."""
        try:
            from ipyevents import Event
        except ImportError:
            return
        self._event = Event(source=self._image, watched_events=["mousemove", "click"], wait=HOVER)
        self._event.on_dom_event(self._hovered)

    def _moved(self, _: Any) -> None:
        """A slider has moved: a new curve, and the orbit nearest to the one before."""
        begun = time.perf_counter()
        if self._later is not None:
            self._later.cancel()
            self._later = None
        try:
            curve = self._explorer.quick_curve(self._winds, **self.values)
        except ValueError as refusal:
            self._words.value = f"These numbers are refused: {html.escape(str(refusal))}"
            return
        self._take(curve, begun)
        self._winds = curve.harmonics is not None
        if self._winds:
            with contextlib.suppress(RuntimeError):  # without the loop of a kernel
                self._later = asyncio.get_running_loop().call_later(REST, self._rested)

    def _rested(self) -> None:
        """The sliders rest: the whole of a curve that winds."""
        begun = time.perf_counter()
        curve = self._explorer.curve(**self.values)
        self._winds = len(curve.frequency) > MOST_QUICK_POINTS
        self._take(curve, begun)

    def _take(self, curve: LiveCurve, begun: float) -> None:
        self._curve = curve
        self._picture.show_curve(curve)
        # The point of the new curve nearest to the orbit that was shown.
        self._at = None
        if len(curve.frequency):
            place = self._place
            self._at = self._picture.nearest_to(*place) if place else highest_stable(curve)
        self._draw(begun)

    def _hovered(self, event: dict[str, Any]) -> None:
        width, height = event["boundingRectWidth"], event["boundingRectHeight"]
        if width and height:
            x, y = event["relativeX"] / width, event["relativeY"] / height
            self._go_to(self._picture.nearest(x, y))

    def _slid(self, change: dict[str, Any]) -> None:
        if not self._busy and len(self._curve.frequency):
            self._go_to(round(change["new"] * (len(self._curve.frequency) - 1)))

    def _go_to(self, at: int | None) -> None:
        if at is not None and at != self._at:
            self._at, self._place = at, None
            self._draw(time.perf_counter())

    def _draw(self, begun: float) -> None:
        curve, at = self._curve, self._at
        self._picture.show_orbit(curve, at)
        self._image.value = self._picture.png()
        seconds = time.perf_counter() - begun
        self._words.value = f"{self._explorer.sentence(curve, at, seconds)}<br>{HELP}"
        if at is None:
            return
        self._place = float(curve.frequency[at]), float(curve.response[at])
        self._busy = True  # its own move is no order
        self._along.value = at / max(len(curve.frequency) - 1, 1)
        self._busy = False


def _wide() -> dict[str, Any]:
    return {"style": {"description_width": "150px"}, "layout": {"width": "98%"}}


def _slider(name: str, slider: Range) -> Any:
    low, high, kind = slider.low, slider.high, ipywidgets.FloatSlider
    if is_logarithmic(slider):
        low, high, kind = np.log10(low), np.log10(high), ipywidgets.FloatLogSlider
    return kind(
        value=slider.start,
        min=low,
        max=high,
        step=(high - low) / STEPS,
        description=with_unit(name, axis_unit(name)),
        readout_format=".4g",
        **_wide(),
    )
