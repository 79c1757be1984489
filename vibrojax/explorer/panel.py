"""The explorer in a notebook: ipywidgets around the picture."""

import asyncio
import contextlib
import html
import time
from collections.abc import Callable
from typing import Any

import ipywidgets
import numpy as np

from vibrojax.ensemble.ranges import Range
from vibrojax.explorer.live_curve import MOST_QUICK_POINTS, LiveCurve, highest_stable
from vibrojax.explorer.sliders import is_logarithmic
from vibrojax.results.variables import axis_unit, with_unit

Numbers = dict[str, float]

STEPS = 100
"""Steps of a slider over its range."""
HOVER = 40
"""Milliseconds between two looks at where the mouse is."""
REST, AHEAD = 0.25, 0.01
"""Seconds after which the sliders rest, and after which the next step of one is computed."""
ONE_STEP = 1.2
"""Largest move, in steps of the slider, that is expected to be made again."""
SAME = 1e-9
"""Relative difference by which a slider may round."""
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
        self._busy, self._winds = False, False
        self._timers: list[asyncio.TimerHandle] = []
        """Of what is done when the sliders stay as they are."""
        self._ahead: tuple[Numbers, LiveCurve] | None = None
        """Numbers that the sliders are expected to show next, and their curve."""
        self._make_room()
        grid = ipywidgets.GridBox(
            list(self._sliders.values()),
            layout={"grid_template_columns": "repeat(2, minmax(300px, 540px))"},
        )
        self.box = ipywidgets.VBox([grid, self._image, self._along, self._words])
        self._watch()
        self._moved(None)

    @property
    def values(self) -> Numbers:
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

    def _moved(self, change: dict[str, Any] | None) -> None:
        """A slider has moved: a new curve, and the orbit nearest to the one before."""
        begun = time.perf_counter()
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
        now, ahead = self.values, self._ahead
        self._ahead = None
        try:
            if ahead is not None and np.allclose(
                [*ahead[0].values()], [*now.values()], rtol=SAME, atol=0.0
            ):
                curve = ahead[1]
            else:
                curve = self._explorer.quick_curve(self._winds, **now)
        except ValueError as refusal:
            self._words.value = f"These numbers are refused: {html.escape(str(refusal))}"
            return
        self._take(curve, begun)
        self._winds = curve.harmonics is not None
        following = self._once_more(change)
        if following is not None:
            self._after(AHEAD, self._look_ahead, following)
        if self._winds:
            self._after(REST, self._rested)

    def _after(self, seconds: float, action: Callable[..., None], *arguments: Any) -> None:
        """Do something later, if no slider moves until then."""
        with contextlib.suppress(RuntimeError):  # without the loop of a kernel
            loop = asyncio.get_running_loop()
            self._timers.append(loop.call_later(seconds, action, *arguments))

    def _once_more(self, change: dict[str, Any] | None) -> Numbers | None:
        """Return the numbers after another step of the slider that has just made one; or None."""
        if change is None:
            return None
        slider, places = change["owner"], np.array([change["old"], change["new"]])
        is_log = isinstance(slider, ipywidgets.FloatLogSlider)
        before, now = np.log10(places) if is_log else places
        place = now + (now - before)
        if abs(now - before) > ONE_STEP * slider.step or not slider.min <= place <= slider.max:
            return None
        (name,) = (name for name, own in self._sliders.items() if own is slider)
        return self.values | {name: float(10**place if is_log else place)}

    def _look_ahead(self, following: Numbers) -> None:
        """Compute the curve that is drawn at once if the slider goes on as it did."""
        with contextlib.suppress(ValueError):  # a step may lead to numbers that are refused
            self._ahead = following, self._explorer.quick_curve(self._winds, **following)

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
