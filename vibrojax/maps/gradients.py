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
from jaxtyping import Array

from vibrojax._tools.compiled import compiled
from vibrojax.branches.folds import Fold, fold_response
from vibrojax.branches.special_points import touch_near
from vibrojax.ensemble.slopes import systems_with_slopes, with_slopes
from vibrojax.maps.measures import STEPWISE, Curve, Measure
from vibrojax.maps.responses import Computed, Grid
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.maps.template import DIFFERENTIATED
from vibrojax.steady.batches import in_batches, take_rigs
from vibrojax.steady.paths import frequency_path
from vibrojax.stepping.measures import ratios_of
from vibrojax.stepping.prepared_rigs import Prepared, Rigs, prepare
from vibrojax.stepping.stepper import AbstractStepper

FOLD_WIDTH = 16
"""Folds differentiated side by side."""
SAME = 1e-2
"""Relative distance up to which a fold is taken for the one behind a jump."""

Slopes = dict[str, dict[str, np.ndarray]]
"""By the name of the number, then by variable."""


@compiled
def _prepared(systems, slopes, stepper) -> tuple[Prepared, Any]:
    """Rigs made ready, and the derivatives of that in each of the numbers (leading axis)."""

    def ready(systems):
        return prepare(stepper, jax.vmap(lambda s: Rigs(s.equations(), s.drive))(systems))

    made, slopes = with_slopes(ready, systems, jax.tree.map(lambda a: a.swapaxes(0, 1), slopes))
    smooth = jax.tree.map(lambda a, b: b if eqx.is_inexact_array(a) else None, made, slopes)
    return made, smooth


@compiled
def _point_slopes(prepared, slopes, rigs, value, is_ratio, state, period):
    """Derivatives (points, numbers) of the variables at some points."""
    numbers, rest = eqx.partition(take_rigs(prepared, rigs), eqx.is_inexact_array)

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
        take_rigs(slopes, rigs)
    )
    end_by_state, by_state = jax.vmap(lambda e: push(nothing, e))(eye)
    matrix = jnp.eye(n) - jnp.moveaxis(end_by_state, (0, 1), (-1, -2))  # points, rows, columns
    change = jnp.linalg.solve(matrix, jnp.moveaxis(end_by_number, (0, 1), (-1, -2)))
    return {
        name: by_number[name].T + jnp.einsum("sp,psk->pk", by_state[name], change)
        for name in by_number
    }


def curve_slopes(
    maker: RigMaker,
    index: tuple[np.ndarray, ...],
    names: tuple[str, ...],
    grid: Grid,
    stepper: AbstractStepper,
    computed: Computed,
) -> Slopes:
    """Differentiate all curves of a block; NaN where there is no steady state."""
    static, numbers = maker.lane_numbers(index, names)
    systems = systems_with_slopes(maker.make, static, names, numbers)
    prepared, slopes = _prepared(*systems, stepper)
    period = computed.points.period
    rig, *_, column = np.nonzero(period > 0)
    states = computed.points.states[period > 0]
    value, periods = grid.values[column], period[period > 0].astype(np.int32)
    is_ratio = grid.axis == "frequency_ratio"

    def at_points(i):
        return _point_slopes(prepared, slopes, rig[i], value[i], is_ratio, states[i].T, periods[i])

    at = in_batches(at_points, len(rig)) if len(rig) else {}
    found: Slopes = {name: {} for name in names}
    first = np.asarray(slopes.first_frequency) / (2 * np.pi)
    for k, name in enumerate(names):
        for variable in DIFFERENTIATED:
            own = np.full(period.shape, np.nan)
            if at:
                own[period > 0] = at[variable][:, k]
            found[name][variable] = own
        found[name]["natural_frequency"] = first[k]
    return found


@compiled
def _fold_slopes(systems, slopes, near, free, axis) -> Array:
    """Derivatives (folds, numbers) of the frequencies of folds, or of touches where `free`."""

    def one(system, slopes, near, free):
        def place(system):
            fold = fold_response(system, near, axis=axis).parameter
            path = frequency_path(system, axis == "frequency_ratio", False)
            touch = touch_near(path, jnp.asarray(near.parameter))
            touch = jnp.where(touch.found, touch.parameter, jnp.nan)
            value = jnp.where(free, touch, fold)
            # What was found is another fold, or none, where it lies elsewhere.
            same = jnp.abs(value / near.parameter - 1) < SAME
            return jnp.where(same, value, jnp.nan)

        found = with_slopes(place, system, slopes)
        return jnp.where(jnp.isfinite(found.made), found.slopes, jnp.nan)

    return jax.vmap(one)(systems, slopes, near, free)


def fold_slopes(
    maker: RigMaker,
    index: tuple[np.ndarray, ...],
    names: tuple[str, ...],
    axis: str,
    computed: Computed,
) -> Slopes:
    """Differentiate jumps and folds; NaN where there is none or its fold was not found."""
    static, numbers = maker.lane_numbers(index, names)
    systems = jax.device_get(systems_with_slopes(maker.make, static, names, numbers))
    found: Slopes = {name: {} for name in names}
    for variable, (states, free) in computed.folds.items():
        value = computed.numbers[variable]
        there = np.isfinite(value) & np.isfinite(states).all(axis=-1)
        lane, place = np.nonzero(there)[0], value[there]
        start, begins = states[there], free[there]

        def at_folds(i, lane=lane, place=place, start=start, begins=begins):
            zero, known = jnp.zeros(len(i)), jnp.ones(len(i), bool)
            near = Fold(jnp.asarray(place[i]), zero, zero, jnp.asarray(start[i]), known)
            own = jax.tree.map(lambda a: a[lane[i]], systems)
            return _fold_slopes(own.made, own.slopes, near, begins[i], axis)

        at = in_batches(at_folds, len(lane), FOLD_WIDTH) if len(lane) else None
        for k, name in enumerate(names):
            slope = np.full(value.shape, np.nan)
            if at is not None:
                slope[there] = at[:, k]
            found[name][variable] = slope
    return found


@compiled
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
