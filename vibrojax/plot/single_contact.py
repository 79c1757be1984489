"""Picture of the response with one contact per drive period."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import matplotlib
import numpy as np
from contourpy import contour_generator
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.plot.style import GREY, LABEL, label_of, new_picture, outside_legend
from vibrojax.steady.single_contact_points import Points

if TYPE_CHECKING:
    from vibrojax.steady.single_contact_result import SingleContactResponse

FOLD = "#b3123c"
UNSTABLE = (0, (4, 2))
CORRECTIONS = 3
"""Newton steps from an interpolated level set to the true one."""
LONGEST = 0.02
"""Longest straight piece of a level set, over the size of the picture."""
HALVINGS = 5
"""Rounds in which longer pieces are halved."""


def plot_single_contact(
    response: "SingleContactResponse", gap_ratios: Sequence[float] | None
) -> Figure:
    """Draw level sets of the gap ratio as amplitude against frequency, and the folds."""
    if min(response.gap_ratio.shape) < 2:
        raise ValueError(
            "A picture needs at least two frequencies and two contact fractions, got "
            f"{response.gap_ratio.shape[1]} and {response.gap_ratio.shape[0]}."
        )
    own = response.own_gap_ratio
    wanted = [own * k for k in (0.25, 0.5, 1.0, 2.0, 4.0)] if gap_ratios is None else gap_ratios
    levels = sorted({response._gap_ratio(float(v)) for v in wanted})
    surface = _Surface(response)
    curves = {level: surface.level(level) for level in levels}
    if gap_ratios is None:
        curves = {level: curve for level, curve in curves.items() if curve.drawn.any()}
    figure, axes = new_picture()
    # The bright yellow end is not legible on white.
    shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, max(len(curves), 1)))
    handles, labels, top = [], [], 0.0
    for shade, (level, curve) in zip(shades, curves.items(), strict=False):
        is_own = np.isclose(level, own)
        width = 2.8 if is_own else 1.7
        top = max(top, np.max(curve.amplitude, initial=0.0, where=curve.drawn))
        for stable, style in ((True, "-"), (False, UNSTABLE)):
            shown = curve.where(curve.stable == stable)
            axes.plot(curve.frequency, shown, color=shade, linestyle=style, linewidth=width)
        unit = "" if response.ratio_units == "1" else f" {response.ratio_units}"
        whose = " (this system)" if is_own else ""
        handles.append(Line2D([], [], color=shade, linewidth=width))
        labels.append(f"gap / drive {level:.4g}{unit}{whose}")
    axes.plot(
        response.frequencies, response.contact_free_amplitude_ratio, color=GREY, linewidth=1.0
    )
    folds = surface.folds()
    axes.plot(folds.frequency, folds.where(folds.drawn), color=FOLD, linestyle=":", linewidth=1.8)
    handles += [
        Line2D([], [], color=GREY, linewidth=1.0),
        Line2D([], [], color=GREY, linewidth=1.8),
        Line2D([], [], color=GREY, linewidth=1.8, linestyle=UNSTABLE),
        Line2D([], [], color=FOLD, linewidth=1.8, linestyle=":"),
    ]
    labels += ["no contact", "stable", "unstable", "folds"]
    axes.set_xlim(response.frequencies[0], response.frequencies[-1])
    axes.set_ylim(0.0, 1.08 * top if top else None)
    axes.set_xlabel(label_of(response.axis), fontsize=LABEL)
    axes.set_ylabel(label_of("amplitude_ratio", response.ratio_units), fontsize=LABEL)
    axes.set_title("One contact per drive period", fontsize=LABEL, loc="left")
    outside_legend(axes, handles, labels)
    return figure


class _Curve(NamedTuple):
    """Lines end to end, with a place that is not drawn between them."""

    frequency: np.ndarray
    amplitude: np.ndarray
    stable: np.ndarray
    drawn: np.ndarray

    def where(self, chosen: np.ndarray) -> np.ndarray:
        """Amplitudes of the chosen places and those that join them to the others."""
        beside = np.append(False, chosen[:-1]) & ~chosen
        return np.where((chosen | beside) & self.drawn, self.amplitude, np.nan)


class _Surface:
    """The gap ratio over (contact fraction, frequency), the touch as its first row."""

    def __init__(self, response: "SingleContactResponse"):
        self.response = response
        self.surface = response._surface()
        self.x, self.y = self.surface.frequencies, np.append(0.0, self.surface.fractions)

    def _lines(self, first, values, level: float) -> np.ndarray:
        """Places (contact fraction, frequency) of a level, a NaN between lines."""
        surface = np.ma.masked_invalid(np.concatenate([first[None], values]))
        places = [np.full((1, 2), np.nan)]
        for line in contour_generator(self.x, self.y, surface).lines(level):
            places += [np.asarray(line)[:, ::-1], np.full((1, 2), np.nan)]
        return np.concatenate(places)

    def _curve(self, places: np.ndarray, good: np.ndarray, points: Points) -> _Curve:
        inside = (self.x[0] <= places[:, 1]) & (places[:, 1] <= self.x[-1])
        drawn = good & inside & np.asarray(points.valid)
        return _Curve(
            places[:, 1], np.asarray(points.amplitude), np.asarray(points.multiplier) < 1, drawn
        )

    def _filled(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        good = np.asarray(np.isfinite(places).all(axis=1))
        least = 1e-2 * self.y[1], self.x[0]
        return good, np.maximum(np.where(good[:, None], places, least), least)

    def level(self, level: float) -> _Curve:
        """The level set of the gap ratio, corrected to where it truly is."""
        r = self.response
        touch = np.interp(self.x, r.frequencies, r.touch_gap_ratio)
        good, places = self._filled(self._lines(touch, self.surface.gap_ratio, level))
        places, on_level, points = self._corrected(places, level)
        # What stays between two lines is not drawn, so that they are not joined.
        kept = on_level | ~good
        places, good = places[kept], good[kept]
        points = Points(*(np.asarray(a)[kept] for a in points))
        reach = np.array([np.ptp(self.x), np.max(points.amplitude, initial=0.0, where=good)])
        reach = np.where(reach > 0, reach, 1.0)  # 0 where no motion of this level is there
        for _ in range(HALVINGS):
            shown = np.stack([places[:, 1], points.amplitude], axis=1) / reach
            far = np.linalg.norm(np.diff(shown, axis=0), axis=1) > LONGEST
            (at,) = np.nonzero(far & good[1:] & good[:-1])
            if not at.size:
                break
            between, on_level, more = self._corrected((places[at] + places[at + 1]) / 2, level)
            places = np.insert(places, at + 1, between, axis=0)
            good = np.insert(good, at + 1, on_level)
            points = Points(
                *(np.insert(a, at + 1, b, axis=0) for a, b in zip(points, more, strict=True))
            )
        return self._curve(places, good, points)

    def _corrected(self, places, level: float) -> tuple[np.ndarray, np.ndarray, Points]:
        """Newton steps to the level, the short way in units of cells; and which got there."""
        r = self.response
        cell = np.array([np.diff(self.y).mean(), np.diff(self.x).mean()])
        for _ in range(CORRECTIONS):
            points = r._evaluate(places)
            slope = points.slope * cell
            step = (level - points.gap_ratio)[:, None] * slope
            step = np.nan_to_num(step / np.sum(slope**2, axis=1, keepdims=True)) * cell
            places = np.maximum(places + np.clip(step, -cell, cell), 1e-3 * self.y[1])
        points = r._evaluate(places)
        size = level if level > 0 else np.max(r.touch_gap_ratio)
        return places, np.abs(points.gap_ratio - level) < 1e-4 * size, points

    def folds(self) -> _Curve:
        """Where the gap ratio does not change with the contact fraction, at every gap ratio."""
        slope = self.surface.slope
        good, places = self._filled(self._lines(slope[0], slope, 0.0))
        height, move = np.diff(self.y).mean(), np.zeros(len(places))
        for _ in range(CORRECTIONS):
            step = 1e-3 * places[:, 0]
            sides = [places + np.stack([k * step, 0 * step], axis=1) for k in (-1.0, 1.0)]
            low, high = (self.response._evaluate(side).slope[:, 0] for side in sides)
            move = np.nan_to_num(-(low + high) * step / np.where(high == low, np.inf, high - low))
            moved = places[:, 0] + np.clip(move, -height, height)
            places = np.stack([np.maximum(moved, 1e-2 * self.y[1]), places[:, 1]], axis=1)
        points = self.response._evaluate(places)
        good &= np.abs(move) < 0.1 * height
        return self._curve(places, good, points)
