"""A branch at given values of its parameter: interpolated, then solved there anew."""

from typing import TYPE_CHECKING, Any

import numpy as np

from vibrojax.response.balanced_motion import read_all, solve_all
from vibrojax.response.tracing import make_exact
from vibrojax.results.branch import Branch, axis_description
from vibrojax.results.variables import VARIABLES

if TYPE_CHECKING:
    import xarray

VARIABLES_KEPT = (
    "amplitude_ratio",
    "peak_ratio",
    "rms_ratio",
    "first_harmonic_ratio",
    "contact_force",
    "contact_fraction",
    "contacts_per_period",
    "leading_multiplier",
    "residual",
)


def resample(branch: Branch, values: Any) -> "xarray.Dataset":
    """Solve for the responses of a branch at given values; see `Branch.resample`."""
    import xarray

    values = np.atleast_1d(np.asarray(values, float))
    if values.ndim != 1 or not values.size or not np.isfinite(values).all():
        raise ValueError(f"values must be a non-empty list of finite numbers, got {values!r}.")
    at, which, depth = _crossings(branch, values)
    crossings = int(which.max(initial=-1)) + 1
    shape = (len(values), crossings)
    columns = {name: np.full(shape, np.nan) for name in (*VARIABLES_KEPT, "stable")}
    states = np.full((*shape, branch.initial_state.shape[1]), np.nan)
    if len(at):
        solved = _solve(branch, values[at], depth)
        for name, column in columns.items():
            column[at, which] = solved[name]
        states[at, which] = solved["initial_state"]
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


def _crossings(branch: Branch, values: np.ndarray):
    """Where the branch passes each value: value, how many times before, spectrum there."""
    x = branch.values
    at, which, spectra = [], [], []
    for k, value in enumerate(values):
        inside = (np.minimum(x[:-1], x[1:]) <= value) & (value < np.maximum(x[:-1], x[1:]))
        if len(x) and value == x[-1] and not inside[-1:].any():
            inside[-1:] = x[-2:-1] != x[-1]
        for count, i in enumerate(np.flatnonzero(inside)):
            share = (value - x[i]) / (x[i + 1] - x[i])
            at.append(k)
            which.append(count)
            spectra.append(_interpolated(branch, i, share))
    return np.array(at, int), np.array(which, int), np.array(spectra)


def _interpolated(branch: Branch, i: int, share: float) -> np.ndarray:
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


def _solve(branch: Branch, values: np.ndarray, depth: np.ndarray) -> dict[str, np.ndarray]:
    """Solve at the values held fixed; NaN where no motion is found near the branch."""
    lane = np.zeros(len(values), int)
    if branch.exact:
        point = make_exact(branch.path, lane, depth, values, period=branch.period, hold=True)
        r, multipliers, good = point.reading, point.multipliers, point.valid
        residual = point.residual
    else:
        depth, good = solve_all(branch.path, lane, depth, values, period=branch.period)
        r = read_all(branch.path, lane, depth, values, period=branch.period)
        multipliers, residual = r.multipliers, r.residual
    from vibrojax.studies.continue_response import references

    reference, _ = references(branch.path, lane, values)
    leading = np.max(np.abs(multipliers), axis=1)
    solved = {
        "amplitude_ratio": (r.highest - r.lowest) / 2 / reference,
        "peak_ratio": np.maximum(r.highest, -r.lowest) / reference,
        "rms_ratio": np.sqrt(r.mean_square) / reference,
        "first_harmonic_ratio": r.first_harmonic / reference,
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
