"""The chirp from 2 to 9 Hz in 15 s, fig. 4: histories of the 17 links and their cycles."""

import numpy as np
from pendulum import full_starts

import vibrojax as vj

CHIRP = vj.Chirp(2.0, 9.0, 15.0)
STEP, RATE = 1e-4, 1000.0
HYSTERESIS = 0.3 * 0.006 / 0.04
"""rad: 0.3 of the angle at which the straight pendulum touches a limiter, as in the reference."""
EDGES = np.arange(3.5, 9.01, 0.5)


def run(starts: int = 12) -> tuple[vj.history.Histories, dict]:
    """Return the histories from random starts, and what is read off them."""
    states = full_starts(starts, seed=1)
    histories = vj.simulate(
        vj.default_pendulum(),
        waveform=CHIRP,
        duration=15.0,
        initial_states=[(s[:17], s[17:]) for s in states],
        sampling_rate=RATE,
        stepper=vj.LinearlyImplicit(longest_step=STEP),
    )
    cycles = histories.cycles("bearing_angle", threshold=HYSTERESIS)
    table = cycles.statistics(EDGES, share_of={3: 0.25, 5: 0.25})
    rows = [
        {
            "from_Hz": float(table.lower_edge[k]),
            "to_Hz": float(table.upper_edge[k]),
            "cycles": int(table["count"][k]),
            "median": float(table["median"][k]),
            "standard_deviation": float(table["standard_deviation"][k]),
            "share_of_3": float(table["share_of_3"][k]),
            "share_of_5": float(table["share_of_5"][k]),
        }
        for k in range(len(EDGES) - 1)
    ]
    time = np.asarray(histories[0].time)
    hertz = 2.0 + 7.0 * time / 15.0
    chord = np.array([np.asarray(one.quantity("chord_reduction")) for one in histories])
    whole = range(2, 9)
    largest = [[float(c[(hertz >= f) & (hertz < f + 1)].max()) for f in whole] for c in chord]
    highest = chord.argmax(axis=1)
    at_highest = [
        {
            "frequency_Hz": float(hertz[k]),
            "chord_reduction_m": float(c[k]),
            "cycle": _cycle_at(cycles, n + 1, time[k]),
        }
        for n, (c, k) in enumerate(zip(chord, highest, strict=True))
    ]
    return histories, {
        "starts": starts,
        "cycles": len(cycles),
        "bins": rows,
        "cycle": {
            "frequency_Hz": cycles.drive_frequency.round(4).tolist(),
            "drive_periods": cycles.drive_periods.round(4).tolist(),
        },
        "chord_by_Hz_m": {
            "from_Hz": list(whole),
            "median": np.median(largest, axis=0).tolist(),
            "least": np.min(largest, axis=0).tolist(),
            "most": np.max(largest, axis=0).tolist(),
        },
        "largest_chord": at_highest,
    }


def _cycle_at(cycles: vj.history.Cycles, history: int, time: float) -> float | None:
    """Return the length, in drive periods, of the cycle of a history that a time is in."""
    own = (cycles.history == history) & (cycles.start <= time)
    own &= time < cycles.start + cycles.length
    return float(cycles.drive_periods[own][0]) if own.any() else None
