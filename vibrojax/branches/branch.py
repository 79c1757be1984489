"""A branch of periodic responses: the result of a continuation."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_known
from vibrojax._tools.signatures import validated
from vibrojax.branches.comparing import compare
from vibrojax.branches.points import CURVES, BranchPoints
from vibrojax.branches.resampling import resample
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.branches.switching import switch_branch
from vibrojax.results.axes import coordinates_of, place_of
from vibrojax.results.saving import AbstractSaved
from vibrojax.sweep.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


ENDINGS = {
    "status": "How the branch ended",
    "sentence": "How the branch ended, in words",
    "ticks": "Motions solved for",
}
"""What a dataset of several branches says of each."""


class Branch(BranchPoints, AbstractSaved):
    """Periodic responses of one system along a branch, stable and unstable, in order of arclength.

    Arrays have the shape (points,). Ratios are over the drive amplitude; displacements are those
    that the system reports (the tip), relative to the base.
    """

    @classmethod
    def of(cls, points: BranchPoints) -> "Branch":
        """Make a branch of its points."""
        own: dict[str, Any] = {field.name: getattr(points, field.name) for field in fields(points)}
        own["isolas"] = tuple(map(cls.of, points.isolas))
        return cls(**own)

    @validated
    def resample(self, values: ArrayLike | Sequence[Any]) -> "xarray.Dataset":
        """Return the responses at given values of the parameter, solved there anew.

        Dimensions are the parameter and `crossing`: a branch with folds passes a value several
        times, counted along the branch; NaN where it does not. Raises `ValueError` for values that
        are not finite.
        """
        return resample(self, values)

    @validated
    def switch(self, number: int = 0, settings: ContinuationSettings | None = None) -> "Branch":
        """Follow the branch of twice the period that leaves at a period doubling.

        `number` counts `period_doublings`; of the settings `max_points` and `longest_step` count,
        the rest is as on this branch. Raises `ValueError` where there is no such point, and where
        no motion is found next to it: one has more than 64 contacts, or breaks its own at once.
        """
        return Branch.of(switch_branch(self, number, settings or ContinuationSettings()))

    @validated
    def compare(self, sweep: FrequencyResponse) -> "xarray.Dataset":
        """Return how far the settled points of a sweep of the same system are from the branch.

        `relative_difference` of every point of the period of the branch, over (direction,
        frequency): the least over the passages of the branch, and of its isolas where they were
        looked for, of the largest change of amplitude, rms and contact force; NaN for points of
        other periods and outside of the range. `on_branch` is 1 where it is 1e-6 or less, 0 where
        it is more (the point is of an isola that is not known, or one of the two is wrong), -1
        where it is not known. Raises `ValueError` for a branch along another number than the
        frequency axis of the sweep, or a sweep of several systems.
        """
        return compare(self, sweep)

    @validated
    def plot(
        self,
        variable: str = "amplitude_ratio",
        *,
        sweep: FrequencyResponse | None = None,
        band: "xarray.Dataset | None" = None,
    ) -> "Figure":
        """Draw one variable against the parameter: stable solid, unstable dashed, points marked.

        Isolas that were found are drawn too. `sweep`, a `FrequencyResponse`, is laid over it; with
        `band`, of `vj.design.band`, what tolerances may make of the curve is shaded. Raises
        `ValueError` for an unknown variable, a sweep along another number or of several systems, or
        a band along another number or without the variable.
        """
        if band is not None and (
            getattr(band, "attrs", {}).get("axis") != self.axis or f"{variable}_change" not in band
        ):
            raise ValueError(
                f"band must be one of vj.design.band along {self.axis} that has {variable}."
            )
        return _picture([self, *map(Branch.of, self.isolas)], variable, sweep, band)


def _picture(
    branches: Sequence[Branch],
    variable: str,
    sweep: FrequencyResponse | None = None,
    band: "xarray.Dataset | None" = None,
) -> "Figure":
    known = (*CURVES, *branches[0].derived)
    check_known("variable", variable, known)
    drawn = [b.to_xarray() for b in branches if len(b.values)]
    if not drawn:
        raise ValueError("None of the branches has a point to draw.")
    laid = None if sweep is None else sweep.to_xarray()
    if laid is not None and variable not in laid:
        raise ValueError(f"A sweep has no {variable}: draw the branch without it.")
    if sweep is not None and sweep.axis != branches[0].axis:
        raise ValueError(
            f"sweep must be along {branches[0].axis}, as the branch is, got one along {sweep.axis}."
        )
    if sweep is not None and any(len(values) > 1 for values in sweep.axes.values()):
        raise ValueError("sweep must be of one system: pick one value of every axis.")
    from vibrojax.plot.branches import plot_branches

    return plot_branches(drawn, variable, laid, band)


class Branches(eqx.Module):
    """The branches of a continuation over further axes: one `Branch` per combination."""

    axes: dict[str, np.ndarray]
    """Values of the axes of the call, by name; numbers that go together as a structured array."""
    branches: tuple[Branch, ...]
    """In the order of the crossed axes, the last one running fastest."""

    def __len__(self) -> int:
        return len(self.branches)

    def __getitem__(self, index: int) -> Branch:
        return self.branches[index]

    def __iter__(self) -> Iterator[Branch]:
        return iter(self.branches)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return tuple(len(v) for v in self.axes.values())

    @validated
    def sel(self, **labels: float) -> Branch:
        """Return the branch nearest to a value of every axis: `labels`, by name.

        Raises `ValueError` for an axis that is unknown or left out.
        """
        return self.branches[int(np.ravel_multi_index(place_of(self.axes, labels), self.shape))]

    @property
    def status(self) -> np.ndarray:
        """Status of every branch, over the axes."""
        return np.array([b.status for b in self.branches]).reshape(self.shape)

    def to_xarray(self) -> "xarray.Dataset":
        """Return one dataset over the axes and `point`, branches filled up with NaN."""
        import xarray

        parts = [b.to_xarray().drop_vars(list(b.labels)) for b in self.branches]
        axis = self.branches[0].axis
        parts = [p.reset_coords([axis, "arclength"]) for p in parts]
        # Numbered points, so that shorter branches are filled up with NaN.
        parts = [p.assign_coords({d: np.arange(p.sizes[d]) for d in p.dims}) for p in parts]
        stacked = xarray.concat(parts, "lane", join="outer", combine_attrs="drop_conflicts")
        for name, words in ENDINGS.items():
            about = {"units": "1", "long_name": words}
            stacked[name] = ("lane", [getattr(b, name) for b in self.branches], about)
        for name in parts[0].dims:
            words = f"{str(name).replace('_', ' ').capitalize()}, from 0"
            stacked[name].attrs |= {"units": "1", "long_name": words}
        names = list(self.axes)
        grid = np.indices(self.shape).reshape(len(names), -1)
        stacked = stacked.assign_coords(
            {n: ("lane", at) for n, at in zip(names, grid, strict=True)}
        )
        over_axes = (
            stacked.set_index(lane=names).unstack("lane")
            if len(names) > 1
            else stacked.swap_dims(lane=names[0])
        )
        return over_axes.drop_vars(names).assign_coords(coordinates_of(self.axes))

    @validated
    def plot(self, variable: str = "amplitude_ratio") -> "Figure":
        """Draw all branches in one picture, one colour each.

        `variable` is a name of a curve, such as `contact_force`. Raises `ValueError` for
        another, or when there is nothing to draw.
        """
        return _picture(self.branches, variable)

    def __repr__(self) -> str:
        shape = ", ".join(f"{name}: {len(v)}" for name, v in self.axes.items())
        tally = Counter(b.status for b in self.branches)
        counts = ", ".join(f"{n} {status}" for status, n in tally.items())
        points = sum(len(b.values) for b in self.branches)
        return f"Branches({shape}): {points} points; {counts}"
