"""Two bodies that meet at stops between them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import block_diag
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import as_number, check_one, check_position, concrete
from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive, BaseMotion, NoDrive, PointForce
from vibrojax.model.equations import AbstractGauge, LinearEquations
from vibrojax.model.internal_states import InternalStates, no_states
from vibrojax.model.states import Displacement
from vibrojax.model.stops import Stop, as_stops
from vibrojax.model.systems import AbstractSystem

Matrix = ArrayLike | Sequence[Any]


class JoinedGauge(AbstractGauge):
    """Reads the displacement that the second body reports, and what the first lets one watch."""

    first: AbstractGauge | None
    """What reads the coordinates of the first body, if anything."""
    response_map: Float[Array, " coordinates"]
    """Displacement that the second body reports, by its coordinates."""

    def __call__(self, q: Float[Array, " coordinates"]) -> dict[str, Float[Array, ""]]:
        """Return `second_displacement` (m) beside the observables of the first body."""
        size = q.shape[0] - self.response_map.shape[0]
        seen = {"second_displacement": self.response_map @ q[size:]}
        return seen if self.first is None else seen | self.first(q[:size])


@validated
class Joined(AbstractSystem):
    """Two bodies with stops between them: a stop that has a mass, a beam that hits another beam.

        vj.Joined(beam, vj.model.Oscillator(0.01, 2e3), vj.Stop(0.5, 4e-4, law))
        vj.Joined(beam, other_beam, vj.Stop(1.0, 1e-3, law), second_position=0.8)

    A stop between them is touched where side times (displacement of the first less that of the
    second) is more than its gap: with side 1 the second body is above the first. Its force acts on
    both. All displacements are relative to one base, on which both stand under a `BaseMotion`. What
    is reported, and every place x/L, is of the first body, and `frequency_ratio` is over its first
    natural frequency; `second_displacement` can be watched. Either may be joined itself: what
    touches it then touches its first body. Coordinates are those of the first body, then of the
    second; stops are those between, then those of the second body, then of the first. Source:
    Woiwode and Krack 2024, for two cantilevers.

    Parameters:
        first: an `ImpactingBeam`, a `MatrixSystem`, an `Oscillator`, or two that are joined.
        second: the same.
        between: one or several `Stop`; the position is that on the first body.
        second_position: the place x/L on the second, or a list with one for each stop; the tip by
            default. None where the second has no places.
        first_map: of a first body without places, as its `stop_map`: displacement of each contact
            point by coordinate, shape (stops, n). The side is taken care of.
        second_map: the same of the second.

    The drive is that of the one body that has one. Raises `ValueError` for bodies that cannot be
    joined, no stop between them, places or maps that are missing or do not fit, or two drives.
    """

    first: AbstractSystem
    second: AbstractSystem
    between: tuple[Stop, ...]
    second_position: tuple[Any, ...]
    first_map: Float[Array, "stops coordinates"] | None
    second_map: Float[Array, "stops other_coordinates"] | None

    def __init__(
        self,
        first: AbstractSystem,
        second: AbstractSystem,
        between: Stop | tuple[Stop, ...] | list[Stop],
        *,
        second_position: Matrix | None = None,
        first_map: Matrix | None = None,
        second_map: Matrix | None = None,
    ) -> None:
        self.first, self.second, self.between = first, second, as_stops(between)
        if not self.between:
            raise ValueError("between must hold at least one Stop, got none.")
        self.second_position = self._places(second_position)
        self.first_map = None if first_map is None else jnp.asarray(first_map, float)
        self.second_map = None if second_map is None else jnp.asarray(second_map, float)
        self._check_drives()
        self._bodies()

    def _places(self, given: Any) -> tuple[Any, ...]:
        """Place on the second body of every stop between; none where it has no places."""
        if self.second.reported_place is None:
            if given is None or (isinstance(given, tuple) and not given):
                return ()
            raise ValueError(
                f"second_position must be None for a {type(self.second).__name__}, which has no "
                f"places, got {in_short(given)}. Its second_map says where the stops are."
            )
        several = isinstance(given, tuple | list) or np.ndim(given) > 0
        places = tuple(given) if several else (1.0 if given is None else given,)
        places = places * len(self.between) if len(places) == 1 else places
        if len(places) != len(self.between):
            raise ValueError(
                f"second_position must be one place x/L or one for each of the {len(self.between)} "
                f"stops, got {in_short(given)}."
            )
        for place in places:
            check_one("second_position", place, "place x/L")
            check_position("second_position", place)
        return tuple(map(as_number, places))

    def _check_drives(self) -> None:
        bodies = {"first": self.first, "second": self.second}
        if not any(isinstance(body.drive, NoDrive) for body in bodies.values()):
            raise ValueError(
                f"drive must be that of one body, with NoDrive of the other, got "
                f"{self.first.drive!r} and {self.second.drive!r}. A BaseMotion of one moves both."
            )
        if not isinstance(self.drive, BaseMotion):
            return
        for name, body in bodies.items():
            rows = concrete(getattr(body, "input_map", None))
            if rows is not None and not rows.any():
                raise ValueError(
                    f"input_map of the {name} body must be given, M times the influence vector: "
                    "the BaseMotion of the other moves both."
                )

    def _bodies(self) -> tuple[AbstractSystem, AbstractSystem]:
        """The bodies, each with its side of the stops between them behind its own."""
        places = self.second_position or (None,) * len(self.between)
        facing = tuple(
            replace(stop, position=place, side=-stop.side)
            for stop, place in zip(self.between, places, strict=True)
        )
        return (
            self.first.with_stops(self.between, self.first_map),
            self.second.with_stops(facing, self.second_map),
        )

    @property
    def drive(self) -> AbstractDrive:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What drives the bodies."""
        return self.second.drive if isinstance(self.first.drive, NoDrive) else self.first.drive

    @property
    def stops(self) -> tuple[Stop, ...]:
        """All stops: those between, those of the second body, those of the first."""
        own = (getattr(body, "stops", ()) for body in (self.second, self.first))
        return sum(own, self.between)

    def equations(self) -> LinearEquations:
        """Put the equations of both bodies side by side, with the stops between them."""
        one, two = (body.equations().linear_between_contacts for body in self._bodies())
        assert one is not None
        assert two is not None  # only such bodies have `with_stops`
        if isinstance(self.drive, PointForce):
            held = [isinstance(body.drive, NoDrive) for body in (self.first, self.second)]
            one, two = (
                replace(e, input_map=jnp.zeros_like(e.input_map)) if still else e
                for e, still in zip((one, two), held, strict=True)
            )
        return side_by_side(one, two, len(self.between))

    def with_stops(
        self, stops: tuple[Stop, ...], stop_map: Float[Array, "stops coordinates"] | None = None
    ) -> "Joined":
        """Return the bodies with further `stops` at the first, last in the order of all.

        `stop_map` places them where that body has no places.
        """
        return replace(self, first=self.first.with_stops(stops, stop_map))

    def with_fixed_structure(self) -> "Joined":
        """Return the bodies with nothing left in their structure that their numbers decided."""
        first, second = self.first.with_fixed_structure(), self.second.with_fixed_structure()
        return replace(self, first=first, second=second)

    @property
    def reported_place(self) -> float | None:
        """That of the first body."""
        return self.first.reported_place

    def _of_first(self, values: Float[Array, " modes"]) -> Float[Array, " coordinates"]:
        return jnp.concatenate([values, jnp.zeros(self._bodies()[1].equations().size)])

    def shape_at(self, position: ArrayLike) -> Float[Array, " coordinates"]:
        """Return the displacement at a place x/L of the first body; `position` is from 0 to 1.

        Raises `ValueError` where that has no places.
        """
        return self._of_first(self._bodies()[0].shape_at(position))

    def static_shape(self, tip_displacement: ArrayLike) -> Float[Array, " coordinates"]:
        """Return the coordinates of the first body pulled at its tip to `tip_displacement`, m.

        The second is at rest. Raises `ValueError` for a first body without a tip.
        """
        return self._of_first(self._bodies()[0].static_shape(tip_displacement))

    def flexibility_left_out(self) -> list[float] | None:
        """Static flexibility at each stop that the coordinates lack, m/N; None: not known."""
        one, two = (body.flexibility_left_out() for body in self._bodies())
        if one is None or two is None:
            return None
        count = len(self.between)
        both = [a + b for a, b in zip(one[-count:], two[-count:], strict=True)]
        return both + two[:-count] + one[:-count]

    def modal_coordinates(self, displacement: Displacement) -> Float[Array, " coordinates"]:
        """Return the coordinates of displacements, or velocities, of both bodies.

        `displacement` is a tuple of two, each as its body takes it or None for rest. Raises
        `ValueError` for anything else.
        """
        if not isinstance(displacement, tuple) or len(displacement) != 2:
            raise ValueError(
                "displacement must be a tuple of two, that of the first body and that of the "
                f"second (None: at rest), got {in_short(displacement)}."
            )
        return jnp.concatenate(
            [
                jnp.zeros(body.equations().size) if given is None else body.modal_coordinates(given)
                for body, given in zip(self._bodies(), displacement, strict=True)
            ]
        )


def side_by_side(first: LinearEquations, second: LinearEquations, shared: int) -> LinearEquations:
    """Return the equations of two bodies; so many of their last stops are shared."""
    own, others = (len(e.stops) - shared for e in (first, second))

    def both(name: str, none: Callable[[int], Array]) -> list[Array] | None:
        """What both have by this name; `none` makes it of a size where one has it only."""
        parts = [(e.size, getattr(e, name)) for e in (first, second)]
        if all(part is None for _, part in parts):
            return None
        return [none(size) if part is None else part for size, part in parts]

    def in_a_row(name: str, none: Callable[[int], Array] = jnp.ones) -> Any:
        parts = both(name, none)
        return None if parts is None else jnp.concatenate(parts)

    def in_blocks(name: str) -> Any:
        parts = both(name, lambda size: jnp.zeros((size, size)))
        return None if parts is None else block_diag(*parts)

    def at_stops(one: Array, two: Array) -> Array:
        """Rows of the stops between, of those of the second body, of those of the first."""
        return jnp.concatenate(
            [
                jnp.concatenate([one[own:], two[others:]], axis=1),
                jnp.pad(two[:others], ((0, 0), (one.shape[1], 0))),
                jnp.pad(one[:own], ((0, 0), (0, two.shape[1]))),
            ]
        )

    return LinearEquations(
        stops=(*first.stops[own:], *second.stops[:others], *first.stops[:own]),
        angular_frequency=in_a_row("angular_frequency"),
        damping_ratio=in_a_row("damping_ratio"),
        input_map=in_a_row("input_map"),
        stop_map=at_stops(first.stop_map, second.stop_map),
        force_map=at_stops(first.force_map.T, second.force_map.T).T,
        response_map=jnp.pad(first.response_map, (0, second.size)),
        modal_mass=in_a_row("modal_mass"),
        damping_coupling=in_blocks("damping_coupling"),
        stiffness_sign=in_a_row("stiffness_sign"),
        gauge=JoinedGauge(first.gauge, second.response_map),
        stiffness_coupling=in_blocks("stiffness_coupling"),
        load=in_a_row("load", jnp.zeros),
        free=first.free or second.free,
        internal=_internal(first, second, at_stops),
    )


def _internal(
    first: LinearEquations, second: LinearEquations, at_stops: Callable[[Array, Array], Array]
) -> InternalStates | None:
    """Internal states of both bodies, those of the first in front."""
    if first.internal is None and second.internal is None:
        return None
    one, two = (
        no_states(e.size, len(e.stops)) if e.internal is None else e.internal
        for e in (first, second)
    )
    blocks = ("flow", "from_displacement", "from_velocity", "acceleration")
    rows = {name: (getattr(one, name), getattr(two, name)) for name in ("from_input", "weight")}
    return InternalStates(
        **{name: block_diag(getattr(one, name), getattr(two, name)) for name in blocks},
        **{name: jnp.concatenate(pair) for name, pair in rows.items()},
        from_force=at_stops(one.from_force.T, two.from_force.T).T,
        response=jnp.pad(one.response, (0, two.size)),
        names=one.names + tuple(f"second_{name}" for name in two.names),
        reports=one.reports,
    )
