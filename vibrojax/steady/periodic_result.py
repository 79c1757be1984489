"""A periodic response: the result at one point."""

from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float, Int

from vibrojax._tools.signatures import validated
from vibrojax.model.systems import AbstractSystem, equation_kinds
from vibrojax.results.derived import AbstractRatios
from vibrojax.results.status import Status
from vibrojax.results.variables import RESPONSE, described_as
from vibrojax.stepping.resonance import is_unbounded, unbounded_at

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

    from vibrojax.history.history import History

NUMBERS = (*RESPONSE, "leading_multiplier", "residual", "frequency")

ELSEWHERE = 0.3
"""Farthest that a motion may lie from its guess, over its size, without a word."""
SAME = 1e-6
"""Relative distance of states below which a motion has returned."""


class Sampled(NamedTuple):
    """What is read off a motion, m and N."""

    highest: Float[Array, ""]
    lowest: Float[Array, ""]
    mean_square: Float[Array, ""]
    first_harmonic: Float[Array, ""]
    contact_force: Float[Array, ""]
    contact_fraction: Float[Array, ""]
    contacts: Float[Array, ""]
    initial_state: Float[Array, " states"]


class PeriodicResponse(AbstractRatios):
    """A steady state and its stability. Numbers are arrays without axes (or those of a `vmap`)."""

    amplitude_ratio: Float[Array, "*lanes"]
    """Half peak-to-peak displacement over drive amplitude."""
    peak_ratio: Float[Array, "*lanes"]
    """Largest displacement, either side, over drive amplitude."""
    rms_ratio: Float[Array, "*lanes"]
    """RMS displacement, the mean included, over drive amplitude."""
    first_harmonic_ratio: Float[Array, "*lanes"]
    """Amplitude at the drive frequency over drive amplitude."""
    contact_force: Float[Array, "*lanes"]
    """Largest contact force, N."""
    contact_fraction: Float[Array, "*lanes"]
    """Share of the time in contact, 0 to 1."""
    contacts_per_period: Float[Array, "*lanes"]
    """Contacts per drive period."""
    initial_state: Float[Array, "*lanes states"]
    """(q, q') at drive phase 0, m and m/s, in the coordinates of the system: as `guess=`,
    `initial_state=`, `start=` and `starts=` take it."""
    floquet_multipliers: Complex[Array, "*lanes states"]
    """Eigenvalues of the Jacobian of the map over `period` drive periods; without derivative."""
    residual: Float[Array, "*lanes"]
    """Relative residual of the motion."""
    status: Int[Array, "*lanes"]
    """0 where the motion was found, 1 where the search failed, `Status.unbounded` where an undamped
    mode that no stop holds is driven at its own frequency."""
    minimal_period: Int[Array, "*lanes"]
    """Drive periods after which the motion repeats first, a divisor of `period`; 0 where none was
    found."""
    guess_distance: Float[Array, "*lanes"]
    """Distance of the motion from the guess at drive phase 0, over its own size, both in the norm
    of energy; NaN where there was no guess or no motion was found."""
    frequency: Float[Array, "*lanes"]
    """Drive frequency, Hz."""
    frequency_ratio: Float[Array, "*lanes"]
    """Drive frequency over the first natural frequency; NaN for a system without one."""
    period: int = eqx.field(static=True)
    """Drive periods after which the motion repeats."""
    exact: bool = eqx.field(static=True)
    """Whether it is an exact solution between contact times."""
    ratio_units: str = eqx.field(static=True)
    """Unit of the ratios: `1` for base motion, `m/N` for a force."""
    system: AbstractSystem
    """What moves."""

    @property
    def converged(self) -> Any:
        """Whether the motion was found."""
        return self.status == 0

    @property
    def leading_multiplier(self) -> Any:
        """Largest modulus of the Floquet multipliers."""
        return jnp.max(jnp.abs(self.floquet_multipliers), axis=-1)

    @property
    def stable(self) -> Any:
        """Whether all Floquet multipliers lie inside the unit circle."""
        return self.leading_multiplier < 1.0

    @property
    def instability(self) -> str:
        """`none`, or how stability was lost: fold, period doubling or Neimark-Sacker.

        By the multiplier farthest outside the unit circle: real above 1, real below -1, or complex.

        Raises `ValueError` for a batch: pick one lane.
        """
        multipliers = np.asarray(self.floquet_multipliers)
        if multipliers.ndim != 1:
            raise ValueError("instability is of one response: pick one lane of the batch.")
        leading = multipliers[int(np.argmax(np.abs(multipliers)))]
        if np.abs(leading) < 1.0:
            return "none"
        if np.abs(leading.imag) > 1e-9 * np.abs(leading):
            return "Neimark-Sacker"
        return "fold" if leading.real > 0 else "period doubling"

    @property
    def sentence(self) -> str:
        """The status in words."""
        if (np.asarray(self.status) == Status.unbounded.value).any():
            return Status.unbounded.sentence
        if np.asarray(self.status).any():
            return "No periodic motion was found: the numbers mean nothing."
        kind = {
            "none": "stable",
            "fold": "unstable: past a fold (a real multiplier above 1)",
            "period doubling": "unstable: past a period doubling (a real multiplier below -1)",
            "Neimark-Sacker": "unstable: past a Neimark-Sacker point (a complex pair outside)",
        }
        motion = f"The motion repeats after {self.period} drive period(s) and is " + (
            kind[self.instability] + "."
        )
        return " ".join((motion, *self.notes))

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be known of a motion that was found: where a guess led, in sentences.

        Raises `ValueError` for a batch: pick one lane.
        """
        if np.ndim(self.status):
            raise ValueError("notes are of one response: pick one lane of the batch.")
        parts = []
        sooner, distance = int(self.minimal_period), float(self.guess_distance)
        if 0 < sooner < self.period:
            parts.append(
                f"It repeats after {sooner} drive period(s) already: it is no motion of period "
                f"{self.period}."
            )
        if distance > ELSEWHERE:
            parts.append(
                f"It lies {distance:.2g} of its size away from the guess: it may be another motion "
                "than the one meant."
            )
        return tuple(parts)

    @validated(traceable=True)
    def history(self, samples_per_period: int = 256) -> "History":
        """Return the motion over its period as a time history.

        `samples_per_period` is the number of samples in a drive period. Raises `ValueError`
        when it is below 1.
        """
        from vibrojax.history.simulate import simulate

        state = equation_kinds(self.system).split(self.initial_state)
        return simulate(
            self.system,
            frequency=self.frequency,
            periods=self.period,
            samples_per_period=samples_per_period,
            initial_state=state,
        )

    def plot(self) -> "Figure":
        """Draw displacement and contact force over the period of the motion."""
        return self.history().plot()

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset of the numbers, with units and long names."""
        import xarray

        lanes = tuple(f"lane_{k}" for k in range(np.ndim(self.status)))

        def variable(name: str, values: Any, *dims: str) -> tuple[Any, ...]:
            return (*lanes, *dims), np.asarray(values), described_as(name, self.ratio_units)

        names = (*NUMBERS, *self.derived, "frequency_ratio", "minimal_period", "guess_distance")
        names = (*names, "status")
        data: dict[str, Any] = {name: variable(name, getattr(self, name)) for name in names}
        multipliers = np.asarray(self.floquet_multipliers)
        for part, values in (("real", np.real(multipliers)), ("imaginary", np.imag(multipliers))):
            name = f"floquet_multiplier_{part}"
            data[name] = variable(name, values, "multiplier")
        about = {"units": "m, m/s", "long_name": "Modal displacements, then velocities, at phase 0"}
        data["initial_state"] = (*lanes, "state"), np.asarray(self.initial_state), about
        return xarray.Dataset(data, attrs={"title": "vibrojax periodic response"})

    def __repr__(self) -> str:
        if np.ndim(self.status):
            failed = int(np.sum(np.asarray(self.status) != 0))
            far = int(np.sum(np.asarray(self.guess_distance) > ELSEWHERE))
            parts = f"{failed} not found" + (f", {far} far from their guess" if far else "")
            return f"PeriodicResponse(batch of {np.shape(self.status)}, {parts})"
        try:
            values = [f"  {name:22s}{float(getattr(self, name)):.6g}" for name in NUMBERS]
        except TypeError:  # being traced
            return f"PeriodicResponse(period={self.period})"
        return "\n".join(["PeriodicResponse", *values, f"  {self.sentence}"])


def numbers_of(
    place: Any,
    reading: Any,
    *,
    period: int,
    strobes: Float[Array, "periods states"],
    guess: Float[Array, " states"] | None,
    multipliers: Array,
    residual: Array,
    converged: Array,
) -> dict[str, Array]:
    """Put what was read off a motion into ratios to the drive: the arrays of a `PeriodicResponse`.

    `strobes` are its states at drive phase 0, one for each drive period of it.
    """
    converged = converged & jnp.all(jnp.isfinite(strobes))
    sooner, distance = compared(place, lax.stop_gradient(strobes), guess)
    reference, _ = place.drive.reference
    natural = getattr(place.equations, "angular_frequency", None)
    w = place.angular_frequency
    resonances = unbounded_at(place.equations, place.drive)
    grows = is_unbounded(lax.stop_gradient(resonances), w)
    converged = converged & ~grows
    status = jnp.where(converged, 0, jnp.where(grows, Status.unbounded.value, 1))
    lost = jnp.where(converged, 0.0, jnp.nan)
    return dict(
        amplitude_ratio=(reading.highest - reading.lowest) / 2 / reference + lost,
        peak_ratio=jnp.maximum(reading.highest, -reading.lowest) / reference + lost,
        rms_ratio=jnp.sqrt(reading.mean_square) / reference + lost,
        first_harmonic_ratio=reading.first_harmonic / reference + lost,
        contact_force=reading.contact_force + lost,
        contact_fraction=reading.contact_fraction + lost,
        contacts_per_period=reading.contacts / period + lost,
        initial_state=reading.initial_state,
        floquet_multipliers=multipliers,
        residual=residual,
        status=status.astype(jnp.int32),
        minimal_period=jnp.where(converged, sooner, 0).astype(jnp.int32),
        guess_distance=jnp.where(converged, distance, jnp.nan),
        frequency=w / (2 * jnp.pi),
        frequency_ratio=w * jnp.nan if natural is None else w / natural[0],
    )


def compared(place: Any, strobes: Array, guess: Array | None) -> tuple[Array, Array]:
    """Return the periods after which a motion repeats first, and its distance from a guess."""
    equations, count = place.equations, strobes.shape[0]
    if equations.linear_between_contacts is not None:
        weight = equations.linear_between_contacts.energy_weight
    else:
        n = equations.size
        weight = jnp.ones(strobes.shape[1]).at[n : 2 * n].set(1 / place.angular_frequency)
    weight = lax.stop_gradient(weight)
    size = jnp.max(jnp.linalg.norm(strobes * weight, axis=1))
    size = jnp.where(size > 0, size, 1.0)

    def away(other: Array) -> Array:
        return jnp.max(jnp.linalg.norm((strobes - other) * weight, axis=1)) / size

    sooner = jnp.asarray(count)
    for shift in [n for n in range(count - 1, 0, -1) if count % n == 0]:
        sooner = jnp.where(away(jnp.roll(strobes, shift, axis=0)) < SAME, shift, sooner)
    if guess is None:
        return sooner, jnp.asarray(jnp.nan)
    apart = jnp.linalg.norm((strobes[0] - lax.stop_gradient(guess)) * weight)
    return sooner, apart / size
