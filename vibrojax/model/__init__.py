"""What moves: beams, stops, contact laws, drives, and the equations of systems."""

from vibrojax.model.drives import AbstractDrive as AbstractDrive
from vibrojax.model.drives import AbstractSignal as AbstractSignal
from vibrojax.model.drives import AbstractWaveform as AbstractWaveform
from vibrojax.model.elastic_pendulum import Limiters as Limiters
from vibrojax.model.equations import AbstractEquations as AbstractEquations
from vibrojax.model.equations import LinearEquations as LinearEquations
from vibrojax.model.finite_elements import FiniteElements as FiniteElements
from vibrojax.model.internal_states import InternalStates as InternalStates
from vibrojax.model.laws import AbstractContactLaw as AbstractContactLaw
from vibrojax.model.laws import AbstractLinearLaw as AbstractLinearLaw
from vibrojax.model.laws import AbstractMemoryLaw as AbstractMemoryLaw
from vibrojax.model.matrix_system import MatrixModes as MatrixModes
from vibrojax.model.modes import Modes as Modes
from vibrojax.model.oscillator import Oscillator as Oscillator
from vibrojax.model.piezo import PiezoLayers as PiezoLayers
from vibrojax.model.piezo import bimorph as bimorph
from vibrojax.model.pulses import half_sine as half_sine
from vibrojax.model.pulses import sawtooth as sawtooth
from vibrojax.model.pulses import trapezoid as trapezoid
from vibrojax.model.random_signal import random_signal as random_signal
from vibrojax.model.reduction import Reduction as Reduction
from vibrojax.model.reduction import reduce as reduce
from vibrojax.model.relaxing_laws import AbstractRelaxingLaw as AbstractRelaxingLaw
from vibrojax.model.relaxing_laws import MaxwellChain as MaxwellChain
from vibrojax.model.systems import AbstractSystem as AbstractSystem
from vibrojax.model.systems import Motion as Motion
