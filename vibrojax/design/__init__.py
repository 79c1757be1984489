"""Designs by gradient: measures with derivatives, optima, fronts, tolerances, scatter."""

from vibrojax.design.constraints import Constraint as Constraint
from vibrojax.design.optimum import Optimum as Optimum
from vibrojax.design.pareto import ParetoFront as ParetoFront
from vibrojax.design.pareto import pareto as pareto
from vibrojax.design.propagate import PropagationSettings as PropagationSettings
from vibrojax.design.propagation import Propagation as Propagation
from vibrojax.design.respond import respond as respond
from vibrojax.design.response import Response as Response
from vibrojax.design.robust import Robust as Robust
from vibrojax.design.robust import Tolerance as Tolerance
from vibrojax.design.settings import OptimiseSettings as OptimiseSettings
from vibrojax.design.sobol_indices import SobolIndices as SobolIndices
from vibrojax.design.tolerance_band import band as band
