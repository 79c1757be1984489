"""The explorer: sliders, a frequency response that follows them, and the orbit under the cursor."""

import base64
import os
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vibrojax._tools.checks import nearest
from vibrojax._tools.files import path_of
from vibrojax._tools.signatures import validated
from vibrojax.branches.branch import Branch
from vibrojax.branches.continuation import Ending
from vibrojax.branches.continue_response import continue_response
from vibrojax.explorer.live_curve import CurveTracer, LiveCurve, highest_stable, nearest_point
from vibrojax.explorer.live_orbit import LiveOrbit, orbit_at
from vibrojax.explorer.sliders import Slider, unit_of
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.saving import whole_files
from vibrojax.results.variables import named_value

if TYPE_CHECKING:
    from vibrojax.explorer.picture import LivePicture

NOTE = "A still picture: the sliders are there where the notebook runs (in Jupyter, ipywidgets)."


class Measurement(NamedTuple):
    """A measured curve and which of its channels is drawn."""

    curve: MeasuredCurve
    values: np.ndarray


class Explorer:
    """A frequency response with sliders, as `explore` makes it.

    In a notebook with ipywidgets it shows itself with its sliders; elsewhere, and in a saved
    notebook, as a still picture. What the sliders say is in `values`; `system()` and `branch()`
    take it further.

    Parameters:
        tracer: makes the curve from the numbers.
        sliders: ranges and starts, by name of the number.
        labels: of the axes of the response, below and beside.
        force: whether the contact force is what is drawn against frequency.
        measured: points to be laid over.
    """

    def __init__(
        self,
        tracer: CurveTracer,
        sliders: dict[str, Slider],
        labels: tuple[str, str],
        force: bool,
        measured: tuple[Measurement, ...] = (),
    ):
        self._tracer, self.sliders, self._labels = tracer, sliders, labels
        self._force = force
        self._measured = measured
        self._start = {name: slider.value for name, slider in sliders.items()}
        self._panel: Any = None

    @property
    def values(self) -> dict[str, float]:
        """The numbers that the sliders show; without sliders on screen, where they start."""
        return dict(self._start) if self._panel is None else self._panel.values

    def __dir__(self) -> list[str]:
        return [
            "branch",
            "curve",
            "figure",
            "orbit",
            "save",
            "sliders",
            "system",
            "values",
            "widget",
        ]

    def __repr__(self) -> str:
        moved = [
            f"{name} {slider.low:g} to {slider.high:g} {unit_of(name)}".rstrip()
            for name, slider in self.sliders.items()
        ]
        return f"Explorer({', '.join(moved)})\n  {NOTE}"

    def _numbers(self, numbers: dict[str, float]) -> dict[str, float]:
        for name in numbers:
            if name not in self.sliders:
                raise ValueError(f"Unknown number {name!r}. {nearest(name, self.sliders)}")
        return self.values | {name: float(value) for name, value in numbers.items()}

    @validated
    def system(self, **numbers: float) -> AbstractSystem:
        """Return the system with the numbers of the sliders, or with other `numbers` by name (SI).

        Raises `ValueError` for a name that has no slider, or numbers that the function refuses.
        """
        return self._tracer.system(self._numbers(numbers))

    @validated
    def curve(self, **numbers: float) -> LiveCurve:
        """Return the curve that is drawn for the sliders' or other `numbers` (128 samples).

        Raises `ValueError` as `system` does.
        """
        chosen = self._checked(numbers)
        return self._shown(self._tracer(chosen))

    @validated
    def quick_curve(self, winds: bool, **numbers: float) -> LiveCurve:
        """Return the curve of `numbers`, or where it winds (for `winds` at once) a quick look.

        Raises `ValueError` as `system` does.
        """
        return self._shown(self._tracer.quick(self._checked(numbers), winds))

    def _checked(self, numbers: dict[str, float]) -> dict[str, float]:
        chosen = self._numbers(numbers)
        self._tracer.system(chosen)  # concrete numbers are checked, traced ones are not
        return chosen

    def _shown(self, curve: LiveCurve) -> LiveCurve:
        return curve._replace(response=curve.contact_force) if self._force else curve

    @validated
    def orbit(self, frequency: float, **numbers: float) -> LiveOrbit:
        """Return the orbit nearest to a frequency (ratio or Hz, as drawn).

        Of several motions at one frequency it is the stable one of the largest response. `numbers`
        are others than the sliders show.
        Raises `ValueError` as `system` does, and where no curve was found.
        """
        curve = self.curve(**numbers)
        return orbit_at(curve, nearest_point(curve, frequency))

    @validated
    def branch(self, **numbers: float) -> Branch:
        """Return the exact branch (`continue_response`) of the sliders' or other `numbers`.

        Raises `ValueError` as `system` does.
        """
        tracer = self._tracer
        frequencies: dict[str, Any] = {tracer.axis: (tracer.low, tracer.high)}
        found = continue_response(self.system(**numbers), **frequencies)
        assert isinstance(found, Branch)
        return found

    def picture(self) -> "LivePicture":
        """Return an empty picture with its axes and the measured points."""
        from vibrojax.explorer.picture import LivePicture

        tracer = self._tracer
        rows = 2 if self._measured else 1
        picture = LivePicture((tracer.low, tracer.high), *self._labels, rows=rows)
        for measured, values in self._measured:
            picture.lay_measured(measured, values)
        picture.legend()
        return picture

    @validated
    def figure(self, frequency: float | None = None, **numbers: float) -> Any:
        """Return the still picture as a matplotlib figure.

        `frequency` is that of the orbit drawn (ratio or Hz, as on the axis; by default the one of
        the largest response), `numbers` are others than the sliders show. Raises `ValueError` as
        `system` does.
        """
        return self._still(frequency, numbers).figure

    @validated
    def save(
        self, path: str | os.PathLike[str], frequency: float | None = None, **numbers: float
    ) -> None:
        """Write the still picture to the file `path` (PNG, SVG, PDF by its ending).

        `frequency` and `numbers` are those of `figure`. Raises `ValueError` as `system` does, or
        for a path that cannot be a file's; `OSError` where writing fails.
        """
        ending = path_of("path", path).suffix or ".png"
        with whole_files(path if str(path).endswith(ending) else f"{path}{ending}") as (part,):
            self.figure(frequency, **numbers).savefig(part, format=ending[1:])

    def _still(self, frequency: float | None, numbers: dict[str, float]) -> "LivePicture":
        chosen = self._numbers(numbers)
        picture, curve = self.picture(), self.curve(**chosen)
        picture.show_curve(curve)
        if len(curve.frequency):
            at = highest_stable(curve) if frequency is None else nearest_point(curve, frequency)
            picture.show_orbit(curve, orbit_at(curve, at), at)
        picture.freeze(", ".join(named_value(n, float(f"{v:.4g}")) for n, v in chosen.items()))
        return picture

    @property
    def widget(self) -> Any:
        """The sliders and the picture as an ipywidgets box, to put into a layout of one's own.

        Raises `ImportError` where ipywidgets is not installed.
        """
        if self._panel is None:
            from vibrojax.explorer.panel import Panel

            self._panel = Panel(self)
        return self._panel.box

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        """Show sliders in a live notebook; in all others a still picture with a note."""
        bundle: dict[str, Any] = {"text/plain": repr(self)}
        if kernel_is_live():
            try:
                bundle |= self.widget._repr_mimebundle_()
            except ImportError:
                bundle["text/plain"] += "\n  For sliders: pip install ipywidgets ipyevents"
        still = self._still(None, {})
        still.note(NOTE)
        bundle["image/png"] = base64.b64encode(still.png()).decode()
        return bundle

    def sentence(self, curve: LiveCurve, at: int | None, seconds: float) -> str:
        """Say in words what is drawn: the point `at` of the `curve`, and in how many `seconds`."""
        if at is None or not len(curve.frequency):
            return f"Nothing to draw here: {curve.ending.sentence}"
        unit = "" if self._tracer.axis == "frequency_ratio" else " Hz"
        stable = "stable" if curve.stable[at] else "unstable"
        folds = ", ".join(f"{value:.5g}{unit}" for _, value in curve.folds[:6]) or "none"
        words = (
            f"Orbit at {curve.frequency[at]:.5g}{unit}: {stable} (largest multiplier "
            f"{curve.leading_multiplier[at]:.3g}), response {curve.response[at]:.4g}, contact "
            f"force {curve.contact_force[at]:.3g} N. Folds: {folds}. "
        )
        if curve.harmonics is not None:
            words += f"A quick look with {curve.harmonics} harmonics: the curve winds. "
        if curve.ending is not Ending.completed:
            words += f"{curve.ending.sentence} "
        return words + f"Drawn in {1e3 * seconds:.0f} ms."


def kernel_is_live() -> bool:
    """Whether this runs in the kernel of a notebook."""
    try:
        from IPython.core.getipython import get_ipython
    except ImportError:
        return False
    return hasattr(get_ipython(), "kernel")
