"""Directions of sweeps: as a table names them, or guessed from the order of its rows."""

from typing import Any

import numpy as np

from vibrojax.measured.curve import DIRECTIONS

_FORWARD = {"forward", "forwards", "fwd", "f", "up", "u", "+", "rising", "increasing"}
_BACKWARD = {"backward", "backwards", "bwd", "b", "down", "d", "-", "falling", "decreasing"}
_MOST_TURNS = 3
NO_DIRECTION = -9
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


def directions_in(cells: np.ndarray) -> np.ndarray:
    """Return the direction that every cell names; `NO_DIRECTION` where it names none."""
    texts = [str(cell) for cell in cells.tolist()]
    named = {text: direction_named(text) for text in set(texts)}
    known = {text: NO_DIRECTION if one is None else one for text, one in named.items()}
    return np.array([known[text] for text in texts], dtype=int)


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
    known = np.flatnonzero(found)
    found = np.append(found[known], signs[-1])[np.searchsorted(known, np.arange(len(found)))]
    tally = ", ".join(
        f"{np.sum(found == d)} {DIRECTIONS[d]}" for d in (1, -1) if (found == d).any()
    )
    return found, f"Directions were guessed from the order of the rows: {tally}. {advice}"
