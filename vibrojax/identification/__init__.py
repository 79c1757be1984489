"""Numbers of a rig from measurements."""

from vibrojax.identification.identification import Identification as Identification
from vibrojax.identification.law_comparison import LawComparison as LawComparison
from vibrojax.identification.least_squares import LevenbergMarquardt as LevenbergMarquardt
from vibrojax.identification.least_squares import Optax as Optax
