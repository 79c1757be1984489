"""Designs by gradient: scatter that is propagated, and tolerances."""

from vibrojax.design.propagate import PropagationSettings as PropagationSettings
from vibrojax.design.propagation import Propagation as Propagation
from vibrojax.design.robust import Robust as Robust
from vibrojax.design.robust import Tolerance as Tolerance
from vibrojax.design.sobol_indices import SobolIndices as SobolIndices
