"""The explorer: sliders, a frequency response that follows them, and the orbit under the cursor."""

import base64
import os
from typing import TYPE_CHECKING, Any

from vibrojax._tools.checks import check_known
from vibrojax._tools.files import path_of
from vibrojax._tools.signatures import validated
from vibrojax.branches.branch import Branch
from vibrojax.branches.continuation import Ending
from vibrojax.branches.continue_response import continue_response
from vibrojax.ensemble.ranges import Range
from vibrojax.explorer.live_curve import (
    CurveTracer,
    LiveCurve,
    LiveOrbit,
    highest_stable,
    nearest_point,
    orbit_at,
)
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.saving import whole_files
from vibrojax.results.variables import axis_unit, named_value

if TYPE_CHECKING:
    from vibrojax.explorer.picture import LivePicture

NOTE = "A still picture: the sliders are there where the notebook runs (in Jupyter, ipywidgets)."


class Explorer:
    """A frequency response with sliders, as `explore` makes it.

    In a notebook with ipywidgets it shows itself with its sliders; elsewhere, and in a saved
    notebook, as a still picture. What the sliders say is in `values`; `system()` and `branch()`
    take it further.

    Parameters:
        tracer: makes the curve from the numbers.
        sliders: ranges and starts, by name of the number.
        labels: of the axes of the response, below and beside.
        measured: points to be laid over.
    """

    def __init__(
        self,
        tracer: CurveTracer,
        sliders: dict[str, Range],
        labels: tuple[str, str],
        measured: tuple[MeasuredCurve, ...] = (),
    ):
        self._tracer, self.sliders, self._labels = tracer, sliders, labels
        self._measured = measured
        self._panel: Any = None

    @property
    def values(self) -> dict[str, float]:
        """The numbers that the sliders show; without sliders on screen, where they start."""
        if self._panel is not None:
            return self._panel.values
        return {name: slider.start or 0.0 for name, slider in self.sliders.items()}

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
        moved = []
        for name, slider in self.sliders.items():
            unit = "" if axis_unit(name) == "1" else f" {axis_unit(name)}"
            moved.append(f"{name} {slider.low:g} to {slider.high:g}{unit}")
        return f"Explorer({', '.join(moved)})\n  {NOTE}"

    def _numbers(self, numbers: dict[str, float]) -> dict[str, float]:
        for name in numbers:
            check_known("number", name, self.sliders)
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
        return self._tracer(self._checked(numbers))

    @validated
    def quick_curve(self, winds: bool, **numbers: float) -> LiveCurve:
        """Return the curve of `numbers`, or where it winds (for `winds` at once) a quick look.

        Raises `ValueError` as `system` does.
        """
        return self._tracer.quick(self._checked(numbers), winds)

    def _checked(self, numbers: dict[str, float]) -> dict[str, float]:
        chosen = self._numbers(numbers)
        self._tracer.system(chosen)  # concrete numbers are checked, traced ones are not
        return chosen

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
        frequencies: dict[str, Any] = {tracer.axis: Range(tracer.low, tracer.high)}
        found = continue_response(self.system(**numbers), **frequencies)
        assert isinstance(found, Branch)
        return found

    def picture(self) -> "LivePicture":
        """Return an empty picture with its axes and the measured points."""
        from vibrojax.explorer.picture import LivePicture

        tracer = self._tracer
        rows = 2 if self._measured else 1
        unit = self.system().drive.reference[1]
        picture = LivePicture((tracer.low, tracer.high), *self._labels, rows=rows, unit=unit)
        for one in self._measured:
            picture.lay_measured(one, tracer.force)
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
            picture.show_orbit(curve, at)
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
        look = f"A quick look with {curve.harmonics} harmonics: the curve winds. "
        return (
            f"Orbit at {curve.frequency[at]:.5g}{unit}: {stable} (largest multiplier "
            f"{curve.leading_multiplier[at]:.3g}), response {curve.response[at]:.4g}, contact "
            f"force {curve.contact_force[at]:.3g} N. Folds: {folds}. "
            f"{look if curve.harmonics is not None else ''}"
            f"{f'{curve.ending.sentence} ' if curve.ending is not Ending.completed else ''}"
            f"Drawn in {1e3 * seconds:.0f} ms."
        )


def kernel_is_live() -> bool:
    """Whether this runs in the kernel of a notebook."""
    try:
        from IPython.core.getipython import get_ipython
    except ImportError:
        return False
    return hasattr(get_ipython(), "kernel")
