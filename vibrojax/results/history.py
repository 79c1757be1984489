"""The result of a simulation: a time history and what can be read from it."""

from typing import TYPE_CHECKING, Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._checks import check_choice, is_traced
from vibrojax.results.status import Status
from vibrojax.systems.base import AbstractSystem, LinearEquations, Motion
from vibrojax.systems.impacting_beam import ImpactingBeam

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

QUANTITIES = {
    "displacement": ("m", "Displacement"),
    "velocity": ("m/s", "Velocity"),
    "acceleration": ("m/s2", "Acceleration"),
    "contact_force": ("N", "Contact force"),
}


class Spectrum(NamedTuple):
    """Amplitude spectrum of a history."""

    frequency: Float[np.ndarray, " frequencies"]
    """Hz."""
    amplitude: Float[np.ndarray, " frequencies"]
    """Peak amplitude in the unit of the quantity: a sine of amplitude 1 shows as 1."""


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
        q, v = jnp.split(states, 2, axis=1)

        def read(time, q, v):
            drive_input = motion.drive.input(motion.waveform, time)
            equations = motion.equations
            return equations.acceleration(q, v, drive_input), equations.contact_forces(q, v)

        accelerations, force = jax.vmap(read)(time, q, v)
        ended = (result == diffrax.RESULTS.successful) & jnp.all(jnp.isfinite(states))
        status = jnp.where(ended, Status.completed.value, Status.diverged.value)
        return cls(system, motion, time, q, v, accelerations, force, status)

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
        start: float = 0.0,
        window: str = "hann",
    ) -> Spectrum:
        """Return the amplitude spectrum of a quantity from the time `start` (s) on.

        `window` is any name that `scipy.signal.get_window` knows; `flattop` reads amplitudes best,
        `boxcar` is exact over whole periods. Raises `ValueError` for an unknown quantity, or when
        fewer than 8 samples are left.
        """
        from scipy.signal import periodogram

        time = np.asarray(self.time)
        values = np.asarray(self.quantity(quantity, position))[time >= start]
        if len(values) < 8:
            raise ValueError(f"start = {start!r} s leaves {len(values)} samples, 8 are needed.")
        # The last sample of a whole number of periods repeats the first.
        rate = 1 / (time[1] - time[0])
        keep: Any = False  # the mean: scipy's annotation knows only names
        frequency, power = periodogram(values[:-1], rate, window, detrend=keep, scaling="spectrum")
        return Spectrum(frequency, np.sqrt(power * np.where(frequency > 0, 2.0, 1.0)))

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
        samples, coordinates = self.coordinates.shape
        head = f"History({samples} samples, {coordinates} coordinates"
        if is_traced(self.time):
            return head + ")"
        return f"{head}, 0 to {float(self.time[-1]):.6g} s, {Status(int(self.status)).name})"
