"""Pictures of contact laws beside each other: force records, and how well each law does."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray
from matplotlib.figure import Figure

from vibrojax.plot.style import COLORS, LINE_STYLES, SERIES, SIZE, dress, empty_picture, name_axes

MOST_RECORDS = 5


def plot_laws(laws: xarray.Dataset, predictions: Mapping[str, Sequence[xarray.Dataset]]) -> Figure:
    """Draw the force of every record (up to five) with each law, and how the laws differ."""
    names = [str(name) for name in laws["law"].values]
    count = len(predictions[names[0]])
    records = min(count, MOST_RECORDS)
    figure = empty_picture((SIZE[0] + 3.0, max(SIZE[1], 1.2 + 1.7 * records)))
    grid = figure.add_gridspec(records, 2, width_ratios=[2.2, 1.0])
    panels = [figure.add_subplot(grid[k, 0]) for k in range(records)]
    labels = laws["record"].values if "record" in laws else [""]
    for k, axes in enumerate(panels):
        dress(axes)
        for j, name in enumerate(names):
            data = predictions[name][k]
            own = data["channel"].values == "contact_force"
            time = data["measured_time"].values[own]
            if j == 0:
                measured = data["measured_value"].values[own]
                axes.plot(
                    time, measured, ".", color=COLORS["black"], markersize=5, label="measured"
                )
            fitted = data["fitted_value"].values[own]
            style = LINE_STYLES[j % len(LINE_STYLES)]
            color = SERIES[j % len(SERIES)]
            axes.plot(
                time, fitted, linestyle=style, color=color, linewidth=1.5, label=in_words(name)
            )
        name_axes(axes, None, "Force (N)", str(labels[k]) or None)
    name_axes(panels[-1], "Time (s)" + f", {records} of {count} records" * (records < count))
    handles, words = panels[0].get_legend_handles_labels()
    figure.legend(handles, words, loc="outside upper left", ncols=min(len(words), 6), frameon=False)
    beside = figure.add_subplot(grid[:, 1])
    _judge(beside, laws, names)
    return figure


def in_words(name: str) -> str:
    """Return the name of a law as a person writes it."""
    return {
        "kelvin_voigt": "Kelvin-Voigt",
        "hunt_crossley": "Hunt-Crossley",
        "hertz": "Hertz",
    }.get(name, name.replace("_", " "))


def _judge(axes, laws: xarray.Dataset, names: list[str]) -> None:
    """Draw what each law foretells of records left out, or its criterion; the least is best."""
    dress(axes)
    places = np.arange(len(names))[::-1]
    colors = [SERIES[k % len(SERIES)] for k in range(len(names))]
    if "foretold" in laws:
        values, label = laws["foretold"], "Mean square of residuals of\nrecords left out (1: noise)"
        axes.barh(places, values.mean("record"), height=0.6, color=colors, alpha=0.45)
        each = values.transpose("record", "law").values
        axes.plot(each.T, np.tile(places[:, None], len(each)), "o", color="black", markersize=4)
        axes.set_xlim(left=0.0)
        axes.axvline(1.0, color=COLORS["grey"], linestyle=":")
    else:
        label = "Akaike's criterion above its least"
        axes.barh(places, laws["akaike"], height=0.6, color=colors, alpha=0.45)
    axes.set_yticks(places, [in_words(name) for name in names])
    name_axes(axes, label)
