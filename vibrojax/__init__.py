"""vibrojax: differentiable, vectorised frequency sweeps of beams that hit stops.

Importing vibrojax switches JAX to float64, unless the environment variable JAX_ENABLE_X64 is set.
"""

from types import ModuleType as _ModuleType

from vibrojax import _interrupts as _interrupts

# isort: split
# Interrupts are watched before JAX is imported, which takes a while.
from vibrojax import _forks as _forks
from vibrojax import _precision as _precision
from vibrojax.beam import Cantilever as Cantilever
from vibrojax.beam import PointMass as PointMass
from vibrojax.contact import Stop as Stop
from vibrojax.contact_laws import AbstractContactLaw as AbstractContactLaw
from vibrojax.contact_laws import AbstractLinearLaw as AbstractLinearLaw
from vibrojax.contact_laws import AbstractMemoryLaw as AbstractMemoryLaw
from vibrojax.contact_laws import Hertz as Hertz
from vibrojax.contact_laws import HuntCrossley as HuntCrossley
from vibrojax.contact_laws import KelvinVoigt as KelvinVoigt
from vibrojax.contact_laws import StandardLinearSolid as StandardLinearSolid
from vibrojax.drive import AbstractDrive as AbstractDrive
from vibrojax.drive import AbstractWaveform as AbstractWaveform
from vibrojax.drive import BaseMotion as BaseMotion
from vibrojax.drive import Chirp as Chirp
from vibrojax.drive import Harmonic as Harmonic
from vibrojax.drive import NoDrive as NoDrive
from vibrojax.drive import PointForce as PointForce
from vibrojax.explorer.explore import explore as explore
from vibrojax.explorer.explorer import Explorer as Explorer
from vibrojax.measured.curve import MeasuredCurve as MeasuredCurve
from vibrojax.measured.curve import MeasuredCurves as MeasuredCurves
from vibrojax.measured.history import MeasuredHistory as MeasuredHistory
from vibrojax.measured.history import read_measured_history as read_measured_history
from vibrojax.measured.reading import read_measured_curve as read_measured_curve
from vibrojax.modes import Modes as Modes
from vibrojax.modes import modes as modes
from vibrojax.response.folds import Fold as Fold
from vibrojax.response.folds import fold_response as fold_response
from vibrojax.response.lyapunov import lyapunov_exponent as lyapunov_exponent
from vibrojax.response.methods import HarmonicBalance as HarmonicBalance
from vibrojax.response.methods import Shooting as Shooting
from vibrojax.response.periodic_response import periodic_response as periodic_response
from vibrojax.response.simulate import motion as motion
from vibrojax.response.simulate import simulate as simulate
from vibrojax.results.basins import Basins as Basins
from vibrojax.results.bifurcation import BifurcationDiagram as BifurcationDiagram
from vibrojax.results.branch import Branch as Branch
from vibrojax.results.branch import Branches as Branches
from vibrojax.results.branch import SpecialPoint as SpecialPoint
from vibrojax.results.coexisting import Coexisting as Coexisting
from vibrojax.results.contacts import Contacts as Contacts
from vibrojax.results.cycles import Cycles as Cycles
from vibrojax.results.energy import EnergyFlow as EnergyFlow
from vibrojax.results.fold_curves import FoldCurve as FoldCurve
from vibrojax.results.fold_curves import FoldCurves as FoldCurves
from vibrojax.results.frequency_response import FrequencyResponse as FrequencyResponse
from vibrojax.results.histories import Histories as Histories
from vibrojax.results.history import History as History
from vibrojax.results.identification import Identification as Identification
from vibrojax.results.lyapunov import LyapunovExponent as LyapunovExponent
from vibrojax.results.maps import plot_map as plot_map
from vibrojax.results.maps import plot_map_summary as plot_map_summary
from vibrojax.results.periodic_response import PeriodicResponse as PeriodicResponse
from vibrojax.results.poincare import PoincareSection as PoincareSection
from vibrojax.results.regime_kinds import Regime as Regime
from vibrojax.results.regimes import Regimes as Regimes
from vibrojax.results.resolution import ResolutionCheck as ResolutionCheck
from vibrojax.results.single_contact_response import (
    SingleContactResponse as SingleContactResponse,
)
from vibrojax.results.spectrum import Spectrum as Spectrum
from vibrojax.results.status import Status as Status
from vibrojax.rig_file import read_rig as read_rig
from vibrojax.rigs import default_rig as default_rig
from vibrojax.stepping.linearly_implicit import LinearlyImplicit as LinearlyImplicit
from vibrojax.stepping.method import AbstractMethod as AbstractMethod
from vibrojax.stepping.method import ExactContact as ExactContact
from vibrojax.stepping.method import ExponentialSplitting as ExponentialSplitting
from vibrojax.studies.basins import basins as basins
from vibrojax.studies.bifurcation import bifurcation_diagram as bifurcation_diagram
from vibrojax.studies.coexisting import coexisting_responses as coexisting_responses
from vibrojax.studies.continue_response import continue_response as continue_response
from vibrojax.studies.fold_curves import fold_curves as fold_curves
from vibrojax.studies.frequency_sweep import frequency_sweep as frequency_sweep
from vibrojax.studies.identification.least_squares import (
    LevenbergMarquardt as LevenbergMarquardt,
)
from vibrojax.studies.identification.least_squares import Optax as Optax
from vibrojax.studies.identify import identify as identify
from vibrojax.studies.identify import identify_each as identify_each
from vibrojax.studies.maps.basin_fractions import BasinFractions as BasinFractions
from vibrojax.studies.maps.continuation_curves import ContinuationCurve as ContinuationCurve
from vibrojax.studies.maps.dimensions import zipped as zipped
from vibrojax.studies.maps.periodic_points import PeriodicPoints as PeriodicPoints
from vibrojax.studies.maps.planning import MapPlan as MapPlan
from vibrojax.studies.maps.regime_sweep import RegimeSweep as RegimeSweep
from vibrojax.studies.maps.responses import SettledSweep as SettledSweep
from vibrojax.studies.maps.store_files import StoreFull as StoreFull
from vibrojax.studies.maps.store_files import StoreInUse as StoreInUse
from vibrojax.studies.maps.store_files import StoreReadOnly as StoreReadOnly
from vibrojax.studies.parameter_map import parameter_map as parameter_map
from vibrojax.studies.regimes import regimes as regimes
from vibrojax.studies.resolution import check_resolution as check_resolution
from vibrojax.studies.simulate_each import simulate_each as simulate_each
from vibrojax.studies.single_contact import single_contact_response as single_contact_response
from vibrojax.systems.base import AbstractEquations as AbstractEquations
from vibrojax.systems.base import AbstractSystem as AbstractSystem
from vibrojax.systems.base import LinearEquations as LinearEquations
from vibrojax.systems.base import Motion as Motion
from vibrojax.systems.elastic_pendulum import ElasticPendulum as ElasticPendulum
from vibrojax.systems.elastic_pendulum import Limiters as Limiters
from vibrojax.systems.elastic_pendulum import default_pendulum as default_pendulum
from vibrojax.systems.impacting_beam import ImpactingBeam as ImpactingBeam
from vibrojax.systems.linearised_pendulum import LinearisedPendulum as LinearisedPendulum
from vibrojax.systems.matrix_system import MatrixModes as MatrixModes
from vibrojax.systems.matrix_system import MatrixSystem as MatrixSystem

__version__ = "0.1.0"


def __dir__() -> list[str]:
    """Return the public names, without the submodules that importing them left here."""
    found = [n for n, v in globals().items() if n[0] != "_" and not isinstance(v, _ModuleType)]
    return sorted([*found, "__version__"])


__all__ = __dir__()  # pyright: ignore[reportUnsupportedDunderAll]
