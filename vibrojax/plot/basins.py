"""Picture of basins: the attractor of every start, in colours that the colour-blind can tell."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from vibrojax.plot.style import LABEL, SMALL, new_picture, outside_legend
from vibrojax.results.variables import named_value

if TYPE_CHECKING:
    from vibrojax.regime.basins_result import Basins

COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#f0e442", "#d55e00")
"""Of periodic attractors by share. Source: Okabe and Ito 2008."""
OTHER, WILD, TAME, DIVERGED = "#ffffff", "#4d4d4d", "#b3b3b3", "#000000"


def plot_basins(basins: "Basins", **selection: Any) -> Figure:
    """Draw the basins at one combination of the other axes; see `Basins.plot`."""
    index, chosen = basins.place_of(selection)
    number = basins.attractor[index]
    share, error = basins.share[index], basins.standard_error[index]
    names, places = list(basins.starts), list(basins.starts.values())
    shades = [DIVERGED]
    handles, labels, others = [], [], 0.0
    periodic = iter(COLORS)
    for k, part in enumerate(share):
        period = int(basins.period[(*index, k)])
        if period == 0:
            color = WILD if basins.cross_well[(*index, k)] else TAME
        else:
            color = next(periodic, OTHER)
        shades.append(color)
        if part == 0:
            continue
        if color == OTHER:
            others += float(part)
            continue
        handles.append(Patch(facecolor=color, edgecolor="black", linewidth=0.5))
        words = basins.name_of(k + 1, index)
        labels.append(f"{words}: {100 * part:.1f} ± {100 * error[k]:.1f} %")
    if others:
        handles.append(Patch(facecolor=OTHER, edgecolor="black", linewidth=0.5))
        labels.append(f"further attractors: {100 * others:.1f} %")
    lost = float(np.mean(number == 0))
    if lost:
        handles.append(Patch(facecolor=DIVERGED))
        labels.append(f"diverged: {100 * lost:.1f} %")
    figure, axes = new_picture()
    axes.grid(False)
    colors = ListedColormap(shades)
    limits: dict[str, Any] = {"vmin": -0.5, "vmax": len(shades) - 0.5}
    if basins.sampling == "grid":
        edges = [_edges(np.asarray(place, float)) for place in places]
        axes.pcolormesh(*edges, number.T, cmap=colors, rasterized=True, **limits)
    else:
        size = float(np.clip(3000 / max(number.size, 1), 4, 40))
        style = {"s": size, "edgecolors": "black", "linewidths": 0.2}
        axes.scatter(*places, c=number, cmap=colors, **style, **limits)
    told = [f"{n.replace('_', ' ')} ({u})" if (u := basins.units.get(n)) else n for n in names]
    axes.set_xlabel(told[0], fontsize=LABEL)
    axes.set_ylabel(told[1], fontsize=LABEL)
    if chosen:
        title = ", ".join(named_value(name, value) for name, value in chosen.items())
        axes.set_title(title, fontsize=SMALL, loc="left")
    outside_legend(axes, handles, labels)
    return figure


def _edges(middles: np.ndarray) -> np.ndarray:
    """Ends of the cells, half way between neighbours."""
    if len(middles) == 1:
        return middles[0] + np.array([-0.5, 0.5])
    inner = (middles[1:] + middles[:-1]) / 2
    ends = 2 * middles[0] - inner[0], 2 * middles[-1] - inner[-1]
    return np.concatenate([ends[:1], inner, ends[1:]])
