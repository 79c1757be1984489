"""Pictures of the three designs, from the files that run.py writes: maps and curves."""

import json
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from problems import BAND, DRIVE, LARGEST, MOST_FORCE, PROBLEMS

from vibrojax.plot.style import COLORS, LABEL, SMALL

sys.path.insert(0, str(Path(__file__).parents[1]))
import common

matplotlib.use("Agg")

HERE = Path(__file__).parent
AXES = {
    "gap": (1e3, "Gap (mm)"),
    "stiffness": (1e-3, "Stiffness of the stop (kN/m)"),
    "resistance": (1e-3, "Load resistance (kOhm)"),
}
"""How numbers of a rig are drawn: by what they are multiplied, and their name."""
VALUES = {
    "band": "Half-power bandwidth (frequency ratio)",
    "quiet": "Largest contact force (N)",
    "power": "Mean power over 40 to 60 Hz (mW)",
}
BOUNDED = {"band": "contact force (N)", "quiet": "amplitude of the tip (mm)"}
RIGS = {"first": (COLORS["orange"], 1.6), "best": (COLORS["blue"], 2.4)}
WORDS = {"first": "middle of the bounds", "best": "best design"}


def draw(name: str) -> None:
    """Draw the map and the curves of a problem, where they have been computed."""
    path = HERE / "results" / f"drawn_{name}.json"
    if not path.exists():
        return
    data = json.loads(path.read_text())
    found = json.loads((HERE / "results" / f"{name}.json").read_text())
    _map(name, data["map"], found).savefig(HERE / "pictures" / f"map_{name}.png", dpi=110)
    _curves(name, data, found).savefig(HERE / "pictures" / f"curves_{name}.png", dpi=110)


def _map(name: str, data: dict[str, Any], found: dict[str, Any]) -> Figure:
    problem = PROBLEMS[name]
    (x, (by_x, x_label)), (y, (by_y, y_label)) = ((n, AXES[n]) for n in problem.map_axes)
    horizontal, vertical = by_x * np.array(data[x]), by_y * np.array(data[y])
    value, bounded = (np.array(data[key]).T for key in ("value", "constraint"))
    figure = Figure(figsize=(8.4, 6), layout="constrained")
    axes = figure.subplots()
    levels = matplotlib.ticker.MaxNLocator(14).tick_values(value.min(), value.max())
    colors = "viridis" if problem.maximise else "viridis_r"
    filled = axes.contourf(horizontal, vertical, value, levels, cmap=colors)
    lines = axes.contour(horizontal, vertical, value, levels, colors="white", linewidths=0.5)
    axes.clabel(lines, lines.levels[::2], fontsize=SMALL - 2, fmt="%g")
    bar = figure.colorbar(filled, ax=axes)
    bar.set_label(VALUES[name], fontsize=LABEL)
    handles: list[Any] = []
    if name in BOUNDED and bounded.max() > problem.most:
        style = {"colors": COLORS["red"], "linewidths": 2.2}
        axes.contour(horizontal, vertical, bounded, [problem.most], **style)
        above = [problem.most, max(bounded.max(), 1.01 * problem.most)]
        axes.contourf(horizontal, vertical, bounded, above, colors="none", hatches=["//"])
        words = f"{BOUNDED[name]} above {problem.most:g}"
        handles.append(Patch(fc="white", ec=COLORS["red"], hatch="///", label=words))
    grid = np.meshgrid(horizontal, vertical)
    axes.plot(*grid, ".", color="black", markersize=1.5, alpha=0.5)
    place = by_x * found["numbers"][x], by_y * found["numbers"][y]
    star = {"color": "white", "markeredgecolor": "black", "ls": "none", "clip_on": False}
    axes.plot(*place, "*", markersize=19, zorder=6, **star)
    best = by_x * data["best"][x], by_y * data["best"][y]
    square = {"mfc": "none", "mec": "black", "mew": 1.8, "ls": "none", "clip_on": False}
    axes.plot(*best, "s", markersize=15, zorder=5, **square)
    handles += [
        Line2D([], [], marker="*", markersize=15, label="vj.optimise", **star),
        Line2D([], [], marker="s", markersize=11, label="best rig of the map", **square),
        Line2D([], [], marker=".", color="black", markersize=3, ls="none", label="rigs of the map"),
    ]
    axes.set(xscale="log", yscale="log")
    axes.tick_params(pad=9)
    for axis, ticks in ((axes.xaxis, horizontal), (axes.yaxis, vertical)):
        _ticks(axis, ticks[0], ticks[-1])
    axes.set_xlabel(x_label, fontsize=LABEL)
    axes.set_ylabel(y_label, fontsize=LABEL)
    figure.legend(handles=handles, loc="outside upper left", ncols=2, fontsize=SMALL, frameon=False)
    return figure


def _ticks(axis: Any, low: float, high: float) -> None:
    """Put plain numbers on a logarithmic axis."""
    steps = np.outer(10.0 ** np.arange(-3, 5), (1, 1.5, 2, 3, 5, 7)).ravel()
    shown = [s for s in steps if low * 0.999 <= s <= high * 1.001]
    axis.set_ticks(shown, [f"{s:g}" for s in shown])
    axis.set_ticks([], minor=True)


def _curves(name: str, data: dict[str, Any], found: dict[str, Any]) -> Figure:
    panels = {
        "band": (("amplitude_ratio", 1.0, "Tip amplitude over that of the base"),),
        "quiet": (("amplitude_ratio", 1e3 * DRIVE, "Tip amplitude (mm)"),),
        "power": (("mean_power", 1e3, "Mean power (mW)"),),
    }[name] + (("contact_force", 1.0, "Largest contact force (N)"),)
    figure = Figure(figsize=(9, 7.2), layout="constrained")
    both = figure.subplots(2, 1, sharex=True)
    for axes, (variable, unit, label) in zip(both, panels, strict=True):
        for rig, (color, width) in RIGS.items():
            curve = data[rig]
            x, y, stable = (np.array(curve[k]) for k in ("x", variable, "stable"))
            _draw(axes, x, unit * y, stable, color, width)
            if name == "band" and variable == "amplitude_ratio":
                _band(axes, x, y, stable, color)
            if variable == "mean_power":
                mean = found["value"] if rig == "best" else found["first_value"]
                axes.hlines(mean, *BAND, color=color, lw=1.2, ls=":")
        common.finish(axes)
        axes.set_ylabel(label, fontsize=LABEL)
        axes.set_ylim(bottom=0)
    limit = {"band": (both[1], MOST_FORCE, "2 N allowed")}
    limit["quiet"] = (both[0], 1e3 * LARGEST, "5 mm allowed")
    if name in limit:
        axes, height, words = limit[name]
        axes.set_ylim(top=max(axes.get_ylim()[1], 1.12 * height))
        axes.axhline(height, color=COLORS["red"], lw=1.4, ls=(0, (1.5, 1.5)))
        axes.annotate(
            words,
            (0.22, height),
            xycoords=("axes fraction", "data"),
            xytext=(-4, 5),
            textcoords="offset points",
            ha="right",
            fontsize=SMALL,
            color=COLORS["red"],
        )
    unit = "Frequency ratio" if name == "band" else "Drive frequency (Hz)"
    both[1].set_xlabel(unit, fontsize=LABEL)
    handles = [
        Line2D([], [], color=color, lw=width, label=WORDS[rig])
        for rig, (color, width) in RIGS.items()
    ]
    if not all(all(data[rig]["stable"]) for rig in RIGS):
        handles.append(Line2D([], [], color="0.35", lw=1.6, ls=common.DASHES, label="unstable"))
    if name == "band":
        handles.append(Line2D([], [], color="0.35", lw=5, alpha=0.4, label="half-power band"))
    if name == "power":
        handles.append(Line2D([], [], color="0.35", lw=1.2, ls=":", label="mean over the band"))
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=SMALL)
    return figure


def _draw(axes: Any, x: Any, y: Any, stable: Any, color: str, width: float) -> None:
    """Draw a branch, what is unstable dashed."""
    changes = np.flatnonzero(np.diff(stable.astype(int))) + 1
    for start, stop in zip([0, *changes], [*changes, len(x)], strict=True):
        part = slice(max(start - (not stable[start]), 0), stop + (not stable[start]))
        style = {"lw": width, "ls": "-"} if stable[start] else {"lw": 1.3, "ls": common.DASHES}
        axes.plot(x[part], y[part], color=color, **style)


def _band(axes: Any, x: Any, y: Any, stable: Any, color: str) -> None:
    """Mark where stable motions are above the root of half of their peak's square."""
    level = y[stable].max() / np.sqrt(2.0)
    grid = np.linspace(x.min(), x.max(), 4001)
    above = np.zeros(len(grid), bool)
    for k in np.flatnonzero(stable[1:] & stable[:-1]):
        low, high = sorted(x[k : k + 2])
        inside = (grid >= low) & (grid <= high)
        order = np.argsort(x[k : k + 2])
        above[inside] |= np.interp(grid[inside], x[k : k + 2][order], y[k : k + 2][order]) >= level
    axes.plot(grid, np.where(above, level, np.nan), color=color, lw=6, alpha=0.4)
