"""Regimes over frequency and base amplitude, bifurcation diagram, and what each regime harvests."""

from dataclasses import replace

import numpy as np
from pendulum import INFERRED, MARCHED, modal, modal_starts

import vibrojax as vj

AMPLITUDES = (3e-3, 10e-3)
"""m, first and last of the map."""


def regime_map(frequencies: int, amplitudes: int, periods: int) -> tuple[vj.regime.Regimes, dict]:
    """Return the regimes over frequency and base amplitude, from one start."""
    found = vj.regimes(
        modal,
        frequency=np.linspace(2.0, 9.0, frequencies),
        base_amplitude=np.linspace(*AMPLITUDES, amplitudes),
        starts=modal_starts(1, seed=3),
        settings=replace(MARCHED, periods=periods),
        progress=False,
    )
    period = found.period
    shares = {
        str(n): float(np.mean(period == n)) for n in np.unique(period) if np.mean(period == n) > 0
    }
    return found, {
        "frequency_Hz": np.asarray(found.frequencies).tolist(),
        "base_amplitude_m": found.axes["base_amplitude"].tolist(),
        "period": period[:, 0].tolist(),
        "regime": found.regime[:, 0].tolist(),
        "lyapunov_per_s": np.round(found.lyapunov_exponent[:, 0], 3).tolist(),
        "share_of_period": shares,
        "share_of_regime": {r.word: found.fraction(r.name) for r in vj.Regime},
    }


def bifurcation(
    values: int, transient: int, periods: int
) -> tuple[vj.regime.BifurcationDiagram, dict]:
    """Carry the motion along the frequency, up and down."""
    start = modal_starts(1, seed=3)[0]
    found = vj.bifurcation_diagram(
        modal(),
        frequency=np.linspace(2.0, 9.0, values),
        start=start,
        progress=False,
        settings=replace(MARCHED, transient=transient, periods=periods, lyapunov=False),
    )
    three = {
        way: np.asarray(found.values)[row == 3].tolist()
        for way, row in zip(found.directions, found.period, strict=True)
    }
    return found, {
        "frequency_Hz": np.asarray(found.values).tolist(),
        "period": dict(zip(found.directions, found.period.tolist(), strict=True)),
        "period_3_Hz": {way: [min(v), max(v)] if v else None for way, v in three.items()},
    }


def energies(frequencies: int, starts: int, periods: int) -> dict:
    """Return bending and power of every motion against frequency, from several starts."""
    found = vj.regimes(
        modal(),
        frequency=np.linspace(2.0, 9.0, frequencies),
        starts=modal_starts(starts, seed=4),
        settings=replace(MARCHED, periods=periods),
        progress=False,
    )
    names = ("chord_reduction_max", "strain_energy_mean", "strain_power_rms", "lyapunov_exponent")
    numbers = {name: np.asarray(found[name]) for name in names}
    group = np.where(np.isin(found.period, (0, 1, 3, 5)), found.period, -1)
    # Periods that are multiples of 3 are the period-3 motion beyond a doubling.
    group = np.where((found.period > 3) & (found.period % 3 == 0), 3, group)
    group = np.where(found.regime == vj.Regime.chaotic.value, 0, group)
    by_kind = {}
    for kind, word in ((0, "nonperiodic"), (1, "period 1"), (3, "period 3 and multiples")):
        own = group == kind
        if own.any():
            by_kind[word] = {name: float(v[own].mean()) for name, v in numbers.items()} | {
                "lanes": int(own.sum()),
                "largest_chord_reduction_m": float(numbers["chord_reduction_max"][own].max()),
            }
    own = (group == -1) | (group == 5)
    if own.any():
        by_kind["other periods"] = {name: float(v[own].mean()) for name, v in numbers.items()} | {
            "lanes": int(own.sum())
        }
    power, chord = numbers["strain_power_rms"], numbers["chord_reduction_max"]
    beside = side_by_side(np.asarray(found.frequencies), group, power, chord)
    most = np.unravel_index(numbers["chord_reduction_max"].argmax(), group.shape)
    return {
        "frequency_Hz": np.asarray(found.frequencies).tolist(),
        "base_amplitude_m": INFERRED["base_amplitude"][0],
        "kind": group.tolist(),
        "period": found.period.tolist(),
        **{f"{name}": np.asarray(v).tolist() for name, v in numbers.items()},
        "by_kind": by_kind,
        "power_and_chord_of_3_over_nonperiodic": beside,
        "most_bent": {
            "frequency_Hz": float(np.asarray(found.frequencies)[most[1]]),
            "period": int(found.period[most]),
            "chord_reduction_m": float(numbers["chord_reduction_max"][most]),
        },
    }


def side_by_side(frequency, kind, power, chord) -> list[list[float]]:
    """Return means in period 3 over nonperiodic ones where starts lead to both: Hz, power, chord.

    `kind`, `power` (W) and `chord` (m) have the shape (starts, frequencies).
    """
    kind, power, chord = (np.asarray(a) for a in (kind, power, chord))
    rows = []
    for hertz, here, watt, metre in zip(frequency, kind.T, power.T, chord.T, strict=True):
        three, none = here == 3, here == 0
        if three.any() and none.any():
            ratios = (values[three].mean() / values[none].mean() for values in (watt, metre))
            rows.append([float(hertz), *map(float, ratios)])
    return rows
