"""Derivatives of curves and measures with respect to named numbers of the rig.

Of a steady state they are implicit: the state returns after its period, x = P(x, p), so that
dx/dp = (1 - P_x)^-1 P_p, and what is read off the motion follows by the chain rule. Of a jump they
are those of the fold behind it. Forward mode through the stepper, contact times included.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.response.folds import Fold, fold_response
from vibrojax.response.paths import frequency_path
from vibrojax.response.special_points import touch_near
from vibrojax.stepping.method import AbstractMethod
from vibrojax.studies.maps.measures import STEPWISE, Curve, Measure
from vibrojax.studies.maps.responses import Computed, Grid
from vibrojax.studies.maps.rig_maker import RigMaker
from vibrojax.studies.maps.template import DIFFERENTIATED
from vibrojax.studies.swept_lanes import Prepared, Rigs, prepare, ratios_of
from vibrojax.systems.base import as_arrays

WIDTH = 64
"""Points differentiated side by side."""
FOLD_WIDTH = 16
SAME = 1e-2
"""Relative distance up to which a fold is taken for the one behind a jump."""

Slopes = dict[str, dict[str, np.ndarray]]
"""By the name of the number, then by variable."""


def _padded(count: int, width: int) -> list[np.ndarray]:
    """Indices in batches of one width, the last one repeated."""
    starts = range(0, count, width)
    return [np.minimum(np.arange(start, start + width), count - 1) for start in starts]


@eqx.filter_jit
def _prepared(make, static, names, numbers, method) -> tuple[Prepared, Any]:
    """Rigs made ready, and the derivatives of that in each of the named numbers (leading axis)."""

    def ready(numbers):
        def one(own):
            system = as_arrays(make(**static, **own))
            return Rigs(system.equations(), system.drive)

        return prepare(method, jax.vmap(one)(numbers))

    def slope(name):
        change = {n: jnp.full_like(v, float(n == name)) for n, v in numbers.items()}
        return eqx.filter_jvp(ready, (numbers,), (change,))[1]

    found = ready(numbers)
    wanted = eqx.filter(found, eqx.is_inexact_array)
    slopes = [
        jax.tree.map(
            lambda a, b: jnp.zeros_like(a) if b is None else b,
            wanted,
            eqx.filter(slope(name), eqx.is_inexact_array),
            is_leaf=lambda a: a is None,
        )
        for name in names
    ]
    return found, jax.tree.map(lambda *a: jnp.stack(a), *slopes)


def _take(tree: Any, rigs: Any) -> Any:
    return jax.tree.map(lambda a: jnp.take(a, rigs, axis=-1) if eqx.is_array(a) else a, tree)


@eqx.filter_jit
def _point_slopes(prepared, slopes, rigs, value, is_ratio, state, period):
    """Derivatives (numbers, points) of the variables at some points."""
    numbers, rest = eqx.partition(_take(prepared, rigs), eqx.is_inexact_array)

    def run(numbers, state):
        own: Prepared = eqx.combine(numbers, rest)
        unit = own.first_frequency if is_ratio else 2 * jnp.pi
        end, _, measures = own.march(state, value * unit, period, True)
        assert measures is not None  # a march that observes has them
        return end, ratios_of(measures, period, own.reference, jnp)

    _, push = jax.linearize(run, numbers, state)
    n = state.shape[0]
    nothing = jax.tree.map(jnp.zeros_like, numbers)
    eye = jnp.broadcast_to(jnp.eye(n)[:, :, None], (n, *state.shape))
    end_by_number, by_number = jax.vmap(lambda d: push(d, jnp.zeros_like(state)))(
        _take(slopes, rigs)
    )
    end_by_state, by_state = jax.vmap(lambda e: push(nothing, e))(eye)
    matrix = jnp.eye(n) - jnp.moveaxis(end_by_state, (0, 1), (-1, -2))  # points, rows, columns
    change = jnp.linalg.solve(matrix, jnp.moveaxis(end_by_number, (0, 1), (-1, -2)))
    return {
        name: by_number[name] + jnp.einsum("sp,psk->kp", by_state[name], change)
        for name in by_number
    }


def curve_slopes(
    maker: RigMaker,
    index: tuple[np.ndarray, ...],
    names: tuple[str, ...],
    grid: Grid,
    method: AbstractMethod,
    computed: Computed,
) -> Slopes:
    """Differentiate all curves of a block; NaN where there is no steady state."""
    static, numbers = maker.lane_numbers(index, names)
    prepared, slopes = _prepared(maker.make, static, names, numbers, method)
    period = computed.points.period
    rig, *_, column = np.nonzero(period > 0)
    states = computed.points.states[period > 0]
    value, periods = grid.values[column], period[period > 0].astype(np.int32)
    is_ratio = grid.axis == "frequency_ratio"
    parts = [
        jax.device_get(
            _point_slopes(prepared, slopes, rig[at], value[at], is_ratio, states[at].T, periods[at])
        )
        for at in _padded(len(rig), WIDTH)
    ]
    found: Slopes = {name: {} for name in names}
    first = np.asarray(slopes.first_frequency) / (2 * np.pi)
    for k, name in enumerate(names):
        for variable in DIFFERENTIATED:
            own = np.full(period.shape, np.nan)
            if parts:
                joined = np.concatenate([part[variable][k] for part in parts])
                own[period > 0] = joined[: len(rig)]
            found[name][variable] = own
        found[name]["natural_frequency"] = first[k]
    return found


@eqx.filter_jit
def _fold_slopes(make, static, names, numbers, near, free, axis):
    def one(numbers, near, free):
        def place(moved):
            system = as_arrays(make(**static, **(numbers | moved)))
            fold = fold_response(system, near, axis=axis).parameter
            path = frequency_path(system, axis == "frequency_ratio", False)
            touch = touch_near(path, jnp.asarray(near.parameter))
            touch = jnp.where(touch.found, touch.parameter, jnp.nan)
            value = jnp.where(free, touch, fold)
            # What was found is another fold, or none, where it lies elsewhere.
            same = jnp.abs(value / near.parameter - 1) < SAME
            return jnp.where(same, value, jnp.nan), same

        slopes, same = jax.jacfwd(place, has_aux=True)({n: numbers[n] for n in names})
        return {n: jnp.where(same, slope, jnp.nan) for n, slope in slopes.items()}

    return jax.vmap(one)(numbers, near, free)


def fold_slopes(
    maker: RigMaker,
    index: tuple[np.ndarray, ...],
    names: tuple[str, ...],
    axis: str,
    computed: Computed,
) -> Slopes:
    """Differentiate jumps and folds; NaN where there is none or its fold was not found."""
    static, numbers = maker.lane_numbers(index, names)
    numbers = {n: np.asarray(v) for n, v in numbers.items()}
    found: Slopes = {name: {} for name in names}
    for variable, (states, free) in computed.folds.items():
        value = computed.numbers[variable]
        slopes = {name: np.full(value.shape, np.nan) for name in names}
        there = np.isfinite(value) & np.isfinite(states).all(axis=-1)
        lane = np.nonzero(there)[0]
        places, start = np.argwhere(there), states[there]
        for at in _padded(len(lane), FOLD_WIDTH):
            zero = np.zeros(len(at))
            near = Fold(
                *map(jnp.asarray, (value[there][at], zero, zero, start[at], np.ones(len(at), bool)))
            )
            own = {n: v[lane[at]] for n, v in numbers.items()}
            got = _fold_slopes(maker.make, static, names, own, near, free[there][at], axis)
            for name in names:
                slopes[name][tuple(places[at].T)] = np.asarray(got[name])
        for name in names:
            found[name][variable] = slopes[name]
    return found


@eqx.filter_jit
def _measure_slopes(function, curves, shared, changes):
    def one(curve, change):
        kept = {n: v for n, v in curve.items() if n not in change}

        def of(moved):
            return jnp.asarray(function(moved | kept | shared), float)

        return jax.jvp(of, ({n: curve[n] for n in change},), (change,))[1]

    return jax.vmap(one)(curves, changes)


def measure_slopes(
    measures: tuple[Measure, ...], curves: Curve, shared: Curve, slopes: Slopes
) -> dict[str, np.ndarray]:
    """Return d_<measure>_d_<number> for all lanes; NaN where a point without derivative counts.

    Raises `ValueError` for a function that JAX cannot trace.
    """
    found: dict[str, np.ndarray] = {}
    for measure in measures:
        if measure.own and measure.name in STEPWISE:
            continue
        for name, own in slopes.items():
            lost = {n: np.isnan(a) & np.isfinite(curves[n]) for n, a in own.items()}
            known = {n: np.where(np.isnan(a), 0.0, a) for n, a in own.items()}
            try:
                value = _measure_slopes(measure.function, curves, shared, known)
                unknown = _measure_slopes(
                    measure.function, curves, shared, {n: a.astype(float) for n, a in lost.items()}
                )
            except (jax.errors.JAXTypeError, TypeError) as error:
                raise ValueError(
                    f"The measure {measure.name!r} cannot be differentiated: write it with "
                    f"jax.numpy and the operators of arrays. ({str(error).splitlines()[0]})"
                ) from None
            value = np.where(np.asarray(unknown) != 0, np.nan, np.asarray(value))
            missing = ~np.isfinite(curves.get(measure.name, 0.0))
            found[f"d_{measure.name}_d_{name}"] = np.where(missing, np.nan, value)
    return found
