"""Maps of regimes: which kind of motion there is, with the state carried along the frequency."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from vibrojax._tools.checks import check_choice, nearest
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.frequencies import DIRECTIONS
from vibrojax.maps.responses import AbstractMapResponse, Computed, Grid, Points
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem, as_arrays
from vibrojax.regime.poincare_map import PoincareMap
from vibrojax.regime.regime_points import SWEPT, RegimePlan, carried_points, regime_plan
from vibrojax.regime.regimes import check_steps, frequency_unit, regime_method
from vibrojax.results.status import Status
from vibrojax.stepping.method import AbstractMethod

VARIABLES = (
    "period",
    "regime",
    "status",
    "return_error",
    "lyapunov_exponent",
    "lyapunov_standard_error",
    *SWEPT,
    "cross_well",
    "crossings_per_period",
    "displacement_rms",
    "strain_energy_mean",
    "strain_energy_max",
    "strain_power_rms",
)
NOT_COUNTED = -1
"""Steps of a lane, which this response does not count."""


@validated
class RegimeSweep(AbstractMapResponse):
    """Regimes with the motion carried along the frequencies, as `bifurcation_diagram` does it.

    Settings are those of `bifurcation_diagram`. Derivatives are those of the periodic motions;
    others have none (NaN). `lane_steps` is not counted (-1). Raises `ValueError` for settings that
    cannot work.
    """

    direction: str = eqx.field(static=True, default="both")
    """`both`, `forward` or `backward`."""
    transient: int = eqx.field(static=True, default=200)
    """Drive periods marched before the window."""
    periods: int = eqx.field(static=True, default=100)
    """Drive periods observed."""
    max_period: int = eqx.field(static=True, default=16)
    """Longest period looked for, in drive periods."""
    tolerance: float = eqx.field(static=True, default=0.02)
    """Relative error within which a motion returns to itself."""
    lyapunov: bool = eqx.field(static=True, default=True)
    """Whether the largest Lyapunov exponent is computed."""
    samples_per_period: int = eqx.field(static=True, default=32)
    """Samples per drive period of what is observed."""
    barrier: float = eqx.field(static=True, default=0.0)
    """Displacement of the barrier between two sides, m."""
    observables: tuple[str, ...] = eqx.field(static=True, default=())
    """Further observables of the system (`chord_reduction`, ...): their `_max` and `_rms`."""
    strobes: bool = eqx.field(static=True, default=False)
    """Whether strobed `displacement` and `velocity` are kept, along a dimension `strobe`."""
    step_tolerance: float = eqx.field(static=True, default=1e-4)
    """Error of the steps to expect relative to the response."""
    steps_per_period: int | None = eqx.field(static=True, default=None)
    """Steps per drive period, instead of those the tolerance asks for."""
    method: AbstractMethod | None = None
    """How motions are stepped; None: as suits the system."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work; what depends on the system is checked beside it."""
        check_choice("direction", self.direction, tuple(DIRECTIONS))
        self._plan()
        check_steps(self.step_tolerance, self.steps_per_period)

    def _plan(self) -> RegimePlan:
        return regime_plan(
            transient=self.transient,
            periods=self.periods,
            max_period=self.max_period,
            tolerance=self.tolerance,
            lyapunov=self.lyapunov,
            samples_per_period=self.samples_per_period,
            barrier=self.barrier,
            spectrum=False,
        )

    def march_method(self, sample: AbstractSystem, grid: Grid) -> AbstractMethod:
        """Return the method asked for, or the one that suits the system."""
        return regime_method(
            sample, grid.axis, self.method, self.step_tolerance, self.steps_per_period
        )

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse a system that nothing drives, and observables that it has not."""
        self.march_method(sample, grid)
        equations = as_arrays(sample).equations()
        known = equations.observables(jnp.zeros(equations.size))
        for name in self.observables:
            if name not in known:
                raise ValueError(f"Unknown observable {name!r}. {nearest(str(name), known)}")

    def ways(self) -> tuple[str, list[Any]]:
        """Return the directions."""
        return "direction", list(DIRECTIONS[self.direction])

    @property
    def variables(self) -> tuple[str, ...]:
        """Kinds, periods, exponents, contacts, energies and the observables asked for."""
        more = (f"{name}_{kind}" for name in self.observables for kind in ("max", "rms"))
        own = (*VARIABLES, *(name for name in more if name not in VARIABLES))
        return (*own, *self.behind)

    @property
    def behind(self) -> dict[str, tuple[str, int]]:
        """Strobes, where they are kept."""
        if not self.strobes:
            return {}
        return dict.fromkeys(("displacement", "velocity"), ("strobe", self.periods))

    @property
    def offered(self) -> tuple[str, ...]:
        """Shares of kinds, the largest exponent and power, and what a sweep has."""
        return (
            "chaotic_fraction",
            "periodic_fraction",
            "largest_lyapunov_exponent",
            "largest_strain_power",
            "peak_amplitude_ratio",
            "peak_frequency",
            "largest_contact_force",
            "natural_frequency",
        )

    @property
    def lane_words(self) -> tuple[str, str, str]:
        """As bad as its worst point; one that grows without bound counts as diverged."""
        return Status.settled.name, Status.aperiodic.name, Status.diverged.name

    @property
    def point_words(self) -> tuple[str, ...]:
        """Those of `Status`."""
        return tuple(status.name for status in Status)

    @property
    def bytes_per_point(self) -> int:
        """Memory that a point of a curve takes while its block is computed."""
        return 8 * (len(self.variables) + 24 + 2 * self.periods)

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Carry the rigs of a block along the frequencies."""
        sample = maker.sample(tuple(int(i[0]) for i in index))
        poincare = PoincareMap.of(self.march_method(sample, grid), maker.rigs(index))
        ways = DIRECTIONS[self.direction]
        lanes, count = len(poincare.weight), len(grid.values)
        rig = np.repeat(np.arange(lanes), len(ways))
        unit = frequency_unit(poincare, grid.axis)
        found = carried_points(
            poincare,
            np.repeat(rig[:, None], count, axis=1),
            grid.values * unit[rig][:, None],
            np.tile([way == "backward" for way in ways], lanes),
            np.zeros((len(rig), poincare.states)),
            self._plan(),
        )
        shape = (lanes, len(ways), count)
        found = {n: v.reshape(*shape, *v.shape[2:]) for n, v in found.items()}
        states = found.pop("state")
        natural = np.asarray(poincare.prepared.first_frequency) / (2 * np.pi)
        return Computed(
            curves={name: found[name] for name in self.variables},
            numbers={"natural_frequency": natural},
            points=Points(states, found["period"]),
            lane_status=np.minimum(found["status"].max(axis=(1, 2)), Status.diverged.value),
            lane_steps=np.full(lanes, NOT_COUNTED, np.int64),
            folds={},
        )
