"""Reading the published records of the rig: text files of a stepped test, as far as they are known.

What is known is what the programs of the source read (README.md says it, and what is not known).
A run is some files whose names begin alike:

    FRC_SteppedFrequency_0_0305ms2_1_dspace            time (s), not known, velocity of the base
                                                       (m/s), of the response (m/s), frequency (Hz)
    FRC_SteppedFrequency_0_0305ms2_1_frequency_steps   time (s), what was asked for from then on
    Backbone_SteppedResponseAmplitude_1_MPV_Point_11   time (s), velocity of a point (m/s)
"""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

import vibrojax as vj

ENDINGS = ("", ".txt", ".csv", ".dat")
RUN = re.compile(
    r"(FRC_SteppedFrequency|FRC_SteppedPhase)_(\d+_\d+)ms2_\d+"
    r"|(Backbone_SteppedResponseAmplitude)_\d+"
)
STEPS = {
    "FRC_SteppedFrequency": "frequency_steps",
    "FRC_SteppedPhase": "phase_steps",
    "Backbone_SteppedResponseAmplitude": "amplitude_steps",
}
PERIODS = 70
"""The last of a hold that count, as in the source."""
HARMONICS = 7
TOLERANCE = 2.5e-2
"""Of the base's acceleration about its nominal level, as in the source."""


class Run(NamedTuple):
    """A stepped test, one point for each hold."""

    curve: vj.io.MeasuredCurve
    """First harmonic of the displacement, m, over the frequency, Hz."""
    base_acceleration: np.ndarray
    """Amplitude of the first harmonic, m/s2, by point."""


def read_run(folder: Path, run: str, *, frame: str, nominal_frequency: float = 28.2) -> Run:
    """Read a run such as `FRC_SteppedFrequency_0_0305ms2_1`.

    `frame` says whether its response is `relative` to the base or `absolute`: the files do not.
    Holds shorter than 70 periods of the nominal frequency (Hz) are left out, and so are points at
    which the acceleration of the base was off its level by more than 2.5 %. Raises `ValueError` for
    files that are not there, not as known, or hold nothing.
    """
    kind, level = _kind_of(run)
    signals = read_columns(_file(folder, f"{run}_dspace"), 5)
    steps = read_columns(_file(folder, f"{run}_{STEPS[kind]}"), 2)
    time, base, response, frequency = signals[:, [0, 2, 3, 4]].T
    points = []
    for start, end in _holds(run, steps, time, nominal_frequency):
        in_hold = (time >= start) & (time <= end)
        mean = float(np.mean(frequency[in_hold & (time >= end - PERIODS / nominal_frequency)]))
        used = in_hold & (time >= end - PERIODS / mean)
        points.append((mean, *first_harmonics(time[used], mean, base[used], response[used])))
    hertz, *velocities = np.array(points).T
    hertz = hertz.real
    acceleration = 2 * np.pi * hertz * np.abs(velocities[0])
    kept = np.full(len(hertz), True)
    notes = [f"Read from {run}, {len(hertz)} holds."]
    if level is not None:
        kept = np.abs(acceleration / level - 1) < TOLERANCE
        notes.append(
            f"{np.sum(~kept)} points are left out, with the base off {level:g} m/s2 by more than "
            f"{100 * TOLERANCE:g} %."
        )
        if not kept.any():
            raise ValueError(f"{run}: the base is nowhere within 2.5 % of {level:g} m/s2.")
    # A stepped frequency rises or falls; what follows a phase or an amplitude may do either.
    way = np.sign(hertz[-1] - hertz[0]) if kind == "FRC_SteppedFrequency" else 0
    curve = vj.io.MeasuredCurve(
        hertz[kept],
        "frequency",
        amplitude=np.abs(velocities[1] / (2 * np.pi * hertz))[kept],
        phase=np.angle(velocities[1] / velocities[0])[kept],
        direction=[int(way)],
        quantity="first_harmonic",
        is_ratio=False,
        frame=frame,
        label=run,
        notes=notes,
    )
    return Run(curve, acceleration[kept])


def read_point(folder: Path, run: str, point: int) -> tuple[np.ndarray, np.ndarray]:
    """Read time (s) and velocity (m/s) of a point of the scanning vibrometer; 17 is the base."""
    _kind_of(run)
    if not 1 <= point <= 17:
        raise ValueError(f"point must be from 1 to 17, got {point}.")
    time, velocity = read_columns(_file(folder, f"{run}_MPV_Point_{point:_>2}"), 2)[:, :2].T
    return time, velocity


def read_columns(path: Path, least: int) -> np.ndarray:
    """Read a table of numbers, its first column a time that rises; lines by columns.

    A line of words above it is skipped, as the programs of the source do. Raises `ValueError` for
    what is no such table of at least so many columns.
    """
    with open(path, encoding="utf-8", errors="replace") as file:
        lines = [line for _, line in zip(range(100), file, strict=False)]
    begin = next((k for k, line in enumerate(lines) if re.match(r"\s*[-+.\d]", line)), None)
    if begin is None:
        raise ValueError(f"{path.name} has no line that begins with a number among its first 100.")
    if re.search(r"\d,\d+\s*[;\t ]", lines[begin]):
        raise ValueError(f"{path.name}, line {begin + 1}: commas in numbers are not known here.")
    separator = next((c for c in ",;\t" if c in lines[begin]), None)
    try:
        table = np.loadtxt(path, delimiter=separator, skiprows=begin, ndmin=2, comments=None)
    except ValueError as error:
        raise ValueError(f"{path.name} is not a table of numbers: {error}") from None
    if table.shape[1] < least:
        raise ValueError(f"{path.name} must have at least {least} columns, got {table.shape[1]}.")
    if not np.isfinite(table).all():
        line = begin + 1 + int(np.argmin(np.isfinite(table).all(axis=1)))
        raise ValueError(f"{path.name}, line {line}: a number is not finite.")
    if (np.diff(table[:, 0]) < 0).any():
        line = begin + 2 + int(np.argmax(np.diff(table[:, 0]) < 0))
        raise ValueError(f"{path.name}, line {line}: its time, the first column, must rise.")
    return table


def first_harmonics(time: np.ndarray, frequency: float, *signals: np.ndarray) -> list[complex]:
    """Amplitudes c of Re(c exp(i w t)) in signals, by least squares beside those of multiples."""
    turns = np.exp(2j * np.pi * frequency * np.outer(time - time[0], np.arange(HARMONICS + 1)))
    basis = np.concatenate([turns.real, -turns.imag[:, 1:]], axis=1)
    found, *_ = np.linalg.lstsq(basis, np.stack(signals, axis=1), rcond=None)
    return [complex(c[1], c[1 + HARMONICS]) for c in found.T]


def _kind_of(run: str) -> tuple[str, float | None]:
    """Kind of a run, and the level of the base's acceleration, m/s2, where it has one."""
    found = RUN.fullmatch(run)
    if found is None:
        raise ValueError(
            "run must be as FRC_SteppedFrequency_0_0305ms2_1, FRC_SteppedPhase_0_028ms2_1 or "
            f"Backbone_SteppedResponseAmplitude_1, got {run!r}: others are not known."
        )
    level = found[2] and float(found[2].replace("_", "."))
    return found[1] or found[3], level


def _file(folder: Path, name: str) -> Path:
    there = [path for ending in ENDINGS if (path := folder / (name + ending)).is_file()]
    if len(there) != 1:
        what = f"{len(there)} files" if there else "no file"
        raise ValueError(f"folder {str(folder)!r} must have one file {name}, got {what} of it.")
    return there[0]


def _holds(
    run: str, steps: np.ndarray, time: np.ndarray, frequency: float
) -> list[tuple[float, float]]:
    """Start and end of what was held for long enough: two steps in turn that ask for the same."""
    steps = steps[(steps[:, 0] >= time[0]) & (steps[:, 0] <= time[-1])]
    at = np.flatnonzero(np.diff(steps[:, 1]) == 0)
    holds = [(float(steps[k, 0]), float(steps[k + 1, 0])) for k in at]
    found = [(start, end) for start, end in holds if (end - start) * frequency > PERIODS]
    if not found:
        raise ValueError(f"{run}: nothing is held for more than {PERIODS} periods.")
    return found
