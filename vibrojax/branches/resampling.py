"""A branch at given values of its parameter: interpolated, then solved there anew."""

from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax._tools.described import in_short
from vibrojax.branches.exact_results import columns_of_motions, motions_at
from vibrojax.branches.points import CURVES, BranchPoints
from vibrojax.branches.readings import Columns, columns_of
from vibrojax.results.variables import axis_description, described_as
from vibrojax.steady.balanced_motion import solve_all

if TYPE_CHECKING:
    import xarray

ROUND_OFF = 1e-12
"""How near a value counts as the end of the range, over that."""
READ = (*CURVES, "stable", "initial_state")


def resample(branch: BranchPoints, values: Any) -> "xarray.Dataset":
    """Solve for the responses of a branch at given values; see `Branch.resample`."""
    import xarray

    values = np.atleast_1d(np.asarray(values, float))
    if values.ndim != 1 or not values.size or not np.isfinite(values).all():
        raise ValueError(
            f"values must be a non-empty list of finite numbers, got {in_short(values)}."
        )
    at, which, first, share = passages_of(branch, values)
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
        "crossing": ("crossing", np.arange(crossings), described_as("crossing")),
    }
    return xarray.Dataset(data, coordinates, attrs=dict(branch.attributes))


def passages_of(branch: BranchPoints, values: np.ndarray):
    """Where the branch passes each value: value, times before, point before, way to the next."""
    x = branch.values
    for end in x[[0, -1]] if len(x) else ():
        values = np.where(np.abs(values - end) <= ROUND_OFF * np.abs(end), end, values)
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
    assert depth is not None  # of a balanced branch
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


def _points(branch: BranchPoints, values, first, share) -> Columns:
    """Read points of the branch itself."""
    index = first + share.astype(int)
    return {name: np.asarray(getattr(branch, name))[index] for name in READ}


def _solve(branch: BranchPoints, values, first, share) -> Columns:
    """Solve at the values held fixed; NaN where no motion is found near the branch."""
    solve = _balanced if branch.curve is None else _exact
    columns, good = solve(branch, values, first, share)
    leading = np.max(np.abs(columns["floquet_multipliers"]), axis=1)
    columns |= {"leading_multiplier": leading, "stable": (leading < 1).astype(float)}
    return {
        n: np.where(good if c.ndim == 1 else good[:, None], c, np.nan)
        for n, c in columns.items()
        if n in READ
    }


def _balanced(branch: BranchPoints, values, first, share) -> tuple[Columns, np.ndarray]:
    lane = np.zeros(len(values), int)
    places = zip(first.tolist(), share.tolist(), strict=True)
    depth = np.array([_interpolated(branch, i, s) for i, s in places])
    depth, good = solve_all(branch.path, lane, depth, values, period=branch.period)
    return columns_of(branch.path, lane, depth, values, branch.period), good


def _exact(branch: BranchPoints, values, first, share) -> tuple[Columns, np.ndarray]:
    assert branch.curve is not None
    both = motions_at(branch, list(zip(first.tolist(), values.tolist(), strict=True)))
    good = np.array([motion is not None for motion, _ in both])
    known = next((seen for _, seen in both if seen is not None), None)
    if known is None:
        nothing = np.full((len(values), len(branch.curve.search.unit)), np.nan)
        columns = {name: nothing[:, 0] for name in CURVES}
        return columns | {"initial_state": nothing, "floquet_multipliers": nothing}, good
    # Something has to stand where there is no motion.
    motions = [m or branch.curve.motions[k] for (m, _), k in zip(both, first, strict=True)]
    seen = [each or known for _, each in both]
    return columns_of_motions(branch.path, 0, motions, seen, branch.period), good
