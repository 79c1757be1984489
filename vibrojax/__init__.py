"""vibrojax: differentiable, vectorised frequency sweeps of beams that hit stops.

Importing vibrojax switches JAX to float64, unless the environment variable JAX_ENABLE_X64 is set.
"""

from types import ModuleType as _ModuleType

from vibrojax._tools import interrupts as _interrupts  # noqa: F401

# isort: split
# Interrupts are watched before JAX is imported, which takes a while.
from vibrojax._tools import forks as _forks  # noqa: F401
from vibrojax._tools import precision as _precision  # noqa: F401
from vibrojax.branches.branch import Branch as Branch
from vibrojax.branches.branch import Branches as Branches
from vibrojax.branches.coexisting import coexisting_responses as coexisting_responses
from vibrojax.branches.coexisting_result import Coexisting as Coexisting
from vibrojax.branches.continue_response import continue_response as continue_response
from vibrojax.branches.fold_curves import FoldCurve as FoldCurve
from vibrojax.branches.fold_curves import FoldCurves as FoldCurves
from vibrojax.branches.fold_curves import fold_curves as fold_curves
from vibrojax.branches.folds import Fold as Fold
from vibrojax.branches.folds import fold_response as fold_response
from vibrojax.branches.points import SpecialPoint as SpecialPoint
from vibrojax.ensemble.arguments import zipped as zipped
from vibrojax.explorer.explore import explore as explore
from vibrojax.explorer.explorer import Explorer as Explorer
from vibrojax.history.contacts import Contacts as Contacts
from vibrojax.history.cycles import Cycles as Cycles
from vibrojax.history.energy import EnergyFlow as EnergyFlow
from vibrojax.history.histories import Histories as Histories
from vibrojax.history.history import History as History
from vibrojax.history.poincare import PoincareSection as PoincareSection
from vibrojax.history.simulate import motion as motion
from vibrojax.history.simulate import simulate as simulate
from vibrojax.history.simulate_each import simulate_each as simulate_each
from vibrojax.history.spectrum import Spectrum as Spectrum
from vibrojax.identification.identification import Identification as Identification
from vibrojax.identification.identify import identify as identify
from vibrojax.identification.identify import identify_each as identify_each
from vibrojax.identification.least_squares import (
    LevenbergMarquardt as LevenbergMarquardt,
)
from vibrojax.identification.least_squares import Optax as Optax
from vibrojax.io.rig_file import read_rig as read_rig
from vibrojax.maps.basin_fractions import BasinFractions as BasinFractions
from vibrojax.maps.continuation_curves import ContinuationCurve as ContinuationCurve
from vibrojax.maps.parameter_map import parameter_map as parameter_map
from vibrojax.maps.periodic_points import PeriodicPoints as PeriodicPoints
from vibrojax.maps.planning import MapPlan as MapPlan
from vibrojax.maps.regime_sweep import RegimeSweep as RegimeSweep
from vibrojax.maps.settled_sweep import SettledSweep as SettledSweep
from vibrojax.maps.store_files import StoreFull as StoreFull
from vibrojax.maps.store_files import StoreInUse as StoreInUse
from vibrojax.maps.store_files import StoreReadOnly as StoreReadOnly
from vibrojax.measured.curve import MeasuredCurve as MeasuredCurve
from vibrojax.measured.curve import MeasuredCurves as MeasuredCurves
from vibrojax.measured.history import MeasuredHistory as MeasuredHistory
from vibrojax.measured.history import read_measured_history as read_measured_history
from vibrojax.measured.reading import read_measured_curve as read_measured_curve
from vibrojax.model.beam import Cantilever as Cantilever
from vibrojax.model.beam import PointMass as PointMass
from vibrojax.model.drives import AbstractDrive as AbstractDrive
from vibrojax.model.drives import AbstractWaveform as AbstractWaveform
from vibrojax.model.drives import BaseMotion as BaseMotion
from vibrojax.model.drives import Chirp as Chirp
from vibrojax.model.drives import Harmonic as Harmonic
from vibrojax.model.drives import NoDrive as NoDrive
from vibrojax.model.drives import PointForce as PointForce
from vibrojax.model.elastic_pendulum import ElasticPendulum as ElasticPendulum
from vibrojax.model.elastic_pendulum import Limiters as Limiters
from vibrojax.model.elastic_pendulum import default_pendulum as default_pendulum
from vibrojax.model.equations import AbstractEquations as AbstractEquations
from vibrojax.model.equations import LinearEquations as LinearEquations
from vibrojax.model.examples import default_rig as default_rig
from vibrojax.model.impacting_beam import ImpactingBeam as ImpactingBeam
from vibrojax.model.laws import AbstractContactLaw as AbstractContactLaw
from vibrojax.model.laws import AbstractLinearLaw as AbstractLinearLaw
from vibrojax.model.laws import AbstractMemoryLaw as AbstractMemoryLaw
from vibrojax.model.laws import Hertz as Hertz
from vibrojax.model.laws import HuntCrossley as HuntCrossley
from vibrojax.model.laws import KelvinVoigt as KelvinVoigt
from vibrojax.model.laws import StandardLinearSolid as StandardLinearSolid
from vibrojax.model.linearised_pendulum import LinearisedPendulum as LinearisedPendulum
from vibrojax.model.matrix_system import MatrixModes as MatrixModes
from vibrojax.model.matrix_system import MatrixSystem as MatrixSystem
from vibrojax.model.modes import Modes as Modes
from vibrojax.model.modes import modes as modes
from vibrojax.model.stops import Stop as Stop
from vibrojax.model.systems import AbstractSystem as AbstractSystem
from vibrojax.model.systems import Motion as Motion
from vibrojax.plot.maps import plot_map as plot_map
from vibrojax.plot.maps import plot_map_summary as plot_map_summary
from vibrojax.regime.basins import basins as basins
from vibrojax.regime.basins_result import Basins as Basins
from vibrojax.regime.bifurcation import bifurcation_diagram as bifurcation_diagram
from vibrojax.regime.bifurcation_result import BifurcationDiagram as BifurcationDiagram
from vibrojax.regime.kinds import Regime as Regime
from vibrojax.regime.lyapunov import lyapunov_exponent as lyapunov_exponent
from vibrojax.regime.lyapunov_result import LyapunovExponent as LyapunovExponent
from vibrojax.regime.regimes import regimes as regimes
from vibrojax.regime.regimes_result import Regimes as Regimes
from vibrojax.resolution import ResolutionCheck as ResolutionCheck
from vibrojax.resolution import check_resolution as check_resolution
from vibrojax.results.status import Status as Status
from vibrojax.steady.methods import HarmonicBalance as HarmonicBalance
from vibrojax.steady.methods import Shooting as Shooting
from vibrojax.steady.periodic_response import periodic_response as periodic_response
from vibrojax.steady.periodic_result import PeriodicResponse as PeriodicResponse
from vibrojax.steady.single_contact_response import (
    single_contact_response as single_contact_response,
)
from vibrojax.steady.single_contact_result import (
    SingleContactResponse as SingleContactResponse,
)
from vibrojax.stepping.linearly_implicit import LinearlyImplicit as LinearlyImplicit
from vibrojax.stepping.method import AbstractMethod as AbstractMethod
from vibrojax.stepping.method import ExactContact as ExactContact
from vibrojax.stepping.method import ExponentialSplitting as ExponentialSplitting
from vibrojax.sweep.frequency_response import FrequencyResponse as FrequencyResponse
from vibrojax.sweep.frequency_sweep import frequency_sweep as frequency_sweep

__version__ = "0.1.0"


def __dir__() -> list[str]:
    """Return the public names, without the submodules that importing them left here."""
    found = [n for n, v in globals().items() if n[0] != "_" and not isinstance(v, _ModuleType)]
    return sorted([*found, "__version__"])


__all__ = __dir__()  # pyright: ignore[reportUnsupportedDunderAll]
