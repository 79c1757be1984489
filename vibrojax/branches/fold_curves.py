"""Folds followed in a second number: the hysteresis region of a map as lines."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from vibrojax._tools.checks import check_count
from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.branches.along import along_of
from vibrojax.branches.branch import Branch
from vibrojax.branches.continue_response import continue_response
from vibrojax.branches.folds import Fold, fold_response
from vibrojax.branches.points import SpecialPoint
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.variables import axis_description, described_as

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

        names = {self.parameter: "values", self.axis: "folds"}
        data = {
            name: ("point", getattr(self, field), axis_description(name))
            for name, field in names.items()
        }
        for name in ("amplitude_ratio", "contact_force"):
            described = described_as(name, self.ratio_units)
            data[name] = ("point", getattr(self, name), described)
        attributes = {"title": "vibrojax fold curve", "parameter": self.parameter}
        attributes |= {"axis": self.axis}
        attributes |= dict(zip(("low_ending", "high_ending"), self.endings, strict=True))
        return xarray.Dataset(data, attrs=attributes)

    def plot(self) -> "Figure":
        """Draw the frequency of the fold against the second number."""
        from vibrojax.plot.branch import plot_fold_curves

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

        length = max((len(c.values) for c in self.curves), default=0)

        def padded(name: str) -> np.ndarray:
            rows = [getattr(c, name) for c in self.curves]
            out = np.full((len(rows), length), np.nan)
            for k, row in enumerate(rows):
                out[k, : len(row)] = row
            return out

        dims = ("fold", "point")
        data: dict[str, Any] = {
            self.parameter: (dims, padded("values"), axis_description(self.parameter)),
            self.axis: (dims, padded("folds"), axis_description(self.axis)),
            "amplitude_ratio": (
                dims,
                padded("amplitude_ratio"),
                described_as("amplitude_ratio", self.branch.ratio_units),
            ),
            "contact_force": (
                dims,
                padded("contact_force"),
                described_as("contact_force"),
            ),
        }
        return xarray.Dataset(data, attrs=dict(self.branch.attributes))

    def plot(self) -> "Figure":
        """Draw the fold frequencies against the second number.

        Raises `ValueError` when there is no fold.
        """
        if not self.curves:
            raise ValueError("There are no folds to draw.")
        from vibrojax.plot.branch import plot_fold_curves

        return plot_fold_curves([curve.to_xarray() for curve in self.curves])

    def __repr__(self) -> str:
        lines = [f"FoldCurves({len(self.curves)} folds along {self.parameter})"]
        for c in self.curves:
            lines.append(f"  {c!r}")
        return "\n".join(lines)


@validated
def fold_curves(
    system: Callable[..., AbstractSystem] | AbstractSystem,
    *,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    start: float | None = None,
    max_points: int = 400,
    **numbers: Any,
) -> FoldCurves:
    """Follow the folds of the response, the jump frequencies, in a second number.

    The branch is traced once, at `start`; each of its folds is then followed both ways by solving
    for it anew (`fold_response`) from a prediction along its curve.

    Parameters:
        system: a function from named numbers to a system with linear stops.
        frequency_ratio, frequency: the range of the drive frequency (ratio or Hz) in which the
            first branch is traced.
        start: value of the second number at which it is traced; the middle of its range by default.
        max_points: most points of a curve.
        numbers: arguments of the function: one tuple (low, high), the range of the second number;
            the rest are fixed.

    Where the contacts of the fold change, or it becomes a corner at a touch, the branch is traced
    anew a little further on and the fold taken from there.

    Raises `ValueError` as `continue_response` does, for lists among the numbers, a start outside
    the range, or stops that are not linear.
    """
    check_count("max_points", max_points, least=3)
    if isinstance(system, AbstractSystem) or not callable(system):
        raise ValueError(
            "fold_curves needs a function that makes the system from named numbers, got "
            f"{type(system).__name__}."
        )
    if (frequency_ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    axis = "frequency_ratio" if frequency_ratio is not None else "frequency"
    swept = frequency_ratio if frequency_ratio is not None else frequency
    if not isinstance(swept, tuple):
        raise ValueError(f"{axis} must be a range (low, high), got {in_short(swept)}.")
    middle = float(np.mean(swept))
    is_ratio = axis == "frequency_ratio"
    along = along_of(system, middle if is_ratio else None, None if is_ratio else middle, numbers)
    if along.axes:
        raise ValueError(
            f"{next(iter(along.axes))} is a list: fold_curves follows one number, the others are "
            "fixed."
        )
    begin = (along.low + along.high) / 2 if start is None else float(start)
    if not along.low <= begin <= along.high:
        raise ValueError(
            f"start must be from {along.low:g} to {along.high:g}, the range of {along.name}, got "
            f"{begin:g}."
        )
    fixed = along.static | along.fixed

    def make(value: float) -> AbstractSystem:
        return system(**fixed, **{along.name: value})

    range_of: dict[str, Any] = {axis: swept}
    branch = continue_response(make(begin), **range_of)
    assert isinstance(branch, Branch)
    tracer = _Tracer(make, along.name, axis, swept, along.low, along.high, max_points)
    curves = []
    for point in branch.special_points:
        if point.kind != "fold" or point.initial_state is None:
            continue
        first = fold_response(make(begin), point, axis=axis)
        if bool(first.found):
            curves.append(tracer.both_ways(begin, first, _turn(branch, point)))
    return FoldCurves(along.name, axis, tuple(curves), branch)


class _Tracer:
    """Follows one fold at a time; knows how to make the system and to trace a branch of it."""

    def __init__(self, make, parameter, axis, swept, low, high, max_points):
        self.make, self.parameter, self.axis, self.swept = make, parameter, axis, swept
        self.low, self.high, self.max_points = low, high, max_points

    def both_ways(self, begin: float, first: Fold, turn: int) -> FoldCurve:
        down, why_down = self.follow(begin, first, -1, turn)
        up, why_up = self.follow(begin, first, 1, turn)
        points = [*down[::-1], (begin, first), *up]
        return FoldCurve(
            values=np.array([v for v, _ in points]),
            folds=np.array([float(f.parameter) for _, f in points]),
            amplitude_ratio=np.array([float(f.amplitude_ratio) for _, f in points]),
            contact_force=np.array([float(f.contact_force) for _, f in points]),
            endings=(why_down, why_up),
            parameter=self.parameter,
            axis=self.axis,
            ratio_units=str(self.make(begin).drive.reference[1]),
        )

    def follow(self, begin: float, first: Fold, way: int, turn: int):
        """Follow one fold from its start to an end of the range; points, and how it ended."""
        width = self.high - self.low
        end = self.high if way > 0 else self.low
        points: list[tuple[float, Fold | SpecialPoint]] = [(begin, first)]
        smooth, step = points[:], FIRST
        while len(points) <= self.max_points:
            value = points[-1][0]
            if value == end:
                return points[1:], "end of the range"
            following = value + way * step * width
            if way * (following - end) > -1e-9 * width:
                following = end
            if smooth:
                guess = _predicted(smooth, following)
                found = fold_response(self.make(following), guess, axis=self.axis)
                if bool(found.found) and self.close(found, guess):
                    points.append((following, found))
                    smooth = [*smooth[-2:], points[-1]]
                    step = min(1.6 * step, LONGEST)
                    continue
                step *= 0.4
                if step >= SHORTEST:
                    continue
            # Contacts change here, or the fold is a corner at a touch: look on a new branch.
            following = value + way * BRIDGE * width
            following = min(max(following, self.low), self.high)
            guess = _predicted(points, following)
            bridged = self.on_branch(following, guess, turn)
            if bridged is None:
                return points[1:], "the fold ends here: beyond it no fold is near"
            points.append((following, bridged))
            smooth = [points[-1]] if bridged.initial_state is not None else []
            step = FIRST
        return points[1:], "the points allowed did not suffice"

    def close(self, found: Fold, guess: Fold) -> bool:
        return abs(float(found.parameter) - float(guess.parameter)) < NEAR * float(guess.parameter)

    def on_branch(self, value: float, guess: Fold, turn: int) -> SpecialPoint | None:
        """Find the fold of the same turn nearest to the guess on the branch at this value."""
        range_of: dict[str, Any] = {self.axis: self.swept}
        branch = continue_response(self.make(value), **range_of)
        assert isinstance(branch, Branch)
        wanted = float(guess.parameter)
        folds = [p for p in branch.special_points if p.kind == "fold" and _turn(branch, p) == turn]
        folds = [p for p in folds if abs(p.parameter - wanted) < BRIDGE_NEAR * wanted]
        return min(folds, key=lambda p: abs(p.parameter - wanted), default=None)


def _turn(branch: Branch, point: SpecialPoint) -> int:
    """1 where the parameter is largest at a fold, -1 where it is smallest."""
    near = branch.values[max(point.after - 1, 0) : point.after + 2]
    return 1 if branch.values[point.after] >= near.max() else -1


def _predicted(points: list[tuple[float, Fold | SpecialPoint]], value: float) -> Fold:
    """Guess the next fold along the line, or the parabola, through the last ones."""
    recent = points[-3:]
    nodes = [v for v, _ in recent]
    weights = [float(np.prod([(value - b) / (a - b) for b in nodes if b != a])) for a in nodes]

    def mixed(name: str) -> Any:
        parts = zip(weights, recent, strict=True)
        return sum(w * np.asarray(getattr(f, name)) for w, (_, f) in parts)

    last = recent[-1][1]
    corner = any(f.initial_state is None for _, f in recent)
    return Fold(
        parameter=mixed("parameter"),
        amplitude_ratio=jnp.asarray(last.amplitude_ratio),
        contact_force=jnp.asarray(last.contact_force),
        initial_state=jnp.zeros(0) if corner else mixed("initial_state"),
        found=jnp.asarray(True),
    )


if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure
