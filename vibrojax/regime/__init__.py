"""Kinds of motion: regimes, bifurcation diagrams, basins of attraction."""

from vibrojax.regime.basins_result import Basins as Basins
from vibrojax.regime.lyapunov import LyapunovExponent as LyapunovExponent
from vibrojax.regime.table import BifurcationDiagram as BifurcationDiagram
from vibrojax.regime.table import Regimes as Regimes
