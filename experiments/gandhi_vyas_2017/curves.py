"""The frequency sweeps behind Figs 7 to 12, and one table of the numbers of each curve."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from paper_rig import (
    DAMPING,
    GAP,
    MASS_RATIOS,
    POSITION,
    STIFFNESS,
    TAPERS,
    rig_of,
    touch_frequency,
)

import vibrojax as vj

GAPS = (0.1e-3, 0.2e-3, 0.3e-3, 0.4e-3, 0.5e-3, 0.6e-3, 0.8e-3, 1.0e-3, 1.2e-3, 1.4e-3, 1.6e-3)
POSITIONS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
STIFFNESSES = (2750.0, 5500.0, 11000.0)
DAMPINGS = (5e-5, 0.5)
NUM_MODES = (3, 4, 5, 6, 7, 8)

# Frequency grids as (start, end, step), the next piece starting where the last one ends: fine
# where the curves of that formulation jump. A jump between coarse points comes early, because the
# step itself starts a transient that crosses to the other branch.
GRIDS = {
    ("figures", "consistent"): (
        (0.85, 1.06, 0.01),
        (1.06, 1.12, 0.002),
        (1.12, 1.17, 0.005),
        (1.17, 1.27, 0.002),
        (1.27, 1.35, 0.01),
    ),
    ("figures", "as_printed"): (
        (0.85, 1.14, 0.01),
        (1.14, 1.18, 0.002),
        (1.18, 1.40, 0.01),
        (1.40, 1.74, 0.004),
        (1.74, 1.80, 0.01),
    ),
    ("gap", "consistent"): ((0.95, 1.45, 0.005),),
    ("gap", "as_printed"): ((0.95, 1.65, 0.005),),
    ("position", "consistent"): ((0.95, 1.80, 0.01),),
    ("position", "as_printed"): ((0.95, 2.00, 0.01),),
    ("contact", "consistent"): ((1.04, 1.40, 0.005),),
    ("contact", "as_printed"): ((1.12, 1.65, 0.005),),
    ("modes", "consistent"): ((1.05, 1.12, 0.0025), (1.12, 1.20, 0.01), (1.20, 1.27, 0.0025)),
    ("modes", "as_printed"): ((1.13, 1.18, 0.0025), (1.18, 1.36, 0.01), (1.36, 1.48, 0.004)),
}


class Study(NamedTuple):
    """One call of `frequency_sweep` and what it returned."""

    name: str
    formulation: str
    num_modes: int
    curve: vj.sweep.FrequencyResponse


def grid(name: str, formulation: str, quick: bool) -> np.ndarray:
    """Frequency ratios of a study; the quick ones are coarse everywhere."""
    pieces = GRIDS["figures" if name in ("fig7", "fig8to10") else name, formulation]
    if quick:
        return np.arange(pieces[0][0], pieces[-1][1] + 1e-9, 0.02)
    points = [np.arange(start, end - 1e-9, step) for start, end, step in pieces]
    return np.round(np.concatenate([*points, [pieces[-1][1]]]), 6)


def axes_of(name: str, quick: bool) -> dict[str, Any]:
    """Numbers and axes of a study, as keywords of the rig function."""
    tapers = TAPERS[::2] if quick else TAPERS
    ends = slice(None, None, 4 if quick else 1)
    return {
        "fig7": {"taper": 0.0, "mass_ratio": 1.5, "gap": [GAP, 10 * GAP]},
        "fig8to10": {"taper": tapers, "mass_ratio": MASS_RATIOS},
        "gap": {"taper": tapers, "mass_ratio": 0.5, "gap": GAPS[ends]},
        "position": {"taper": tapers, "mass_ratio": 0.5, "position": POSITIONS[ends]},
        "contact": {
            "taper": tapers,
            "mass_ratio": 0.5,
            "stiffness": STIFFNESSES,
            "damping": DAMPINGS,
        },
        "modes": {"taper": tapers, "mass_ratio": 0.5},
    }[name]


def run_studies(formulation: str, quick: bool = False) -> Iterator[Study]:
    """Run the studies of one formulation, all lanes of a study in one batch.

    The quick run leaves out the variation of the contact and of the number of modes.
    """
    plans = [(name, 5) for name in ("fig7", "fig8to10", "gap", "position")]
    if not quick:
        plans += [("contact", 5)] + [("modes", n) for n in NUM_MODES]
    for name, num_modes in plans:
        forward_only = name in ("gap", "position")
        curve = vj.frequency_sweep(
            rig_of(formulation, num_modes),
            frequency_ratio=grid(name, formulation, quick),
            **axes_of(name, quick),
            settings=vj.SweepSettings(
                direction="forward" if forward_only else "both",
                refine_jumps=None if forward_only or quick else 1e-4,
                max_periods=200 if name.startswith("fig") and not quick else 120,
            ),
        )
        yield Study(name, formulation, num_modes, curve)


def settled_peak_ratio(curve: vj.sweep.FrequencyResponse) -> np.ndarray:
    """Peak ratio with the points that are not periodic taken out (NaN)."""
    periodic = np.asarray(curve.status) == vj.Status.settled.value
    return np.where(periodic, curve.peak_ratio, np.nan)


def summarise(study: Study, quick: bool = False) -> pd.DataFrame:
    """One row per lane: its numbers, peak, jumps, hysteresis, and how many points are aperiodic.

    The peak is that of the forward sweep, as in the paper, over periodic points alone; frequencies
    are ratios. The area lies between the peak ratios of the two directions.
    """
    curve = study.curve
    fixed = {k: v for k, v in axes_of(study.name, quick).items() if np.ndim(v) == 0}
    names = ("taper", "mass_ratio", "gap", "position", "stiffness", "damping")
    usual = dict(zip(names, (0.5, 0.5, GAP, POSITION, STIFFNESS, DAMPING), strict=True))
    ratios = np.asarray(curve.frequencies)
    peaks = settled_peak_ratio(curve)
    rows = []
    for lane in np.ndindex(*(len(v) for v in curve.axes.values())):
        swept = {k: float(v[i]) for (k, v), i in zip(curve.axes.items(), lane, strict=True)}
        numbers = {**usual, **fixed, **swept}
        forward = peaks[lane][0]
        top = int(np.argmax(np.where(np.isnan(forward), -1.0, forward)))
        both = np.asarray(curve.peak_ratio)[lane]
        hysteretic = len(curve.directions) == 2
        area = np.trapezoid(np.abs(both[0] - both[-1]), ratios) if hysteretic else np.nan
        down, up = float(curve.jump_down[lane]), float(curve.jump_up[lane])
        rows.append(
            {
                "study": study.name,
                "formulation": study.formulation,
                "num_modes": study.num_modes,
                **numbers,
                "peak_ratio": forward[top],
                "amplitude_ratio": curve.amplitude_ratio[lane][0, top],
                "peak_frequency": ratios[top],
                "peak_below_end": bool(top < len(ratios) - 1),
                "jump_down": down,
                "jump_up": up,
                "touch_frequency": touch_frequency(study.formulation, **numbers),
                "hysteresis_width": down - up,
                "hysteresis_area": area,
                "contact_force": np.nanmax(curve.contact_force[lane]),
                "contacts_at_peak": curve.contacts_per_period[lane][0, top],
                "points": both.size,
                "aperiodic_points": int((curve.status[lane] != vj.Status.settled.value).sum()),
            }
        )
    return pd.DataFrame(rows)


def curve_table(curve: vj.sweep.FrequencyResponse, index: int) -> pd.DataFrame:
    """Curves of one mass ratio as columns: peak ratio and period by taper and direction."""
    table = {"frequency_ratio": curve.frequencies}
    for i, taper in enumerate(curve.axes["taper"]):
        for k, direction in enumerate(curve.directions):
            key = f"taper_{taper:g}_{direction}"
            table[f"{key}_peak_ratio"] = np.round(curve.peak_ratio[i, index, k], 4)
            table[f"{key}_period"] = curve.period[i, index, k]
    return pd.DataFrame(table)
