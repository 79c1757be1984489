"""Pictures of kinds of motion: regimes, sections, exponents, bifurcation diagrams and basins."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from vibrojax.plot.style import (
    COLORS,
    GREY,
    SERIES,
    STYLES,
    WORDS,
    chosen_in,
    color_bar,
    edges_of,
    family_colors,
    finish,
    label_for,
    line_styles,
    name_axes,
    new_panels,
    new_picture,
    outside_legend,
)
from vibrojax.results.axes import axes_of, axis_scale

KINDS = {
    "periodic": (COLORS["blue"], "o"),
    "quasi_periodic": (COLORS["green"], "s"),
    "chaotic": (COLORS["orange"], "^"),
    "undecided": (COLORS["middle"], "D"),
    "diverged": (COLORS["black"], "x"),
    "gave_up": (COLORS["middle"], "x"),
}
"""Colour and marker of a kind of motion; shades of blue count the period."""
PERIOD_COLORS = [to_hex(matplotlib.colormaps["Blues"](k)) for k in np.linspace(0.18, 0.86, 5)]
"""Of period 1, 2, 3, 4 and of longer ones."""
HIGHEST = len(PERIOD_COLORS)
POINTS: dict[str, dict[str, Any]] = {
    "forward": {"marker": ".", "markersize": 4.0, "markeredgewidth": 0.0},
    "backward": {
        "marker": "o",
        "markersize": 4.5,
        "markerfacecolor": "none",
        "markeredgewidth": 0.5,
    },
}
"""Filled points upwards, rings downwards: distinct without colour too."""
STARTS_AT = 5
"""Share of the periods, percent, before which a mean is not drawn: it says nothing yet."""
ATTRACTORS = SERIES[:7]
"""Colours of periodic attractors, by share."""
OTHER, DIVERGED = "white", COLORS["black"]


def kinds_in(kind: xarray.DataArray) -> dict[str, np.ndarray]:
    """Return where there is which kind of motion, of the kinds that there are."""
    names = str(kind.attrs["flag_meanings"]).split()
    flags = zip(names, kind.attrs["flag_values"], strict=True)
    where = {name: np.asarray(kind.values == value) for name, value in flags}
    return {name: own for name, own in where.items() if own.any()}


def plot_regimes(regimes: xarray.Dataset) -> Figure:
    """Draw kinds, periods and exponents against frequency, as a map over one axis more."""
    figure, (upper, lower) = new_panels([3.2, 3.2])
    *left, axis = map(str, regimes["regime"].dims)
    exponent = regimes["lyapunov_exponent"]
    if left:
        scale = axis_scale(axes_of(regimes, left), left[0])
        view = regimes.isel({left[0]: np.argsort(scale.places)})
        edges = edges_of(regimes[axis].values), edges_of(np.sort(scale.places))
        _category_map(upper, view, edges)
        _exponent_map(lower, view["lyapunov_exponent"], edges)
        for axes in (upper, lower):
            axes.grid(False)
            name_axes(axes, None, scale.label)
            if not scale.is_scale:
                axes.set_yticks(scale.places, scale.labels)
            if left[0] == "start":
                axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        lower.axhline(0.0, color=GREY, linewidth=1.0)
        x, error = regimes[axis].values, 2 * regimes["lyapunov_standard_error"].values
        style: dict[str, Any] = {"fmt": "none", "ecolor": GREY, "elinewidth": 0.9}
        lower.errorbar(x, exponent.values, error, **style)
        for kind, own in kinds_in(regimes["regime"]).items():
            color, marker = KINDS[kind]
            for axes, name in ((upper, "period"), (lower, "lyapunov_exponent")):
                style = {"color": color, "marker": marker, "markersize": 5.5}
                style |= {"linestyle": "none", "label": kind.replace("_", "-")}
                axes.plot(x[own], regimes[name].values[own].astype(float), **style)
        _name_periods(upper, int(regimes["period"].max()))
        name_axes(lower, None, label_for(exponent))
    name_axes(upper, title=chosen_in(regimes))
    name_axes(lower, label_for(regimes[axis]))
    return outside_legend(figure)


def _name_periods(axes: Axes, longest: int) -> None:
    """Name whole periods; motions that have none stand on a line below."""
    name_axes(axes, None, "Period (drive periods)")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    top = max(4, longest)
    axes.set_ylim(-0.06 * top, 1.06 * top)
    ticks = [t for t in axes.get_yticks() if 0 < t <= top and t == int(t)]
    axes.set_yticks([0, *ticks], ["none", *(f"{t:.0f}" for t in ticks)])


def _category_map(axes: Axes, view: xarray.Dataset, edges: tuple[np.ndarray, np.ndarray]) -> None:
    """Draw kinds over two axes, periodic ones by their period."""
    period = view["period"].values
    others = [kind for kind in KINDS if kind != "periodic"]
    colors = [*PERIOD_COLORS, *(KINDS[kind][0] for kind in others)]
    category = np.minimum(np.maximum(period, 1), HIGHEST) - 1
    kinds = kinds_in(view["regime"])
    for k, kind in enumerate(others):
        category = np.where(kinds.get(kind, False), HIGHEST + k, category)
    norm = BoundaryNorm(np.arange(len(colors) + 1) - 0.5, len(colors))
    axes.pcolormesh(*edges, category, cmap=ListedColormap(colors), norm=norm, rasterized=True)
    longest = int(period.max(initial=0))
    words = [f"period {k}" for k in range(1, HIGHEST + 1)]
    words[-1] += f" to {longest}" * (longest > HIGHEST)
    words += [kind.replace("_", "-") for kind in others]
    for k in np.unique(category):
        _name_color(axes, words[k], colors[k], GREY)


def _name_color(axes: Axes, words: str, color: str, edge: str = "black") -> None:
    """Add a colour to the legend."""
    axes.fill_between([], [], facecolor=color, edgecolor=edge, linewidth=0.5, label=words)


def _exponent_map(
    axes: Axes, exponent: xarray.DataArray, edges: tuple[np.ndarray, np.ndarray]
) -> None:
    known = exponent.values[np.isfinite(exponent.values)]
    # As far down as up: how strongly a periodic motion attracts says nothing of the regime.
    high = known.max(initial=0.0)
    reach = high if high > 0 else max(np.abs(known).max(initial=0.0), 1e-12)
    style: dict[str, Any] = {"cmap": "RdBu_r", "norm": Normalize(-reach, reach)}
    drawn = axes.pcolormesh(*edges, exponent.values, rasterized=True, **style)
    below = bool((known < -reach).any())
    label = label_for(exponent).replace("Lyapunov ", "Lyapunov\n")
    color_bar([axes], drawn, label, extend="min" if below else "neither")


def plot_poincare(regimes: xarray.Dataset) -> Figure:
    """Draw displacement and velocity at every drive period, of one lane or along one axis."""
    _, axes = new_picture()
    across, up = regimes["displacement"], regimes["velocity"]
    left = [str(d) for d in regimes["regime"].dims]
    title = chosen_in(regimes)
    # Points of a period are few and seen well; those of a chaotic motion are many and small.
    if not left:
        (kind,), period = kinds_in(regimes["regime"]), int(regimes["period"])
        color, marker = KINDS[kind]
        size = 4.0 if kind == "chaotic" else 8.0
        axes.plot(across, up, linestyle="none", color=color, marker=marker, markersize=size)
        words = kind.replace("_", "-") + (f", period {period}" if period > 0 else "")
        title = ", ".join(part for part in (words, title) if part)
    else:
        scale = axis_scale(axes_of(regimes, left), left[0])
        for k, color in enumerate(family_colors(axes, scale, marker="o", linestyle="none")):
            axes.plot(across[k], up[k], ".", color=color, markersize=5)
    at = "at drive phase 0"
    return finish(axes, f"Displacement {at} (m)", f"Velocity {at} (m/s)", title)


def plot_order_spectrum(regimes: xarray.Dataset) -> Figure:
    """Draw the amplitudes of one lane against frequency over drive frequency."""
    spectrum = regimes["spectrum"]
    orders, lines = spectrum["order"].values, spectrum.values
    _, axes = new_picture()
    axes.semilogy(orders, lines, color=COLORS["blue"], linewidth=1.3)
    axes.set_xlim(0, orders[-1])
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    top = float(np.nanmax(lines)) if np.isfinite(lines).any() else 1.0
    axes.set_ylim(max(1e-6 * top, float(np.nanmin(lines)) / 2) or None, 2 * top)
    return finish(axes, label_for(spectrum["order"]), label_for(spectrum), chosen_in(regimes))


def plot_lyapunov(found: xarray.Dataset) -> Figure:
    """Draw the mean rate up to every drive period, and the exponent with its error."""
    _, axes = new_picture()
    rates, count = found["rate"].values, found["drive_period"].values
    shown = slice(rates.size * STARTS_AT // 100, None)
    mean, style = np.cumsum(rates) / count, {"color": COLORS["blue"], "linewidth": 2.0}
    axes.plot(count[shown], mean[shown], label="mean rate so far", **style)
    value, error = (float(found[f"lyapunov_{name}"]) for name in ("exponent", "standard_error"))
    color, band = COLORS["orange"], (value - 2 * error, value + 2 * error)
    axes.axhline(value, color=color, linestyle=STYLES["backward"], linewidth=1.5)
    words = f"exponent {value:.4g} 1/s and two standard errors"
    axes.axhspan(*band, color=color, alpha=0.2, label=words)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    return finish(axes, "Drive periods", label_for(found["rate"]))


def plot_bifurcation_diagram(diagram: xarray.Dataset) -> Figure:
    """Draw strobed displacements and exponents against the parameter, in its directions."""
    figure, (upper, lower) = new_panels([4.4, 2.0])
    parameter = diagram[diagram["period"].dims[-1]]
    x, exponent = parameter.values, diagram["lyapunov_exponent"]
    for direction in reversed(diagram["direction"].values.tolist()):  # rings lie below the points
        style: dict[str, Any] = POINTS[direction] | {"color": COLORS[direction]}
        style |= {"linestyle": "none", "label": WORDS[direction]}
        own = diagram.sel(direction=direction)
        strobed = own["displacement"].values
        many = np.broadcast_to(x[:, None], strobed.shape)
        upper.plot(many.ravel(), strobed.ravel(), rasterized=True, **style)
        error = 2 * own["lyapunov_standard_error"].values
        style |= {"markersize": 7.0, "ecolor": GREY, "elinewidth": 0.7}
        lower.errorbar(x, own["lyapunov_exponent"].values, error, **style)
    lower.axhline(0.0, color=GREY, linewidth=1.0)
    name_axes(upper, None, "Displacement at drive phase 0 (m)", chosen_in(diagram, "direction"))
    name_axes(lower, label_for(parameter), label_for(exponent).replace("Lyapunov ", "Lyapunov\n"))
    return outside_legend(figure)


def plot_basins(basins: xarray.Dataset, starts: Sequence[str], names: Sequence[str]) -> Figure:
    """Draw the basins at one combination of the other axes.

    `starts` are the names of the two numbers, `names` say in words what the attractors are.
    """
    _, axes = new_picture()
    number = basins["attractor"].values
    colors = [DIVERGED]
    periodic, others = iter(ATTRACTORS), 0.0
    for k, name in enumerate(names):
        own = basins.isel(attractor_number=k)
        color = COLORS["dark" if bool(own["cross_well"]) else "pale"]
        if int(own["period"]):
            color = next(periodic, OTHER)
        colors.append(color)
        share, error = 100 * float(own["share"]), 100 * float(own["standard_error"])
        if color == OTHER:
            others += share
        elif share:
            _name_color(axes, f"{name}: {share:.1f} ± {error:.1f} %", color)
    if others:
        _name_color(axes, f"further attractors: {others:.1f} %", OTHER)
    if lost := float(np.mean(number == 0)):
        _name_color(axes, f"diverged: {100 * lost:.1f} %", DIVERGED)
    axes.grid(False)
    cells: dict[str, Any] = {"vmin": -0.5, "vmax": len(colors) - 0.5}
    cells["cmap"] = ListedColormap(colors)
    x, y = (basins[name].values.astype(float) for name in starts)
    if number.ndim == 2:
        axes.pcolormesh(edges_of(x), edges_of(y), number.T, rasterized=True, **cells)
    else:
        size = float(np.clip(3000 / max(number.size, 1), 4, 40))
        axes.scatter(x, y, c=number, s=size, edgecolors="black", linewidths=0.2, **cells)
    across, up = (label_for(basins[name]) for name in starts)
    return finish(axes, across, up, chosen_in(basins))


def plot_orbits(
    basins: xarray.Dataset,
    orbits: Sequence[tuple[np.ndarray, np.ndarray]],
    names: Sequence[str],
    samples: int,
) -> Figure:
    """Draw every attractor in the plane of displacement and velocity, marked at drive phase 0.

    `orbits` are the displacements (m) and velocities (m/s) over a period, with so many samples to
    a drive period; `names` say in words what the attractors are.
    """
    _, axes = new_picture()
    for k, (orbit, style) in enumerate(zip(orbits, line_styles(len(orbits)), strict=True)):
        across, along = 1e3 * orbit[0], orbit[1]
        amplitude, share = (float(basins[n].values[k]) for n in ("amplitude_ratio", "share"))
        label = f"{k + 1}: {names[k]}, amplitude ratio {amplitude:.4g}, "
        label += f"{100 * share:.3g} % of starts"
        axes.plot(across, along, linewidth=2.0, label=label, **style)
        strobed = slice(0, -1, samples)
        axes.plot(across[strobed], along[strobed], "o", color=style["color"], markersize=7)
    title = [chosen_in(basins), "dots: drive phase 0"]
    if lost := float(basins["diverged_share"]):
        title.append(f"{100 * lost:.3g} % of starts diverged")
    return finish(axes, "Displacement (mm)", "Velocity (m/s)", "; ".join(filter(None, title)))
