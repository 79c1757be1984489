"""A beam with piezoelectric layers and a load: vibration energy harvesting with stops."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float

from vibrojax._tools.checks import check_choice, check_positive, number_field
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive, Values
from vibrojax.model.equations import LinearEquations
from vibrojax.model.impacting_beam import ImpactingBeam
from vibrojax.model.internal_states import InternalStates
from vibrojax.model.piezo import PiezoLayers
from vibrojax.model.states import Displacement
from vibrojax.model.stops import Stop
from vibrojax.model.systems import AbstractSystem

Number = float | Float[Array, "..."]
UNITS = {"voltage": "V", "power": "W^0.5"}
"""Unit of what is reported; that of a displacement is one over the drive amplitude."""


class AsMeasured(AbstractDrive):
    """A drive over whose amplitude responses are not divided."""

    drive: AbstractDrive
    unit: str = eqx.field(static=True)

    def complex_amplitude(self, rate: Values, second: Values) -> Complex[Array, "..."]:
        """Return that of the drive."""
        return self.drive.complex_amplitude(rate, second)

    @property
    def reference(self) -> tuple[ArrayLike, str]:
        """1, and the unit of the response."""
        return 1.0, self.unit

    @property
    def signal_factor(self) -> float:
        """That of the drive."""
        return self.drive.signal_factor

    def with_amplitude(self, amplitude: ArrayLike) -> "AsMeasured":
        """Return the same of the drive with another `amplitude`, m or N."""
        return AsMeasured(self.drive.with_amplitude(amplitude), self.unit)


@validated
class Harvester(AbstractSystem):
    """A cantilever with piezoelectric layers, a resistive load, and stops if it has any.

    With modes q of modal mass m and natural angular frequency w, and the voltage v of the layers,

        m_i (q_i'' + 2 zeta_i w_i q_i' + w_i^2 q_i) + theta_i v = drive and contact,
        capacitance v' = sum of theta_i q_i' - i,

    with the current i = v/resistance, or through an inductance as well. Source: Erturk and Inman
    2008, 2009. It is linear between contacts: sweeps, branches, maps and all else are exact.

    What results report is the voltage of the load, V, the power in it, or the displacement of the
    tip over the drive amplitude. Of the `power` they have `mean_power` and `peak_power`, W, and
    their ratios are the root of it, W^0.5; of the `voltage` they have `voltage`, V.

    Raises `ValueError` for a resistance or inductance that is not above 0, or an unknown word.
    """

    rig: ImpactingBeam
    """The beam with its stops, drive and damping."""
    layers: PiezoLayers
    """The piezoelectric layers."""
    resistance: Number = number_field("ohm")
    """Load resistance, ohm."""
    inductance: Number | None = number_field("H", default=None)
    """Inductance, H; None for none."""
    inductor: str = eqx.field(static=True, default="series")
    """Whether the inductance is in `series` with the load or `parallel` to it."""
    report: str = eqx.field(static=True, default="power")
    """What results report: `power`, `voltage` or `displacement`."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are no circuit."""
        check_positive("resistance", self.resistance, "ohm")
        if self.inductance is not None:
            check_positive("inductance", self.inductance, "H")
        check_choice("inductor", self.inductor, ("series", "parallel"))
        check_choice("report", self.report, ("power", "voltage", "displacement"))

    @property
    def drive(self) -> AbstractDrive:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What drives the beam."""
        if self.report == "displacement":
            return self.rig.drive
        return AsMeasured(self.rig.drive, UNITS[self.report])

    @property
    def stops(self) -> tuple[Stop, ...]:
        """The stops of the beam."""
        return self.rig.stops

    def with_stops(
        self, stops: tuple[Stop, ...], stop_map: Float[Array, "stops coordinates"] | None = None
    ) -> "Harvester":
        """Return the harvester with further `stops` at its beam; there is no `stop_map`."""
        return replace(self, rig=self.rig.with_stops(stops, stop_map))

    def coupling(self) -> Float[Array, " modes"]:
        """Modal force of a unit voltage, theta, N/V, or charge per modal coordinate, C/m."""
        ends = jnp.stack([self.layers.start, self.layers.end])
        slopes = self.rig.modes().shape(ends, derivative=1)
        moment = jnp.asarray(self.layers.moment_per_volt)
        return moment * (slopes[1] - slopes[0]) / self.rig.beam.length

    def equations(self) -> LinearEquations:
        """Put the circuit with the modes of the beam."""
        base, theta = self.rig.equations(), self.coupling()
        capacitance, resistance = (
            jnp.asarray(a, float) for a in (self.layers.capacitance, self.resistance)
        )
        none = jnp.zeros_like(theta)
        into = theta / capacitance
        if self.inductance is None:
            flow = jnp.array([[-1.0]]) / (resistance * capacitance)
            load, weight, names = jnp.ones(1), [capacitance], ("voltage",)
        else:
            inductance = jnp.asarray(self.inductance, float)
            weight, names = [capacitance, inductance], ("voltage", "current")
            if self.inductor == "series":
                rows = [[0.0, -1 / capacitance], [1 / inductance, -resistance / inductance]]
                load = jnp.stack([0.0, resistance])
            else:
                rows = [[-1 / (resistance * capacitance), -1 / capacitance], [1 / inductance, 0.0]]
                load = jnp.array([1.0, 0.0])
            flow = jnp.stack([jnp.stack([jnp.asarray(a) for a in row]) for row in rows])
        count, size = len(names), len(theta)
        internal = InternalStates(
            flow=flow,
            from_displacement=jnp.zeros((count, size)),
            from_velocity=jnp.stack([into, none][:count]),
            from_input=jnp.zeros(count),
            from_force=jnp.zeros((count, len(self.stops))),
            acceleration=jnp.stack([-theta / base.modal_mass, none][:count], axis=1),
            response=load / jnp.sqrt(resistance) if self.report == "power" else load,
            weight=jnp.sqrt(jnp.stack(weight)),
            names=names,
            reports=self.report != "displacement",
        )
        return replace(base, internal=internal)

    @validated(traceable=True)
    def optimal_resistance(self, frequency: ArrayLike) -> Float[Array, ""]:
        """Return the load, ohm, that takes most power at a `frequency` (Hz), without stops.

        That is 1 over the size of the admittance of the layers and the beam behind them, from the
        short circuit of the source (Erturk and Inman 2008, 2009). An inductance is
        left out.
        """
        w = 2 * np.pi * jnp.asarray(frequency)
        base, theta = self.rig.equations(), self.coupling()
        natural = base.angular_frequency
        dynamic = natural**2 - w**2 + 2j * base.damping_ratio * natural * w
        moved = jnp.sum(theta**2 / base.modal_mass / dynamic)
        return 1 / jnp.abs(1j * w * (jnp.asarray(self.layers.capacitance) + moved))

    @property
    def reported_place(self) -> float:
        """The tip, x/L = 1: where histories have their displacement."""
        return self.rig.reported_place

    def shape_at(self, position: ArrayLike) -> Float[Array, " modes"]:
        """Return the mode shapes at a place x/L; `position` is from 0 (root) to 1 (tip)."""
        return self.rig.shape_at(position)

    def flexibility_left_out(self) -> list[float] | None:
        """Static flexibility at each stop that the modes kept lack, m/N."""
        return self.rig.flexibility_left_out()

    def modal_coordinates(self, displacement: Displacement) -> Float[Array, " modes"]:
        """Return the modal coordinates (m) of a displacement, as an `ImpactingBeam` does.

        `displacement` is a function of x/L or a dict of numbers (m) by place. Raises `ValueError`
        for anything else.
        """
        return self.rig.modal_coordinates(displacement)

    def static_shape(self, tip_displacement: ArrayLike) -> Float[Array, " modes"]:
        """Return the modal coordinates (m) of the beam pulled at its tip to `tip_displacement`."""
        return self.rig.static_shape(tip_displacement)
