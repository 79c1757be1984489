"""Derivatives of curves and measures with respect to named numbers of the rig.

Of a steady state they are implicit: the state returns after its period, x = P(x, p), so that
dx/dp = (1 - P_x)^-1 P_p, and what is read off the motion follows by the chain rule. At a fold
1 - P_x is singular, w (1 - P_x) = 0: there the frequency f moves with the numbers so that
w P_f df + w P_p dp = 0. Of a jump derivatives are those of the fold behind it. Forward mode through
the stepper, contact times included.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from vibrojax._tools.compiled import compiled
from vibrojax.branches.special_points import touch_near
from vibrojax.ensemble.slopes import WithSlopes, systems_with_slopes, with_slopes
from vibrojax.maps.measures import STEPWISE, Curve, Measure
from vibrojax.maps.responses import Computed, Folds, Grid
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.results.variables import DIFFERENTIATED
from vibrojax.steady.batches import in_batches, take_rigs
from vibrojax.steady.fold_ahead import folds_within
from vibrojax.steady.paths import frequency_path
from vibrojax.stepping.measures import ratios_of
from vibrojax.stepping.prepared_rigs import Prepared, Rigs, prepare
from vibrojax.stepping.stepper import AbstractStepper

lax = jax.lax

TOUCH_WIDTH = 16
"""Touches solved for side by side."""
TOGETHER = 8
"""Most derivatives that are carried side by side through a march: each has tables of its own."""
SINGULAR = 1e-2
"""Smallest singular value below which a motion is a fold, in units of energy."""
SAME = 1e-2
"""Relative distance up to which a touch is taken for the one behind a jump."""

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


class Differentiated(NamedTuple):
    """Rigs of a block, and their derivatives in the numbers of some names."""

    names: tuple[str, ...]
    systems: WithSlopes
    prepared: Prepared
    slopes: Any
    """Of `prepared`, names leading."""


def differentiate(
    maker: RigMaker,
    index: tuple[np.ndarray, ...],
    names: tuple[str, ...],
    stepper: AbstractStepper,
) -> Differentiated:
    """Make the rigs of a block ready, with derivatives in the numbers of these names."""
    static, numbers = maker.lane_numbers(index, names)
    systems = systems_with_slopes(maker.make, static, names, numbers)
    return Differentiated(names, systems, *_prepared(*systems, stepper))


class _PointSlopes(NamedTuple):
    """Derivatives at some points; states in units of energy."""

    variables: dict[str, Array]
    """Arrays (points, numbers)."""
    matrix: Array
    """1 - P_x: points, rows, columns."""
    by_number: Array
    """P_p: points, rows, numbers."""
    by_value: Array
    """P_f: points, rows."""


@compiled
def _point_slopes(prepared, slopes, rigs, value, is_ratio, state, period) -> _PointSlopes:
    numbers, rest = eqx.partition(take_rigs(prepared, rigs), eqx.is_inexact_array)

    def run(numbers, state, value):
        own: Prepared = eqx.combine(numbers, rest)
        unit = own.first_frequency if is_ratio else 2 * jnp.pi
        end, _, measures = own.march(state, value * unit, period, True)
        assert measures is not None  # a march that observes has them
        return end, ratios_of(measures, period, own.reference, jnp)

    own = take_rigs(slopes, rigs)
    n, names = state.shape[0], len(jax.tree.leaves(own)[0])

    def along(way):
        """Along one of the named numbers, then of the coordinates of the state, then the value."""
        chosen = jnp.minimum(way, names - 1)
        by_number = jax.tree.map(lambda a: jnp.where(way < names, a[chosen], 0.0), own)
        by_state = jnp.zeros_like(state) + (way == names + jnp.arange(n))[:, None]
        by_value = jnp.zeros_like(value) + (way == names + n)
        return jax.jvp(run, (numbers, state, value), (by_number, by_state, by_value))[1]

    # One loop for all of them: XLA takes twice as long for one of each kind.
    runs = -(-(names + n + 1) // TOGETHER)
    ways = jnp.arange(-(-(names + n + 1) // runs) * runs)
    ends, read = lax.map(jax.vmap(along), ways.reshape(runs, -1))
    ends, read = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), (ends, read))
    by_number, by_state, by_value = ends[:names], ends[names : names + n], ends[names + n]
    matrix = jnp.eye(n) - jnp.moveaxis(by_state, (0, 1), (-1, -2))  # points, rows, columns
    by_number = jnp.moveaxis(by_number, (0, 1), (-1, -2))
    change = jnp.linalg.solve(matrix, by_number)
    variables = {
        name: a[:names].T + jnp.einsum("sp,psk->pk", a[names : names + n], change)
        for name, a in read.items()
    }
    weight = eqx.combine(numbers, rest).march.energy_weight().T
    rows = weight[:, :, None]
    return _PointSlopes(
        variables, rows * matrix / weight[:, None], rows * by_number, weight * by_value.T
    )


def _at_points(
    rigs: Differentiated, rig: np.ndarray, value: np.ndarray, grid: Grid, states, periods
) -> _PointSlopes:
    """Return derivatives at points, one or more, of these rigs."""
    is_ratio, periods = grid.axis == "frequency_ratio", periods.astype(np.int32)

    def some(i):
        own = rig[i], value[i], is_ratio, states[i].T, periods[i]
        return _point_slopes(rigs.prepared, rigs.slopes, *own)

    return in_batches(some, len(rig))


def curve_slopes(rigs: Differentiated, grid: Grid, computed: Computed) -> Slopes:
    """Differentiate all curves of a block; NaN where there is no steady state."""
    period = computed.points.period
    rig, *_, column = np.nonzero(period > 0)
    states = computed.points.states[period > 0]
    points = rig, grid.values[column], grid, states, period[period > 0]
    at = _at_points(rigs, *points).variables if len(rig) else {}
    found: Slopes = {name: {} for name in rigs.names}
    first = np.asarray(rigs.slopes.first_frequency) / (2 * np.pi)
    for k, name in enumerate(rigs.names):
        for variable in DIFFERENTIATED:
            own = np.full(period.shape, np.nan)
            if at:
                own[period > 0] = at[variable][:, k]
            found[name][variable] = own
        found[name]["natural_frequency"] = first[k]
    return found


@compiled
def _touch_slopes(systems, slopes, value, is_ratio) -> tuple[Array, Array]:
    """Frequencies of touches, and their derivatives (touches, numbers)."""

    def one(system, slopes, value):
        def place(system):
            touch = touch_near(frequency_path(system, is_ratio, False), value)
            return jnp.where(touch.found, touch.parameter, jnp.nan)

        return tuple(with_slopes(place, system, slopes))

    return jax.vmap(one)(systems, slopes, value)


def fold_slopes(rigs: Differentiated, grid: Grid, computed: Computed) -> Slopes:
    """Differentiate jumps and folds; NaN where there is none or its fold was not found."""
    found: Slopes = {name: {} for name in rigs.names}
    for variable, folds in computed.folds.items():
        value = computed.numbers[variable]
        # Touches are found anew, without a state.
        there = np.isfinite(value) & (folds.free | np.isfinite(folds.states).all(axis=-1))
        slope = np.full((*value.shape, len(rigs.names)), np.nan)
        for free, slopes_of in ((True, _of_touches), (False, _of_folds)):
            chosen = np.nonzero(there & (folds.free == free))
            if len(chosen[0]):
                own = Folds(*(a[chosen] for a in folds))
                slope[chosen] = slopes_of(rigs, chosen[0], own, grid)
        for k, name in enumerate(rigs.names):
            found[name][variable] = slope[..., k]
    return found


def _of_touches(rigs: Differentiated, lane: np.ndarray, folds: Folds, grid: Grid) -> np.ndarray:
    """Return derivatives (touches, numbers) of the places of touches; NaN where there is none."""
    systems = jax.device_get(rigs.systems)
    place = folds.bracket.mean(axis=1)

    def some(i):
        own = jax.tree.map(lambda a: a[lane[i]], systems)
        return _touch_slopes(own.made, own.slopes, place[i], grid.axis == "frequency_ratio")

    found, slopes = in_batches(some, len(lane), TOUCH_WIDTH)
    # What was found is another one where it lies elsewhere.
    return np.where(np.abs(found / place - 1)[:, None] < SAME, slopes, np.nan)


def _of_folds(rigs: Differentiated, lane: np.ndarray, folds: Folds, grid: Grid) -> np.ndarray:
    """Return derivatives (folds, numbers) of the places of folds; NaN where a motion is none."""
    place, states = folds.bracket[:, 0].copy(), folds.states.copy()
    near = np.flatnonzero(np.diff(folds.bracket)[:, 0] != 0)
    if len(near):
        first = np.asarray(rigs.prepared.first_frequency)[lane[near]]
        unit = first if grid.axis == "frequency_ratio" else 2 * np.pi
        given = lane[near], states[near], (folds.bracket[near].T * unit).T
        fold, states[near] = folds_within(rigs.prepared.march, *given)
        place[near] = np.where(folds.period[near] == 1, fold / unit, np.nan)
    slopes = np.full((len(lane), len(rigs.names)), np.nan)
    known = np.flatnonzero(np.isfinite(place))
    if len(known):
        at = _at_points(rigs, lane[known], place[known], grid, states[known], folds.period[known])
        # Who was given up on the way has no matrix, which numpy would refuse for all.
        lost = ~np.isfinite(at.matrix).all(axis=(1, 2), keepdims=True)
        left, sizes, _ = np.linalg.svd(np.where(lost, np.eye(at.matrix.shape[1]), at.matrix))
        still = left[:, None, :, -1]  # on which the return does not depend
        slope = -(still @ at.by_number)[:, 0] / (still @ at.by_value[:, :, None])[:, 0]
        slopes[known] = np.where(sizes[:, -1:] < SINGULAR, slope, np.nan)
    return slopes


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
