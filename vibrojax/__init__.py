"""vibrojax: differentiable, vectorised frequency sweeps of beams that hit stops.

Importing vibrojax switches JAX to float64, unless the environment variable JAX_ENABLE_X64 is set.
"""

from types import ModuleType as _ModuleType

from vibrojax._tools import interrupts as _interrupts  # noqa: F401

# isort: split
# Interrupts are watched before JAX is imported, which takes a while.
from vibrojax._tools import forks as _forks  # noqa: F401
from vibrojax._tools import precision as _precision  # noqa: F401
from vibrojax._tools import threads as _threads  # noqa: F401

# isort: split
from vibrojax import branches as branches
from vibrojax import design as design
from vibrojax import explorer as explorer
from vibrojax import history as history
from vibrojax import identification as identification
from vibrojax import io as io
from vibrojax import maps as maps
from vibrojax import model as model
from vibrojax import regime as regime
from vibrojax import steady as steady
from vibrojax import stepping as stepping
from vibrojax import sweep as sweep
from vibrojax.branches.continue_response import continue_response as continue_response
from vibrojax.branches.fold_curves import fold_curves as fold_curves
from vibrojax.branches.folds import fold_response as fold_response
from vibrojax.branches.settings import ContinuationSettings as ContinuationSettings
from vibrojax.design.optimise import optimise as optimise
from vibrojax.design.propagate import propagate as propagate
from vibrojax.ensemble.arguments import zipped as zipped
from vibrojax.ensemble.ranges import Range as Range
from vibrojax.explorer.explore import explore as explore
from vibrojax.history.simulate import motion as motion
from vibrojax.history.simulate import simulate as simulate
from vibrojax.identification.compare_laws import compare_laws as compare_laws
from vibrojax.identification.identify import identify as identify
from vibrojax.maps.parameter_map import parameter_map as parameter_map
from vibrojax.model.beam import Cantilever as Cantilever
from vibrojax.model.beam import PointMass as PointMass
from vibrojax.model.drives import BaseMotion as BaseMotion
from vibrojax.model.drives import Chirp as Chirp
from vibrojax.model.drives import Harmonic as Harmonic
from vibrojax.model.drives import NoDrive as NoDrive
from vibrojax.model.drives import PointForce as PointForce
from vibrojax.model.elastic_pendulum import ElasticPendulum as ElasticPendulum
from vibrojax.model.elastic_pendulum import default_pendulum as default_pendulum
from vibrojax.model.examples import default_rig as default_rig
from vibrojax.model.harvester import Harvester as Harvester
from vibrojax.model.impacting_beam import ImpactingBeam as ImpactingBeam
from vibrojax.model.joined import Joined as Joined
from vibrojax.model.laws import Hertz as Hertz
from vibrojax.model.laws import HuntCrossley as HuntCrossley
from vibrojax.model.laws import KelvinVoigt as KelvinVoigt
from vibrojax.model.linearised_pendulum import LinearisedPendulum as LinearisedPendulum
from vibrojax.model.matrix_system import MatrixSystem as MatrixSystem
from vibrojax.model.modes import modes as modes
from vibrojax.model.relaxing_laws import StandardLinearSolid as StandardLinearSolid
from vibrojax.model.signals import Sampled as Sampled
from vibrojax.model.signals import Tones as Tones
from vibrojax.model.state_space import StateSpace as StateSpace
from vibrojax.model.stops import Stop as Stop
from vibrojax.plot.maps import plot_map as plot_map
from vibrojax.plot.maps import plot_map_summary as plot_map_summary
from vibrojax.regime.basins import basins as basins
from vibrojax.regime.bifurcation import bifurcation_diagram as bifurcation_diagram
from vibrojax.regime.lyapunov import lyapunov_exponent as lyapunov_exponent
from vibrojax.regime.regimes import regimes as regimes
from vibrojax.regime.settings import BasinSettings as BasinSettings
from vibrojax.regime.settings import RegimeSettings as RegimeSettings
from vibrojax.resolution import check_resolution as check_resolution
from vibrojax.results.status import Status as Status
from vibrojax.steady.kinds import Regime as Regime
from vibrojax.steady.methods import HarmonicBalance as HarmonicBalance
from vibrojax.steady.methods import PeriodicSettings as PeriodicSettings
from vibrojax.steady.methods import Shooting as Shooting
from vibrojax.steady.periodic_response import periodic_response as periodic_response
from vibrojax.steady.single_contact_response import (
    single_contact_response as single_contact_response,
)
from vibrojax.stepping.linearly_implicit import LinearlyImplicit as LinearlyImplicit
from vibrojax.stepping.stepper import ExactContact as ExactContact
from vibrojax.stepping.stepper import ExponentialSplitting as ExponentialSplitting
from vibrojax.sweep.frequency_sweep import frequency_sweep as frequency_sweep
from vibrojax.sweep.settings import SweepSettings as SweepSettings

__version__ = "0.2.0"


def __dir__() -> list[str]:
    """Return the public names; those of results and abstract classes are in the rooms."""
    found = [n for n, v in globals().items() if n[0] != "_" and not isinstance(v, _ModuleType)]
    return sorted([*found, "__version__"])


__all__ = __dir__()  # pyright: ignore[reportUnsupportedDunderAll]
