"""How a map is cut up, what it takes, and what it will take: before anything runs."""

import math
import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from vibrojax.ensemble.arguments import Arguments, Dimension
from vibrojax.maps.chunks import Chunks, cut, spread_out
from vibrojax.maps.responses import AbstractMapResponse, Grid
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.maps.work import MapSpec, MapWork

POINTS = {"cpu": 40_000, "gpu": 2_000_000}
"""Points of a block: work of a minute or so, which is what an interruption costs."""
FEWEST, MOST = 64, 4096
"""Lanes of a block on a CPU, unless the memory allows less."""
TRIAL = 32
"""Lanes that the time of a map is estimated from."""


def lane_bytes(response: AbstractMapResponse, grid: Grid, coordinates: int) -> int:
    """Memory that a lane takes while its block is computed, about."""
    ways = max(1, len(response.ways()[1]))
    state = 2 * coordinates * 8
    tables = 16 * state * state // 8
    history = 40 * state
    return ways * (len(grid.values) * (response.bytes_per_point + state) + tables + history)


def chunks_of(
    maker: RigMaker,
    response: AbstractMapResponse,
    grid: Grid,
    lanes: int | None,
    memory: float,
    workers: int,
) -> Chunks:
    """Cut a map into blocks that fit the memory and keep all workers busy."""
    shape = maker.arguments.shape
    if lanes is None:
        kind = jax.default_backend()
        points = POINTS.get(kind, POINTS["gpu"])
        scale = points // POINTS["cpu"]
        ways = max(1, len(response.ways()[1]))
        lanes = int(np.clip(points // (ways * len(grid.values)), FEWEST, MOST * scale))
        size = eqx.filter_eval_shape(maker.sample().equations).size
        lanes = min(lanes, max(1, int(memory // lane_bytes(response, grid, size))))
        if workers > 1:  # some blocks for each, so that none waits long for the last
            lanes = min(lanes, max(16, math.ceil(maker.arguments.lanes / (4 * workers))))
    return cut(shape, maker.static, lanes)


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
        return "\n".join(
            [
                f"Map of {self.lanes:,} lanes, {self.points:,} points",
                f"  chunks     {self.chunks:,} of up to {self.lanes_per_chunk:,} lanes",
                f"  memory     {_bytes(self.memory_bytes)} for each chunk that is computed",
                f"  result     {_bytes(self.stored_bytes)}",
                f"  rate       {1 / self.lane_seconds:,.3g} lanes/s, {self.workers} at a time, "
                "measured on a few lanes",
                f"  time       about {clock(self.seconds)}, compiling {self.compile_seconds:.0f} s "
                "of it",
            ]
        )


def plan_of(spec: MapSpec, maker: RigMaker, workers: int) -> MapPlan:
    """Run a few lanes spread over the map, and say what all of them will take."""
    shape = spec.arguments.shape
    rows = spread_out(shape, min(TRIAL, spec.chunks.lanes_per_block))
    trial = _trial(spec, maker, rows)
    started = time.perf_counter()
    work = MapWork(trial)
    work.compute(0)
    between = time.perf_counter()
    work.compute(0)
    run = time.perf_counter() - between
    ways = max(1, len(spec.response.ways()[1]))
    coordinates = eqx.filter_eval_shape(maker.sample().equations).size
    stored = sum(math.prod(v.shape) * v.dtype.itemsize for v in spec.template.variables.values())
    per_lane = lane_bytes(spec.response, spec.grid, coordinates)
    return MapPlan(
        lanes=spec.arguments.lanes,
        points=spec.arguments.lanes * ways * len(spec.grid.values),
        chunks=spec.chunks.number,
        lanes_per_chunk=spec.chunks.lanes_per_block,
        memory_bytes=per_lane * spec.chunks.lanes_per_block,
        stored_bytes=stored,
        workers=min(workers, spec.chunks.number),
        lane_seconds=run / len(rows),
        compile_seconds=max(0.0, between - started - run),
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
    dimension = Dimension("lane", values)
    template = spec.template._replace(
        outer=("lane",),
        variables={
            n: v._replace(shape=(len(rows), *v.shape[len(spec.template.outer) :]))
            for n, v in spec.template.variables.items()
        },
    )
    return spec._replace(
        arguments=Arguments((dimension,), fixed),
        chunks=cut((len(rows),), (False,), len(rows)),
        template=template,
    )


def _bytes(count: float | int) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"


def clock(seconds: float) -> str:
    """Return a time in words."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    if seconds < 172800:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 86400:.1f} days"
