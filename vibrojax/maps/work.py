"""One block of a map, from its number to the values of all variables."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from vibrojax.ensemble.arguments import Arguments
from vibrojax.maps.chunks import Block, Chunks
from vibrojax.maps.gradients import (
    Slopes,
    curve_slopes,
    differentiate,
    fold_slopes,
    measure_slopes,
)
from vibrojax.maps.measures import AT_FOLDS, Measure, measure_lanes
from vibrojax.maps.responses import AbstractMapResponse, Computed, Grid
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.maps.template import Template
from vibrojax.stepping.choice import choose_stepper
from vibrojax.stepping.linearly_implicit import LinearlyImplicit

GRADIENT_TOLERANCE = 1e-6
"""Tolerance of the march that is differentiated: extremes are read off a finer grid."""


class MapSpec(NamedTuple):
    """All that a map is; can be sent to another process."""

    make: Callable[..., Any]
    arguments: Arguments
    grid: Grid
    response: AbstractMapResponse
    measures: tuple[Measure, ...]
    keep_curves: bool
    gradients: tuple[str, ...]
    chunks: Chunks
    template: Template
    identity: str = ""
    """Stands for all of this in the records of its chunks."""

    @property
    def reads_folds(self) -> bool:
        """Whether a measure may be read off jumps or folds; each of the user's may."""
        return any(not m.own or m.name in AT_FOLDS for m in self.measures)

    def where(self, number: int) -> str:
        """Say where a block lies along the axes."""
        return ", ".join(
            f"{d.name}[{part.start}:{part.stop}]"
            for d, part in zip(
                self.arguments.dimensions, self.chunks.at(number).region, strict=True
            )
        )


class MapWork:
    """A map ready to be computed, block by block."""

    def __init__(self, spec: MapSpec):
        self.spec = spec
        self.maker = RigMaker(spec.make, spec.arguments)
        self.together = self.maker.together(spec.chunks.lanes_per_block)
        self.some_rigs = functools.lru_cache(16)(self._some_rigs)

    def compute(self, number: int) -> tuple[Block, dict[str, np.ndarray]]:
        """Return a block and the values of all variables in it."""
        spec = self.spec
        block = spec.chunks.at(number)
        response = spec.response if spec.reads_folds else spec.response.without_jumps()
        computed = response.compute(self.maker, block.indices, spec.grid)
        values = self._values(block, computed)
        inside = block.inside
        found = {}
        for name, described in spec.template.variables.items():
            own = values[name][inside].reshape((*block.shape, *described.inner.values()))
            found[name] = own.astype(described.dtype)
        return block, found

    def rigs(self, number: int) -> str:
        """Return what stands for the rigs of a block."""
        return self.some_rigs(number // self.together)[number % self.together]

    def _some_rigs(self, part: int) -> list[str]:
        """Return the same for blocks whose fingerprints are made together."""
        chunks = self.spec.chunks
        first = part * self.together
        numbers = range(first, min(first + self.together, chunks.number))
        return list(self.maker.digests(map(chunks.at, numbers)))

    def _values(self, block: Block, computed: Computed) -> dict[str, np.ndarray]:
        spec = self.spec
        frequencies = spec.grid.values
        curves = self._without_ways(computed.curves) | computed.numbers
        in_ratio = spec.grid.axis == "frequency_ratio"
        natural = computed.numbers["natural_frequency"]
        curves["unit_frequency"] = np.ones_like(natural) if in_ratio else natural
        shared = {"frequencies": frequencies, spec.grid.axis: frequencies}
        values = measure_lanes(spec.measures, curves, shared)
        if spec.gradients:
            values |= self._derivatives(block, computed, curves, shared)
        if spec.keep_curves:
            values |= self._without_ways(computed.curves)
        return values | {"lane_status": computed.lane_status, "lane_steps": computed.lane_steps}

    def _without_ways(self, curves: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Drop the axis of the ways where there is but one without a name."""
        ways = self.spec.response.layout.ways
        return dict(curves) if ways else {n: a[:, 0] for n, a in curves.items()}

    def _derivatives(
        self, block: Block, computed: Computed, curves: dict, shared: dict
    ) -> dict[str, np.ndarray]:
        spec = self.spec
        sample = self.maker.first_of(block.indices)
        stepper = spec.response.march_stepper(sample, spec.grid)
        if not isinstance(stepper, LinearlyImplicit):  # whose orbits are those of their own steps
            stepper = choose_stepper(sample, None, GRADIENT_TOLERANCE, None)
        names = spec.gradients
        rigs = differentiate(self.maker, block.indices, names, stepper)
        at_points = curve_slopes(rigs, spec.grid, computed)
        at_folds: Slopes = {name: {} for name in names}
        if spec.reads_folds:  # long to compile
            at_folds = fold_slopes(rigs, spec.grid, computed)
        slopes: Slopes = {}
        for name in names:
            numbers = {n: a for n, a in at_points[name].items() if n == "natural_frequency"}
            over = {n: a for n, a in at_points[name].items() if n not in numbers}
            slopes[name] = self._without_ways(over) | numbers | at_folds[name]
            if spec.grid.axis == "frequency":
                slopes[name]["unit_frequency"] = numbers["natural_frequency"]
        values = measure_slopes(spec.measures, curves, shared, slopes)
        for name in names:
            for variable, slope in slopes[name].items():
                if spec.keep_curves and variable in computed.curves:
                    values[f"d_{variable}_d_{name}"] = slope
        return values
