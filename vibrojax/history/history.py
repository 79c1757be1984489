"""The result of a simulation: a time history and what can be read from it."""

from typing import TYPE_CHECKING

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_choice, is_traced
from vibrojax._tools.described import recipe
from vibrojax._tools.signatures import validated
from vibrojax.history.contacts import Contacts, Peak, contacts_of, peak_of
from vibrojax.history.cycles import Cycles, cycles_of
from vibrojax.history.energy import EnergyFlow, energy_of
from vibrojax.history.history_spectrum import spectrum_of_history
from vibrojax.history.poincare import PoincareSection, section_of
from vibrojax.history.quantities import (
    MOVING,
    QUANTITIES,
    STRAIN_POWER,
    dataset,
    displacement_of,
    numbered,
    observables_of,
    quantity_of,
    unit_and_label,
)
from vibrojax.history.samples import SampledMotion
from vibrojax.history.signals import chirp_signals, input_of, signals_of
from vibrojax.history.spectrum import Spectrum
from vibrojax.model.drives import AbstractSignal
from vibrojax.model.systems import AbstractSystem, Motion
from vibrojax.results.status import Status

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class History(SampledMotion):
    """Motion of one lane at equal intervals; displacements are relative to the base."""

    @validated(traceable=True)
    def displacement(self, position: ArrayLike | None = None) -> Float[Array, " samples"]:
        """Displacement relative to the base at s = x/L of a beam, m.

        Without a position, here and below: what a frequency response reports, the tip of a beam.

        Raises `ValueError` for a `position` where the system has none, or outside [0, 1].
        """
        return displacement_of(self, position)[0]

    @validated(traceable=True)
    def velocity(self, position: ArrayLike | None = None) -> Float[Array, " samples"]:
        """Velocity relative to the base, m/s; `position` and errors are as for `displacement`."""
        return displacement_of(self, position)[1]

    @validated(traceable=True)
    def acceleration(self, position: ArrayLike | None = None) -> Float[Array, " samples"]:
        """Acceleration relative to the base, m/s2; `position` and errors as for `displacement`.

        With contact damping the force jumps at touch, and the peak of the acceleration does not
        converge with the number of modes.
        """
        return displacement_of(self, position)[2]

    @validated(traceable=True)
    def quantity(self, name: str, position: ArrayLike | None = None) -> Float[Array, " samples"]:
        """Return a quantity by name; the contact force is that of all stops together.

        Beside displacement, velocity, acceleration and contact force: the observables of the
        equations (`strain_energy`, J, of every system) and `strain_power`, the rate of the strain
        energy, W. Raises `ValueError` for an unknown name, or a position where there is none.
        """
        return quantity_of(self, name, position)[0]

    @validated
    def spectrum(
        self,
        quantity: str = "displacement",
        position: ArrayLike | None = None,
        *,
        start: float | int = 0.0,
        window: str = "hann",
        segment: float | int | None = None,
        overlap: float | int = 0.5,
        averages: int | None = None,
        scaling: str = "peak",
        span: float | int | None = None,
        units: str | None = None,
    ) -> Spectrum:
        """Return the spectrum of a quantity as an analyser shows it.

            history.spectrum("acceleration", start=2, segment=2, averages=30, span=800, units="g")

        Parameters:
            quantity, position: as for `quantity`; one place.
            start: time from which on the record counts, s.
            window: a name that `scipy.signal.get_window` knows. `hann` separates lines, `flattop`
                reads amplitudes best, `boxcar` is exact over whole periods and for transients that
                die out within the segment.
            segment: length of the segments whose powers are averaged, s. None: one segment, all of
                the record but its last sample, which repeats the first over whole periods.
            overlap: share of a segment that the next one has too, from 0 to below 1.
            averages: segments to average, from `start` on; None: as many as the record has.
            scaling: `peak` (a sine of amplitude 1 shows as 1), `rms`, `power` (rms squared),
                `density` (power per Hz) or `energy_density` (of a transient: density times
                segment).
            span: highest frequency kept, Hz. Nothing is filtered: what lies above is left out.
            units: such as `g` or `mm`; None: SI units.

        Raises `ValueError` for an unknown quantity, window, scaling or unit, a history that
        diverged or holds lanes, fewer than 8 samples in a segment, one longer than the record,
        too few averages, an overlap or span outside of what is possible, or a history sampled below
        twice the highest natural frequency when more than 1 % of the rms is folded from there.
        """
        return spectrum_of_history(
            self,
            quantity,
            position,
            start=start,
            window=window,
            segment=segment,
            overlap=overlap,
            averages=averages,
            scaling=scaling,
            span=span,
            units=units,
        )

    @validated
    def cycles(
        self,
        quantity: str = "displacement",
        *,
        level: float | int = 0.0,
        threshold: float | int | None = None,
    ) -> Cycles:
        """Return the cycles of a quantity, from up-crossing to up-crossing of a level.

            history.cycles("bearing_angle", threshold=0.04).plot()

        Parameters:
            quantity: as for `quantity`.
            level: what is crossed, in the unit of the quantity.
            threshold: hysteresis: an up-crossing counts only if the quantity was below level -
                threshold since the one before. None: 0.3 of the rms of the quantity about the
                level.

        Crossing times are those of cubics between the samples, and the lengths in drive periods
        count the phase of the drive, exactly also in a chirp. Source: Litak et al., fig. 4. Raises
        `ValueError` for an unknown quantity, a negative threshold, or a history that diverged, is
        traced or holds lanes.
        """
        return cycles_of(self, quantity, level, threshold)

    @validated
    def poincare(
        self,
        quantity: str = "displacement",
        level: float | int | None = None,
        direction: str = "upwards",
        *,
        phase: float | int = 0.0,
        start: float | int = 0.0,
    ) -> PoincareSection:
        """Return a Poincaré section: the motion once a drive period, or where a level is crossed.

            history.poincare(start=5.0).plot()
            history.poincare("bearing_angle", level=0.0)

        Parameters:
            quantity: `displacement` or an observable, as for `quantity`; drawn by `plot`.
            level: value at whose crossings the motion is read, in the unit of the quantity. None:
                it is read whenever the drive has the given phase.
            direction: crossings counted: `upwards`, `downwards` or `both`.
            phase: of the drive, rad, for a section without a level.
            start: time from which on crossings count, s.

        Between samples a cubic is read, so that values are good to the fourth power of the
        interval, to the second where a stop is touched between two samples. Raises `ValueError` for
        what cannot be, a section by the phase of a system that nothing drives, or a history that
        diverged, is traced or holds lanes.
        """
        return section_of(self, quantity, level, direction, phase, start)

    def contacts(self) -> Contacts:
        """Return the table of all contacts, one row each, with their exact times.

        What happens between the samples is computed: times are good to about 1e-12 s where the
        stops are linear in contact, else as the steps of `ExponentialSplitting` allow.

        Raises `ValueError` for a history that diverged, is traced or holds lanes, for a system that
        is not linear but for its stops, for damping that couples the modes together with stops that
        are not linear in contact, or for samples too far apart.
        """
        return contacts_of(self)

    @validated
    def peak(
        self,
        quantity: str = "acceleration",
        position: ArrayLike | None = None,
        start: float | int = 0.0,
    ) -> Peak:
        """Return the value of largest modulus from `start` (s) on, and its time, in SI units.

        Also between the samples, and on both sides of every touch and departure, where
        accelerations and forces jump. Of the `contact_force` of all stops together the largest
        value, not modulus. Quantity and position (one place) are as for `quantity`.

        Raises `ValueError` for an unknown quantity, a `start` after the end, and as `contacts`
        does.
        """
        check_choice("quantity", quantity, tuple(QUANTITIES))
        if self.motion.equations.linear_between_contacts is None:
            raise ValueError(
                "Peaks between samples are known of systems that are linear but for their stops. "
                "Sample finely, and take the largest of history.quantity(...)."
            )
        return peak_of(self, quantity, position, start)

    def energy(self) -> EnergyFlow:
        """Return the energy of every mode and stop, and the losses and the input till then.

        Raises `ValueError` as `contacts` does.
        """
        return energy_of(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over time, mode (or coordinate) and stop, with units and long names."""
        equations, unit = self.motion.equations, self.motion.equations.coordinate_units
        modal = equations.linear_between_contacts is not None
        kind, along = ("Modal", "mode") if modal else ("Generalised", "coordinate")
        over = ("time", along)
        data = {
            "time": ("time", self.time, "s", "Time"),
            "coordinates": (over, self.coordinates, unit, f"{kind} coordinates"),
            "rates": (over, self.rates, f"{unit}/s", f"{kind} velocities"),
            "accelerations": (over, self.accelerations, f"{unit}/s2", f"{kind} accelerations"),
            "contact_force": (("time", "stop"), self.contact_force, "N", "Contact force"),
        }
        at_tip = self.system.reported_place == 1.0
        prefix, place = ("tip_", " of the tip") if at_tip else ("", "")
        for name, values in zip(MOVING, displacement_of(self), strict=True):
            units, label = QUANTITIES[name]
            data[prefix + name] = ("time", values, units, label + place)
        if isinstance(self.motion.waveform, AbstractSignal):
            values, units, label = input_of(self)
            data["drive_force" if units == "N" else "base_acceleration"] = (
                "time",
                values,
                units,
                label,
            )
        for name in (*observables_of(equations), STRAIN_POWER):
            data[name] = ("time", self.quantity(name), *unit_and_label(name))
        counted = numbered(along, self.coordinates.shape[1])
        counted |= numbered("stop", self.contact_force.shape[1])
        attributes = {"status": Status(int(self.status)).name, "rig": recipe(self.system)}
        return dataset(data, counted, attributes)

    @validated
    def plot(self, quantity: str = "displacement", position: ArrayLike | None = None) -> "Figure":
        """Draw a quantity and the contact force against time.

        `quantity` and `position` are those of `History.quantity`. Raises `ValueError` for
        an unknown quantity, or a position where there is none.
        """
        from vibrojax.plot.history import plot_signals

        return plot_signals(np.asarray(self.time), signals_of(self, quantity, position))

    @validated
    def plot_chirp(self, *quantities: str) -> "Figure":
        """Draw the drive, quantities and the drive frequency against time, one below the other.

        By default the bearing angle where there is one, else the displacement, and the chord
        reduction, else the strain energy. Source: Litak et al., fig. 4. Raises `ValueError` for an
        unknown quantity, a system that nothing drives, or a history that holds lanes.
        """
        from vibrojax.plot.history import plot_signals

        return plot_signals(np.asarray(self.time), chirp_signals(self, quantities))

    def __repr__(self) -> str:
        *lanes, samples, coordinates = self.coordinates.shape
        head = f"History({samples} samples, {coordinates} coordinates"
        if is_traced(self.time) or lanes:
            return head + ")"
        span = f"{float(self.time[0]):.6g} to {float(self.time[-1]):.6g} s"
        return f"{head}, {span}, {Status(int(self.status)).name})"


def history_of(
    system: AbstractSystem, motion: Motion, time: Array, states: Array, result: diffrax.RESULTS
) -> History:
    """Read everything off the states, shape (samples, states), and how diffrax ended."""
    q, v, memory = (part.T for part in motion.equations.split(states.T))
    equations = motion.sharp_equations()

    def read(time, q, v, memory):
        held = (memory,) if equations.memory_size else ()
        drive_input = motion.drive.input(motion.waveform, time)
        acceleration = equations.acceleration(q, v, drive_input, *held)
        return acceleration, equations.contact_forces(q, v, *held)

    accelerations, force = jax.vmap(read)(time, q, v, memory)
    ended = (result == diffrax.RESULTS.successful) & jnp.all(jnp.isfinite(states))
    status = jnp.where(ended, Status.completed.value, Status.diverged.value)
    return History(system, motion, time, q, v, accelerations, force, memory, status)
