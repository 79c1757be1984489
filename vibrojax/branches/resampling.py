"""A branch at given values of its parameter: interpolated, then solved there anew."""

from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from vibrojax._tools.described import in_short
from vibrojax.branches.finishing import ratios_of
from vibrojax.branches.lane_paths import references
from vibrojax.branches.points import CURVES, BranchPoints
from vibrojax.branches.tracing import exact_from, make_exact
from vibrojax.results.variables import VARIABLES, axis_description
from vibrojax.steady.balanced_motion import read_all, solve_all
from vibrojax.steady.exact_point import ExactPoint, Guess

if TYPE_CHECKING:
    import xarray

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
    columns = {name: np.full(shape, np.nan) for name in (*CURVES, "stable")}
    states = np.full((*shape, branch.initial_state.shape[1]), np.nan)
    # What is a point of the branch already, as the ends of its range are, is not solved again.
    known = (share == 0) | (share == 1)
    for part, read in ((known, _points), (~known, _solve)):
        if part.any():
            place = at[part], which[part]
            found = read(branch, values[at[part]], first[part], share[part])
            for name, column in columns.items():
                column[place] = found[name]
            states[place] = found["initial_state"]
    units = {"ratio": branch.ratio_units}

    def described(name: str) -> dict[str, str]:
        unit, long_name = VARIABLES[name]
        return {"units": units.get(unit, unit), "long_name": long_name}

    dims = (branch.axis, "crossing")
    data: dict[str, Any] = {n: (dims, c, described(n)) for n, c in columns.items()}
    described_state = {
        "units": "m, m/s",
        "long_name": "Modal displacements, then velocities, at phase 0",
    }
    data["initial_state"] = ((*dims, "state"), states, described_state)
    coordinates: dict[str, Any] = {
        branch.axis: (branch.axis, values, axis_description(branch.axis)),
        "crossing": np.arange(crossings),
    }
    return xarray.Dataset(data, coordinates, attrs=dict(branch.attributes))


def _crossings(branch: BranchPoints, values: np.ndarray):
    """Where the branch passes each value: value, times before, point before, way to the next."""
    x = branch.values
    at, which, first, shares = [], [], [], []
    for k, value in enumerate(values):
        inside = (np.minimum(x[:-1], x[1:]) <= value) & (value < np.maximum(x[:-1], x[1:]))
        if len(x) and value == x[-1] and not inside[-1:].any():
            inside[-1:] = x[-2:-1] != x[-1]
        for count, i in enumerate(np.flatnonzero(inside)):
            share = (value - x[i]) / (x[i + 1] - x[i])
            at.append(k)
            which.append(count)
            first.append(i)
            shares.append(share)
    return np.array(at, int), np.array(which, int), np.array(first, int), np.array(shares)


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
    weights = [
        np.prod([(value - b) / (a - b) for j, b in enumerate(nodes) if j != k])
        for k, a in enumerate(nodes)
    ]
    return np.einsum("k,k...->...", weights, depth[i - 1 : i + 3])


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
    close = Guess(point.events, point.orbit, np.zeros(len(point.valid), bool))
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
        close = Guess(near.events, near.orbit, np.ones(len(left), bool))
    point = _replaced(branch, point, left, close, values)
    # Next to a resonance without damping samples do not determine the state: from the points.
    for way in (0, 1):
        left = np.flatnonzero(~point.valid)
        if len(left):
            i = first[left] + way
            near = make_exact(branch.path, lane[left], branch.depth[i], x[i], period=period)
            close = Guess(near.events, near.orbit, near.valid)
            point = _replaced(branch, point, left, close, values)
    return point


def _replaced(branch: BranchPoints, point: ExactPoint, which, guess: Guess, values) -> ExactPoint:
    """Put the motions found from guesses in the place of some points."""
    lane = np.zeros(len(which), int)
    found = exact_from(branch.path, lane, guess, values[which], period=branch.period, hold=True)

    def put(a, b):
        a = np.array(a)
        a[which] = b
        return a

    return jax.tree.map(put, point, found)


def _points(branch: BranchPoints, values, first, share) -> dict[str, np.ndarray]:
    """Read points of the branch itself."""
    index = first + share.astype(int)
    return {n: np.asarray(getattr(branch, n))[index] for n in (*CURVES, "stable", "initial_state")}


def _solve(branch: BranchPoints, values, first, share) -> dict[str, np.ndarray]:
    """Solve at the values held fixed; NaN where no motion is found near the branch."""
    lane = np.zeros(len(values), int)
    places = zip(first.tolist(), share.tolist(), strict=True)
    depth = np.array([_interpolated(branch, i, s) for i, s in places])
    if branch.exact:
        point = _exactly(branch, values, first, share, depth)
        r, multipliers, good = point.reading, point.multipliers, point.valid
        residual = point.residual
    else:
        depth, good = solve_all(branch.path, lane, depth, values, period=branch.period)
        r = read_all(branch.path, lane, depth, values, period=branch.period)
        multipliers, residual = r.multipliers, r.residual
    reference, _ = references(branch.path, lane, values)
    leading = np.max(np.abs(multipliers), axis=1)
    solved = {
        **ratios_of(r._asdict(), reference),
        "contact_force": r.contact_force,
        "contact_fraction": r.contact_fraction,
        "contacts_per_period": r.contacts / branch.period,
        "leading_multiplier": leading,
        "residual": residual,
        "stable": (leading < 1).astype(float),
        "initial_state": r.initial_state,
    }
    return {
        n: np.where(good.reshape((-1,) + (1,) * (np.ndim(v) - 1)), v, np.nan)
        for n, v in solved.items()
    }
