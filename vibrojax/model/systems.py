"""What moves: a *system* holds the numbers a person gives.

Its *equations* are computed from them once, before any stepping, so that nothing derived can go
stale.
"""

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_index, name_of
from vibrojax._tools.compiled import compiled
from vibrojax._tools.described import described, in_short, shown_value
from vibrojax._tools.signatures import check_not_traced, check_one_lane, validated
from vibrojax.model.drives import AbstractDrive, AbstractSignal, AbstractWaveform
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.states import Displacement, as_state, check_coordinates
from vibrojax.model.stops import Stop

ModuleType = TypeVar("ModuleType", bound=eqx.Module)
SystemType = TypeVar("SystemType", bound="AbstractSystem")


class AbstractSystem(eqx.Module):
    """A thing that moves and can be driven. Its numbers are leaves; its equations derive."""

    drive: eqx.AbstractVar[AbstractDrive]
    """What drives the system; its equations leave the waveform open."""

    @abstractmethod
    def equations(self) -> AbstractEquations:
        """Compute the equations of motion from the numbers of the system."""

    @property
    def reported_place(self) -> float | None:
        """Place x/L of the displacement that is reported; None for a system without places."""
        return None

    def shape_at(self, position: ArrayLike) -> Float[Array, " coordinates"]:
        """Return the displacement at a place x/L by coordinate; `position` is from 0 to 1.

        Raises `ValueError` for a system without places.
        """
        raise ValueError("Only the history of a beam has a position along it.")

    def static_shape(self, tip_displacement: ArrayLike) -> Float[Array, " coordinates"]:
        """Return the coordinates of the system pulled at its tip to `tip_displacement`, m.

        Raises `ValueError` for a system without a tip.
        """
        raise ValueError("release is for an ImpactingBeam: give initial_state instead.")

    def with_stops(
        self, stops: tuple[Stop, ...], stop_map: Float[Array, "stops coordinates"] | None = None
    ) -> "AbstractSystem":
        """Return the system with further `stops`, which come last in its equations.

        `stop_map` places them on a system without places. Raises `ValueError` for a system that is
        not linear between contacts.
        """
        raise ValueError(f"A {type(self).__name__} takes no further stops: it cannot be joined.")

    def flexibility_left_out(self) -> list[float] | None:
        """Static flexibility at each stop that the coordinates lack, m/N; None: not known."""
        return None

    @validated(traceable=True)
    def mass_at(self, stop: int = 1, modes: int | None = None) -> Float[Array, ""]:
        """Return the mass that a sudden force at a stop has to move, kg: 1 / sum of phi^2/m.

        It is what `KelvinVoigt.from_restitution` asks for. It does not depend on laws and gaps, and
        can be differentiated.

        Parameters:
            stop: number of the stop, from 1.
            modes: how many modes count, from the lowest: those whose periods are short beside the
                contact do not. None: all that are kept.

        Raises `ValueError` for a system that is not linear between contacts, or a number of a stop
        or of modes that it does not have.
        """
        equations = equations_of(as_arrays(self)).linear_between_contacts
        if equations is None:
            raise ValueError(
                f"mass_at is for systems that are linear between contacts, got {in_short(self)}. "
                "Give mass= as a number."
            )
        if not equations.stops:
            raise ValueError("mass_at needs a stop, and this system has none. Give it one.")
        check_index("stop", stop, len(equations.stops), first=1)
        if modes is not None:
            check_index("modes", modes, equations.size, first=1)
        per_force = equations.stop_map[stop - 1, :modes] * equations.force_map[:modes, stop - 1]
        return 1 / jnp.sum(per_force)

    def modal_coordinates(self, displacement: Displacement) -> Float[Array, " coordinates"]:
        """Return the coordinates q of a displacement, or q' of a velocity.

        Of a system that is not reduced to modes they are what is given, shape (coordinates,):
        angles of a pendulum, say. Raises `ValueError` for another shape.

        `displacement` is in the unit of the coordinates.
        """
        count = equation_kinds(self).size
        return check_coordinates("displacement", displacement, count, "the coordinates themselves")

    def state(
        self,
        displacement: Displacement | None = None,
        velocity: Displacement | None = None,
        memory: ArrayLike | Sequence[Any] | None = None,
    ) -> Float[Array, " states"]:
        """Return the state of a displacement and a velocity, as studies take it to start from.

            rig.state(displacement=lambda s: 2e-3 * s**2)          # of a beam, s = x/L
            rig.state({0.5: 1e-3, 1.0: 3e-3}, velocity={1.0: 0.2, 0.5: 0.1})  # at places x/L
            system.state(displacement=x, velocity=v)               # of a MatrixSystem

        It is what `initial_state=`, `guess=`, `start=` and `starts=` take. The state itself is (q,
        q', memories of the stops), shape (states,), q being coordinates of modes of a beam, a
        `MatrixSystem` or a `LinearisedPendulum`, in which displacements are `shapes @ q`, and not
        displacements of any place. It can be differentiated.

        Parameters:
            displacement: m, relative to the base: of a beam a function of x/L, or numbers by place;
                of other systems an array over their coordinates (angles, rad, of a pendulum). At
                rest by default.
            velocity: the same per second.
            memory: internal states of the stops that have one; at rest by default.

        Raises `ValueError` for what is no displacement of the system, or not finite; warns where
        the modes of a beam leave out more than a tenth of it.
        """
        equations = equation_kinds(self)
        parts = [
            jnp.zeros(equations.size) if given is None else self.modal_coordinates(given)
            for given in (displacement, velocity)
        ]
        rest = jnp.zeros(equations.memory_size)
        return as_state("state", (*parts, rest if memory is None else memory), equations)

    def with_fixed_structure(self: SystemType) -> SystemType:
        """Return the system with nothing left in its structure that its numbers decided.

        So that the systems of a study can be stacked; most systems are so already.
        """
        return self

    def __repr__(self) -> str:
        return described(self)


def held_stops(system: AbstractSystem) -> list[Stop]:
    """Return the stops that a system holds, wherever, in the order of its leaves."""
    return [s for s in jax.tree.leaves(system, is_leaf=_is_stop) if _is_stop(s)]


def with_changed_stops(system: SystemType, change: Callable[[Stop], Stop]) -> SystemType:
    """Return the system with every stop that it holds changed."""
    return jax.tree.map(lambda s: change(s) if _is_stop(s) else s, system, is_leaf=_is_stop)


def _is_stop(node: Any) -> bool:
    return isinstance(node, Stop)


def check_is_system(system: Any) -> None:
    """Raise `ValueError` unless it is a system: a function that makes one has to be called."""
    if isinstance(system, AbstractSystem):
        return
    name = getattr(system, "__name__", "make")
    advice = f" Call it first: {name}(...)." if callable(system) else ""
    raise ValueError(
        f"system must be a system, such as an ImpactingBeam, got {shown_value(system)}.{advice}"
    )


def check_made(make: Any, made: Any) -> None:
    """Raise `ValueError` unless a function of a study has made one system, of known numbers."""
    if not isinstance(made, AbstractSystem):
        raise ValueError(f"{name_of(make)} must return a system, got {in_short(made)}.")
    check_one_lane("system", made)
    check_not_traced("This study", "system", made)


def check_without_places(of: str, stops: tuple[Stop, ...], advice: str) -> None:
    """Raise `ValueError` where a stop of a system without places has one."""
    for stop in stops:
        if stop.position is not None:
            raise ValueError(
                f"position must be None for a Stop of {of}, got {stop.position!r}. {advice}"
            )


def as_arrays(system: ModuleType) -> ModuleType:
    """Turn every number of a module into an array, so that new numbers do not recompile."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), system)


@compiled(lightly=True)
def equations_of(system: AbstractSystem) -> AbstractEquations:
    """Compute the equations of a system, compiled once for all numbers of its structure."""
    return system.equations()


def equation_kinds(system: AbstractSystem) -> AbstractEquations:
    """Return the equations without their numbers: what kind they are; nothing is compiled."""
    return equations_of.kinds(as_arrays(system))


@validated
class Motion(eqx.Module):
    """Equations, drive and waveform together: all that a solver's `args` need."""

    equations: AbstractEquations
    """The equations of motion, computed from the system."""
    drive: AbstractDrive
    """Where the drive acts and how strongly."""
    waveform: AbstractWaveform
    """How the drive runs in time."""
    prepared: Any = None
    """What a solver computes once for these equations (`ContactPhases`), or None."""

    def __repr__(self) -> str:
        return described(self)

    @property
    def clock(self) -> Float[Array, ""]:
        """Angular frequency of the drive at the beginning, rad/s; under a signal of the first mode.

        Of 64 samples or of the first tone where a system has no modes.
        """
        waveform, linear = self.waveform, self.equations.linear_between_contacts
        if not isinstance(waveform, AbstractSignal):
            return waveform.phase(jnp.zeros(()))[1]
        return waveform.clock if linear is None else linear.angular_frequency[0]

    @property
    def strength(self) -> Float[Array, ""]:
        """Size of the input at the beginning, m/s2 or N; under a signal the largest one."""
        waveform = self.waveform
        if isinstance(waveform, AbstractSignal):
            return waveform.strength(self.drive)
        _, rate, second = waveform.phase(jnp.zeros(()))
        return jnp.abs(self.drive.complex_amplitude(rate, second))

    def sharp_equations(self) -> AbstractEquations:
        """Return the equations with the corner of the contact force kept, where it can be."""
        linear = self.equations.linear_between_contacts
        if self.prepared is None or linear is None:
            return self.equations
        stops = tuple(dataclasses.replace(stop, smoothing=0.0) for stop in linear.stops)
        return dataclasses.replace(linear, stops=stops)

    def vector_field(
        self, time: Float[ArrayLike, ""], state: Float[Array, " states"], args: object
    ) -> Float[Array, " states"]:
        """Return d(q, q', memories)/dt: the vector field of any diffrax solver.

        `time` in s, `state` of shape (states,); `args` is what diffrax hands on, not used.
        """
        equations = self.equations
        q, rate, memory = equations.split(state)
        drive_input = self.drive.input(self.waveform, jnp.asarray(time, state.dtype))
        if not equations.memory_size:  # as equations of one's own may know of no memory
            return jnp.concatenate([rate, equations.acceleration(q, rate, drive_input)])
        acceleration = equations.acceleration(q, rate, drive_input, memory)
        return jnp.concatenate(
            [rate, acceleration, equations.memory_rates(q, rate, memory, drive_input)]
        )
