"""A branch at given values of its parameter: interpolated, then solved there anew."""

from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax._tools.described import in_short
from vibrojax.branches.points import CURVES, BranchPoints
from vibrojax.branches.readings import Columns, columns_of
from vibrojax.branches.tracing import held_from, make_exact
from vibrojax.results.variables import axis_description, described_as
from vibrojax.steady.balanced_motion import read_all, solve_all
from vibrojax.steady.batches import take

if TYPE_CHECKING:
    import xarray

READ = (*CURVES, "stable", "initial_state")
CREEPS = 8
"""Tries to close in on a value where the branch is steep."""


def resample(branch: BranchPoints, values: Any) -> "xarray.Dataset":
    """Solve for the responses of a branch at given values; see `Branch.resample`."""
    import xarray

    values = np.atleast_1d(np.asarray(values, float))
    if values.ndim != 1 or not values.size or not np.isfinite(values).all():
        raise ValueError(
            f"values must be a non-empty list of finite numbers, got {in_short(values)}."
        )
    at, which, first, share = _crossings(branch, values)
    crossings = int(which.max(initial=-1)) + 1
    shape = (len(values), crossings)
    states = branch.initial_state.shape[1:]
    columns: Columns = {
        name: np.full(shape + (states if name == "initial_state" else ()), np.nan) for name in READ
    }
    # What is a point of the branch already, as the ends of its range are, is not solved again.
    known = (share == 0) | (share == 1)
    for part, read in ((known, _points), (~known, _solve)):
        if part.any():
            place = at[part], which[part]
            found = read(branch, values[at[part]], first[part], share[part])
            for name, column in columns.items():
                column[place] = found[name]
    dims = (branch.axis, "crossing")
    data: dict[str, Any] = {
        n: (dims + ("state",) * (c.ndim - 2), c, described_as(n, branch.ratio_units))
        for n, c in columns.items()
    }
    coordinates: dict[str, Any] = {
        branch.axis: (branch.axis, values, axis_description(branch.axis)),
        "crossing": np.arange(crossings),
    }
    return xarray.Dataset(data, coordinates, attrs=dict(branch.attributes))


def _crossings(branch: BranchPoints, values: np.ndarray):
    """Where the branch passes each value: value, times before, point before, way to the next."""
    x = branch.values
    rows = []
    for k, value in enumerate(values):
        inside = (np.minimum(x[:-1], x[1:]) <= value) & (value < np.maximum(x[:-1], x[1:]))
        if len(x) and value == x[-1] and not inside[-1:].any():
            inside[-1:] = x[-2:-1] != x[-1]
        for count, i in enumerate(np.flatnonzero(inside)):
            rows.append((k, count, i, (value - x[i]) / (x[i + 1] - x[i])))
    at, which, first = np.array([row[:3] for row in rows], int).reshape(-1, 3).T
    return at, which, first, np.array([row[3] for row in rows])


def _interpolated(branch: BranchPoints, i: int, share: float) -> np.ndarray:
    """Cubic through the four neighbours, or a line at the ends and next to a fold."""
    depth, x = branch.depth, branch.values
    line = (1 - share) * depth[i] + share * depth[i + 1]
    if i == 0 or i + 2 >= len(x):
        return line
    nodes = x[i - 1 : i + 3]
    step = np.diff(nodes)
    if not (np.all(step > 0) or np.all(step < 0)) or np.ptp(np.abs(step)) > 3 * np.abs(step).min():
        return line
    value = x[i] + share * (x[i + 1] - x[i])
    return np.einsum("k,k...->...", polynomial_weights(nodes, value), depth[i - 1 : i + 3])


def polynomial_weights(nodes: np.ndarray, value: float) -> np.ndarray:
    """Return the weight of each node in the polynomial through all of them, at a value."""
    return np.array([np.prod([(value - b) / (a - b) for b in nodes if b != a]) for a in nodes])


def _exactly(branch: BranchPoints, values, first, share, depth):
    """Exact motions at the values; where the branch is steep, by creeping along it."""
    lane = np.zeros(len(values), int)
    period = branch.period
    point = make_exact(branch.path, lane, depth, values, period=period, hold=True)
    left = np.flatnonzero(~point.valid)
    if not len(left):
        return point
    x, i = branch.values, first[left]
    low, high = np.zeros(len(left)), np.ones(len(left))
    below, above = x[i] - values[left], x[i + 1] - values[left]
    near = take(point, left)
    for turn in range(CREEPS):
        middle = np.clip(low - below * (high - low) / (above - below), low, high)
        middle = np.where(turn % 3 == 2, (low + high) / 2, middle)
        way = middle[:, None, None]
        between = (1 - way) * branch.depth[i] + way * branch.depth[i + 1]
        guess = (1 - middle) * x[i] + middle * x[i + 1]
        near = make_exact(branch.path, lane[left], between, guess, period=period)
        value = np.where(near.valid, near.parameter - values[left], guess - values[left])
        same = value * below > 0
        low, below = np.where(same, middle, low), np.where(same, value, below)
        high, above = np.where(same, high, middle), np.where(same, above, value)
    near = near._replace(valid=np.ones(len(left), bool))
    point = held_from(branch.path, lane, point, left, near, values, period)
    # Next to a resonance without damping samples do not determine the state: from the points.
    for way in (0, 1):
        left = np.flatnonzero(~point.valid)
        if len(left):
            i = first[left] + way
            near = make_exact(branch.path, lane[left], branch.depth[i], x[i], period=period)
            point = held_from(branch.path, lane, point, left, near, values, period)
    return point


def _points(branch: BranchPoints, values, first, share) -> Columns:
    """Read points of the branch itself."""
    index = first + share.astype(int)
    return {name: np.asarray(getattr(branch, name))[index] for name in READ}


def _solve(branch: BranchPoints, values, first, share) -> Columns:
    """Solve at the values held fixed; NaN where no motion is found near the branch."""
    lane = np.zeros(len(values), int)
    places = zip(first.tolist(), share.tolist(), strict=True)
    depth = np.array([_interpolated(branch, i, s) for i, s in places])
    if branch.exact:
        motion = _exactly(branch, values, first, share, depth)
        good = motion.valid
    else:
        depth, good = solve_all(branch.path, lane, depth, values, period=branch.period)
        motion = read_all(branch.path, lane, depth, values, period=branch.period)
    columns = columns_of(branch.path, lane, values, motion, branch.period)
    leading = np.max(np.abs(columns["floquet_multipliers"]), axis=1)
    columns |= {"leading_multiplier": leading, "stable": (leading < 1).astype(float)}
    return {
        n: np.where(good if c.ndim == 1 else good[:, None], c, np.nan)
        for n, c in columns.items()
        if n in READ
    }
