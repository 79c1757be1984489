"""Branches of periodic responses along the drive frequency or any other number."""

from collections.abc import Callable
from importlib.metadata import version
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from vibrojax._checks import check_count, check_range
from vibrojax.response.balanced_motion import read_all
from vibrojax.response.continuation import LONGEST_STEP, Ending, Settings, begin
from vibrojax.response.methods import HarmonicBalance
from vibrojax.response.paths import AbstractPath, ParameterPath, frequency_path, localise
from vibrojax.response.special_points import brackets_of, first_touches, refine, special
from vibrojax.response.starting import stepper
from vibrojax.response.tracing import (
    Traced,
    free_motion,
    in_batches,
    make_exact,
    take,
    trace_branches,
)
from vibrojax.results.branch import Branch, Branches, SpecialPoint
from vibrojax.stepping.choice import is_exact
from vibrojax.studies.axes import lanes_of
from vibrojax.studies.continuation_axes import Along, along_of
from vibrojax.studies.starting import sampled_depth, settled_guess
from vibrojax.systems.base import AbstractSystem

CONVERGED = 1e-4
"""Newton correction at which a point to be made exact counts as found; others go on to 1e-8."""
FALLBACKS = ({"factor": 2.0}, {"factor": 0.5}, {"factor": 0.5, "harmonics": 12})
"""Resolutions tried in turn where a branch does not reach its end."""


def continue_response(
    system: AbstractSystem | Callable[..., AbstractSystem],
    *,
    frequency_ratio: ArrayLike | tuple[float, float] | None = None,
    frequency: ArrayLike | tuple[float, float] | None = None,
    period: int = 1,
    tolerance: float = 1e-4,
    method: HarmonicBalance | None = None,
    start: Any = None,
    max_points: int = 2000,
    longest_step: float = LONGEST_STEP,
    **numbers: Any,
) -> Branch | Branches:
    """Follow the periodic response along one number, through folds, stable and unstable.

    The branch is traced by pseudo-arclength continuation of the condensed harmonic balance; with
    linear stops every point is then made an exact solution between its contact times, with exact
    Floquet multipliers, and so are its special points.

    Parameters:
        system: a system with stops, or a function from named numbers to one.
        frequency_ratio, frequency: the drive frequency (ratio to the first natural frequency of
            the unstopped system, or Hz): a range (low, high) to follow, or one number.
        period: drive periods after which the motion repeats.
        tolerance: relative error to aim at, where motions are not exact.
        method: `HarmonicBalance(samples=..., harmonics=...)` to choose the resolution.
        start: where to start inside the range: a `PeriodicResponse`, or a state (q, q') at
            drive phase 0 with its parameter, as `(state, value)`; the branch is then followed both
            ways. By default it starts at the low end of the range.
        max_points: most points of a branch.
        longest_step: longest step of the arclength.
        numbers: arguments of the function: a tuple (low, high) is the range to follow (exactly one
            in the call), a list an axis with one branch per value, anything else is fixed.

    Returns a `Branch`, or `Branches` where there are axes; each has a status, and says which
    fallback it needed. Raises `ValueError` for no range or several, a range without width, period
    below 1, a tolerance out of reach, a system without stops or drive, or one that is not linear
    but for its stops.
    """
    check_count("period", period)
    check_count("max_points", max_points, least=10)
    check_range("tolerance", tolerance, 0.0, 0.1, include_low=False, allowed="above 0, up to 0.1")
    check_range("longest_step", longest_step, 1e-4, 1.0, allowed="from 1e-4 to 1")
    method = HarmonicBalance() if method is None else method
    along = along_of(system, frequency_ratio, frequency, numbers)
    exact = is_exact(along.sample)
    samples = _samples(method, tolerance, exact)
    work = _Work(along, exact, samples, method.harmonics, period, max_points, longest_step)
    if start is not None:
        return work.from_start(start)
    branches = work.run()
    return Branches(along.axes, tuple(branches)) if along.axes else branches[0]


def _samples(method: HarmonicBalance, tolerance: float, exact: bool) -> int:
    if exact:  # the balance is only where the exact solution starts from
        return method.samples or 128
    method.check_reach(tolerance)
    return method.samples_for(tolerance)


@eqx.filter_jit
def frequency_paths(systems: AbstractSystem, is_ratio: bool, exact: bool) -> AbstractPath:
    """Make the paths along the frequency of stacked systems."""
    return jax.vmap(lambda s: frequency_path(s, is_ratio, exact))(systems)


@eqx.filter_jit
def _references(paths: AbstractPath, parameter):
    def one(path, p):
        place = path.at(p)
        reference, _ = place.drive.reference
        return jnp.asarray(reference, float), place.equations.angular_frequency[0]

    return jax.vmap(one)(paths, parameter)


def references(paths: AbstractPath, lane: np.ndarray, values: np.ndarray):
    """Return drive amplitude (the reference of ratios) and first natural angular frequency."""
    paths = jax.device_get(paths)
    return in_batches(
        lambda i: _references(localise(paths, lane[i], values[i], False), values[i]), len(lane)
    )


class _Work:
    """One continuation: its lanes and how they are traced."""

    def __init__(
        self, along: Along, exact, samples, harmonics, period, max_points, longest, paths=None
    ):
        self.along, self.exact, self.samples = along, exact, samples
        self.harmonics, self.period, self.max_points = harmonics, period, max_points
        self.longest = longest
        self.paths = paths_of(along, exact) if paths is None else paths
        self.low, self.high = along.low, along.high
        self.is_frequency = along.name in ("frequency_ratio", "frequency")

    @property
    def lanes(self) -> int:
        return self.along.count

    def settings(self, count: int, start: np.ndarray, direction: np.ndarray) -> Settings:
        width = self.high - self.low
        # Change of the parameter that counts as much as the motion changing by its size.
        scale = width / 0.5
        if self.along.name == "frequency_ratio":
            scale = min(1.0, scale)
        ones = np.ones(count)
        return Settings(
            start=np.asarray(start, float) * ones,
            low=self.low * ones,
            high=self.high * ones,
            direction=direction * ones,
            scale=scale * ones,
            tolerance=np.asarray(CONVERGED if self.exact else 1e-8),
            longest=np.asarray(float(self.longest)),
        )

    def trace(self, paths, guess, samples, harmonics, start, direction) -> list[Traced]:
        settings = self.settings(len(start), start, direction)
        return trace_branches(
            paths,
            settings,
            begin(guess, start),
            samples=samples * self.period,
            period=self.period,
            harmonics=None if harmonics is None else harmonics * self.period,
            max_points=self.max_points,
        )

    def run(self) -> list[Branch]:
        start = np.full(self.lanes, self.low)
        n = self.samples * self.period
        guess = free_motion(self.paths, start, n, self.period)
        up = np.ones(self.lanes)
        traced = self.trace(self.paths, guess, self.samples, self.harmonics, start, up)
        notes = [""] * self.lanes
        self._start_from_march(traced, notes, start)
        self._fall_back(traced, notes, start)
        return self.finish(self.paths, traced, notes, np.arange(self.lanes))

    def _start_from_march(self, traced, notes, start) -> None:
        """Where no first point was found, start from where a march settles."""
        lost = [k for k in range(self.lanes) if len(traced[k].parameter) == 0]
        if not lost:
            return
        paths = take(self.paths, np.array(lost))
        guess, found = settled_guess(
            paths, start[lost], self.samples * self.period, self.period, self.exact
        )
        lost = [k for k, ok in zip(lost, found, strict=True) if ok]
        if not lost:
            return
        paths = take(self.paths, np.array(lost))
        again = self.trace(
            paths, guess[found], self.samples, self.harmonics, start[lost], np.ones(len(lost))
        )
        for k, t in zip(lost, again, strict=True):
            traced[k] = t
            notes[k] = " It starts from a settled march."

    def _fall_back(self, traced, notes, start) -> None:
        """Where the end was not reached, try other resolutions of the balance."""
        for fallback in FALLBACKS:
            left = [k for k, t in enumerate(traced) if t.ending is not Ending.completed]
            if not left:
                return
            samples = int(self.samples * fallback["factor"])
            harmonics = fallback.get("harmonics", self.harmonics)
            paths = take(self.paths, np.array(left))
            n = samples * self.period
            guess = free_motion(paths, start[left], n, self.period)
            again = self.trace(paths, guess, samples, harmonics, start[left], np.ones(len(left)))
            for k, t in zip(left, again, strict=True):
                if t.ending is Ending.completed:
                    traced[k] = t
                    kept = f" and {harmonics} harmonics" if harmonics else ""
                    notes[k] = f" It was traced with {samples} samples{kept}, as a fallback."

    def from_start(self, start: Any) -> Branch:
        """Follow a branch both ways from a motion inside the range."""
        if self.lanes != 1:
            raise ValueError("start is for one branch: give no lists besides it.")
        state, value = start_of(start, self.along.name)
        if not self.low <= value <= self.high:
            raise ValueError(
                f"start has {self.along.name} = {value:g}, outside the range {self.low:g} to "
                f"{self.high:g}."
            )
        n = self.samples * self.period
        guess, found = settled_guess(
            self.paths, np.array([value]), n, self.period, self.exact, state=np.asarray(state)
        )
        if not found[0]:
            raise ValueError(
                f"start is no periodic motion of period {self.period} at {self.along.name} = "
                f"{value:g}: Newton's method did not converge from it."
            )
        both = take(self.paths, np.zeros(2, int))
        guess = np.repeat(np.asarray(guess), 2, axis=0)
        ways = self.trace(
            both, guess, self.samples, self.harmonics, np.full(2, value), np.array([1.0, -1.0])
        )
        return self.join(ways)

    @classmethod
    def again(cls, branch: Branch, max_points: int = 2000, longest_step: float = LONGEST_STEP):
        """Prepare to follow the motions of twice the period of a branch."""
        along = Along(
            make=None,
            name=branch.axis,
            low=branch.range[0],
            high=branch.range[1],
            axes={},
            fixed={},
            static={},
            labels=[branch.labels],
            frequency=np.nan,
            is_ratio=branch.axis == "frequency_ratio",
            sample=_Sample(branch.ratio_units),
            description=branch.attributes["rig"],
        )
        samples = int(branch.attributes["samples"])
        return cls(
            along, True, samples, None, 2 * branch.period, max_points, longest_step, branch.path
        )

    def from_direction(self, depth, tangent, value) -> Branch:
        """Follow a branch one way from a point of it along a direction."""
        settings = self.settings(1, value, np.ones(1))
        traced = trace_branches(
            self.paths,
            settings,
            begin(depth, value, tangent, np.zeros(1)),
            samples=self.samples * self.period,
            period=self.period,
            max_points=self.max_points,
        )
        return self.finish(self.paths, _until_joined(traced, tangent), [""], np.arange(1))[0]

    def join(self, ways: list[Traced]) -> Branch:
        """Join the two ways from a start into one branch."""
        up, down = ways
        if up.ending is Ending.closed or not len(down.parameter):
            joined, note = up, ""
        else:
            parts = [
                np.concatenate([a[::-1], b[1:]]) for a, b in zip(down[:2], up[:2], strict=True)
            ]
            direction = np.concatenate([-down.direction[::-1], up.direction[1:]])
            both_done = up.ending is down.ending is Ending.completed
            ending = Ending.completed if both_done else up.ending
            joined = Traced(parts[0], parts[1], direction, ending, up.ticks + down.ticks)
            note = "" if both_done else f" Downwards: {down.ending.sentence}"
        return self.finish(self.paths, [joined], [note], np.arange(1))[0]

    def finish(self, paths, traced: list[Traced], notes, lanes) -> list[Branch]:
        """Make the points exact, find the special ones and put the result together."""
        counts = [len(t.parameter) for t in traced]
        lane = np.repeat(np.arange(len(traced)), counts)
        if not len(lane):
            return [self.empty(traced[k], notes[k], lanes[k]) for k in range(len(traced))]
        groups = _same_size([t.depth for t in traced])
        parameter = np.concatenate([t.parameter for t in traced])
        length = np.concatenate([_arclength(t) for t in traced])
        pieces, keep = self._points(paths, lane, groups, parameter)
        values = pieces["parameter"]
        reference, natural = references(paths, lane, values)
        pieces |= {
            "amplitude_ratio": (pieces["highest"] - pieces["lowest"]) / 2 / reference,
            "peak_ratio": np.maximum(pieces["highest"], -pieces["lowest"]) / reference,
            "rms_ratio": np.sqrt(pieces["mean_square"]) / reference,
            "first_harmonic_ratio": pieces["first_harmonic"] / reference,
            "arclength": length,
        }
        chosen = [np.flatnonzero((lane == k) & keep) for k in range(len(traced))]
        depth = [t.depth[keep[lane == k]] for k, t in enumerate(traced)]
        specials = self._special(paths, pieces, chosen, depth)
        branches = []
        for k, t in enumerate(traced):
            at = chosen[k]
            data = {name: pieces[name][at] for name in _FIELDS}
            branches.append(
                Branch(
                    axis=self.along.name,
                    values=values[at],
                    contacts_per_period=pieces["contacts"][at] / self.period,
                    floquet_multipliers=pieces["multipliers"][at],
                    special_points=specials(k),
                    period=self.period,
                    status=t.ending.name,
                    sentence=t.ending.sentence + notes[k] + self._inexact(data["exact_points"]),
                    ticks=t.ticks,
                    exact=self.exact,
                    ratio_units=self.along.sample.drive.reference[1],
                    natural_frequency=float(natural[at[0]] / 2 / np.pi) if len(at) else np.nan,
                    labels=self.along.labels[lanes[k]],
                    range=(self.low, self.high),
                    attributes=self.attributes(),
                    path=take(self.paths, np.array([lanes[k]])),
                    depth=depth[k],
                    **data,
                )
            )
        return branches

    def _points(self, paths, lane, groups, parameter):
        """Read every point: exactly, or off the balance. Returns columns and which to keep."""
        results = []
        for index, depth in groups:
            if self.exact:
                point = make_exact(paths, lane[index], depth, parameter[index], period=self.period)
                r = point.reading
                columns = r._asdict() | {
                    "parameter": point.parameter,
                    "multipliers": point.multipliers,
                    "residual": point.residual,
                    "exact_points": point.valid,
                }
                columns = {n: np.array(columns[n]) for n in _COLUMNS}
                columns["contacts"] = columns["contacts"].astype(float)
                failed = np.flatnonzero(~point.valid)
            else:
                columns = {n: None for n in _COLUMNS}
                failed = np.arange(len(index))
            if len(failed):
                balanced = self._balanced(paths, lane[index], depth, parameter[index], failed)
                for n, values in balanced.items():
                    if columns[n] is None:
                        columns[n] = values
                    else:
                        columns[n][failed] = values
            results.append((index, columns))
        whole = {
            name: np.concatenate([c[name] for _, c in results])[
                np.argsort(np.concatenate([i for i, _ in results]))
            ]
            for name in _COLUMNS
        }
        return whole, np.isfinite(whole["highest"])

    def _balanced(self, paths, lane, depth, parameter, at) -> dict[str, np.ndarray]:
        """Read points off the balance, where that is all there is."""
        r = read_all(paths, lane[at], depth[at], parameter[at], period=self.period)
        columns = r._asdict() | {
            "parameter": parameter[at],
            "exact_points": np.zeros(len(at), bool),
        }
        return {n: np.array(columns[n]) for n in _COLUMNS}

    def _special(self, paths, pieces, chosen, depth):
        """Refine the special points of all branches; return a look-up by branch."""
        values, multipliers = pieces["parameter"], pieces["multipliers"]
        brackets = []
        for k, at in enumerate(chosen):
            if len(at) >= 3:
                sound = pieces["exact_points"][at] if self.exact else np.ones(len(at), bool)
                brackets += brackets_of(k, values[at], multipliers[at], sound)
        branches = [(values[at], depth[k]) for k, at in enumerate(chosen)]
        found = None
        if self.exact and brackets:
            found = refine(paths, branches, brackets, self.period)
        of = special(found)

        def specials(k: int) -> tuple[SpecialPoint, ...]:
            at = chosen[k]
            points = []
            if self.exact:
                for kind in ("fold", "period_doubling", "neimark_sacker"):
                    for after, parameter, motion in of(kind, k):
                        points.append(self._described(paths, k, kind, after, parameter, motion))
            else:
                points += _unrefined(
                    brackets,
                    k,
                    values[at],
                    pieces["amplitude_ratio"][at],
                    pieces["contact_force"][at],
                    pieces["initial_state"][at],
                )
            if self.period == 1 and len(at):
                touching = pieces["contact_fraction"][at] > 0
                for after, parameter in first_touches(paths, k, values[at], touching):
                    amplitude = float(pieces["amplitude_ratio"][at][after])
                    points.append(SpecialPoint("grazing", parameter, amplitude, 0.0, None, after))
            return tuple(sorted(_snapped(points, values[at]), key=lambda p: p.after))

        return specials

    def _inexact(self, exact_points: np.ndarray) -> str:
        count = int(np.sum(~exact_points))
        if not (self.exact and count):
            return ""
        return (
            f" {count} of its points are harmonic balance only: no exact motion was found for them."
        )

    def _described(self, paths, lane, kind, after, parameter, motion) -> SpecialPoint:
        reading = motion.reading
        (reference,), _ = references(paths, np.array([lane]), np.array([parameter]))
        amplitude = float((reading.highest - reading.lowest) / 2 / reference)
        force = float(reading.contact_force)
        return SpecialPoint(kind, parameter, amplitude, force, reading.initial_state, after)

    def attributes(self) -> dict[str, str]:
        return {
            "title": "vibrojax continuation",
            "rig": self.along.description,
            "samples": str(self.samples),
            "vibrojax_version": version("vibrojax"),
            "jax_version": version("jax"),
        }

    def empty(self, traced: Traced, note: str, lane: int) -> Branch:
        states = 2 * int(take(self.paths, 0).at(jnp.asarray(self.low)).equations.size)
        none = np.zeros(0)
        return Branch(
            axis=self.along.name,
            values=none,
            contacts_per_period=none,
            floquet_multipliers=np.zeros((0, states), complex),
            special_points=(),
            period=self.period,
            status=traced.ending.name,
            sentence="No periodic motion was found to start from." + note,
            ticks=traced.ticks,
            exact=self.exact,
            ratio_units=self.along.sample.drive.reference[1],
            natural_frequency=np.nan,
            labels=self.along.labels[lane],
            range=(self.low, self.high),
            attributes=self.attributes(),
            path=take(self.paths, np.array([lane])),
            depth=np.asarray(traced.depth),
            **(
                {name: none for name in _FIELDS}
                | {"initial_state": np.zeros((0, states)), "exact_points": np.zeros(0, bool)}
            ),
        )


_COLUMNS = (
    "highest",
    "lowest",
    "mean_square",
    "first_harmonic",
    "contact_force",
    "contact_fraction",
    "contacts",
    "initial_state",
    "multipliers",
    "residual",
    "parameter",
    "exact_points",
)
_FIELDS = (
    "arclength",
    "amplitude_ratio",
    "peak_ratio",
    "rms_ratio",
    "first_harmonic_ratio",
    "contact_force",
    "contact_fraction",
    "residual",
    "initial_state",
    "exact_points",
)


def paths_of(along: Along, exact: bool) -> AbstractPath:
    """Make the stacked paths of all lanes."""
    if along.name in ("frequency_ratio", "frequency"):
        lanes = lanes_of(along.make, along.numbers)
        systems = lanes.systems
        if not lanes.batched:
            systems = jax.tree.map(lambda a: jnp.asarray(a)[None], systems)
        return frequency_paths(systems, along.name == "frequency_ratio", exact)
    rows = {n: jnp.asarray([labels[n] for labels in along.labels]) for n in along.axes}
    fixed = {n: jnp.full(along.count, v, float) for n, v in along.fixed.items()}
    return ParameterPath(
        make=along.make,
        name=along.name,
        fixed=rows | fixed,
        static=along.static,
        frequency=jnp.full(along.count, along.frequency),
        is_ratio=along.is_ratio,
    )


class _Sample(NamedTuple):
    """What the result needs of a system that is not at hand."""

    ratio_units: str

    @property
    def drive(self):
        return self

    @property
    def reference(self):
        return 1.0, self.ratio_units


@eqx.filter_jit
def _critical(paths: AbstractPath, value, state, period):
    """Return the state of a motion and one moved a little along its multiplier of -1."""
    path = take(paths, 0)
    place = path.at(value[0])
    march = stepper(True).prepare(place.equations, place.drive)
    weight = march.energy_weight()
    periods = jnp.asarray(period, jnp.int32)

    def image(x):
        return march(x / weight, place.angular_frequency, periods, False)[0] * weight

    matrix = jax.jacfwd(image)(state * weight)
    # The multiplier is real: its vector spans the null space of the matrix plus one.
    _, _, right = jnp.linalg.svd(matrix + jnp.eye(state.size))
    size = 1e-4 * jnp.linalg.norm(state * weight)
    return state, state + size * right[-1] / weight


def _until_joined(traced: list[Traced], tangent: np.ndarray) -> list[Traced]:
    """Cut a doubled branch where it joins the single one again: its odd part changes sign."""
    (one,) = traced
    along = np.sum((one.depth * np.conj(tangent[0])).real, axis=(1, 2))
    back = np.flatnonzero(along <= 0)
    if not len(back):
        return traced
    end = int(back[0])
    return [
        Traced(one.parameter[:end], one.depth[:end], one.direction[:end], Ending.joined, one.ticks)
    ]


def start_of(start: Any, name: str) -> tuple[np.ndarray, float]:
    """Read a start: a `PeriodicResponse`, or (state, value)."""
    if hasattr(start, "initial_state"):
        return np.asarray(start.initial_state), float(getattr(start, name))
    try:
        state, value = start
        return np.asarray(state, float), float(value)
    except (TypeError, ValueError):
        raise ValueError(
            f"start must be a PeriodicResponse or (state, {name}), got {start!r}."
        ) from None


def _same_size(depths: list[np.ndarray]):
    """Group points whose spectra have the same length: (index of the point, spectra)."""
    first = np.cumsum([0] + [len(d) for d in depths])
    sizes = sorted({d.shape[-1] for d in depths if len(d)})
    groups = []
    for size in sizes:
        with_size = [k for k, d in enumerate(depths) if len(d) and d.shape[-1] == size]
        index = np.concatenate([np.arange(first[k], first[k + 1]) for k in with_size])
        groups.append((index, np.concatenate([depths[k] for k in with_size])))
    return groups


def _arclength(traced: Traced) -> np.ndarray:
    if len(traced.parameter) < 2:
        return np.zeros(len(traced.parameter))
    size = np.sqrt(np.sum(np.abs(traced.depth[:-1]) ** 2, axis=(1, 2)))
    moved = np.sqrt(np.sum(np.abs(np.diff(traced.depth, axis=0)) ** 2, axis=(1, 2)))
    step = np.hypot(moved / size, np.diff(traced.parameter))
    return np.concatenate([[0.0], np.cumsum(step)])


def _snapped(points: list[SpecialPoint], values: np.ndarray) -> list[SpecialPoint]:
    """Put folds that are corners at a touch on the touch itself.

    Where contact begins, a branch can turn round at once: then its extreme is the touch, and no
    smooth fold beyond it was found.
    """
    touches = [p for p in points if p.kind == "grazing"]

    def snap(point: SpecialPoint) -> SpecialPoint:
        if point.kind != "fold":
            return point
        middle = values[point.after]
        near = values[max(point.after - 1, 0) : point.after + 2]
        way = 1.0 if middle >= near.max() else -1.0
        for touch in touches:
            beyond = way * (touch.parameter - point.parameter)
            if abs(touch.after - point.after) <= 2 and 0 < beyond < 2e-3 * abs(touch.parameter):
                return SpecialPoint(
                    "fold", touch.parameter, touch.amplitude_ratio, 0.0, None, point.after
                )
        return point

    return [snap(p) for p in points]


def _unrefined(brackets, lane, values, amplitude, force, state) -> list[SpecialPoint]:
    """Special points of a balanced branch: the vertex of a parabola, or the middle of a step."""
    points = []
    for b in brackets:
        if b.lane != lane:
            continue
        if b.kind == "fold":
            y = values[b.at - 1 : b.at + 2]
            bend = y[0] - 2 * y[1] + y[2]
            parameter = y[1] - (y[2] - y[0]) ** 2 / (8 * bend) if bend else y[1]
        else:
            parameter = (values[b.at] + values[b.at + 1]) / 2
        points.append(
            SpecialPoint(
                b.kind,
                float(parameter),
                float(amplitude[b.at]),
                float(force[b.at]),
                state[b.at],
                b.at,
            )
        )
    return points


def switch_branch(branch: Branch, number: int, **settings: Any) -> Branch:
    """Follow the doubled period from a period doubling; see `Branch.switch`."""
    points = [p for p in branch.special_points if p.kind == "period_doubling"]
    if not 0 <= number < len(points):
        raise ValueError(
            f"number must be one of the {len(points)} period doublings of the branch, counted from "
            f"0, got {number}."
        )
    if not branch.exact:
        raise ValueError("Only branches of linear stops without smoothing can be switched.")
    point = points[number]
    assert point.initial_state is not None
    work = _Work.again(branch, **settings)
    n = work.samples * work.period
    value = np.array([point.parameter])
    state = jnp.asarray(point.initial_state)
    response = _critical(branch.path, value, state, branch.period)
    depth = [
        np.asarray(sampled_depth(branch.path, value, s[None], n, work.period, True))
        for s in response
    ]
    # The doubled motion leaves along the mode that changes sign from period to period.
    base, moved = depth
    odd = (moved - base) * (np.arange(base.shape[-1]) % 2 == 1)
    even = base * (np.arange(base.shape[-1]) % 2 == 0)
    return work.from_direction(even, odd, value)
