"""Results about regimes: kinds of motion of every lane, and along a parameter."""

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from vibrojax._tools.checks import check_known
from vibrojax._tools.signatures import validated
from vibrojax.results.axes import coordinates_of, lane_of, pick, place_of, view_of
from vibrojax.results.saving import AbstractSaved
from vibrojax.results.status import Status
from vibrojax.results.variables import described_as, described_statistic
from vibrojax.steady.kinds import Regime

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

Array = np.ndarray
INNER = {"displacement": "strobe", "velocity": "strobe", "spectrum": "order"}
"""Variables with a dimension of their own behind those of the lanes."""
FLAGS = {
    "regime": [kind.name for kind in Regime],
    "status": [status.name for status in Status],
}


class AbstractRegimeTable(AbstractSaved):
    """Variables over lanes, read by name: `table["strain_power_rms"]`."""

    variables: eqx.AbstractVar[dict[str, Array]]
    orders: eqx.AbstractVar[Float[Array, " orders"] | None]
    ratio_units: eqx.AbstractVar[str]
    attributes: eqx.AbstractVar[dict[str, str]]

    @property
    @abstractmethod
    def coordinates(self) -> dict[str, Array]:
        """Values along every dimension of the lanes."""

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions of the lanes."""
        return tuple(self.coordinates)

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset with named dimensions, units and long names."""
        import xarray

        own: dict[str, Any] = coordinates_of(self.coordinates)
        data: dict[str, Any] = {}
        for name, values in self.variables.items():
            known = described_statistic(name)
            units = self.ratio_units if known.units == "ratio" else known.units
            about: dict[str, Any] = {"units": units, "long_name": known.long_name}
            if name in FLAGS:
                about["flag_values"] = list(range(len(FLAGS[name])))
                about["flag_meanings"] = " ".join(FLAGS[name])
            inner = (INNER[name],) if name in INNER else ()
            data[name] = ((*self.dims, *inner), values, about)
        if "displacement" in self.variables:
            own["strobe"] = np.arange(self.variables["displacement"].shape[-1])
        if self.orders is not None and "spectrum" in self.variables:
            own["order"] = self.orders
        found = xarray.Dataset(data, own, attrs=dict(self.attributes))
        for name in {"strobe", "order", "direction"} & set(own):
            found[name].attrs |= described_as(name)
        return found

    def __getitem__(self, name: str) -> Array:
        check_known("variable", name, self.variables)
        return self.variables[name]

    @property
    def period(self) -> Int[Array, "..."]:
        """Drive periods after which the motion repeats; 0 where none was found."""
        return self.variables["period"]

    @property
    def regime(self) -> Int[Array, "..."]:
        """Kind of motion, as the values of `Regime`."""
        return self.variables["regime"]

    @property
    def lyapunov_exponent(self) -> Float[Array, "..."]:
        """Largest Lyapunov exponent, 1/s."""
        return self.variables["lyapunov_exponent"]

    @property
    def lyapunov_standard_error(self) -> Float[Array, "..."]:
        """Standard error of the exponent, 1/s."""
        return self.variables["lyapunov_standard_error"]

    def _words(self) -> list[str]:
        """Return name and shape, and how many lanes there are of each kind of motion."""
        shape = ", ".join(f"{name}: {len(v)}" for name, v in self.coordinates.items())
        count = np.bincount(np.asarray(self.regime).ravel(), minlength=len(Regime))
        motions = ", ".join(f"{count[r.value]} {r.word}" for r in Regime if count[r.value])
        return [f"{type(self).__name__}({shape})", f"  motions   {motions}"]


class Regimes(AbstractRegimeTable):
    """Kinds of motion over the axes of the call, the starts and the drive frequency.

    `regimes["strain_power_rms"]` is a variable by name; all have the dimensions of `dims`, the
    strobed `displacement` and `velocity` a dimension `strobe` behind them, the `spectrum` one of
    `order`, the frequency over that of the drive.
    """

    axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    frequencies: Float[Array, " frequencies"]
    """Drive frequencies, in the unit of the axis."""
    axes: dict[str, Array]
    """The other axes, by name; the last is `start` where several starts were given."""
    variables: dict[str, Array]
    """Variables by name, over the dimensions `dims` (and `strobe`, `order`)."""
    orders: Float[Array, " orders"] | None
    """Frequencies of the spectrum over the drive frequency; None where there is none."""
    starts: Float[Array, "starts states"]
    """Initial states (q, q', memories) at drive phase 0."""
    ratio_units: str = eqx.field(static=True)
    """Unit of ratios: `1` for base motion, `m/N` for a force."""
    attributes: dict[str, str] = eqx.field(static=True)
    """What was run: rig, settings, versions."""

    @property
    def coordinates(self) -> dict[str, Array]:
        """Values along every dimension of the lanes."""
        return self.axes | {self.axis: np.asarray(self.frequencies)}

    @validated
    def fraction(self, kind: str) -> float:
        """Return the share of the lanes of a kind: `periodic`, `chaotic`, ...

        Raises `ValueError` for an unknown kind.
        """
        known = [r.name for r in Regime]
        check_known("kind", kind, known)
        return float(np.mean(self.regime == Regime[kind].value))

    def plot(self, **selection: Any) -> "Figure":
        """Draw kind, period and exponent against frequency: a strip, or a map over one more axis.

        `selection` picks one value (nearest) of other axes. Raises `ValueError` for an unknown
        axis, or where more than one is left.
        """
        view = view_of(self.to_xarray(), self.axes, selection, "plot")
        from vibrojax.plot.regime import plot_regimes

        return plot_regimes(view)

    def poincare(self, **selection: Any) -> "Figure":
        """Draw the Poincaré section of a lane: displacement and velocity at every drive period.

        `selection` picks the lane; one axis may be left out, and its values are shown by
        colour. Raises `ValueError` for an unknown axis, or where more are left.
        """
        view = view_of(self.to_xarray(), self.coordinates, selection, "poincare")
        from vibrojax.plot.regime import plot_poincare

        return plot_poincare(view)

    def plot_spectrum(self, **selection: Any) -> "Figure":
        """Draw the spectrum of the displacement of one lane, picked by `selection`.

        Raises `ValueError` where the lane is not picked, or there are no spectra.
        """
        if self.orders is None:
            raise ValueError("There are no spectra: give spectrum=True to vj.regimes.")
        lane = lane_of(self.to_xarray(), self.coordinates, selection)
        from vibrojax.plot.regime import plot_order_spectrum

        return plot_order_spectrum(lane)

    def __repr__(self) -> str:
        lines = self._words()
        periods = np.unique(self.period[self.period > 0])
        if periods.size:
            lines.append(f"  periods   {', '.join(map(str, periods))}")
        exponent = self.lyapunov_exponent
        if np.isfinite(exponent).any():
            at = np.unravel_index(np.nanargmax(exponent), exponent.shape)
            where = float(np.asarray(self.frequencies)[at[-1]])
            lines.append(
                f"  largest Lyapunov exponent {exponent[at]:.4g} +- "
                f"{self.lyapunov_standard_error[at]:.2g} 1/s at {self.axis} {where:.5g}"
            )
        return "\n".join(lines)


class PeriodChange(NamedTuple):
    """Two neighbouring values between which the period changes."""

    direction: str
    low: float
    high: float
    period_low: int
    """Drive periods at the lower value; 0 where none was found."""
    period_high: int

    @property
    def is_doubling(self) -> bool:
        """Whether the one period is twice the other."""
        low, high = sorted((self.period_low, self.period_high))
        return low > 0 and high == 2 * low


class BifurcationDiagram(AbstractRegimeTable):
    """Motions over one parameter, the state carried along each direction.

    `diagram["displacement"]` is a variable by name: strobed displacements, of the dimensions
    `dims` and `strobe`; the others have the dimensions `dims`.
    """

    parameter: str = eqx.field(static=True)
    """Name of what changes: `frequency` (Hz), `frequency_ratio`, or an argument of the function."""
    values: Float[Array, " values"]
    """Values of the parameter, ascending, in its unit."""
    directions: tuple[str, ...] = eqx.field(static=True)
    """Directions followed: `forward`, `backward`."""
    axes: dict[str, Array]
    """The other axes of the call, by name."""
    variables: dict[str, Array]
    """Variables by name, over the dimensions `dims` (and `strobe`, `order`)."""
    orders: Float[Array, " orders"] | None
    """Frequencies of the spectrum over the drive frequency; None where there is none."""
    ratio_units: str = eqx.field(static=True)
    """Unit of the ratios: `1` for base motion, `m/N` for a force."""
    attributes: dict[str, str] = eqx.field(static=True)
    """What was run: rig, settings, versions."""

    @property
    def coordinates(self) -> dict[str, Array]:
        """Values along every dimension of the lanes."""
        directions = {"direction": np.array(self.directions)}
        return self.axes | directions | {self.parameter: np.asarray(self.values)}

    def period_changes(self, **selection: Any) -> list[PeriodChange]:
        """Return the brackets in which the period changes, by direction and value.

        `selection` picks one value (nearest) of every other axis. Raises `ValueError` for an
        unknown axis, or where one is left.
        """
        index = place_of(self.axes, selection)
        values, found = np.asarray(self.values), []
        for direction, period in zip(self.directions, self.period[index], strict=True):
            for k in np.flatnonzero(np.diff(period)):
                bracket = float(values[k]), float(values[k + 1])
                found.append(PeriodChange(direction, *bracket, int(period[k]), int(period[k + 1])))
        return found

    def period_doublings(self, **selection: Any) -> list[PeriodChange]:
        """Return the brackets in which the period doubles or halves; see `period_changes`.

        `selection` picks a value of each other axis, as there. Raises `ValueError` for an
        unknown axis.
        """
        return [change for change in self.period_changes(**selection) if change.is_doubling]

    def plot(self, **selection: Any) -> "Figure":
        """Draw strobed displacements and exponents against the parameter, in both directions.

        `selection` picks one value (nearest) of every other axis, or a `direction`. Raises
        `ValueError` for an unknown axis, or where one is left.
        """
        dataset = self.to_xarray()
        if (direction := selection.pop("direction", None)) is not None:
            index, _ = pick({"direction": np.array(self.directions)}, {"direction": direction})
            dataset = dataset.isel(direction=[*index])
        lane = lane_of(dataset, self.axes, selection)
        from vibrojax.plot.regime import plot_bifurcation_diagram

        return plot_bifurcation_diagram(lane)

    def __repr__(self) -> str:
        lines = self._words()
        if not self.axes:
            lines += [
                f"  {c.direction:9} period {c.period_low or 'none'} to {c.period_high or 'none'} "
                f"between {c.low:.6g} and {c.high:.6g}"
                for c in self.period_changes()
            ]
        return "\n".join(lines)
