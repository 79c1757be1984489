"""Kinds of motion: regimes, bifurcation diagrams, basins of attraction."""

from vibrojax.regime.basins_result import Basins as Basins
from vibrojax.regime.bifurcation_result import BifurcationDiagram as BifurcationDiagram
from vibrojax.regime.lyapunov_result import LyapunovExponent as LyapunovExponent
from vibrojax.regime.regimes_result import Regimes as Regimes
