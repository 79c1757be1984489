"""Pictures of regimes: strips and maps of kinds, Poincaré sections, spectra."""

from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from vibrojax.branches.branch import axis_description
from vibrojax.plot.style import DPI, GREY, LABEL, SMALL, Picture, new_picture
from vibrojax.regime.dataset import description
from vibrojax.regime.kinds import Regime
from vibrojax.results.axes import AxisScale, axis_scale, example, pick
from vibrojax.results.variables import named_value

if TYPE_CHECKING:
    from vibrojax.regime.regimes_result import Regimes

# Okabe and Ito's colours, which also differ in lightness; shades of blue count the period.
KIND_COLORS = {
    Regime.periodic: "#0072b2",
    Regime.quasi_periodic: "#009e73",
    Regime.chaotic: "#d55e00",
    Regime.undecided: "#8a8a8a",
    Regime.diverged: "#000000",
}
KIND_MARKERS = {
    Regime.periodic: "o",
    Regime.quasi_periodic: "s",
    Regime.chaotic: "^",
    Regime.undecided: "D",
    Regime.diverged: "x",
}
PERIOD_COLORS = ("#d6e6f4", "#abd0e6", "#6aaed6", "#3787c0", "#105ba4")
"""Of period 1, 2, 3, 4 and of longer ones."""
HIGHEST = len(PERIOD_COLORS)


def axis_label(name: str) -> str:
    """Return the long name of an axis with its unit."""
    told = axis_description(name)
    return told["long_name"] + ("" if told["units"] == "1" else f" ({told['units']})")


def _scale_label(scale: AxisScale) -> str:
    return axis_label(scale.number) + scale.partners


def variable_label(name: str) -> str:
    """Return the long name of a variable with its unit."""
    told = description(name, "1")
    return told["long_name"] + ("" if told["units"] == "1" else f" ({told['units']})")


def two_panels(heights: tuple[float, float] = (1.0, 1.0)) -> tuple[Picture, tuple[Axes, Axes]]:
    """Make an empty picture of two panels over one axis."""
    margins = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1)
    figure = Picture(figsize=(10.0, 7.6), dpi=DPI, layout=margins)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=heights)
    for axes in (upper, lower):
        axes.grid(True, color="#d9d9d9", linewidth=0.7)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=SMALL)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    return figure, (upper, lower)


def titled(axes: Axes, chosen: dict[str, Any]) -> None:
    """Write above the axes what was picked."""
    told = [named_value(n, v) for n, v in chosen.items()]
    if told:
        axes.set_title(", ".join(told), fontsize=LABEL, loc="left")


def kind_legend(axes: Axes, kind: np.ndarray, beside: bool = True) -> None:
    """Name the kinds of motion that there are."""
    present = [r for r in Regime if (kind == r.value).any()]
    handles = [
        Line2D([], [], color=KIND_COLORS[r], marker=KIND_MARKERS[r], linestyle="none", markersize=7)
        for r in present
    ]
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0)} if beside else {}
    axes.legend(
        handles,
        [r.word for r in present],
        ncols=len(present),
        frameon=False,
        fontsize=SMALL,
        **place,
    )


def scatter_kinds(axes: Axes, x: np.ndarray, y: np.ndarray, kind: np.ndarray) -> None:
    """Draw points, a colour and a marker for every kind of motion."""
    for regime in Regime:
        own = kind == regime.value
        axes.plot(
            x[own],
            y[own],
            color=KIND_COLORS[regime],
            marker=KIND_MARKERS[regime],
            linestyle="none",
            markersize=5.5,
        )


def draw_exponents(
    axes: Axes, x: np.ndarray, exponent: np.ndarray, error: np.ndarray, kind: np.ndarray
) -> None:
    """Draw exponents with two standard errors either way, and the line between order and chaos."""
    axes.axhline(0.0, color=GREY, linewidth=1.0)
    axes.errorbar(x, exponent, 2 * error, fmt="none", ecolor=GREY, elinewidth=0.9)
    scatter_kinds(axes, x, exponent, kind)
    axes.set_ylabel(variable_label("lyapunov_exponent"), fontsize=LABEL)


def draw_periods(axes: Axes, x: np.ndarray, period: np.ndarray, kind: np.ndarray) -> None:
    """Draw periods; motions that have none stand on a line below."""
    scatter_kinds(axes, x, period.astype(float), kind)
    axes.set_ylabel("Period (drive periods)", fontsize=LABEL)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    top = max(4, int(period.max(initial=0)))
    axes.set_ylim(-0.06 * top, 1.06 * top)
    axes.figure.canvas.draw_idle()
    ticks = [t for t in axes.get_yticks() if 0 < t <= top and t == int(t)]
    axes.set_yticks([0, *ticks], ["none", *(f"{t:.0f}" for t in ticks)])


def plot_regimes(regimes: "Regimes", **selection: Any) -> Figure:
    """Draw kinds, periods and exponents against frequency; see `Regimes.plot`."""
    index, chosen, left = pick(regimes.axes, selection)
    if len(left) > 1:
        raise ValueError(
            f"{len(left)} axes are left, {' and '.join(left)}: give a value of all but one, such "
            f"as plot({example(regimes.axes, left[0])})."
        )
    figure, (upper, lower) = two_panels()
    x = np.asarray(regimes.frequencies)
    kind, period = regimes.regime[index], regimes.period[index]
    exponent = regimes.lyapunov_exponent[index]
    if left:
        scale = axis_scale(regimes.axes, left[0])
        _category_map(upper, x, scale.places, kind, period)
        _exponent_map(figure, lower, x, scale.places, exponent)
        for axes in (upper, lower):
            axes.grid(False)
            axes.set_ylabel(_scale_label(scale), fontsize=LABEL)
            if not scale.is_scale:
                axes.set_yticks(scale.places, scale.labels)
            if left[0] == "start":
                axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        titled(lower, chosen)
    else:
        draw_periods(upper, x, period, kind)
        draw_exponents(lower, x, exponent, regimes.lyapunov_standard_error[index], kind)
        kind_legend(upper, kind)
        titled(lower, chosen)
    lower.set_xlabel(axis_label(regimes.axis), fontsize=LABEL)
    return figure


def _edges(values: np.ndarray) -> np.ndarray:
    """Return edges of cells around values."""
    if len(values) == 1:
        half = 0.5 if values[0] == 0 else 0.01 * abs(values[0])
        return np.array([values[0] - half, values[0] + half])
    middle = (values[1:] + values[:-1]) / 2
    return np.r_[2 * values[0] - middle[0], middle, 2 * values[-1] - middle[-1]]


def _ascending(values: np.ndarray, *tables: np.ndarray) -> tuple[np.ndarray, ...]:
    order = np.argsort(values)
    return values[order], *(table[order] for table in tables)


def _category_map(
    axes: Axes, x: np.ndarray, y: np.ndarray, kind: np.ndarray, period: np.ndarray
) -> None:
    """Draw kinds over two axes; periodic ones by their period."""
    y, kind, period = _ascending(y, kind, period)
    others = [r for r in Regime if r is not Regime.periodic]
    colors = [*PERIOD_COLORS, *(KIND_COLORS[r] for r in others)]
    category = np.minimum(np.maximum(period, 1), HIGHEST) - 1
    for k, regime in enumerate(others):
        category = np.where(kind == regime.value, HIGHEST + k, category)
    shades = ListedColormap(colors)
    norm = BoundaryNorm(np.arange(len(colors) + 1) - 0.5, len(colors))
    axes.pcolormesh(_edges(x), _edges(y), category, cmap=shades, norm=norm, rasterized=True)
    longest = int(period.max(initial=0))
    words = [f"period {k}" for k in range(1, HIGHEST)]
    words.append(f"period {HIGHEST}" if longest <= HIGHEST else f"period {HIGHEST} to {longest}")
    words += [r.word for r in others]
    present = [k for k in range(len(colors)) if (category == k).any()]
    handles = [Patch(facecolor=colors[k], edgecolor=GREY, linewidth=0.5) for k in present]
    axes.legend(
        handles,
        [words[k] for k in present],
        ncols=5,
        frameon=False,
        fontsize=SMALL,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
    )


def _exponent_map(
    figure: Figure, axes: Axes, x: np.ndarray, y: np.ndarray, exponent: np.ndarray
) -> None:
    y, exponent = _ascending(y, exponent)
    known = exponent[np.isfinite(exponent)]
    # As far down as up: how strongly a periodic motion attracts says nothing of the regime.
    high = known.max(initial=0.0)
    reach = high if high > 0 else max(np.abs(known).max(initial=0.0), 1e-12)
    norm = Normalize(-reach, reach)
    shades = matplotlib.colormaps["RdBu_r"]
    drawn = axes.pcolormesh(_edges(x), _edges(y), exponent, cmap=shades, norm=norm, rasterized=True)
    below = bool((known < -reach).any())
    bar = figure.colorbar(drawn, ax=axes, pad=0.02, extend="min" if below else "neither")
    bar.set_label(variable_label("lyapunov_exponent"), fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL)


def plot_poincare(regimes: "Regimes", **selection: Any) -> Figure:
    """Draw displacement and velocity at every drive period; see `Regimes.poincare`."""
    index, chosen, left = pick(regimes.coordinates, selection)
    if len(left) > 1:
        raise ValueError(
            f"{len(left)} axes are left, {' and '.join(left)}: give a value of all but one, such "
            f"as poincare({example(regimes.coordinates, left[-1])})."
        )
    displacement, velocity = (regimes[n][index] for n in ("displacement", "velocity"))
    kind, period = regimes.regime[index], regimes.period[index]
    figure, axes = new_picture()
    # Points of a period are few and seen well; those of a chaotic motion are many and small.
    if not left:
        regime = Regime(int(kind))
        size = 4.0 if regime is Regime.chaotic else 8.0
        style = {"marker": KIND_MARKERS[regime], "color": KIND_COLORS[regime], "markersize": size}
        axes.plot(displacement, velocity, linestyle="none", **style)
        word = regime.word + (f", period {int(period)}" if period > 0 else "")
        axes.set_title(", ".join([word, *_told(chosen)]), fontsize=LABEL, loc="left")
    else:
        scale = axis_scale(regimes.coordinates, left[0])
        values = scale.places
        shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, len(values)))
        for k, shade in enumerate(shades):
            axes.plot(displacement[k], velocity[k], ".", color=shade, markersize=5)
        if len(values) <= 8:
            handles = [Line2D([], [], marker="o", linestyle="none", color=s) for s in shades]
            axes.legend(handles, scale.labels, fontsize=SMALL)
        else:
            ends = Normalize(float(np.min(values)), float(np.max(values)))
            shown = ScalarMappable(ends, matplotlib.colormaps["viridis"])
            bar = figure.colorbar(shown, ax=axes, pad=0.02)
            bar.set_label(_scale_label(scale), fontsize=LABEL)
        titled(axes, chosen)
    axes.set_xlabel("Displacement at drive phase 0 (m)", fontsize=LABEL)
    axes.set_ylabel("Velocity at drive phase 0 (m/s)", fontsize=LABEL)
    return figure


def _told(chosen: dict[str, Any]) -> list[str]:
    return [named_value(n, v) for n, v in chosen.items()]


def plot_order_spectrum(regimes: "Regimes", **selection: Any) -> Figure:
    """Draw amplitudes against frequency over drive frequency; see `Regimes.plot_spectrum`."""
    if regimes.orders is None:
        raise ValueError("There are no spectra: give spectrum=True to vj.regimes.")
    index, chosen, left = pick(regimes.coordinates, selection)
    left = [name for name in left if len(regimes.coordinates[name]) > 1]
    if left:
        told = example(regimes.coordinates, left[0])
        raise ValueError(f"Give a value of {' and '.join(left)}, such as {told}.")
    lines = regimes["spectrum"][index].reshape(-1)
    figure, axes = new_picture()
    axes.semilogy(regimes.orders, lines, color=KIND_COLORS[Regime.periodic], linewidth=1.3)
    axes.set_xlabel(axis_label("order"), fontsize=LABEL)
    axes.set_ylabel(variable_label("spectrum"), fontsize=LABEL)
    axes.set_xlim(0, regimes.orders[-1])
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    top = float(np.nanmax(lines)) if np.isfinite(lines).any() else 1.0
    axes.set_ylim(max(1e-6 * top, float(np.nanmin(lines)) / 2) or None, 2 * top)
    titled(axes, chosen)
    return figure
