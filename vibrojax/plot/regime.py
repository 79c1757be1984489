"""Pictures of regimes: strips and maps of kinds, Poincaré sections, spectra."""

from typing import Any

import matplotlib
import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from vibrojax.plot.style import (
    COLORS,
    GREY,
    MAX_LINES,
    SMALL,
    Key,
    chosen_in,
    edges_of,
    finish,
    label_for,
    name_axes,
    new_panels,
    new_picture,
    outside_legend,
    scale_beside,
    shades,
    titled,
)
from vibrojax.results.axes import axes_of, axis_scale

KINDS = {
    "periodic": (COLORS["blue"], "o"),
    "quasi_periodic": (COLORS["green"], "s"),
    "chaotic": (COLORS["orange"], "^"),
    "undecided": (COLORS["middle"], "D"),
    "diverged": (COLORS["black"], "x"),
}
"""Colour and marker of a kind of motion; shades of blue count the period."""
PERIOD_COLORS = [to_hex(matplotlib.colormaps["Blues"](k)) for k in np.linspace(0.18, 0.86, 5)]
"""Of period 1, 2, 3, 4 and of longer ones."""
HIGHEST = len(PERIOD_COLORS)


def kinds_in(kind: xarray.DataArray) -> dict[str, np.ndarray]:
    """Return where there is which kind of motion, of the kinds that there are."""
    names = str(kind.attrs["flag_meanings"]).split()
    where = {n: kind.values == v for n, v in zip(names, kind.attrs["flag_values"], strict=True)}
    return {name: own for name, own in where.items() if own.any()}


def _scatter(axes: Axes, view: xarray.Dataset, name: str) -> Key:
    """Draw a variable, a colour and a marker for every kind of motion; return the legend."""
    values = view[name]
    x, key = values[values.dims[0]].values, {}
    for kind, own in kinds_in(view["regime"]).items():
        color, marker = KINDS[kind]
        style: dict[str, Any] = {"color": color, "marker": marker, "linestyle": "none"}
        axes.plot(x[own], values.values[own].astype(float), markersize=5.5, **style)
        key[kind.replace("_", "-")] = Line2D([], [], markersize=7, **style)
    return key


def plot_regimes(regimes: xarray.Dataset) -> Figure:
    """Draw kinds, periods and exponents against frequency, as a map over one axis more."""
    figure, (upper, lower) = new_panels([3.2, 3.2])
    *left, axis = map(str, regimes["regime"].dims)
    exponent = regimes["lyapunov_exponent"]
    if left:
        scale = axis_scale(axes_of(regimes, left), left[0])
        view = regimes.isel({left[0]: np.argsort(scale.places)})
        edges = edges_of(regimes[axis].values), edges_of(np.sort(scale.places))
        key = _category_map(upper, view, edges)
        _exponent_map(figure, lower, view["lyapunov_exponent"], edges)
        for axes in (upper, lower):
            axes.grid(False)
            name_axes(axes, None, scale.label)
            if not scale.is_scale:
                axes.set_yticks(scale.places, scale.labels)
            if left[0] == "start":
                axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        key = _scatter(upper, regimes, "period")
        _name_periods(upper, int(regimes["period"].max()))
        lower.axhline(0.0, color=GREY, linewidth=1.0)
        error = 2 * regimes["lyapunov_standard_error"].values
        style: dict[str, Any] = {"fmt": "none", "ecolor": GREY, "elinewidth": 0.9}
        lower.errorbar(regimes[axis].values, exponent.values, error, **style)
        _scatter(lower, regimes, "lyapunov_exponent")
        name_axes(lower, None, label_for(exponent))
    outside_legend(figure, key)
    titled(upper, chosen_in(regimes))
    name_axes(lower, label_for(regimes[axis]), None)
    return figure


def _name_periods(axes: Axes, longest: int) -> None:
    """Name whole periods; motions that have none stand on a line below."""
    name_axes(axes, None, "Period (drive periods)")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    top = max(4, longest)
    axes.set_ylim(-0.06 * top, 1.06 * top)
    ticks = [t for t in axes.get_yticks() if 0 < t <= top and t == int(t)]
    axes.set_yticks([0, *ticks], ["none", *(f"{t:.0f}" for t in ticks)])


def _category_map(axes: Axes, view: xarray.Dataset, edges: tuple[np.ndarray, np.ndarray]) -> Key:
    """Draw kinds over two axes, periodic ones by their period; return the legend."""
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
    present = [k for k in range(len(colors)) if (category == k).any()]
    return {words[k]: Patch(facecolor=colors[k], edgecolor=GREY, linewidth=0.5) for k in present}


def _exponent_map(
    figure: Figure, axes: Axes, exponent: xarray.DataArray, edges: tuple[np.ndarray, np.ndarray]
) -> None:
    known = exponent.values[np.isfinite(exponent.values)]
    # As far down as up: how strongly a periodic motion attracts says nothing of the regime.
    high = known.max(initial=0.0)
    reach = high if high > 0 else max(np.abs(known).max(initial=0.0), 1e-12)
    norm = Normalize(-reach, reach)
    colors = matplotlib.colormaps["RdBu_r"]
    drawn = axes.pcolormesh(*edges, exponent.values, cmap=colors, norm=norm, rasterized=True)
    below = bool((known < -reach).any())
    bar = figure.colorbar(drawn, ax=axes, pad=0.02, extend="min" if below else "neither")
    bar.set_label(label_for(exponent), fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL)


def plot_poincare(regimes: xarray.Dataset) -> Figure:
    """Draw displacement and velocity at every drive period, of one lane or along one axis."""
    figure, axes = new_picture()
    across, up = regimes["displacement"], regimes["velocity"]
    left = [str(d) for d in regimes["regime"].dims]
    title, key = chosen_in(regimes), {}
    # Points of a period are few and seen well; those of a chaotic motion are many and small.
    if not left:
        (kind,), period = kinds_in(regimes["regime"]), int(regimes["period"])
        color, marker = KINDS[kind]
        size = 4.0 if kind == "chaotic" else 8.0
        style = {"marker": marker, "color": color, "markersize": size, "linestyle": "none"}
        axes.plot(across, up, **style)
        words = kind.replace("_", "-") + (f", period {period}" if period > 0 else "")
        title = ", ".join(part for part in (words, title) if part)
    else:
        scale = axis_scale(axes_of(regimes, left), left[0])
        values = scale.places
        if len(values) <= MAX_LINES:
            colors = shades(len(values))
            dots: dict[str, Any] = {"marker": "o", "linestyle": "none"}
            lines = [Line2D([], [], color=color, **dots) for color in colors]
            key = dict(zip(scale.labels, lines, strict=True))
        else:
            norm = Normalize(float(values.min()), float(values.max()))
            colors = map(scale_beside(figure, axes, norm, scale.label), values)
        for k, color in enumerate(colors):
            axes.plot(across[k], up[k], ".", color=color, markersize=5)
    at = "at drive phase 0"
    names = f"Displacement {at} (m)", f"Velocity {at} (m/s)"
    return finish(figure, axes, *names, key, title)


def plot_order_spectrum(regimes: xarray.Dataset) -> Figure:
    """Draw the amplitudes of one lane against frequency over drive frequency."""
    spectrum = regimes["spectrum"]
    orders, lines = spectrum["order"].values, spectrum.values
    figure, axes = new_picture()
    axes.semilogy(orders, lines, color=COLORS["blue"], linewidth=1.3)
    axes.set_xlim(0, orders[-1])
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    top = float(np.nanmax(lines)) if np.isfinite(lines).any() else 1.0
    axes.set_ylim(max(1e-6 * top, float(np.nanmin(lines)) / 2) or None, 2 * top)
    names = label_for(spectrum["order"]), label_for(spectrum)
    return finish(figure, axes, *names, {}, chosen_in(regimes))
