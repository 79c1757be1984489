"""Receptance of the tip, 10 to 25 Hz: swept both ways, and every frequency from rest."""

from typing import NamedTuple

import numpy as np
import rig
from rig import DAMPING_RATIO, GAP

import vibrojax as vj

DURATION, COUNTED, RATE = 14.0, 4.0, 2048.0
MAIN = 21.0
"""Hz; beyond it, past a dip, strong forces have a second peak at 23 Hz."""


class FromRest(NamedTuple):
    """Responses at fixed frequencies, each from rest; arrays over forces and frequencies."""

    frequency: np.ndarray
    receptance: np.ndarray
    """rms of the displacement over rms of the force, m/N."""
    without_mean: np.ndarray
    """The same with the mean of the displacement left out, as accelerations give it."""
    touching: np.ndarray
    """Whether there is contact during the last seconds."""


def sweep(
    forces: list[float], frequency: np.ndarray, max_periods: int
) -> vj.sweep.FrequencyResponse:
    """Sweep both ways at every force, N rms."""
    amplitudes = [float(np.sqrt(2.0)) * force for force in forces]
    return vj.frequency_sweep(
        rig.forced_rig,
        force=amplitudes,
        frequency=frequency,
        progress=False,
        settings=vj.SweepSettings(max_periods=max_periods, refine_jumps=1e-3),
    )


def from_rest(forces: list[float]) -> FromRest:
    """Drive from rest at whole frequencies, as the paper did, and take the rms at the end."""
    frequency = np.arange(10.0, 26.0)
    rows: list[list[np.ndarray]] = []
    for force in forces:
        histories = vj.simulate(
            rig.forced_rig,
            force=float(np.sqrt(2.0)) * force,
            frequency=frequency.tolist(),
            duration=DURATION,
            sampling_rate=RATE,
        )
        counted = round(COUNTED * RATE)
        shape = np.asarray(histories[0].motion.equations.response_map)
        tip = np.asarray(histories.lanes.coordinates)[:, -counted - 1 : -1] @ shape
        pushed = np.asarray(histories.lanes.contact_force)[:, -counted - 1 : -1, 0]
        rows.append(
            [np.sqrt(np.mean(tip**2, axis=1)) / force, tip.std(axis=1) / force, pushed.any(axis=1)]
        )
    whole, centred, touching = (np.array(part) for part in zip(*rows, strict=True))
    return FromRest(frequency, whole, centred, touching)


def peak_and_width(frequency: np.ndarray, values: np.ndarray) -> dict[str, float]:
    """Peak of a curve and the width (Hz) around it where it is above the peak over sqrt(2)."""
    top = int(np.nanargmax(values))
    level = values[top] / np.sqrt(2.0)
    above = values >= level
    low = high = top
    while low > 0 and above[low - 1]:
        low -= 1
    while high < len(values) - 1 and above[high + 1]:
        high += 1
    ends = [float(frequency[low]), float(frequency[high])]
    if low > 0:
        ends[0] = float(np.interp(level, values[[low - 1, low]], frequency[[low - 1, low]]))
    if high < len(values) - 1:
        pair = [high + 1, high]
        ends[1] = float(np.interp(level, values[pair], frequency[pair]))
    return {
        "peak_mm_per_N": 1e3 * float(values[top]),
        "at_Hz": float(frequency[top]),
        "width_Hz": ends[1] - ends[0],
        "from_Hz": ends[0],
        "to_Hz": ends[1],
    }


def table(curve: vj.sweep.FrequencyResponse, rest: FromRest, forces: list[float]) -> list[dict]:
    rows = []
    for k, force in enumerate(forces):
        row: dict = {"force_rms_N": force}
        for d, direction in enumerate(curve.directions):
            main = curve.frequencies <= MAIN
            values = np.asarray(curve.receptance[k, d])
            numbers = peak_and_width(curve.frequencies[main], values[main])
            touched = curve.frequencies[np.asarray(curve.contact_force[k, d]) > 0]
            numbers["touching_Hz"] = [float(touched.min()), float(touched.max())]
            above = int(np.argmax(np.where(main, 0.0, values)))
            numbers["above_21_Hz"] = {
                "peak_mm_per_N": 1e3 * float(values[above]),
                "at_Hz": float(curve.frequencies[above]),
                "period": int(curve.period[k, d, above]),
            }
            numbers["without_period"] = int(np.sum(np.asarray(curve.period[k, d]) == 0))
            row[direction] = numbers
        row["jump_up_Hz"], row["jump_down_Hz"] = (
            float(jump[k]) for jump in (curve.jump_up, curve.jump_down)
        )
        main = rest.frequency <= MAIN
        row["from_rest"] = peak_and_width(rest.frequency[main], rest.receptance[k][main])
        row["from_rest"]["touching_Hz"] = rest.frequency[rest.touching[k]].tolist()
        row["from_rest"]["receptance_mm_per_N"] = (1e3 * rest.receptance[k]).round(4).tolist()
        row["from_rest"]["without_mean_mm_per_N"] = (1e3 * rest.without_mean[k]).round(4).tolist()
        between = (curve.frequencies >= 10.0) & (curve.frequencies <= 25.0)
        spread = np.abs(curve.receptance[k, 0] - curve.receptance[k, 1])[between]
        differs = curve.frequencies[between][spread > 0.1 * curve.receptance[k, 1][between]]
        row["two_responses_Hz"] = (
            [float(f) for f in (differs[0], differs[-1])] if len(differs) else []
        )
        rows.append(row)
    return rows


def linear_table() -> dict:
    """The linear system: its peak, and what 2 N does to it."""
    frequency = np.linspace(10.0, 25.0, 30001)
    found = peak_and_width(frequency, rig.linear_receptance(frequency))
    peak = found["peak_mm_per_N"] * 1e-3
    found["force_amplitude_that_reaches_the_gap_N"] = GAP / peak
    for reading, amplitude in (("amplitude", 2.0), ("rms", 2.0 * np.sqrt(2.0))):
        tip = {
            f"{f:g}": 1e3 * amplitude * float(rig.linear_receptance(f))
            for f in (14.0, 15.0, 16.0, 17.0)
        }
        found[f"2_N_as_{reading}"] = {
            "tip_at_resonance_mm": 1e3 * amplitude * peak,
            "tip_at_frequency_mm": tip,
            "damping_ratio_without_contact": DAMPING_RATIO * amplitude * peak / GAP,
        }
    return found
