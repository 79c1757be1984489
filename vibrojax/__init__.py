"""vibrojax: differentiable, vectorised frequency sweeps of beams that hit stops."""

from vibrojax import _precision as _precision
