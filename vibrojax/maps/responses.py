"""How the lanes of a map are answered: which response, with which settings."""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax._tools.described import described
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.status import LOST, Status
from vibrojax.stepping.stepper import AbstractStepper

MARCHED = Status.settled.name, Status.aperiodic.name, "lost"
"""How lanes end that are marched: as bad as their worst point. Lost are those with a point that
diverged, is unbounded or was given up."""
STATUS = tuple(status.name for status in Status)
WHOLE = ("period", "status", "periods_marched", "steps", "regime")
"""Variables that are whole numbers."""


def worst_of(status: Int[np.ndarray, "lanes ..."]) -> Int[np.ndarray, " lanes"]:
    """Return how lanes end whose points ended so, as an index into `MARCHED`."""
    ends = np.where(np.isin(status, LOST), MARCHED.index("lost"), status)
    return ends.reshape(len(status), -1).max(axis=1)


class Grid(NamedTuple):
    """The frequencies of a map."""

    axis: str
    """`frequency_ratio` or `frequency` (Hz)."""
    values: Float[np.ndarray, " frequencies"]
    single: bool
    """Whether it was one number, which then is no axis of the result."""


class Points(NamedTuple):
    """The steady states behind the curves, for derivatives."""

    states: Float[np.ndarray, "lanes ... states"]
    """(q, q') at drive phase 0."""
    period: Int[np.ndarray, "lanes ..."]
    """Drive periods after which they return; 0 where there is no steady state."""


class Folds(NamedTuple):
    """Motions at the folds or touches at which a lane jumps, or next to them."""

    bracket: Float[np.ndarray, "lanes ... 2"]
    """Between which values of the axis: the motion is on its branch at the first. No width where it
    is that of the fold itself; NaN where there is none."""
    states: Float[np.ndarray, "lanes ... states"]
    """(q, q') at drive phase 0, at the first of these values."""
    free: Bool[np.ndarray, "lanes ..."]
    """Whether the motion does not touch: the jump is where it begins to."""
    period: Int[np.ndarray, "lanes ..."]
    """Drive periods after which the motion returns; 0 where it has not settled."""


class Computed(NamedTuple):
    """What a response gives for the lanes of a block."""

    curves: dict[str, np.ndarray]
    """Arrays (lanes, ways, frequencies): ways are directions or crossings."""
    numbers: dict[str, np.ndarray]
    """Arrays (lanes,), or (lanes, places) for folds and touches."""
    points: Points
    lane_status: Int[np.ndarray, " lanes"]
    """Index into the `lane_words` of the layout."""
    lane_steps: Int[np.ndarray, " lanes"]
    folds: dict[str, Folds] = {}  # noqa: RUF012
    """What is behind jumps and folds, over (lanes, [places]), for derivatives."""


class Layout(NamedTuple):
    """What a response is about: the names of what it gives."""

    variables: tuple[str, ...]
    """Over the frequency."""
    offered: tuple[str, ...]
    """Measures that it has."""
    lane_words: tuple[str, str, str]
    """How a lane can end, from whole to lost, in one word."""
    point_words: tuple[str, ...]
    """How a point can end: the words for the numbers of `status`."""
    way: str = ""
    """Dimension before the frequency (`direction`, `crossing`), where there is one."""
    ways: tuple[Any, ...] = ()
    """Its values."""
    behind: dict[str, tuple[str, int]] = {}  # noqa: RUF012
    """Variables with a dimension behind the frequency: its name and length."""
    further: int = 24
    """Numbers besides the variables that a point takes while its block is computed."""


class AbstractMapResponse(eqx.Module):
    """A kind of response with its settings; what `parameter_map` computes for every lane."""

    settings: eqx.AbstractVar[Any]

    @property
    @abstractmethod
    def layout(self) -> Layout:
        """Names of what it gives."""

    @abstractmethod
    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse, with a `ValueError`, settings or systems that cannot work.

        `sample` is one system of the map, `grid` holds its frequencies. Raises `ValueError`
        for what does not go together.
        """

    def without_jumps(self) -> "AbstractMapResponse":
        """Return what computes the same, but for jumps that nobody reads."""
        return self

    @abstractmethod
    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Answer all lanes of a block.

        `maker` makes the rigs, `index` says which of them, `grid` holds the frequencies.
        """

    def march_stepper(self, sample: AbstractSystem, grid: Grid) -> AbstractStepper | None:
        """Return the stepper whose steps its motions were marched with, None where none was.

        `sample` is one system of the map, `grid` holds its frequencies.
        """
        return None

    @property
    def recipe(self) -> str:
        """The settings as Python, without those that are as by default: a store is known by it."""
        return eqx.tree_pformat(self.settings)

    def __repr__(self) -> str:
        return described(self)
