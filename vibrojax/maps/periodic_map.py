"""Maps of periodic responses: every point solved on its own, from rest."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from vibrojax._tools.compiled import compiled
from vibrojax.ensemble.frequencies import check_drive
from vibrojax.maps.responses import AbstractMapResponse, Computed, Grid, Layout, Points
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.status import Status
from vibrojax.steady.batches import in_batches
from vibrojax.steady.methods import PeriodicSettings
from vibrojax.steady.periodic_response import periodic_response
from vibrojax.steady.periodic_result import NUMBERS

WIDTH = 32
"""Points solved side by side."""
CURVES = tuple(name for name in NUMBERS if name != "frequency")


@compiled
def _solved(systems, values, is_ratio, settings):
    def one(system, value):
        name = "frequency_ratio" if is_ratio else "frequency"
        at: Any = {name: value}
        found = periodic_response(system, **at, settings=settings)
        first = found.frequency / found.frequency_ratio
        numbers = {n: getattr(found, n) for n in NUMBERS} | {"natural_frequency": first}
        return numbers, found.initial_state, found.stable, found.status

    return eqx.filter_vmap(one)(systems, values)


class PeriodicMap(AbstractMapResponse):
    """The motion of a given period at every frequency, reached from rest, stable or not.

    Points do not know of their neighbours.
    """

    settings: PeriodicSettings

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse a system that nothing drives."""
        check_drive(sample)

    @property
    def layout(self) -> Layout:
        """Variables of a `PeriodicResponse`, its stability and whether it was found."""
        words = ("found", "not_found", Status.unbounded.name)
        offered = (
            "peak_amplitude_ratio",
            "peak_frequency",
            "resonance_shift",
            "largest_contact_force",
            "natural_frequency",
        )
        return Layout((*CURVES, "stable", "status"), offered, words, words)

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Solve every point of a block."""
        systems = jax.device_get(maker.systems(index))
        lanes = int(np.prod([len(i) for i in index], dtype=int))
        count = len(grid.values)
        rig = np.repeat(np.arange(lanes), count)
        value = np.tile(grid.values, lanes)

        def at(i):
            own = jax.tree.map(lambda a: a[rig[i]], systems)
            return _solved(own, value[i], grid.axis == "frequency_ratio", self.settings)

        numbers, states, stable, status = in_batches(at, len(rig), WIDTH)
        shape = (lanes, 1, count)
        curves = {n: numbers[n].reshape(shape).astype(float) for n in CURVES}
        found = (status == 0).reshape(shape)
        curves["stable"] = np.where(found, stable.reshape(shape), np.nan)
        status = np.where(status == Status.unbounded.value, 2, status)
        curves["status"] = status.reshape(shape).astype(np.int32)
        return Computed(
            curves=curves,
            numbers={"natural_frequency": numbers["natural_frequency"].reshape(lanes, count)[:, 0]},
            points=Points(states.reshape(*shape, -1), np.where(found, self.settings.period, 0)),
            lane_status=curves["status"].max(axis=(1, 2)),
            lane_steps=np.full(lanes, count, np.int64),
        )
