"""Maps of periodic responses: every point solved on its own, from rest."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from vibrojax._tools.checks import check_count, check_range
from vibrojax._tools.signatures import validated
from vibrojax.ensemble.frequencies import check_drive
from vibrojax.maps.responses import AbstractMapResponse, Computed, Grid, Points
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.status import Status
from vibrojax.steady.batches import in_batches
from vibrojax.steady.methods import HarmonicBalance, Shooting
from vibrojax.steady.periodic_response import periodic_response
from vibrojax.steady.periodic_result import NUMBERS

WIDTH = 32
"""Points solved side by side."""


@eqx.filter_jit
def _solved(systems, values, is_ratio, period, method, tolerance):
    def one(system, value):
        name = "frequency_ratio" if is_ratio else "frequency"
        at: Any = {name: value}
        found = periodic_response(system, **at, period=period, method=method, tolerance=tolerance)
        first = found.frequency / found.frequency_ratio
        numbers = {n: getattr(found, n) for n in NUMBERS} | {"natural_frequency": first}
        return numbers, found.initial_state, found.stable, found.status

    return eqx.filter_vmap(one)(systems, values)


@validated
class PeriodicPoints(AbstractMapResponse):
    """The motion of a given period at every frequency, reached from rest, stable or not.

    Settings are those of `periodic_response`; points do not know of their neighbours. Raises
    `ValueError` for a period below 1 or a tolerance that cannot work.
    """

    period: int = eqx.field(static=True, default=1)
    """Drive periods after which the motion repeats."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Error to expect relative to the response."""
    method: Shooting | HarmonicBalance | None = None
    """`HarmonicBalance()` or `Shooting()`; None: as suits the system."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        check_count("period", self.period)
        low, high = 0.0, 0.1
        allowed = "above 0, up to 0.1"
        check_range("tolerance", self.tolerance, low, high, include_low=False, allowed=allowed)

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse a system that nothing drives."""
        check_drive(sample)

    def ways(self) -> tuple[str, list[Any]]:
        """Return that there is one answer at a frequency."""
        return "", []

    @property
    def variables(self) -> tuple[str, ...]:
        """Those of a `PeriodicResponse`, its stability and whether it was found."""
        return (*(n for n in NUMBERS if n != "frequency"), "stable", "status")

    @property
    def offered(self) -> tuple[str, ...]:
        """What needs no direction."""
        return (
            "peak_amplitude_ratio",
            "peak_frequency",
            "resonance_shift",
            "largest_contact_force",
            "natural_frequency",
        )

    @property
    def lane_words(self) -> tuple[str, str, str]:
        """Whether a motion was found at every frequency."""
        return "found", "not_found", Status.unbounded.name

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Solve every point of a block."""
        systems = jax.device_get(maker.systems(index))
        lanes = int(np.prod([len(i) for i in index], dtype=int))
        count = len(grid.values)
        rig = np.repeat(np.arange(lanes), count)
        value = np.tile(grid.values, lanes)

        def at(i):
            own = jax.tree.map(lambda a: a[rig[i]], systems)
            in_ratio = grid.axis == "frequency_ratio"
            return _solved(own, value[i], in_ratio, self.period, self.method, self.tolerance)

        numbers, states, stable, status = in_batches(at, len(rig), WIDTH)
        shape = (lanes, 1, count)
        curves = {n: numbers[n].reshape(shape).astype(float) for n in NUMBERS if n != "frequency"}
        found = (status == 0).reshape(shape)
        curves["stable"] = np.where(found, stable.reshape(shape), np.nan)
        status = np.where(status == Status.unbounded.value, 2, status)
        curves["status"] = status.reshape(shape).astype(np.int32)
        return Computed(
            curves=curves,
            numbers={"natural_frequency": numbers["natural_frequency"].reshape(lanes, count)[:, 0]},
            points=Points(states.reshape(*shape, -1), np.where(found, self.period, 0)),
            lane_status=curves["status"].max(axis=(1, 2)),
            lane_steps=np.full(lanes, count, np.int64),
            folds={},
        )
