"""A map on one page: what was run, its main measures, and what moves the first of them most."""

import textwrap

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import MaxNLocator

from vibrojax.plot.map_axes import (
    FREQUENCIES,
    MapAxis,
    check_map,
    measures_of,
    parameters_of,
    read_axes,
)
from vibrojax.plot.map_drawing import (
    draw_cells,
    flags_of,
    scale_axes,
    shades_of,
    with_regimes,
)
from vibrojax.plot.style import (
    COLORS,
    LABEL,
    SMALL,
    chosen_in,
    dress,
    empty_picture,
    fixed_names,
    label_for,
    name_axes,
    outside_legend,
)
from vibrojax.results.axes import coordinates_along

PAGE = (11.69, 8.27)  # inches, A4
MEASURES = (
    ("peak_amplitude_ratio",),
    ("resonance_shift", "peak_frequency"),
    ("largest_contact_force",),
    ("hysteresis_width", "jump_down"),
)
"""What is drawn of a map, the first present of each group."""
MOST_MAPS = 4
UPPER = 3
"""Of them in the upper row."""
MOST_EFFECTS = 3
BLUE, ORANGE = COLORS["blue"], COLORS["orange"]
BAND = (10, 90)  # percent
MOST_MARKERS = 12
LINE, WRAP = 112, 30  # letters over the page and over a panel


def plot_map_summary(dataset: xarray.Dataset) -> Figure:
    """Draw a page, A4 across; see `vibrojax.plot_map_summary`."""
    dataset = check_map(dataset)
    names = _measures(dataset)
    maps = [n for n in names if len(parameters_of(dataset, n)) > 1]
    tally = _tally(dataset)
    shown = [(name, name in maps, 1.0) for name in maps or names]
    below = shown[UPPER:] + [(names[0], False, 1.5)] * bool(maps)
    widths = [width for *_, width in below] + [0.75] * bool(tally)
    figure = empty_picture(PAGE)
    upper, lower = figure.add_gridspec(2, 1)
    cells = [*upper.subgridspec(1, len(shown[:UPPER]))]
    if widths:
        cells += [*lower.subgridspec(1, len(widths), width_ratios=widths)]
    for cell, (name, as_map, _) in zip(cells, shown[:UPPER] + below, strict=False):
        (_draw_map if as_map else _draw_effects)(figure, cell, dataset, name)
    if tally:
        _draw_tally(figure.add_subplot(cells[-1]), tally, "lane_status" in dataset)
    figure.suptitle(_heading(dataset, names[0], tally), fontsize=LABEL, x=0.02, ha="left")
    return outside_legend(figure)


def _measures(dataset: xarray.Dataset) -> list[str]:
    """Return the measures to draw: the known ones, then others, with two values somewhere."""
    measured = [name for name in measures_of(dataset) if parameters_of(dataset, name)]
    known = [next((n for n in group if n in measured), None) for group in MEASURES]
    others = [n for n in measured if not any(n in group for group in MEASURES)]
    others = [n for n in others if not n.startswith(("d_", "jump_")) and n != "natural_frequency"]
    names = [*filter(None, known), *others][:MOST_MAPS] or measured[:MOST_MAPS]
    if not names:
        raise ValueError(
            "dataset has no measure over a parameter with two values or more, so there is nothing "
            "to sum up. Draw its curves with plot_map."
        )
    return names


def _draw_map(figure: Figure, cell: SubplotSpec, dataset: xarray.Dataset, name: str) -> None:
    """Draw a measure over its two longest axes, at the middle values of the others."""
    axes = figure.add_subplot(cell)
    axes.tick_params(labelsize=SMALL)
    parameters = parameters_of(dataset, name)
    longest = sorted(parameters, key=lambda d: -dataset.sizes[d])[:2]
    y, x = sorted(longest, key=parameters.index)
    others = [d for d in dataset[name].dims if d not in longest]
    view = dataset.isel({d: dataset.sizes[d] // 2 for d in others})
    view, (across, up) = read_axes(view, name, x, y)
    view, words = with_regimes(view, name)
    shades = shades_of(view, name)
    draw_cells(axes, view, name, (across, up), shades, words)
    shades.bar([axes], "")
    lines = textwrap.wrap(label_for(view[name]), WRAP)
    if fixed := chosen_in(view, *fixed_names(dataset)):
        lines += textwrap.wrap(f"at {fixed}", WRAP)
    x, y = (textwrap.fill(axis.label(), WRAP) for axis in (across, up))
    name_axes(axes, x, y, "\n".join(lines))


def _draw_effects(figure: Figure, cell: SubplotSpec, dataset: xarray.Dataset, name: str) -> None:
    """Draw the median of a measure and its band over each parameter, those of most effect."""
    effects: list[tuple[float, MapAxis, np.ndarray]] = []
    for dimension in parameters_of(dataset, name):
        view, (axis,) = read_axes(dataset, name, dimension)
        spread = view[name].transpose(dimension, ...).values.reshape(len(axis.places), -1)
        bands = np.full((3, len(axis.places)), np.nan)
        filled = np.isfinite(spread).any(axis=1)
        if filled.any():
            bands[:, filled] = np.nanpercentile(spread[filled], [BAND[0], 50, BAND[1]], axis=1)
        reach = np.nanmax(bands[1], initial=-np.inf) - np.nanmin(bands[1], initial=np.inf)
        effects.append((float(reach), axis, bands))
    effects.sort(key=lambda effect: -effect[0])
    measure = label_for(dataset[name])
    if len(effects) > 1:
        measure += f": median and {BAND[0]} to {BAND[1]} % band"
    drawn = effects[:MOST_EFFECTS]
    shared: Axes | None = None
    row = cell.subgridspec(1, len(drawn))
    for number, (_, axis, bands) in enumerate(drawn):
        axes = figure.add_subplot(row[0, number], sharey=shared)
        line = "none" if axis.names is not None else "-"
        axes.fill_between(axis.places, bands[0], bands[2], color=BLUE, alpha=0.2, linewidth=0)
        marker = "o" if line == "none" or len(axis.places) <= MOST_MARKERS else None
        axes.plot(axis.places, bands[1], linestyle=line, marker=marker, color=BLUE)
        scale_axes(axes, axis)
        label = axis.label()
        if axis.names is None and len(drawn) > 1:
            label = _label_ends(axes, axis)
        elif axis.names is not None:
            axes.tick_params(axis="x", rotation=30)
        dress(axes)
        axes.grid(False, axis="x")
        axes.tick_params(labelleft=shared is None)
        name_axes(axes, textwrap.fill(label, 3 * WRAP // (1 + len(drawn))))
        if shared is None:
            name_axes(axes, None, textwrap.fill(measure, WRAP))
            shared = axes


def _label_ends(axes: Axes, axis: MapAxis) -> str:
    """Name only the ends of a narrow axis, inside it, and return its label."""
    ends = axis.places[[0, -1]]
    largest = np.abs(ends).max()
    power = 0 if 1e-2 <= largest < 1e3 or not largest else int(3 * (np.log10(largest) // 3))
    shown = [f"{v:.3g}" for v in ends / 10.0**power]
    axes.set_xticks(ends.tolist(), shown)
    axes.set_xticks([], minor=True)
    for text, side in zip(axes.get_xticklabels(), ("left", "right"), strict=True):
        text.set_horizontalalignment(side)
    return axis.label(f"$10^{{{power}}}$" if power else "")


def _tally(dataset: xarray.Dataset) -> dict[str, int]:
    """Return how many lanes, or else points, ended how; empty when the dataset does not say."""
    name = "lane_status" if "lane_status" in dataset else "status"
    if name not in dataset:
        return {}
    flags = flags_of(dataset[name])
    values = dataset[name].values
    shown = {word: int((values == number).sum()) for word, number in flags.items()}
    return {word: count for word, count in shown.items() if count or word == "settled"}


def _draw_tally(axes: Axes, tally: dict[str, int], lanes: bool) -> None:
    total = max(1, sum(tally.values()))
    bars = axes.barh(list(tally), list(tally.values()))
    for bar, name in zip(bars, tally, strict=True):
        bar.set_color(BLUE if name == "settled" else ORANGE)
    shares = [f"{count} ({100 * count / total:.1f} %)" for count in tally.values()]
    axes.bar_label(bars, shares, padding=5, fontsize=SMALL)
    axes.set(xlim=(0, 1.9 * max(1, *tally.values())), ylim=(len(tally) - 0.4, -0.6))
    dress(axes)
    axes.grid(False)
    title = "How the lanes ended, by their worst point" if lanes else "How the points ended"
    name_axes(axes, "Lanes" if lanes else "Points", title=textwrap.fill(title, WRAP - 6))
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))


def _heading(dataset: xarray.Dataset, name: str, tally: dict[str, int]) -> str:
    sizes = {d: dataset.sizes[d] for d in parameters_of(dataset, name)}
    lanes = int(np.prod(list(sizes.values())))
    names = {d: " with ".join(coordinates_along(dataset, d)).replace("_", " ") for d in sizes}
    axes = " × ".join(f"{n} {names[d]}" for d, n in sizes.items())
    lines = [str(dataset.attrs.get("title", "vibrojax parameter map"))]
    counted = f"{lanes} systems: {axes}"
    if axis := next((f for f in FREQUENCIES if f in dataset.coords), None):
        values = dataset[axis].values.ravel()
        reach = f"{values[0]:.4g}"
        if len(values) > 1:
            reach += f" to {values[-1]:.4g} in {len(values)} points"
        counted += f"; {axis.replace('_', ' ')} {reach}{' Hz' * (axis == 'frequency')}"
    lines.append(counted)
    if tally:
        total = max(1, sum(tally.values()))
        what = "lanes" if "lane_status" in dataset else "points"
        shares = ", ".join(f"{n} {k} ({100 * n / total:.1f} %)" for k, n in tally.items())
        lines.append(f"{what}: {shares}")
    if cost := next((c for c in ("lane_steps", "steps") if c in dataset), None):
        steps = dataset[cost].values.astype(float)
        total = np.sum(steps, where=steps > 0)  # -1 where they were not counted
        if total:
            lines[-1] += f"; cost {float(f'{total:.3g}'):,.0f} steps"
    if rig := str(dataset.attrs.get("rig", "")):
        rig = " ".join(rig.split()).replace("( ", "(")
        lines.append(textwrap.shorten(f"rig: {rig}", LINE, placeholder=" …"))
    return "\n".join(textwrap.fill(line, LINE) for line in lines)
