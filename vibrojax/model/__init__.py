"""What moves: beams, stops, contact laws, drives, and the equations of systems."""

from vibrojax.model.drives import AbstractDrive as AbstractDrive
from vibrojax.model.drives import AbstractSignal as AbstractSignal
from vibrojax.model.drives import AbstractWaveform as AbstractWaveform
from vibrojax.model.equations import AbstractEquations as AbstractEquations
from vibrojax.model.equations import LinearEquations as LinearEquations
from vibrojax.model.laws import AbstractContactLaw as AbstractContactLaw
from vibrojax.model.laws import AbstractLinearLaw as AbstractLinearLaw
from vibrojax.model.laws import AbstractMemoryLaw as AbstractMemoryLaw
from vibrojax.model.matrix_system import MatrixModes as MatrixModes
from vibrojax.model.modes import Modes as Modes
from vibrojax.model.pulses import half_sine as half_sine
from vibrojax.model.pulses import sawtooth as sawtooth
from vibrojax.model.pulses import trapezoid as trapezoid
from vibrojax.model.random_signal import random_signal as random_signal
from vibrojax.model.systems import AbstractSystem as AbstractSystem
from vibrojax.model.systems import Motion as Motion
