"""The equation of motion that every system shares.

M(q) q'' + C q' + K q = f(q, q') + B(q) a(t) + sum over stops of J(q)^T F(penetration, rate)

with C and K constant.
"""

from abc import abstractmethod
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.described import shown_value
from vibrojax.model.internal_states import InternalStates
from vibrojax.model.stop_forces import (
    Memories,
    contact_slope,
    memory_rates,
    stop_forces,
)
from vibrojax.model.stops import Stop, as_stops

Coordinates = Float[Array, " coordinates"]
OwnMemories = Float[Array, " memories"]
PerCoordinate = Float[Array, "coordinates *lanes"]


class AbstractEquations(eqx.Module):
    """The equations of motion of one lane; no batch axis.

    A subclass gives the pieces, of which only the linear ones are constant; the acceleration
    follows from them here.
    """

    stops: eqx.AbstractVar[tuple[Stop, ...]]
    """The stops, in the order of `penetration`."""

    @property
    @abstractmethod
    def size(self) -> int:
        """How many coordinates there are."""

    @property
    def has_constant_mass(self) -> bool:
        """Whether M is the same at every q."""
        return False

    @property
    def linear_between_contacts(self) -> "LinearEquations | None":
        """These equations, if they are linear while no stop changes its contact; else None.

        With it goes all that is known in closed form: natural frequencies, exact contact, harmonic
        balance of the stops alone.
        """
        return None

    @property
    def first_frequency(self) -> Float[Array, ""]:
        """First natural angular frequency, rad/s; NaN where there is none."""
        linear = self.linear_between_contacts
        return jnp.asarray(jnp.nan) if linear is None else linear.angular_frequency[0]

    def drive_unit(self, is_ratio: bool) -> Float[Array, ""]:
        """Return the angular frequency, rad/s, of a drive at 1 Hz, or at ratio 1 if `is_ratio`."""
        return self.first_frequency if is_ratio else jnp.asarray(2 * jnp.pi)

    @property
    def memory_size(self) -> int:
        """How many internal states there are: those of stops (`AbstractMemoryLaw`), and others."""
        return sum(stop.memory_size for stop in self.stops)

    @property
    def state_size(self) -> int:
        """Length of a state (q, q', memories of the stops)."""
        return 2 * self.size + self.memory_size

    def split(
        self, state: Float[Array, "states *lanes"]
    ) -> tuple[PerCoordinate, PerCoordinate, Memories]:
        """Return q, q' and the memories of the stops.

        `state` has the shape (states,) and may carry lanes as trailing axes.
        """
        n = self.size
        return state[:n], state[n : 2 * n], state[2 * n :]

    @abstractmethod
    def mass(self, q: Coordinates) -> Float[Array, "coordinates coordinates"]:
        """Return the mass matrix M(q) at coordinates `q`, in `coordinate_units`."""

    @abstractmethod
    def linear_force(self, q: Coordinates, rate: Coordinates) -> Coordinates:
        """Return C q' + K q; `q` are the coordinates, `rate` their velocities q'."""

    @abstractmethod
    def smooth_force(self, q: Coordinates, rate: Coordinates) -> Coordinates:
        """Return the smooth nonlinear force f(q, q') at `q` and `rate`; 0 for a linear system."""

    @abstractmethod
    def input(self, q: Coordinates) -> Coordinates:
        """Return B(q), the generalised force of a unit input at coordinates `q`."""

    @abstractmethod
    def penetration(self, q: Coordinates) -> Float[Array, " stops"]:
        """Return how deep the body at `q` is in each stop, m; negative out of contact."""

    @abstractmethod
    def response(self, q: Coordinates) -> Float[Array, ""]:
        """Return the displacement at `q` that a frequency response reports, m (the tip, say)."""

    @property
    def coordinate_units(self) -> str:
        """Unit of the coordinates."""
        return "m"

    def observables(self, q: Coordinates) -> dict[str, Float[Array, ""]]:
        """Return what can be watched of a motion at `q`, by name, in SI units.

        `displacement` (the response) and `strain_energy` of every system, and what else it has.
        """
        return {"displacement": self.response(q), "strain_energy": self.strain_energy(q)}

    def strain_energy(self, q: Coordinates) -> Float[Array, ""]:
        """Return the strain energy K q . q / 2 of the coordinates `q`, J."""
        return q @ self.linear_force(q, jnp.zeros_like(q)) / 2

    def mass_times(self, q: Coordinates, vector: Coordinates) -> Coordinates:
        """Return M(q) times a vector; a system may do it without forming M."""
        return self.mass(q) @ vector

    def contact_forces(
        self, q: Coordinates, rate: Coordinates, memory: OwnMemories | None = None
    ) -> Float[Array, " stops"]:
        """Return the rounded force of each stop, N, positive when it pushes the body off.

        `q` are the coordinates, `rate` their velocities q'; without `memory`, stops that have one
        were at rest before.
        """
        depth, depth_rate = jax.jvp(self.penetration, (q,), (rate,))
        return stop_forces(self.stops, depth, depth_rate, memory)

    def memory_rates(
        self,
        q: Coordinates,
        rate: Coordinates,
        memory: OwnMemories,
        drive_input: Float[ArrayLike, ""] = 0.0,
    ) -> OwnMemories:
        """Return how fast the internal states change, per s.

        `q` are the coordinates, `rate` their velocities q', `memory` the internal states,
        `drive_input` is a(t) (m/s2 or N).
        """
        depth, depth_rate = jax.jvp(self.penetration, (q,), (rate,))
        return memory_rates(self.stops, depth, depth_rate, memory)

    def acceleration(
        self,
        q: Coordinates,
        rate: Coordinates,
        drive_input: Float[ArrayLike, ""],
        memory: OwnMemories | None = None,
    ) -> Coordinates:
        """Solve the equation of motion for q''.

        `q` are the coordinates, `rate` their velocities q', `drive_input` is a(t) (m/s2 or N),
        `memory` the internal states of the stops, at rest without it.
        """
        _, pull_back = jax.vjp(self.penetration, q)
        (contact,) = pull_back(-self.contact_forces(q, rate, memory))
        total = (
            self.smooth_force(q, rate)
            - self.linear_force(q, rate)
            + self.input(q) * drive_input
            + contact
        )
        return jnp.linalg.solve(self.mass(q), total)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(coordinates: {self.size}, stops: {len(self.stops)})"


class AbstractGauge(eqx.Module):
    """Reads what can be watched off modal coordinates, beyond the displacement and the energy."""

    @abstractmethod
    def __call__(self, q: Coordinates) -> dict[str, Float[Array, ""]]:
        """Return values by name, in SI units."""


def _anywhere(stops: Stop | tuple[Stop, ...] | list[Stop]) -> tuple[Stop, ...]:
    """Without place and side, so that programs are the same wherever stops are."""
    return tuple(replace(stop, position=None, side=1) for stop in as_stops(stops))


class LinearEquations(AbstractEquations):
    """Modal equations of a body that is linear but for its stops.

    q_i'' + 2 zeta_i w_i q_i' + sum over j of coupling_ij q_j' + w_i^2 q_i = input_i a(t) - sum
    over stops force_map_is F_s. The equations of the beam, and of anything reduced to its modes.
    Source: Gandhi and Vyas 2017, eqs. 36 and 37. Arrays may carry lanes as trailing axes.
    """

    stops: tuple[Stop, ...] = eqx.field(converter=_anywhere)
    """The stops, in the order of the rows of `stop_map`, which has their places and sides."""
    angular_frequency: PerCoordinate
    """Natural angular frequencies w_i, rad/s."""
    damping_ratio: PerCoordinate
    """Damping ratios zeta_i."""
    input_map: PerCoordinate
    """Modal acceleration of a unit input."""
    stop_map: Float[Array, "stops coordinates *lanes"]
    """Displacement of each stop's contact point towards the stop, by coordinate."""
    force_map: Float[Array, "coordinates stops *lanes"]
    """Modal acceleration of a unit contact force, by stop; the force acts against it."""
    response_map: PerCoordinate
    """Displacement that a frequency response reports, by coordinate."""
    modal_mass: PerCoordinate
    """Modal masses, kg; weights of the energy."""
    damping_coupling: Float[Array, "coordinates coordinates *lanes"] | None = None
    """Damping beyond 2 zeta_i w_i: deceleration of coordinate i by the rate of j, 1/s.

    None where the damping does not couple the modes.
    """
    stiffness_sign: PerCoordinate | None = None
    """-1 for a mode that falls away from rest, whose stiffness is -w_i^2, else 1; None: all 1."""
    gauge: AbstractGauge | None = None
    """What reads further observables off the coordinates."""
    stiffness_coupling: Float[Array, "coordinates coordinates *lanes"] | None = None
    """Stiffness over mass beyond w_i^2, 1/s2; None where coordinates are those of modes."""
    internal: InternalStates | None = None
    """States of first order of the structure; None where it has none."""
    free: bool = eqx.field(static=True, default=False)
    """Whether there are modes without stiffness (`stiffness_sign` 0): a body that nothing holds.
    Their `angular_frequency` is a mere unit."""
    load: PerCoordinate | None = None
    """Acceleration of the coordinates by forces that stay the same, gravity say; None: none."""

    @property
    def size(self) -> int:
        """How many coordinates there are."""
        return self.angular_frequency.shape[0]

    @property
    def has_constant_mass(self) -> bool:
        """Whether M is the same at every q: it is."""
        return True

    @property
    def linear_between_contacts(self) -> "LinearEquations":
        """These equations."""
        return self

    def mass(self, q: Coordinates) -> Float[Array, "coordinates coordinates"]:
        """Return the diagonal of modal masses."""
        return jnp.diag(self.modal_mass)

    @property
    def is_modal(self) -> bool:
        """Whether every coordinate is that of a mode that moves alone, about 0, contact apart."""
        coupled = self.damping_coupling, self.stiffness_coupling, self.internal, self.load
        return not self.free and all(part is None for part in coupled)

    @property
    def internal_size(self) -> int:
        """How many internal states the structure has; those of the stops come behind them."""
        return 0 if self.internal is None else self.internal.size

    @property
    def memory_size(self) -> int:
        """How many internal states there are: an even number, if need be with one that idles."""
        return self.internal_size + super().memory_size + self.idle_size

    @property
    def idle_size(self) -> int:
        """1 where a state idles, so that there is an even number of them; else 0."""
        return (self.internal_size + super().memory_size) % 2

    def linear_force(self, q: Coordinates, rate: Coordinates) -> Coordinates:
        """Return C q' + K q."""
        return self.modal_mass * (self._damping(rate) + self._stiffness(q))

    def _stiffness(self, q: Coordinates) -> Coordinates:
        diagonal = self.modal_stiffness * q
        if self.stiffness_coupling is None:
            return diagonal
        return diagonal + self.stiffness_coupling @ q

    @property
    def modal_stiffness(self) -> PerCoordinate:
        """Stiffness over mass of every mode, 1/s2: w_i^2, less than 0 where it falls away."""
        square = self.angular_frequency**2
        return square if self.stiffness_sign is None else self.stiffness_sign * square

    def _damping(self, rate: Coordinates) -> Coordinates:
        diagonal = 2 * self.damping_ratio * self.angular_frequency * rate
        if self.damping_coupling is None:
            return diagonal
        return diagonal + self.damping_coupling @ rate

    def smooth_force(self, q: Coordinates, rate: Coordinates) -> Coordinates:
        """Return the forces that stay the same."""
        return jnp.zeros_like(q) if self.load is None else self.modal_mass * self.load

    def input(self, q: Coordinates) -> Coordinates:
        """Return the generalised force of a unit input."""
        return self.modal_mass * self.input_map

    def penetration(self, q: Coordinates) -> Float[Array, " stops"]:
        """Return how deep the body is in each stop, m."""
        gaps = jnp.stack([jnp.asarray(s.gap) for s in self.stops]) if self.stops else 0.0
        return self.stop_map @ q - gaps

    def response(self, q: Coordinates) -> Float[Array, ""]:
        """Return the reported displacement, m."""
        return self.response_map @ q

    def observables(self, q: Coordinates) -> dict[str, Float[Array, ""]]:
        """Return what can be watched of a motion, by name, in SI units."""
        seen = super().observables(q)
        return seen if self.gauge is None else seen | self.gauge(q)

    @property
    def energy_weight(self) -> Float[Array, "states *lanes"]:
        """Weights of a state: its weighted norm is the root of twice its energy.

        A memory counts with the stiffness of its stop when touched first.
        """
        root_mass = jnp.sqrt(self.modal_mass)
        rows = [root_mass * self.angular_frequency, root_mass]
        if self.internal is not None:
            rows.append(self.internal.weight)
        for stop in self.stops:
            if stop.memory_size:
                root = jnp.sqrt(jnp.maximum(contact_slope(stop), 0.0))
                shape = stop.memory_size, *root_mass.shape[1:]
                rows.append(jnp.broadcast_to(root, shape))
        rows = jnp.concatenate(rows)
        return jnp.concatenate([rows, jnp.ones((self.idle_size, *rows.shape[1:]))])

    def contact_forces(
        self, q: Coordinates, rate: Coordinates, memory: OwnMemories | None = None
    ) -> Float[Array, " stops"]:
        """Return the rounded force of each stop, N, positive when it pushes the body off."""
        return super().contact_forces(q, rate, self.memory_of_stops(memory))

    def memory_of_stops(
        self, memory: Memories | None
    ) -> Float[Array, "stop_memories *lanes"] | None:
        """Return those of the internal states `memory` that are of the stops; None for None."""
        return None if memory is None else memory[self.internal_size :]

    def memory_rates(
        self,
        q: Coordinates,
        rate: Coordinates,
        memory: OwnMemories,
        drive_input: Float[ArrayLike, ""] = 0.0,
    ) -> OwnMemories:
        """Return how fast the internal states change, per s."""
        stops = self.memory_of_stops(memory)
        assert stops is not None
        rates = super().memory_rates(q, rate, stops)
        if self.idle_size:
            rates = rates.at[-1].add(-self.angular_frequency[0] * stops[-1])
        own = self.internal
        if own is None:
            return rates
        flow = own.flow @ memory[: own.size] + own.from_input * drive_input
        flow = flow + own.from_displacement @ q + own.from_velocity @ rate
        flow = flow - own.from_force @ self.contact_forces(q, rate, memory)
        return jnp.concatenate([flow, rates])

    def acceleration(
        self,
        q: Coordinates,
        rate: Coordinates,
        drive_input: Float[ArrayLike, ""],
        memory: OwnMemories | None = None,
    ) -> Coordinates:
        """Solve the equation of motion for q'', without forming the diagonal mass matrix."""
        free = self.input_map * drive_input - self._damping(rate) - self._stiffness(q)
        if self.load is not None:
            free = free + self.load
        if self.internal is not None and memory is not None:
            free = free + self.internal.acceleration @ memory[: self.internal.size]
        return free - self.force_map @ self.contact_forces(q, rate, memory)

    def __repr__(self) -> str:
        frequencies = shown_value(self.angular_frequency, "rad/s", exact=False)
        return (
            f"LinearEquations(coordinates: {self.size}, stops: {len(self.stops)}, "
            f"angular_frequency={frequencies})"
        )
