"""Forward and backward frequency sweeps, the state carried from frequency to frequency."""

import math
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._checks import check_choice, check_count, check_frequencies, check_range, concrete
from vibrojax.response.settling import Settled, settle
from vibrojax.results.frequency_response import FrequencyResponse
from vibrojax.results.status import Status
from vibrojax.stepping.choice import choose_method
from vibrojax.stepping.method import AbstractMarch, AbstractMethod
from vibrojax.studies.axes import Lanes, lanes_of
from vibrojax.studies.jumps import find_jumps
from vibrojax.systems.base import AbstractSystem

EXTENSIONS = 4
"""Grid steps that a jump is followed beyond the one in which the sweep left its branch."""
DIRECTIONS = {
    "both": ("forward", "backward"),
    "forward": ("forward",),
    "backward": ("backward",),
}


class _Prepared(eqx.Module):
    march: AbstractMarch
    first_frequency: Float[Array, "*lanes"]
    reference: Float[Array, "*lanes"]


@eqx.filter_jit
def _prepare(method: AbstractMethod, systems: AbstractSystem, batched: bool) -> _Prepared:
    def one(system):
        equations = system.equations()
        reference, _ = system.drive.reference
        return _Prepared(
            method.prepare(equations, system.drive),
            equations.angular_frequency[0],
            jnp.asarray(reference, float),
        )

    if not batched:
        return one(systems)
    lanes_last = eqx.filter_vmap(one, out_axes=-1)(systems)
    # One more trailing axis, over which the directions broadcast.
    return jax.tree.map(lambda a: a[..., None] if eqx.is_array(a) else a, lanes_last)


@eqx.filter_jit
def _visit(
    march: AbstractMarch,
    state: Float[Array, "states *lanes"],
    angular_frequency: Float[Array, "*lanes"],
    tolerance: Float[Array, ""],
    max_period: int,
    max_periods: Int[Array, ""],
) -> Settled:
    return settle(
        march,
        state,
        angular_frequency,
        tolerance=tolerance,
        max_period=max_period,
        max_periods=max_periods,
    )


def _ratios(settled: Settled, reference: Array) -> dict[str, np.ndarray]:
    """Turn the sums of a lane into the variables of the result."""
    m = settled.measures
    time = jnp.where(m.time > 0, m.time, 1.0)
    harmonic = jnp.hypot(m.integral_with_sine, m.integral_with_cosine) * 2 / time
    lost = settled.status == Status.diverged.value
    values = {
        "amplitude_ratio": (m.highest - m.lowest) / 2 / reference,
        "peak_ratio": jnp.maximum(m.highest, -m.lowest) / reference,
        "rms_ratio": jnp.sqrt(m.integral_of_square / time) / reference,
        "first_harmonic_ratio": harmonic / reference,
        "contact_force": m.force,
        "contact_fraction": m.contact_time / time,
        "contacts_per_period": m.contacts / settled.window,
    }
    return {name: np.asarray(jnp.where(lost, jnp.nan, v)) for name, v in values.items()} | {
        "period": np.asarray(settled.period),
        "status": np.asarray(settled.status),
        "periods_marched": np.asarray(settled.periods_marched),
        "steps": np.asarray(settled.steps),
    }


def frequency_sweep(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    direction: str = "both",
    tolerance: float = 1e-4,
    steps_per_period: int | None = None,
    method: AbstractMethod | None = None,
    max_period: int = 8,
    max_periods: int = 600,
    refine_jumps: float | None = 1e-4,
    progress: bool | None = None,
    **axes: Any,
) -> FrequencyResponse:
    """Sweep the drive frequency up and down and return the steady response at every point.

    At each frequency the lanes march from where the last one ended until their motion returns
    after `max_period` drive periods or fewer, all lanes together. What has not settled after
    `max_periods` is flagged in `status`, never dropped.

    Parameters:
        system: the rig, or a function from named numbers to a rig; then further keywords are its
            arguments, and lists among them are axes, crossed, which the result carries by name.
        frequency_ratio: drive frequencies over the first linear natural frequency of the
            unstopped system, increasing, shape (frequencies,).
        frequency: the same in Hz; give one of the two.
        direction: `both`, `forward` (upwards) or `backward`.
        tolerance: relative error to aim at in amplitudes and forces of settled points.
        steps_per_period: steps of the march, instead of those chosen from contact and tolerance.
        method: how to step: `ExactContact()` or `ExponentialSplitting()`; by default the first
            where the stops are linear in contact, else the second.
        max_period: longest period looked for, in drive periods.
        max_periods: most drive periods marched at one frequency.
        refine_jumps: relative width to which the jumps are bracketed by bisection, each try
            starting from the branch before the jump; None leaves them between grid points.
        progress: show a progress bar; by default on long runs in a terminal.

    Raises `ValueError` for frequencies that are empty, not finite or not increasing, an unknown
    keyword, a system without a drive, or settings that cannot work. Source: Gandhi and Vyas 2017,
    sec. 3.1.
    """
    check_choice("direction", direction, tuple(DIRECTIONS))
    check_count("max_period", max_period)
    check_count("max_periods", max_periods, least=2 * max_period + 1)
    if refine_jumps is not None:
        check_range("refine_jumps", refine_jumps, 1e-9, 1.0, allowed="from 1e-9 to 1, or None")
    axis, grid = _frequency_axis(frequency_ratio, frequency)
    lanes = lanes_of(system, axes)
    check_drive(lanes.sample)
    method = choose_method(lanes.sample, method, tolerance, steps_per_period)
    directions = DIRECTIONS[direction]
    # Its numbers as arrays: a new tolerance does not compile again.
    numbers = jax.tree.map(lambda x: jnp.asarray(x) if isinstance(x, float) else x, method)
    prepared = _prepare(numbers, lanes.systems, lanes.batched)
    sweep = _Sweep(prepared, axis, grid, directions, tolerance, max_period, max_periods)
    points, states = sweep.run(progress)
    curves = {name: _by_frequency([p[name] for p in points], directions) for name in points[0]}
    found = find_jumps(curves["amplitude_ratio"], curves["status"], directions)
    found.fill_brackets(np.asarray(grid))
    if refine_jumps is not None:
        sweep.refine(found, points, states, refine_jumps)
    return _result(lanes, sweep, curves, found, method)


def _frequency_axis(
    ratio: ArrayLike | Sequence[float] | None, frequency: ArrayLike | Sequence[float] | None
) -> tuple[str, np.ndarray]:
    if (ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    if ratio is not None:
        return "frequency_ratio", check_frequencies("frequency_ratio", ratio, "(ratio)")
    return "frequency", check_frequencies("frequency", frequency, "Hz")


def check_drive(system: AbstractSystem) -> None:
    """Refuse, with a `ValueError`, a system that nothing drives."""
    reference, unit = system.drive.reference
    size = concrete(reference)
    if unit == "m" or (size is not None and not (size > 0).all()):
        raise ValueError(
            "A frequency sweep needs a drive with an amplitude above 0, got "
            f"{system.drive!r}. Give the system drive=BaseMotion(...) or PointForce(...)."
        )


def _by_frequency(points: list[np.ndarray], directions: tuple[str, ...]) -> np.ndarray:
    """Stack the points of the march as (..., directions, ascending frequencies)."""
    stacked = np.stack(points, axis=-1)
    if "backward" in directions:
        k = directions.index("backward")
        stacked[..., k, :] = stacked[..., k, ::-1].copy()
    return stacked


class _Sweep:
    """The march over the frequencies of all lanes and the bisection of their jumps."""

    def __init__(self, prepared, axis, grid, directions, tolerance, max_period, max_periods):
        self.prepared, self.axis, self.grid = prepared, axis, np.asarray(grid)
        self.directions, self.max_period = directions, max_period
        self.tolerance = jnp.asarray(1e-2 * tolerance)
        self.max_periods = jnp.asarray(max_periods)
        first = np.asarray(prepared.first_frequency)
        self.natural_frequency = (first[..., 0] if first.ndim else first) / (2 * np.pi)
        self.shape = (*first.shape[:-1], len(directions))
        # From the unit of the axis to rad/s.
        self.unit = first if axis == "frequency_ratio" else 2 * np.pi

    def visit(self, state, values):
        """Settle all lanes, each at its value of the frequency axis."""
        angular = jnp.broadcast_to(jnp.asarray(values * self.unit), self.shape)
        settled = _visit(
            self.prepared.march,
            state,
            angular,
            self.tolerance,
            self.max_period,
            self.max_periods,
        )
        return settled, _ratios(settled, self.prepared.reference)

    def run(self, progress):
        from tqdm import tqdm

        states_count = self.prepared.march.energy_weight().shape[0]
        state = jnp.zeros((states_count, *self.shape))
        points, states = [], []
        hidden = None if progress is None else not progress
        delay = 2.0 if progress is None else 0.0
        bar = tqdm(range(len(self.grid)), "sweep", disable=hidden, delay=delay, unit="point")
        for i in bar:
            ends = {"forward": self.grid[i], "backward": self.grid[-1 - i]}
            settled, values = self.visit(state, np.array([ends[d] for d in self.directions]))
            state = settled.state
            points.append(values)
            states.append(np.asarray(state))
        return points, states

    def refine(self, found, points, states, width):
        """Bisect every jump from the state before it until its bracket is narrow."""
        if not found.any():
            return
        n = len(self.grid)
        at = np.where(found.before >= 0, found.before, 0)
        lanes = np.indices(self.shape)
        order = np.array([d == "backward" for d in self.directions])
        visited = np.where(order, n - 1 - at, at)  # index in the order of the march
        amplitude = np.stack([p["amplitude_ratio"] for p in points])
        start = amplitude[(visited, *lanes)]
        settled_before = np.stack([p["period"] for p in points])[(visited, *lanes)] > 0
        end = amplitude[(np.minimum(visited + 1, n - 1), *lanes)]
        history = np.stack(states)  # (visits, states, *lanes)
        state = np.moveaxis(history, 1, -1)[(visited, *lanes)]
        state = np.moveaxis(state, -1, 0)
        low, high = found.bracket[..., 0].copy(), found.bracket[..., 1].copy()  # before, after
        low = np.where(found.exists, low, self.grid[0])
        high = np.where(found.exists, high, self.grid[0])
        scale = 1.0 if self.axis == "frequency_ratio" else float(np.min(self.natural_frequency))
        span = np.where(found.exists, high - low, 0.0)
        halvings = max(0, math.ceil(math.log2(max(float(np.max(np.abs(span))) / scale / width, 1))))
        for _ in range(EXTENSIONS):
            inside = ~found.exists
            for _ in range(halvings):
                middle = (low + high) / 2
                settled, values = self.visit(jnp.asarray(state), middle)
                value = values["amplitude_ratio"]
                same = np.abs(value - start) < np.abs(value - end)
                # Just past a fold a lane lingers near the lost branch without settling on it.
                same &= (values["period"] > 0) | ~settled_before
                inside |= ~same
                low, high = np.where(same, middle, low), np.where(same, high, middle)
                start = np.where(same, value, start)
                state = np.where(same, np.asarray(settled.state), state)
            if inside.all():
                break
            # A coarse grid step can leave the branch ahead of its end: then look further on.
            high = np.where(inside, high, low + span)
        found.set_brackets(low, high)


def _result(
    lanes: Lanes, sweep: _Sweep, curves: dict[str, np.ndarray], found, method: AbstractMethod
) -> FrequencyResponse:
    shape = lanes.shape

    def over_axes(values: Any) -> Any:
        if not lanes.batched:
            return values
        return values.reshape(*shape, *values.shape[1:])

    ups, downs = found.up_and_down()
    _, ratio_units = lanes.sample.drive.reference
    return FrequencyResponse(
        axis=sweep.axis,
        frequencies=sweep.grid,
        directions=sweep.directions,
        axes=lanes.axes,
        ratio_units=ratio_units,
        natural_frequency=over_axes(sweep.natural_frequency),
        jump_up=over_axes(ups.mean(axis=-1)),
        jump_down=over_axes(downs.mean(axis=-1)),
        jump_up_bracket=over_axes(ups),
        jump_down_bracket=over_axes(downs),
        attributes={
            "title": "vibrojax frequency sweep",
            "rig": lanes.description,
            "method": repr(method),
            "vibrojax_version": version("vibrojax"),
            "jax_version": version("jax"),
        },
        **{name: over_axes(values) for name, values in curves.items()},
    )
