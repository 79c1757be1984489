"""Lanes that march from the end of one drive period to that of the next, each at its own pace."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

States = Float[Array, "states *lanes"]
Counts = Int[Array, "*lanes"]
Which = Bool[Array, "*lanes"]


class AbstractRun(ABC):
    """Lanes at their drive frequencies."""

    @abstractmethod
    def begin(self, state: States) -> Any:
        """Put lanes at the beginning of a drive period."""

    @abstractmethod
    def go_on(self, lanes: Any, live: Which) -> tuple[Any, Which]:
        """Take live lanes further; also which of them have reached the end of their period."""

    @abstractmethod
    def arrived_at(self, lanes: Any) -> tuple[States, Counts]:
        """Return the states of lanes at the end of their period, and the steps taken in it.

        A lane that cannot go on has a state that is not finite: infinite where it was given up.
        """


class EqualRun(AbstractRun):
    """Lanes that need about the same time for a period: they go from end to end together."""

    def __init__(self, march: Callable[..., Any], angular_frequency: Float[Array, "*lanes"]):
        self.march, self.angular_frequency = march, angular_frequency

    def begin(self, state: States) -> tuple[States, Counts]:
        """Put lanes at the beginning of a drive period."""
        return state, jnp.zeros(self.angular_frequency.shape, jnp.int32)

    def go_on(
        self, lanes: tuple[States, Counts], live: Which
    ) -> tuple[tuple[States, Counts], Which]:
        """Take live lanes through a period."""
        periods = live.astype(jnp.int32)
        state, steps, _ = self.march(lanes[0], self.angular_frequency, periods, False)
        return (state, steps), live

    def arrived_at(self, lanes: tuple[States, Counts]) -> tuple[States, Counts]:
        """Return states and steps."""
        return lanes
