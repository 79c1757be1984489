"""The result of a simulation: a time history and what can be read from it."""

from typing import TYPE_CHECKING

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._checks import check_choice, is_traced
from vibrojax.drive import Harmonic
from vibrojax.results.spectrum import FOLDED, Spectrum, folded_share, spectrum_of
from vibrojax.results.status import Status
from vibrojax.systems.base import AbstractSystem, LinearEquations, Motion
from vibrojax.systems.impacting_beam import ImpactingBeam

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

    from vibrojax.results.contacts import Contacts, Peak
    from vibrojax.results.energy import EnergyFlow

QUANTITIES = {
    "displacement": ("m", "Displacement"),
    "velocity": ("m/s", "Velocity"),
    "acceleration": ("m/s2", "Acceleration"),
    "contact_force": ("N", "Contact force"),
}


class History(eqx.Module):
    """Motion of one lane at equal intervals; displacements are relative to the base."""

    system: AbstractSystem
    motion: Motion
    time: Float[Array, " samples"]
    """s."""
    coordinates: Float[Array, "samples coordinates"]
    """Modal coordinates q of a beam, m (shapes as `modes(...)` normalises them)."""
    rates: Float[Array, "samples coordinates"]
    """Their velocities, m/s."""
    accelerations: Float[Array, "samples coordinates"]
    """Their accelerations, m/s2."""
    contact_force: Float[Array, "samples stops"]
    """Force of each stop, N, positive when it pushes the body off."""
    memory: Float[Array, "samples memories"]
    """Internal states of the stops whose law has one, m for a `StandardLinearSolid`."""
    status: Int[Array, ""]
    """`Status.completed` when the integration reached its end, `Status.diverged` when not."""

    @classmethod
    def of(
        cls,
        system: AbstractSystem,
        motion: Motion,
        time: Float[Array, " samples"],
        states: Float[Array, "samples states"],
        result: diffrax.RESULTS,
    ) -> "History":
        """Read everything off the states of an integration."""
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
        return cls(system, motion, time, q, v, accelerations, force, memory, status)

    def _shape(self, position: ArrayLike | None) -> Float[Array, " coordinates"]:
        equations = self.motion.equations
        if position is None and isinstance(equations, LinearEquations):
            return equations.response_map
        if position is None or not isinstance(self.system, ImpactingBeam):
            raise ValueError("Only the history of a beam has a position along it.")
        return self.system.modes().shape(position)

    def displacement(self, position: ArrayLike | None = None) -> Float[Array, " samples"]:
        """Displacement relative to the base at s = x/L of a beam, m.

        Without a position, here and below: what a frequency response reports, the tip of a beam.
        """
        return self.coordinates @ self._shape(position)

    def velocity(self, position: ArrayLike | None = None) -> Float[Array, " samples"]:
        """Velocity relative to the base at s = x/L, m/s."""
        return self.rates @ self._shape(position)

    def acceleration(self, position: ArrayLike | None = None) -> Float[Array, " samples"]:
        """Acceleration relative to the base at s = x/L, m/s2.

        With contact damping the force jumps at touch, and the peak of the acceleration does not
        converge with the number of modes.
        """
        return self.accelerations @ self._shape(position)

    def quantity(self, name: str, position: ArrayLike | None = None) -> Float[Array, " samples"]:
        """Return a quantity by name; the contact force is that of all stops together."""
        check_choice("quantity", name, tuple(QUANTITIES))
        if name == "contact_force":
            return jnp.sum(self.contact_force, axis=1)
        return getattr(self, name)(position)

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
            window: a name that `scipy.signal.get_window` knows. `hann` tells lines apart, `flattop`
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
        if np.ndim(self.time) != 1 or is_traced(self.time):
            raise ValueError(
                "A spectrum is of one history outside jit and vmap, got lanes of shape "
                f"{np.shape(self.time)[:-1]}. Take one: jax.tree.map(lambda a: a[0], history)."
            )
        if int(self.status) != Status.completed.value:
            raise ValueError(f"This history has no spectrum: it {Status(int(self.status)).name}.")
        if position is not None and np.ndim(position):
            raise ValueError(f"position must be one place x/L, got {position!r}.")
        time = np.asarray(self.time)
        inside = time >= start
        if np.sum(inside) < 9:
            raise ValueError(
                f"start = {start!r} s leaves {np.sum(inside)} samples, 9 are needed. The history "
                f"ends at {time[-1]:.6g} s."
            )
        rate = float(1 / (time[1] - time[0]))
        is_force = quantity == "contact_force"
        if is_force:
            position = None
        values = np.asarray(self.quantity(quantity, position))[inside]
        equations, waveform, drive = self.motion.equations, self.motion.waveform, self.motion.drive
        _, angular, second = waveform.phase(jnp.zeros(()))
        clock, natural = float(angular) / (2 * np.pi), np.zeros(0)
        if isinstance(equations, LinearEquations):
            natural = np.asarray(equations.angular_frequency) / (2 * np.pi)
        if np.max(natural, initial=0.0) > rate / 2:
            moved = np.asarray(self.displacement(position))[inside]
            pushed = np.asarray(self.acceleration(position))[inside]
            # A force has no derivative to tell folded lines by: the motion it causes has.
            share = folded_share(pushed if is_force else values, moved, pushed, rate)
            if share > FOLDED:
                raise ValueError(
                    f"The history has {rate:.6g} samples/s and a highest mode of {max(natural):.6g}"
                    f" Hz: {100 * share:.2g} % of the rms lies above {rate / 2:.6g} Hz and would "
                    "be folded. Give simulate a sampling_rate of at least "
                    f"{2.56 * max(natural):.5g} Hz, or samples_per_period of at least "
                    f"{int(np.ceil(2.56 * max(natural) / clock))}."
                )
        moving = abs(complex(drive.complex_amplitude(angular, second))) > 0
        if position is None and isinstance(self.system, ImpactingBeam) and not is_force:
            position = 1.0
        return spectrum_of(
            values[:-1] if segment is None else values,
            rate,
            quantity=quantity,
            window=window,
            segment=segment,
            overlap=overlap,
            averages=averages,
            scaling=scaling,
            span=span,
            units=units,
            drive_frequency=clock if moving and isinstance(waveform, Harmonic) else None,
            natural_frequencies=natural,
            position=None if position is None else float(np.asarray(position)),
        )

    def contacts(self) -> "Contacts":
        """Return the table of all contacts, one row each, with their exact times.

        What happens between the samples is computed: times are good to about 1e-12 s where the
        stops are linear in contact, else as the steps of `ExponentialSplitting` allow.

        Raises `ValueError` for a history that diverged, is traced or holds lanes, for a system that
        is not linear but for its stops, for damping that couples the modes together with stops that
        are not linear in contact, or for samples too far apart.
        """
        from vibrojax.results.contacts import contacts_of

        return contacts_of(self)

    def peak(
        self,
        quantity: str = "acceleration",
        position: ArrayLike | None = None,
        start: float | int = 0.0,
    ) -> "Peak":
        """Return the value of largest modulus from `start` (s) on, and its time, in SI units.

        Also between the samples, and on both sides of every touch and departure, where
        accelerations and forces jump. Of the `contact_force` of all stops together the largest
        value, not modulus. Quantity and position (one place) are as for `quantity`.

        Raises `ValueError` for an unknown quantity, a `start` after the end, and as `contacts`
        does.
        """
        from vibrojax.results.contacts import peak_of

        check_choice("quantity", quantity, tuple(QUANTITIES))
        return peak_of(self, quantity, position, start)

    def energy(self) -> "EnergyFlow":
        """Return the energy of every mode and stop, and the losses and the input till then.

        Raises `ValueError` as `contacts` does.
        """
        from vibrojax.results.energy import energy_of

        return energy_of(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over time, mode and stop, with units and long names."""
        import xarray

        def named(values, units, long_name, *dims):
            return (
                (*("time", *dims),),
                np.asarray(values),
                {"units": units, "long_name": long_name},
            )

        data = {
            "coordinates": named(self.coordinates, "m", "Modal coordinates", "mode"),
            "rates": named(self.rates, "m/s", "Modal velocities", "mode"),
            "accelerations": named(self.accelerations, "m/s2", "Modal accelerations", "mode"),
            "contact_force": named(self.contact_force, "N", "Contact force", "stop"),
        }
        if isinstance(self.motion.equations, LinearEquations):
            beam = isinstance(self.system, ImpactingBeam)
            prefix, place = ("tip_", " of the tip") if beam else ("", "")
            for name in ("displacement", "velocity", "acceleration"):
                units, label = QUANTITIES[name]
                data[prefix + name] = named(getattr(self, name)(), units, label + place)
        coordinates = {
            "time": ("time", np.asarray(self.time), {"units": "s", "long_name": "Time"}),
            "mode": np.arange(1, self.coordinates.shape[1] + 1),
            "stop": np.arange(1, self.contact_force.shape[1] + 1),
        }
        attributes = {"status": Status(int(self.status)).name, "rig": repr(self.system)}
        return xarray.Dataset(data, coordinates, attrs=attributes)

    def plot(self, quantity: str = "displacement", position: ArrayLike | None = None) -> "Figure":
        """Draw a quantity and the contact force against time."""
        from vibrojax.results.history_plot import plot_history

        return plot_history(self, quantity, position)

    def __repr__(self) -> str:
        *lanes, samples, coordinates = self.coordinates.shape
        head = f"History({samples} samples, {coordinates} coordinates"
        if is_traced(self.time) or lanes:
            return head + ")"
        return f"{head}, 0 to {float(self.time[-1]):.6g} s, {Status(int(self.status)).name})"
