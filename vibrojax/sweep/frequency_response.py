"""The result of a frequency sweep: curves in both directions, their jumps, and where they go."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from vibrojax._tools.checks import check_known
from vibrojax._tools.signatures import validated
from vibrojax.results.axes import coordinates_of, view_of
from vibrojax.results.derived import AbstractRatios
from vibrojax.results.saving import AbstractSaved
from vibrojax.results.status import Status
from vibrojax.results.variables import RESPONSE, VARIABLES, described_as

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

Array = np.ndarray
CURVES = (*RESPONSE, "period", "status", "periods_marched", "steps")
MEASURES = (
    "jump_up",
    "jump_down",
    "natural_frequency",
    "peak_amplitude_ratio",
    "peak_frequency",
    "resonance_shift",
)


def _highest(values: Array) -> Any:
    """Largest value along the last axis, leaving NaN out; NaN where there is nothing else."""
    highest = np.max(np.where(np.isnan(values), -np.inf, values), axis=-1)
    return np.where(np.isneginf(highest), np.nan, highest)[()]


class FrequencyResponse(AbstractSaved, AbstractRatios):
    """Steady responses on a frequency axis, with the state carried along each direction.

    Curves have the shape (axes of the call..., directions, frequencies), frequencies ascending in
    both directions. Frequencies are in the unit that was asked for (`axis`). Ratios are over the
    drive amplitude; displacements are of the tip, relative to the base.
    """

    axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    frequencies: Float[Array, " frequencies"]
    """Drive frequencies, ascending, in the unit of the axis."""
    directions: tuple[str, ...] = eqx.field(static=True)
    """Directions swept: `forward`, `backward`, or one of them."""
    axes: dict[str, Array]
    """The other axes of the call, by name; numbers that go together (`vj.zipped`) as one structured
    array."""
    ratio_units: str = eqx.field(static=True)
    """Unit of the ratios: `1` for base motion, `m/N` for a force, else that of what is reported."""
    amplitude_ratio: Float[Array, "..."]
    """Half peak-to-peak displacement over drive amplitude."""
    peak_ratio: Float[Array, "..."]
    """Largest displacement, either side, over drive amplitude."""
    rms_ratio: Float[Array, "..."]
    """RMS displacement, the mean included, over drive amplitude."""
    first_harmonic_ratio: Float[Array, "..."]
    """Amplitude at the drive frequency over drive amplitude."""
    contact_force: Float[Array, "..."]
    """Largest contact force, N."""
    contact_fraction: Float[Array, "..."]
    """Share of the time in contact, 0 to 1."""
    contacts_per_period: Float[Array, "..."]
    """Contacts per drive period."""
    period: Int[Array, "..."]
    """Drive periods after which the motion repeats; 0 where none was found."""
    status: Int[Array, "..."]
    """Values of `Status`: how each point ended."""
    periods_marched: Int[Array, "..."]
    """Drive periods marched to settle."""
    steps: Int[Array, "..."]
    """Steps taken to settle and measure."""
    natural_frequency: float | Float[Array, "..."]
    """First natural frequency of the unstopped system, Hz, over the axes of the call."""
    jump_up: float | Float[Array, "..."]
    """Where the response jumps up, over the axes of the call; NaN where it does not."""
    jump_down: float | Float[Array, "..."]
    """Where the response jumps down; NaN where it does not."""
    jump_up_bracket: Float[Array, "... 2"]
    """The interval in which the jump up lies, low end first; of no width where it is a fold that
    was solved for, exact to round-off."""
    jump_down_bracket: Float[Array, "... 2"]
    """The interval in which the jump down lies, as that of the jump up."""
    attributes: dict[str, str] = eqx.field(static=True)
    """What was run: rig, settings, versions."""

    @property
    def curves(self) -> tuple[str, ...]:
        """Names of what there is over frequency."""
        return (*CURVES, *self.derived)

    @property
    def peak_amplitude_ratio(self) -> float | Float[Array, "..."]:
        """Largest amplitude ratio of the curves, over the axes of the call."""
        return _highest(_highest(self.amplitude_ratio))

    @property
    def peak_frequency(self) -> float | Float[Array, "..."]:
        """Frequency of the largest amplitude ratio, in the unit of the axis."""
        over_directions = _highest(np.swapaxes(self.amplitude_ratio, -1, -2))
        found = np.isfinite(over_directions).any(axis=-1)
        at = np.argmax(np.where(np.isfinite(over_directions), over_directions, -np.inf), axis=-1)
        return np.where(found, np.asarray(self.frequencies)[at], np.nan)[()]

    @property
    def resonance_shift(self) -> float | Float[Array, "..."]:
        """How far the peak lies above the first natural frequency of the unstopped system.

        As a fraction of that frequency.
        """
        unit = 1.0 if self.axis == "frequency_ratio" else self.natural_frequency
        return self.peak_frequency / unit - 1.0

    @property
    def hysteresis_width(self) -> float | Float[Array, "..."]:
        """Distance between the jumps, in the unit of the axis; 0 where nothing jumps."""
        return np.nan_to_num(np.abs(self.jump_down - self.jump_up))

    @property
    def hysteresis_area(self) -> float | Float[Array, "..."]:
        """Area between the two curves: amplitude ratio times the unit of the axis.

        Raises `ValueError` when only one direction was swept.
        """
        if self.directions != ("forward", "backward"):
            raise ValueError("hysteresis_area needs a sweep in both directions.")
        forward, backward = self.amplitude_ratio[..., 0, :], self.amplitude_ratio[..., 1, :]
        return np.trapezoid(np.abs(forward - backward), np.asarray(self.frequencies), axis=-1)

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset with named dimensions, units, long names and the rig in its attributes.

        Dimensions are the axes of the call, `direction`, and `frequency_ratio` or `frequency`.
        """
        import xarray

        outer = tuple(self.axes)
        axis_units = VARIABLES[self.axis].units

        def described(name: str, dims: tuple[str, ...], values: Any) -> tuple[Any, ...]:
            return dims, np.asarray(values), described_as(name, self.ratio_units, axis_units)

        data: dict[str, Any] = {
            name: described(name, dims, getattr(self, name))
            for names, dims in (
                (self.curves, (*outer, "direction", self.axis)),
                (MEASURES, outer),
            )
            for name in names
        }
        data["status"][2]["flag_values"] = [s.value for s in Status]
        data["status"][2]["flag_meanings"] = " ".join(s.name for s in Status)
        coordinates: dict[str, Any] = coordinates_of(self.axes)
        directions = described_as("direction")
        coordinates["direction"] = ("direction", list(self.directions), directions)
        coordinates[self.axis] = described(self.axis, (self.axis,), self.frequencies)
        return xarray.Dataset(data, coordinates, attrs=dict(self.attributes))

    @validated
    def plot(self, variable: str = "amplitude_ratio", **selection: Any) -> "Figure":
        """Draw one variable against frequency, both directions, jumps marked.

        `selection` picks one value (nearest) of each other axis, which is drawn as lines where it
        is left out. Raises `ValueError` for an unknown variable or axis.
        """
        check_known("variable", variable, self.curves)
        directions = self.directions
        if (wanted := selection.pop("direction", None)) is not None:
            if wanted not in directions:
                raise ValueError(
                    f"direction must be one of those swept, {', '.join(directions)}, got "
                    f"{wanted!r}."
                )
            directions = (wanted,)
        view = view_of(self.to_xarray(), self.axes, selection, "plot", others=("direction",))
        from vibrojax.plot.frequency_response import plot_frequency_response

        return plot_frequency_response(view, variable, directions)

    def __repr__(self) -> str:
        shape = ", ".join(f"{name}: {len(v)}" for name, v in self.axes.items())
        lines = [
            f"FrequencyResponse({shape + ', ' if shape else ''}"
            f"direction: {len(self.directions)}, {self.axis}: {len(self.frequencies)})"
        ]
        if not self.axes:
            lines += [
                f"  peak amplitude ratio  {self.peak_amplitude_ratio:.4f} at {self.axis} "
                f"{self.peak_frequency:.5f}",
                "  jump up, jump down    "
                f"{_jump(self.jump_up_bracket)}, {_jump(self.jump_down_bracket)}",
                f"  hysteresis width      {self.hysteresis_width:.5f}",
            ]
        count = np.bincount(np.asarray(self.status).ravel(), minlength=len(Status))
        tally = ", ".join(f"{count[s.value]} {s.name}" for s in Status if count[s.value])
        return "\n".join([*lines, f"  points                {tally}"])


def _jump(bracket: Float[Array, " 2"]) -> str:
    """Say where a jump is, and whether it was solved for."""
    low, high = (float(end) for end in bracket)
    return f"{(low + high) / 2:.5f}" + (" (a fold, exact)" if low == high else "")
