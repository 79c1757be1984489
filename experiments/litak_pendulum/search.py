"""The search for period 5 at 7.8 Hz, and what the inferred numbers do to the picture."""

import time
from dataclasses import replace

import numpy as np
from pendulum import (
    COARSER,
    FREQUENCIES,
    INFERRED,
    MARCHED,
    PRINTED,
    STEPS,
    full_starts,
    modal,
    modal_starts,
)
from scipy.stats import qmc

import vibrojax as vj

BOXES = {
    "limiter_height": (0.02, 0.07),
    "base_amplitude": (2.5e-3, 12e-3),
    "joint_damping_time": (5e-5, 2e-3),
    "bearing_damping": (1e-4, 6e-3),
}
"""Ranges drawn from; the dampings and the amplitude evenly in their logarithms."""
EVEN = ("limiter_height",)
NEAR = 0.2
"""Every second draw is within this share of the inferred numbers."""
QUICK = replace(
    MARCHED, lyapunov=False, periods=40, transient=100, samples_per_period=8, stepper=COARSER
)
OTHERS = tuple(f for f in FREQUENCIES if f != 7.8)


def draws(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Draw numbers: half from the boxes, half near the inferred ones."""
    half = count // 2
    wide, near = (qmc.Sobol(len(BOXES), seed=seed + k).random(half) for k in (0, 1))
    found = {}
    for k, (name, (low, high)) in enumerate(BOXES.items()):
        even = name in EVEN
        first = low + wide[:, k] * (high - low) if even else low * (high / low) ** wide[:, k]
        value = INFERRED[name][0]
        found[name] = np.concatenate([first, value * (1 + NEAR * (2 * near[:, k] - 1))])
    return found


def regimes_of(numbers: dict[str, np.ndarray], frequency, starts, make=modal, **changed):
    """Return the regimes of every draw, one lane for every frequency and start."""

    def system(draw: float):
        return make(**{name: float(values[int(draw)]) for name, values in numbers.items()})

    count = len(next(iter(numbers.values())))
    return vj.regimes(
        system,
        draw=np.arange(count),
        frequency=frequency,
        starts=starts,
        settings=replace(QUICK, **changed),
        progress=False,
    )


def keeps(period: np.ndarray) -> np.ndarray:
    """Whether periods (draws, starts, frequencies) are as printed at all but 7.8 Hz, any start."""
    wanted = np.array([PRINTED[f] for f in OTHERS])
    return np.all((period == wanted).any(axis=1), axis=-1)


def period_5(count: int, more_starts: int) -> dict:
    """Look for period 5 at 7.8 Hz over draws of the inferred numbers, then in the full model."""
    begun, worked = time.perf_counter(), time.process_time()
    numbers = draws(count)
    others = regimes_of(numbers, OTHERS, modal_starts(1, seed=5)).period
    first = regimes_of(numbers, [7.8], modal_starts(2, seed=5)).period[..., 0]
    kept = keeps(others)
    # Again from more starts: what keeps the printed picture, or nearly (one regime off).
    wanted = np.array([PRINTED[f] for f in OTHERS])
    nearly = np.sum(others[:, 0] == wanted, axis=-1) >= 3
    again = np.flatnonzero(nearly)[: 4 * count // 10]
    more = np.zeros((count, 0), int)
    if again.size and more_starts:
        own = {name: values[again] for name, values in numbers.items()}
        seen = regimes_of(own, [7.8], modal_starts(more_starts, seed=6))
        more = np.full((count, more_starts), -1)
        more[again] = seen.period[..., 0]
    every = np.concatenate([first, more], axis=1)
    fives = (every == 5).any(axis=1)
    tens = np.isin(every, (10, 15, 20)).any(axis=1)
    near = np.arange(count) >= count // 2

    def tally(own: np.ndarray) -> dict:
        chosen = first[own]
        periods, counts = np.unique(chosen, return_counts=True)
        return {
            "draws": int(own.sum()),
            "keep_the_other_four": int((kept & own).sum()),
            "share_kept": float(np.mean(kept[own])) if own.any() else 0.0,
            "each_as_printed": {
                str(f): float(np.mean((others[own, :, k] == PRINTED[f]).any(axis=1)))
                for k, f in enumerate(OTHERS)
            },
            "period_5_at_7.8": int((fives & own).sum()),
            "period_10_15_20_at_7.8": int((tens & own).sum()),
            "both": int((kept & fives & own).sum()),
            "periods_at_7.8": {
                str(p): float(c / chosen.size) for p, c in zip(periods, counts, strict=True)
            },
        }

    hits = np.flatnonzero(fives)
    kept_hits = np.flatnonzero(fives & nearly)
    follow = np.concatenate([kept_hits, np.setdiff1d(hits, kept_hits)])[:16]
    result = {
        "boxes": {name: list(box) for name, box in BOXES.items()},
        "near": NEAR,
        "starts_at_7.8": {"all": 2, "three_of_four_or_more": more_starts},
        "draws_with_more_starts": int(again.size),
        "wide": tally(~near),
        "near_the_inferred": tally(near),
        "all": tally(np.ones(count, bool)),
        "three_of_four_and_period_5": int((fives & nearly).sum()),
        "seconds": time.perf_counter() - begun,
        "processor_s": time.process_time() - worked,
    }
    result["hits"] = _followed(numbers, follow, others, every)
    return result


def _followed(numbers, draws_found: np.ndarray, others: np.ndarray, every: np.ndarray) -> list:
    """Look at draws with period 5 in the full model, at all five frequencies."""
    if not draws_found.size:
        return []
    own = {name: values[draws_found] for name, values in numbers.items()}
    # Of 17 links the damping sets the steps.
    every_start, method = full_starts(3, seed=7), vj.LinearlyImplicit()
    found = regimes_of(own, FREQUENCIES, every_start, make=vj.default_pendulum, stepper=method)
    return [
        {name: float(values[k]) for name, values in own.items()}
        | {
            "modes_others": dict(zip(map(str, OTHERS), others[d].T.tolist(), strict=True)),
            "modes_7.8": every[d].tolist(),
            "links": dict(zip(map(str, FREQUENCIES), found.period[k].T.tolist(), strict=True)),
        }
        for k, d in enumerate(draws_found)
    ]


def sensitivity(changes: tuple[float, ...], starts: int) -> dict:
    """Change the inferred numbers one by one and look at the five frequencies."""
    names, values = [], {name: [] for name in INFERRED}
    for name in INFERRED:
        for change in changes:
            for sign in (-1, 1):
                names.append((name, sign * change))
                for other, (value, _) in INFERRED.items():
                    values[other].append(value * (1 + sign * change * (other == name)))
    for name, (value, _) in INFERRED.items():
        values[name].append(value)
    names.append(("none", 0.0))
    numbers = {name: np.array(column) for name, column in values.items()}
    period = regimes_of(numbers, FREQUENCIES, modal_starts(starts, seed=8)).period
    rows = []
    for k, (name, change) in enumerate(names):
        as_printed = {
            str(f): float(np.mean(period[k, :, n] == PRINTED[f])) for n, f in enumerate(FREQUENCIES)
        }
        rows.append(
            {
                "number": name,
                "change": change,
                "period": dict(zip(map(str, FREQUENCIES), period[k].T.tolist(), strict=True)),
                "share_as_printed": as_printed,
                "keeps_the_other_four": bool(
                    all((period[k, :, FREQUENCIES.index(f)] == PRINTED[f]).any() for f in OTHERS)
                ),
            }
        )
    return {"starts": starts, "rows": rows}


def agreement(frequencies: int, starts: int, periods: int) -> dict:
    """Compare six modes with 17 links over frequency."""
    grid = np.linspace(2.5, 9.0, frequencies)
    stepper = vj.LinearlyImplicit(steps_per_period=STEPS)
    settings = replace(MARCHED, periods=periods, lyapunov=False, stepper=stepper)
    common = {"frequency": grid, "settings": settings, "progress": False}
    links = vj.regimes(vj.default_pendulum(), starts=full_starts(starts, seed=9), **common)
    modes = vj.regimes(modal(), starts=modal_starts(starts, seed=9), **common)

    def most(found: vj.regime.Regimes) -> list[int]:
        """Period that most starts reach, multiples of 3 as 3."""
        period = np.where(found.period % 3 == 0, np.minimum(found.period, 3), found.period)
        return [int(np.bincount(column).argmax()) for column in period.T]

    ours, theirs = most(modes), most(links)
    power = {
        name: found["strain_power_rms"].mean(axis=0).tolist()
        for name, found in (("links", links), ("modes", modes))
    }
    return {
        "frequency_Hz": grid.tolist(),
        "starts": starts,
        "links": links.period.T.tolist(),
        "modes": modes.period.T.tolist(),
        "same_most_frequent": float(np.mean(np.array(ours) == np.array(theirs))),
        "differ_at_Hz": grid[np.array(ours) != np.array(theirs)].tolist(),
        "strain_power_rms_W": power,
    }
