"""Motions of a curve as a walk along it knows them: what is asked for, and what was seen."""

from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from vibrojax.branches.contacts import Contacts, Pair, pairs
from vibrojax.steady.orbit_curve import Stride
from vibrojax.stepping.measures import Measures


@dataclass(frozen=True)
class OnCurve:
    """A motion of a curve, and the direction in which the curve goes on."""

    contacts: Contacts
    times: Float[np.ndarray, " events"]
    state: Float[np.ndarray, " states"]
    """At the section, in units of energy."""
    parameter: float
    state_along: Float[np.ndarray, " states"]
    times_along: Float[np.ndarray, " events"]
    parameter_along: float
    matrix: Float[np.ndarray, "states states"]
    error: float = np.inf
    step: float = 0.0
    """Arclength to go on with, of a motion that was a step ahead."""
    height_along: float = 0.0
    bend: float = 0.0
    way: float = 0.0
    """Arclength from the point before."""
    family: int = 0
    """Motions of one family have the same contacts, and no touch between them."""

    def reversed(self) -> "OnCurve":
        """The same motion, the curve followed the other way."""
        return replace(
            self,
            state_along=-self.state_along,
            times_along=-self.times_along,
            parameter_along=-self.parameter_along,
            height_along=-self.height_along,
        )

    def changes_before(self, stop: int, angle: float) -> int:
        """How often a stop changes contact from the section to a drive phase, rad, behind that.

        Odd numbers where it has been touched then, and only there.
        """
        changes = np.asarray(self.contacts.stops, int) == stop
        before = int(np.sum(changes & (self.times < angle)))
        return before + (self.contacts.first_phase >> stop & 1)

    @cached_property
    def multipliers(self) -> Complex[np.ndarray, " states"]:
        """Floquet multipliers."""
        return np.linalg.eigvals(self.matrix) + 0j

    def find_multipliers(self) -> None:
        """Compute the multipliers, which are kept; those of what is no motion may not be found."""
        with suppress(np.linalg.LinAlgError):
            _ = self.multipliers

    @cached_property
    def moduli(self) -> Float[np.ndarray, " states"]:
        """Moduli of the multipliers, the largest first."""
        return np.sort(np.abs(self.multipliers))[::-1]

    @cached_property
    def outside(self) -> int:
        """How many multipliers are outside of the unit circle."""
        return int(np.sum(self.moduli > 1))

    @cached_property
    def pairs(self) -> list[Pair]:
        """Contacts that could vanish at a touch."""
        return pairs(self.contacts, self.times)

    @cached_property
    def size(self) -> float:
        """Of the state, as a length."""
        return max(float(np.linalg.norm(self.state)), 1e-300)


class Ask(NamedTuple):
    """What is to be solved for: a guess and a condition (`orbit_curve.Condition`)."""

    contacts: Contacts
    times: Float[np.ndarray, " events"]
    state: Float[np.ndarray, " states"]
    parameter: float
    by_state: Float[np.ndarray, " states"] | float = 0.0
    by_times: Float[np.ndarray, " events"] | float = 0.0
    by_parameter: float = 0.0
    by_height: float = 0.0
    value: float = 0.0
    peak: int = -1
    stride: Stride = Stride(1.0, 0.0, np.inf, -np.inf, np.inf, 1)
    """How to go on behind it (`orbit_curve.Stride`): there may be several answers."""


Nearness = tuple[Sequence[float], Sequence[float]]


class Look(NamedTuple):
    """Motions that are to be marched and measured."""

    motions: list[OnCurve]
    sections: list[float] | None = None
    """Where their states are wanted too."""
    following: Ask | None = None
    """What is asked for next if all is as it should be: a program of one lane begins with it."""


class Seen(NamedTuple):
    """What a march of a motion showed."""

    contacts: Contacts
    times: Float[np.ndarray, " events"]
    fits: bool
    """Whether there was room for all events."""
    initial_state: Float[np.ndarray, " states"]
    at_section: Float[np.ndarray, " states"]
    measures: Measures
    """Without events."""
    nearest: Nearness = ((), ())
    """How near every stop comes to a change of contact and turns back, m; the drive phase, rad.

    Negative, or -inf; above zero where the change is too shallow for the march to count it.
    """


class Touch(NamedTuple):
    """A touch between two points of a walk: the motion at it, and the pair that it is of."""

    at: int
    """Index of the point that is the touch."""
    entering: bool
    """Whether the pair is there behind the touch, or before it."""
    places: tuple[int, int]
    """Of the pair in the motions that have it."""
    stop: int

    @property
    def cell(self) -> int:
        """Index of the point from which to the next one the pair comes or goes."""
        return self.at if self.entering else self.at - 1


def at_value(contacts: Contacts, times: np.ndarray, state: np.ndarray, value: float) -> Ask:
    """Ask for the motion at a value of the parameter near a guess."""
    return Ask(contacts, times, state, value, by_parameter=1.0, value=value)


Steps = Generator[Ask | Look, Any, Any]
"""Yields what is to be solved for or looked at, and takes the answers."""
