"""Rig files, measurements and matrices, read."""

from vibrojax.io.matrix_files import read_matrices as read_matrices
from vibrojax.io.rig_file import read_rig as read_rig
from vibrojax.measured.curve import MeasuredCurve as MeasuredCurve
from vibrojax.measured.curve import MeasuredCurves as MeasuredCurves
from vibrojax.measured.history import MeasuredHistory as MeasuredHistory
from vibrojax.measured.history_reading import read_measured_history as read_measured_history
from vibrojax.measured.reading import read_measured_curve as read_measured_curve
from vibrojax.measured.record import read_drive as read_drive
