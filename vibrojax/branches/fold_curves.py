"""Folds followed in a second number: the hysteresis region of a map as lines."""

from collections.abc import Callable, Generator
from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import check_count
from vibrojax._tools.signatures import validated
from vibrojax.branches.along import along_of, frequency_of
from vibrojax.branches.branch import Branch
from vibrojax.branches.continue_response import continue_response
from vibrojax.branches.folds import Fold, check_linear_stops, compile_search, fold_response
from vibrojax.branches.points import TURNS, SpecialPoint
from vibrojax.branches.resampling import polynomial_weights
from vibrojax.ensemble.ranges import Range
from vibrojax.model.systems import AbstractSystem, as_arrays
from vibrojax.results.variables import axis_description, described_as

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

FIRST, LONGEST, SHORTEST, BRIDGE = 1e-3, 0.05, 1e-5, 0.02
"""Steps in the second number, over its range; the last where a new branch is traced."""
NEAR = 0.02
"""Farthest that a fold may lie from its prediction, relative."""
BRIDGE_NEAR = 0.005
"""The same where it is taken from a new branch."""


class FoldCurve(eqx.Module):
    """One fold, followed in a second number; arrays of shape (points,)."""

    values: Float[np.ndarray, " points"]
    """The second number, increasing."""
    folds: Float[np.ndarray, " points"]
    """Drive frequency of the fold, in the unit that was asked for."""
    amplitude_ratio: Float[np.ndarray, " points"]
    """Half peak-to-peak displacement at the fold over the drive amplitude."""
    contact_force: Float[np.ndarray, " points"]
    """Largest contact force at the fold, N."""
    endings: tuple[str, str] = eqx.field(static=True)
    """Why the curve ends at its low and at its high end."""
    parameter: str = eqx.field(static=True, default="parameter")
    """Name of the second number."""
    axis: str = eqx.field(static=True, default="frequency_ratio")
    """`frequency_ratio`, or `frequency` in Hz."""
    ratio_units: str = eqx.field(static=True, default="1")
    """Unit of the amplitude ratio: `1` for base motion, `m/N` for a force."""

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over `point`, with units and long names."""
        import xarray

        data = {
            self.parameter: ("point", self.values, axis_description(self.parameter)),
            self.axis: ("point", self.folds, axis_description(self.axis)),
        }
        for name in ("amplitude_ratio", "contact_force"):
            data[name] = ("point", getattr(self, name), described_as(name, self.ratio_units))
        attributes = {"title": "vibrojax fold curve", "parameter": self.parameter}
        low, high = self.endings
        attributes |= {"axis": self.axis, "low_ending": low, "high_ending": high}
        return xarray.Dataset(data, attrs=attributes)

    def plot(self) -> "Figure":
        """Draw the frequency of the fold against the second number."""
        from vibrojax.plot.branches import plot_fold_curves

        return plot_fold_curves([self.to_xarray()])

    def __repr__(self) -> str:
        low, high = self.values[[0, -1]]
        first, last = self.folds[[0, -1]]
        return (
            f"FoldCurve({self.parameter} {low:.6g} to {high:.6g}, {self.axis} {first:.6g} to "
            f"{last:.6g}, {len(self.values)} points)"
        )


class FoldCurves(eqx.Module):
    """All folds of a response, followed in a second number."""

    parameter: str = eqx.field(static=True)
    """Name of the second number."""
    axis: str = eqx.field(static=True)
    """`frequency_ratio`, or `frequency` in Hz."""
    curves: tuple[FoldCurve, ...]
    """In the order of the folds along the branch they start from."""
    branch: Branch
    """The branch on which they were found."""

    def __len__(self) -> int:
        return len(self.curves)

    def __getitem__(self, index: int) -> FoldCurve:
        return self.curves[index]

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over `fold` and `point`, shorter curves filled up with NaN."""
        import xarray

        parts = [c.to_xarray() for c in self.curves]
        # Numbered points, so that shorter curves are filled up with NaN.
        parts = [p.assign_coords(point=np.arange(p.sizes["point"])) for p in parts]
        if not parts:
            return xarray.Dataset(attrs=self.branch.attributes)
        data = xarray.concat(parts, "fold", join="outer", combine_attrs="drop_conflicts")
        return data.drop_vars("point", errors="ignore").assign_attrs(self.branch.attributes)

    def plot(self) -> "Figure":
        """Draw the fold frequencies against the second number.

        Raises `ValueError` when there is no fold.
        """
        if not self.curves:
            raise ValueError("There are no folds to draw.")
        from vibrojax.plot.branches import plot_fold_curves

        return plot_fold_curves([curve.to_xarray() for curve in self.curves])

    def __repr__(self) -> str:
        head = f"FoldCurves({len(self.curves)} folds along {self.parameter})"
        return "\n".join([head, *(f"  {c!r}" for c in self.curves)])


@validated
def fold_curves(
    system: Callable[..., AbstractSystem] | AbstractSystem,
    *,
    frequency_ratio: Range | None = None,
    frequency: Range | None = None,
    max_points: int = 400,
    **numbers: Any,
) -> FoldCurves:
    """Follow the folds of the response, the jump frequencies, in a second number.

    The branch is traced once; each of its folds is then followed both ways by solving for it anew
    (`fold_response`) from a prediction along its curve.

    Parameters:
        system: a function from named numbers to a system with linear stops.
        frequency_ratio, frequency: `vj.Range(low, high)` of the drive frequency (ratio or Hz) in
            which the first branch is traced.
        max_points: most points of a curve, which is followed both ways by turns.
        numbers: arguments of the function: one `vj.Range(low, high, start)`, that of the second
            number, with the value at which the branch is traced (the middle by default); the rest
            are fixed.

    Where the contacts of the fold change, or it becomes a corner at a touch, the branch is traced
    anew a little further on and the fold taken from there.

    Raises `ValueError` as `continue_response` does, for lists among the numbers, or stops that are
    not linear.
    """
    check_count("max_points", max_points, least=3)
    if isinstance(system, AbstractSystem) or not callable(system):
        raise ValueError(
            "fold_curves needs a function that makes the system from named numbers, got "
            f"{type(system).__name__}."
        )
    axis, swept = frequency_of(frequency_ratio, frequency)
    middle, is_ratio = (swept.low + swept.high) / 2, axis == "frequency_ratio"
    along = along_of(system, middle if is_ratio else None, None if is_ratio else middle, numbers)
    if along.axes:
        raise ValueError(
            f"{next(iter(along.axes))} is a list: fold_curves follows one number, the others are "
            "fixed."
        )
    begin = along.range.start
    if begin is None:
        begin = (along.range.low + along.range.high) / 2
    fixed = along.static | along.fixed

    def make(value: float) -> AbstractSystem:
        return system(**fixed, **{along.name: value})

    tracer = _Tracer(make, axis, swept, along.range, max_points)
    check_linear_stops("fold_curves", along.sample)
    compile_search(as_arrays(along.sample), is_ratio)
    branch = tracer.branch(begin)
    curves = []
    for point in branch.special_points:
        if point.kind != "fold" or point.initial_state is None:
            continue
        first = fold_response(make(begin), point, axis=axis)
        if not bool(first.found):
            continue
        turn = _turn(branch, point)
        points, endings = tracer.follow_both_ways(begin, first, turn)
        names = ("parameter", "amplitude_ratio", "contact_force")
        folds, *others = (np.array([float(getattr(f, n)) for _, f in points]) for n in names)
        curves.append(
            FoldCurve(
                np.array([value for value, _ in points]),
                folds,
                *others,
                endings=endings,
                parameter=along.name,
                axis=axis,
                ratio_units=branch.ratio_units,
            )
        )
    return FoldCurves(along.name, axis, tuple(curves), branch)


Points = list[tuple[float, Fold | SpecialPoint]]
"""Folds by the value of the second number."""


class _Tracer(NamedTuple):
    """Follows one fold at a time; knows how to make the system and to trace a branch of it."""

    make: Callable[[float], AbstractSystem]
    axis: str
    swept: Range
    over: Range
    max_points: int

    def branch(self, value: float) -> Branch:
        """Trace the branch at a value of the second number."""
        range_of: dict[str, Any] = {self.axis: self.swept}
        branch = continue_response(self.make(value), **range_of)
        assert isinstance(branch, Branch)
        return branch

    def follow_both_ways(
        self, begin: float, first: Fold, turn: int
    ) -> tuple[Points, tuple[str, str]]:
        """Follow one fold down and up by turns; its points, and how the curve ended at both."""
        down: Points = [(begin, first)]
        up = down[:]
        ways = self.follow(down, -1, turn), self.follow(up, 1, turn)
        endings = ["", ""]
        for k in cycle((0, 1)):
            if all(endings) or len(down) + len(up) > self.max_points:  # the first is of both
                break
            endings[k] = endings[k] or next(ways[k])
        low, high = (ending or "the points allowed did not suffice" for ending in endings)
        return [*down[:0:-1], *up], (low, high)

    def follow(self, points: Points, way: int, turn: int) -> Generator[str, None, None]:
        """Follow a fold from one point to an end of the range, and put the others behind that one.

        Yields before each of them, and last how the curve ended.
        """
        low, high = self.over.low, self.over.high
        width, end = high - low, high if way > 0 else low
        smooth, step = points[:], FIRST
        while (value := points[-1][0]) != end:
            yield ""
            following = value + way * step * width
            if way * (following - end) > -1e-9 * width:
                following = end
            if smooth:
                guess = _predicted(smooth, following)
                found = fold_response(self.make(following), guess, axis=self.axis)
                if bool(found.found) and _distance(found, guess) < NEAR:
                    points.append((following, found))
                    smooth = [*smooth[-2:], points[-1]]
                    step = min(1.6 * step, LONGEST)
                    continue
                step *= 0.4
                if step >= SHORTEST:
                    continue
            # Contacts change here, or the fold is a corner at a touch: look on a new branch.
            following = min(max(value + way * BRIDGE * width, low), high)
            guess = _predicted(points, following)
            branch = self.branch(following)
            folds = [
                p
                for p in branch.special_points
                if p.kind in TURNS
                and _turn(branch, p) == turn
                and _distance(p, guess) < BRIDGE_NEAR
            ]
            if not folds:
                yield "the fold ends here: beyond it no fold is near"
                return
            nearest = min(folds, key=lambda p: _distance(p, guess))
            points.append((following, nearest))
            smooth = [points[-1]] if nearest.kind == "fold" else []
            step = FIRST
        yield "end of the range"


def _distance(fold: Fold | SpecialPoint, guess: Fold) -> float:
    return abs(float(fold.parameter) / float(guess.parameter) - 1)


def _turn(branch: Branch, point: SpecialPoint) -> int:
    """1 where the parameter is largest at a fold, -1 where it is smallest."""
    near = branch.values[max(point.after - 1, 0) : point.after + 2]
    return 1 if branch.values[point.after] >= near.max() else -1


def _predicted(points: Points, value: float) -> Fold:
    """Guess the next fold along the line, or the parabola, through the last ones."""
    recent = [fold for _, fold in points[-3:]]
    weights = polynomial_weights(np.array([v for v, _ in points[-3:]]), value)

    def mixed(name: str) -> Any:
        return sum(w * np.asarray(getattr(f, name)) for w, f in zip(weights, recent, strict=True))

    corner = any(f.initial_state is None for f in recent)
    return Fold(
        parameter=mixed("parameter"),
        amplitude_ratio=jnp.asarray(recent[-1].amplitude_ratio),
        contact_force=jnp.asarray(recent[-1].contact_force),
        initial_state=jnp.zeros(0) if corner else mixed("initial_state"),
        found=jnp.asarray(True),
    )
