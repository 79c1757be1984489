"""How the lanes of a map are answered: which response, with which settings."""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax._tools.described import described
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.frequencies import DIRECTIONS
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.status import Status
from vibrojax.stepping.method import AbstractMethod
from vibrojax.sweep.frequency_response import CURVES as SWEPT_CURVES
from vibrojax.sweep.frequency_sweep import check_sweep, sweep_plan
from vibrojax.sweep.swept_lanes import before_jumps, numbers_of_jumps, sweep_rigs

WHOLE = ("period", "status", "periods_marched", "steps", "regime")
"""Variables that are whole numbers."""


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
    """Motions next to the folds or touches at which a lane jumps."""

    states: Float[np.ndarray, "lanes ... states"]
    """(q, q') at drive phase 0; NaN where there is none."""
    free: Bool[np.ndarray, "lanes ..."]
    """Whether the motion does not touch: the jump is where it begins to."""


class Computed(NamedTuple):
    """What a response gives for the lanes of a block."""

    curves: dict[str, np.ndarray]
    """Arrays (lanes, ways, frequencies): ways are directions or crossings."""
    numbers: dict[str, np.ndarray]
    """Arrays (lanes,), or (lanes, places) for folds and touches."""
    points: Points
    lane_status: Int[np.ndarray, " lanes"]
    """Index into the `lane_words` of the response."""
    lane_steps: Int[np.ndarray, " lanes"]
    folds: dict[str, Folds]
    """What is behind jumps and folds, over (lanes, [places]), for derivatives."""


class AbstractMapResponse(eqx.Module):
    """A kind of response with its settings; what `parameter_map` computes for every lane."""

    @abstractmethod
    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse, with a `ValueError`, settings or systems that cannot work.

        `sample` is one system of the map, `grid` holds its frequencies. Raises `ValueError`
        for what does not go together.
        """

    @abstractmethod
    def ways(self) -> tuple[str, list[Any]]:
        """Return the dimension before the frequency (`direction`, `crossing`) and its values."""

    @property
    @abstractmethod
    def variables(self) -> tuple[str, ...]:
        """Names of the variables over the frequency."""

    @property
    def behind(self) -> dict[str, tuple[str, int]]:
        """Return variables with a dimension behind the frequency: its name and length."""
        return {}

    @property
    @abstractmethod
    def offered(self) -> tuple[str, ...]:
        """Names of the measures it has."""

    @property
    @abstractmethod
    def lane_words(self) -> tuple[str, str, str]:
        """How a lane can end, from whole to lost: a word each."""

    @property
    def point_words(self) -> tuple[str, ...]:
        """How a point can end: a word for each number of `status`."""
        return self.lane_words

    @abstractmethod
    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Answer all lanes of a block.

        `maker` makes the rigs, `index` says which of them, `grid` holds the frequencies.
        """

    def march_method(self, sample: AbstractSystem, grid: Grid) -> AbstractMethod | None:
        """Return the method whose steps its motions were marched with, None where none was.

        `sample` is one system of the map, `grid` holds its frequencies.
        """
        return None

    @property
    def bytes_per_point(self) -> int:
        """Memory that a point of a curve takes while its block is computed."""
        return 8 * (len(self.variables) + 24)

    @property
    def recipe(self) -> str:
        """The settings as Python, without those that are as by default: a store is known by it."""
        return eqx.tree_pformat(self)

    def __repr__(self) -> str:
        return described(self)


@validated
class SettledSweep(AbstractMapResponse):
    """Sweeps with the state carried along, as `frequency_sweep` makes them.

    Settings are those of `frequency_sweep`. Raises `ValueError` for settings that cannot work.
    """

    direction: str = eqx.field(static=True, default="both")
    """`both`, `forward` or `backward`."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Error to expect relative to the response."""
    steps_per_period: int | None = eqx.field(static=True, default=None)
    """Steps per drive period, instead of those the tolerance asks for."""
    method: AbstractMethod | None = None
    """How motions are stepped; None: as suits the system."""
    max_period: int = eqx.field(static=True, default=8)
    """Longest period looked for, in drive periods."""
    max_periods: int = eqx.field(static=True, default=600)
    """Most drive periods marched at a point."""
    refine_jumps: float | None = eqx.field(static=True, default=1e-4)
    """Width to which jumps are refined, as a share of the frequency; None: not at all."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work; what depends on the system is checked beside it."""
        check_sweep(
            self.direction,
            self.tolerance,
            self.steps_per_period,
            self.max_period,
            self.max_periods,
            self.refine_jumps,
        )

    def _plan(self, sample: AbstractSystem, grid: Grid) -> Any:
        return sweep_plan(
            sample,
            grid.axis,
            grid.values,
            direction=self.direction,
            tolerance=self.tolerance,
            steps_per_period=self.steps_per_period,
            method=self.method,
            max_period=self.max_period,
            max_periods=self.max_periods,
            refine_jumps=self.refine_jumps,
        )

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse what `frequency_sweep` refuses."""
        self._plan(sample, grid)

    def march_method(self, sample: AbstractSystem, grid: Grid) -> AbstractMethod:
        """Return that of the sweep."""
        return self._plan(sample, grid).method

    def ways(self) -> tuple[str, list[Any]]:
        """Return the directions."""
        return "direction", list(DIRECTIONS[self.direction])

    @property
    def variables(self) -> tuple[str, ...]:
        """Those of a `FrequencyResponse`."""
        return SWEPT_CURVES

    @property
    def offered(self) -> tuple[str, ...]:
        """All but what needs both directions, where there is one."""
        names = (
            "peak_amplitude_ratio",
            "peak_frequency",
            "resonance_shift",
            "largest_contact_force",
            "jump_up",
            "jump_down",
            "hysteresis_width",
            "hysteresis_area",
            "aperiodic_fraction",
            "natural_frequency",
        )
        both = self.direction == "both"
        return names if both else tuple(n for n in names if n != "hysteresis_area")

    @property
    def lane_words(self) -> tuple[str, str, str]:
        """As bad as its worst point; one that grows without bound counts as diverged."""
        return Status.settled.name, Status.aperiodic.name, Status.diverged.name

    @property
    def point_words(self) -> tuple[str, ...]:
        """Those of `Status`."""
        return tuple(status.name for status in Status)

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Sweep the rigs of a block."""
        sample = maker.sample(tuple(int(i[0]) for i in index))
        swept = sweep_rigs(self._plan(sample, grid), maker.rigs(index))
        jumps = numbers_of_jumps(swept)
        curves = swept.curves
        worst = np.minimum(curves["status"].max(axis=(1, 2)), Status.diverged.value)
        settled = curves["status"] == Status.settled.value
        return Computed(
            curves=curves,
            numbers={
                "jump_up": jumps["jump_up"],
                "jump_down": jumps["jump_down"],
                "natural_frequency": swept.natural_frequency,
            },
            points=Points(swept.states, np.where(settled, curves["period"], 0)),
            lane_status=worst,
            lane_steps=curves["steps"].sum(axis=(1, 2), dtype=np.int64),
            folds={n: Folds(*before) for n, before in before_jumps(swept).items()},
        )


def chosen_response(response: Any) -> AbstractMapResponse:
    """Return the response asked for, by name or with its settings.

    Raises `ValueError` for what is neither.
    """
    from vibrojax.maps.continuation_curves import ContinuationCurve
    from vibrojax.maps.periodic_points import PeriodicPoints
    from vibrojax.maps.regime_sweep import RegimeSweep

    kinds: dict[str, type[AbstractMapResponse]] = {
        "sweep": SettledSweep,
        "periodic": PeriodicPoints,
        "continuation": ContinuationCurve,
        "regimes": RegimeSweep,
    }
    if isinstance(response, AbstractMapResponse):
        return response
    if not isinstance(response, str) or response not in kinds:
        raise ValueError(
            f"response must be one of {', '.join(map(repr, kinds))}, or one of vj.SettledSweep(), "
            f"vj.PeriodicPoints(), vj.ContinuationCurve(), vj.RegimeSweep() with settings, got "
            f"{response!r}."
        )
    return kinds[response]()
