"""How a map is cut up, what it takes, and what it will take: before anything runs."""

import math
import time
from typing import Any, NamedTuple

import jax
import numpy as np

from vibrojax.ensemble.arguments import Arguments, Dimension
from vibrojax.maps.chunks import Chunks, cut, spread_out
from vibrojax.maps.responses import AbstractMapResponse, Grid
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.maps.work import MapSpec, MapWork
from vibrojax.model.systems import equation_kinds

POINTS = {"cpu": 40_000, "gpu": 2_000_000}
"""Points of a block: work of a minute or so, which is what an interruption costs."""
FEWEST, MOST = 64, 4096
"""Lanes of a block on a CPU, unless the memory allows less."""
TRIAL = 32
"""Lanes that the time of a map is estimated from."""


def _lane(maker: RigMaker, response: AbstractMapResponse, grid: Grid) -> tuple[int, int]:
    """Return the points of a lane, and the memory it takes while its block is computed, about."""
    layout = response.layout
    ways = max(1, len(layout.ways))
    state = 16 * equation_kinds(maker.sample()).size
    tables_and_history = 2 * state * state + 40 * state
    points = ways * len(grid.values)
    return points, points * (
        8 * (len(layout.variables) + layout.further) + state
    ) + ways * tables_and_history


def chunks_of(
    maker: RigMaker,
    response: AbstractMapResponse,
    grid: Grid,
    lanes: int | None,
    memory: float,
    workers: int,
) -> Chunks:
    """Cut a map into blocks that fit the memory and keep all workers busy."""
    if lanes is None:
        most = POINTS.get(jax.default_backend(), POINTS["gpu"])
        points, size = _lane(maker, response, grid)
        lanes = int(np.clip(most // points, FEWEST, MOST * (most // POINTS["cpu"])))
        lanes = min(lanes, max(1, int(memory // size)))
        if workers > 1:  # some blocks for each, so that none waits long for the last
            lanes = min(lanes, max(16, math.ceil(maker.arguments.lanes / (4 * workers))))
    return cut(maker.arguments.shape, maker.static, lanes)


class MapPlan(NamedTuple):
    """What a map will take; the answer of `parameter_map(..., dry_run=True)`."""

    lanes: int
    """Combinations of the axes, each a system."""
    points: int
    """Responses: lanes times frequencies times directions."""
    chunks: int
    """Parts that are computed and stored one at a time."""
    lanes_per_chunk: int
    """Lanes of a chunk, at most."""
    memory_bytes: int
    """Memory of a chunk while it is computed, about."""
    stored_bytes: int
    """Size of the result, uncompressed."""
    workers: int
    """Chunks computed at a time."""
    lane_seconds: float
    """Seconds per lane, of one worker, measured on a few lanes spread over the map."""
    compile_seconds: float
    """Seconds to compile, measured."""

    @property
    def seconds(self) -> float:
        """Estimated time of the whole map, s."""
        return self.lanes * self.lane_seconds / self.workers + self.compile_seconds

    def __repr__(self) -> str:
        return (
            f"Map of {self.lanes:,} lanes, {self.points:,} points\n"
            f"  chunks     {self.chunks:,} of up to {self.lanes_per_chunk:,} lanes\n"
            f"  memory     {_bytes(self.memory_bytes)} for each chunk that is computed\n"
            f"  result     {_bytes(self.stored_bytes)}\n"
            f"  rate       {1 / self.lane_seconds:,.3g} lanes/s, {self.workers} at a time, "
            "measured on a few lanes\n"
            f"  time       about {_clock(self.seconds)}, compiling {self.compile_seconds:.0f} s of "
            "it"
        )


def plan_of(spec: MapSpec, maker: RigMaker, workers: int) -> MapPlan:
    """Run a few lanes spread over the map, and say what all of them will take."""
    chunks, variables = spec.chunks, spec.template.variables.values()
    rows = spread_out(spec.arguments.shape, min(TRIAL, chunks.lanes_per_block))
    work = MapWork(_trial(spec, maker, rows))
    times = [time.perf_counter()]
    for _ in range(2):
        work.compute(0)
        times.append(time.perf_counter())
    first, run = np.diff(times).tolist()
    points, size = _lane(maker, spec.response, spec.grid)
    stored = sum(math.prod(v.inner.values()) * v.dtype.itemsize for v in variables)
    return MapPlan(
        lanes=spec.arguments.lanes,
        points=spec.arguments.lanes * points,
        chunks=chunks.number,
        lanes_per_chunk=chunks.lanes_per_block,
        memory_bytes=size * chunks.lanes_per_block,
        stored_bytes=spec.arguments.lanes * stored,
        workers=min(workers, chunks.number),
        lane_seconds=run / len(rows),
        compile_seconds=max(0.0, first - run),
    )


def _trial(spec: MapSpec, maker: RigMaker, rows: list[tuple[int, ...]]) -> MapSpec:
    """Return the map of some single combinations, along one dimension."""
    if not spec.arguments.dimensions:
        return spec
    # Static dimensions stay at their first value: another one would compile anew.
    values: dict[str, Any] = {}
    fixed = dict(spec.arguments.fixed)
    for k, (d, is_static) in enumerate(zip(spec.arguments.dimensions, maker.static, strict=True)):
        for name, own in d.values.items():
            if is_static:
                fixed[name] = own[0].item()
            else:
                values[name] = own[[row[k] for row in rows]].astype(float)
    if not values:
        return spec
    return spec._replace(
        arguments=Arguments((Dimension("lane", values),), fixed, {}),
        chunks=cut((len(rows),), (False,), len(rows)),
    )


def _bytes(count: float | int) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"


def _clock(seconds: float) -> str:
    for most, size, unit in ((120, 1, "s"), (7200, 60, "min"), (172800, 3600, "h")):
        if seconds < most:
            return f"{seconds / size:.{int(unit == 'h')}f} {unit}"
    return f"{seconds / 86400:.1f} days"
