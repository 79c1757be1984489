"""Directions of sweeps: as a table names them, or guessed from the order of its rows."""

from typing import Any

import numpy as np

from vibrojax.measured.curve import DIRECTIONS

_FORWARD = {"forward", "forwards", "fwd", "f", "up", "u", "+", "rising", "increasing"}
_BACKWARD = {"backward", "backwards", "bwd", "b", "down", "d", "-", "falling", "decreasing"}
_MOST_TURNS = 3
ALLOWED = "forward/backward, up/down, f/b or 1/-1"


def direction_named(value: Any) -> int | None:
    """Return 1, -1 or 0 (unknown) for a direction by name or number; None for anything else."""
    text = str(value).strip().lower()
    if text in _FORWARD | _BACKWARD:
        return 1 if text in _FORWARD else -1
    if text == "unknown":
        return 0
    try:
        number = float(text)
    except ValueError:
        return None
    return int(number) if number in DIRECTIONS else None


def guess_directions(frequency: np.ndarray) -> tuple[np.ndarray, str]:
    """Return the direction of every point as the order of the rows has it, and a sentence.

    Rising is forward, falling backward; a point at which the order turns belongs to what came
    before it. A single step back between two runs begins a new run.
    """
    advice = "Give direction= or a column for it if this is wrong."
    steps = np.sign(np.diff(frequency)).astype(int)
    moving = np.flatnonzero(steps)
    if not moving.size:
        return np.zeros(len(frequency), int), "The direction is not known: one frequency only."
    starts = np.append(0, np.flatnonzero(np.diff(steps[moving])) + 1)
    turns = len(starts) - 1
    if turns > _MOST_TURNS:
        text = f"The direction is not known: the order of the rows turns {turns} times."
        return np.zeros(len(frequency), int), f"{text} Give direction= or a column for it."
    signs = steps[moving].copy()
    ends = np.append(starts[1:], len(moving))
    for k in range(1, turns):
        if ends[k] - starts[k] == 1:
            signs[starts[k]] = steps[moving[ends[k]]]
    # A step belongs to the point it leads to, a rest to the step that follows.
    found = np.zeros(len(frequency), int)
    found[moving + 1] = signs
    for row in range(len(found) - 1, -1, -1):
        if found[row] == 0:
            found[row] = found[row + 1] if row + 1 < len(found) else signs[-1]
    tally = ", ".join(
        f"{np.sum(found == d)} {DIRECTIONS[d]}" for d in (1, -1) if (found == d).any()
    )
    return found, f"Directions were guessed from the order of the rows: {tally}. {advice}"
