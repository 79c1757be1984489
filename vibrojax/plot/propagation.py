"""Pictures of scatter that is propagated: samples of every measure, and whose scatter it is."""

from typing import Any

import numpy as np
import scipy.stats
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.plot.style import (
    COLORS,
    DASHES,
    SIZE,
    SMALL,
    balanced,
    dress,
    empty_picture,
    name_axes,
    outside_legend,
)
from vibrojax.results.variables import PLAIN, with_unit

MOST_MEASURES = 6
HEIGHT = 2.7
"""Of the panels of a measure, inches."""
ROW = 0.24
"""What a bar takes of it, inches."""
SHARES = (
    ("share", "share of first order, by gradients", COLORS["blue"], None),
    ("sobol_first", "Sobol index, alone (95 %)", COLORS["amber"], "sobol_first_confidence"),
    ("sobol_total", "Sobol index, with others (95 %)", COLORS["green"], "sobol_total_confidence"),
)
"""Variable, words, colour, and the half width of its interval."""
BARS: dict[str, Any] = {"color": COLORS["sky"], "alpha": 0.55, "edgecolor": "white"}
NORMAL: dict[str, Any] = {
    "color": COLORS["black"],
    "linewidth": 1.8,
    "label": "normal curve of first order",
}
ENDS: dict[str, Any] = {"color": COLORS["orange"], "linestyle": DASHES, "linewidth": 1.5}


def plot_propagation(data: xarray.Dataset) -> Figure:
    """Draw the measures (up to six) of rigs whose numbers scatter.

    Left the histogram of the samples, with the normal curve of first order over it; right the
    shares of the numbers in the variance.
    """
    shown = data.isel(measure=slice(MOST_MEASURES))
    kinds = [kind for kind in SHARES if kind[0] in data]
    height = max(HEIGHT, 1.2 + ROW * len(kinds) * data.sizes["number"])
    figure = empty_picture((SIZE[0] + 2.0, 1.0 + height * shown.sizes["measure"]))
    panels = figure.subplots(shown.sizes["measure"], 2, squeeze=False, width_ratios=[1.7, 1.0])
    for (left, right), k in zip(panels, range(shown.sizes["measure"]), strict=True):
        one = shown.isel(measure=k)
        _samples(left, one)
        _shares(right, one, kinds)
    if shown.sizes["measure"] < data.sizes["measure"]:
        words = f"{MOST_MEASURES} of {data.sizes['measure']} measures"
        figure.suptitle(words, fontsize=SMALL, x=0.01, ha="left")
    name_axes(panels[-1, 1], "Share of the variance")
    return outside_legend(figure)


def _samples(axes: Axes, one: xarray.Dataset) -> None:
    """Draw the histogram of one measure, first order over it, and its quantiles."""
    dress(axes)
    name = str(one["measure"].item()).replace("_", " ")
    units = str(one["measure_units"].item())
    label = with_unit(name[:1].upper() + name[1:], units)
    values = one["values"].values
    kept = values[np.isfinite(values)]
    lost = len(values) - len(kept)
    title = f"{lost} of {len(values)} rigs have no value" if lost else None
    per = "1" if units in PLAIN else f"1/{units}"
    name_axes(axes, balanced(label, 70), with_unit("Density", per), title)
    if not kept.size:
        axes.set_yticks([])
        return
    span = np.ptp(kept) or abs(kept[0]) or 1.0
    ends = (kept.min(), kept.max()) if np.ptp(kept) else (kept[0] - span / 20, kept[0] + span / 20)
    count = int(np.clip(2 * np.sqrt(kept.size), 8, 60))
    axes.hist(kept, bins=count, range=ends, density=True, label="sampled rigs", **BARS)
    top = axes.get_ylim()[1]
    middle, deviation = one["value"].item(), one["first_order_deviation"].item()
    if np.isfinite(middle):
        if np.isfinite(deviation) and deviation > 1e-3 * span:
            low, high = min(ends[0], middle - 3.5 * deviation), middle + 3.5 * deviation
            x = np.linspace(low, max(ends[1], high), 400)
            density = scipy.stats.norm.pdf(x, middle, deviation)
            axes.plot(x, density, **NORMAL)
            top = max(top, 1.05 * density.max())
        words = "at the means"
        axes.axvline(middle, color=COLORS["black"], linestyle=":", linewidth=1.5, label=words)
    axes.set_ylim(0.0, top)
    for k, where in enumerate(one["quantiles"].values[[0, -1]]):
        axes.axvline(where, label=None if k else "5 and 95 % of the samples", **ENDS)


def _shares(axes: Axes, one: xarray.Dataset, kinds: list[Any]) -> None:
    """Draw bars of the shares of the numbers, the first number on top."""
    dress(axes)
    names = [str(name).replace("_", " ") for name in one["number"].values]
    places = np.arange(len(names), dtype=float)
    thick = min(0.8 / len(kinds), 0.45)
    for k, (name, words, color, confidence) in enumerate(kinds):
        half = None if confidence is None else one[confidence].values
        axes.barh(
            places + (k - (len(kinds) - 1) / 2) * thick,
            one[name].values,
            xerr=half,
            height=0.9 * thick,
            color=color,
            label=words,
            error_kw={"elinewidth": 1.2, "capsize": 3, "ecolor": COLORS["dark"]},
        )
    axes.set_yticks(places, names, fontsize=SMALL)
    axes.set_ylim(len(names) - 0.45, -0.55)
    axes.set_xlim(0.0, max(1.0, axes.get_xlim()[1]))
