"""Pictures of the identification experiment, from the numbers that `run.py` saved."""

import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.plot.style import COLORS, GREY, LABEL, MARKERS, SMALL

matplotlib.use("Agg")

BLUE, ORANGE, GREEN = COLORS["forward"], COLORS["backward"], "#2a7f3f"
PURPLE = "#7b3294"
DASHES = (0, (4, 1.6))
TRUE = {"stiffness": 5500.0, "damping 5e-05": 5e-5, "damping 2": 2.0}
UNITS = {"stiffness": "stiffness (N/m)", "damping": "damping (N s/m)"}
WAYS = {1: "forward", -1: "backward", 0: "held"}


def new(rows: int, columns: int, size: tuple[float, float], **how: Any) -> tuple[Figure, Any]:
    """Make a picture in the style of those of vibrojax."""
    figure = Figure(figsize=size, dpi=120, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **how)
    for one in axes.flat:
        one.grid(color="#d9d9d9", linewidth=0.7)
        one.set_axisbelow(True)
        one.tick_params(labelsize=SMALL)
        for side in ("top", "right"):
            one.spines[side].set_visible(False)
    return figure, axes


def draw_points(axes: Axes, curve: dict[str, Any], what: str = "amplitude", **style: Any) -> None:
    """Draw measured points, each sweep with its own mark."""
    x, y, way = (np.array(curve[k]) for k in ("frequency", what, "direction"))
    for sign, name in WAYS.items():
        if not np.any(way == sign):
            continue
        kind = {"ls": "none", "marker": MARKERS.get(name, "o"), "ms": 5, "zorder": 2, **style}
        kind.setdefault("color", COLORS.get(name, BLUE))
        axes.plot(x[way == sign], y[way == sign], label=f"measured, {name}", **kind)


def draw_curve(
    axes: Axes,
    curve: dict[str, Any],
    color: str,
    label: str,
    width: float = 1.8,
    what: str = "amplitude",
):
    """Draw a fitted curve, its unstable part dashed."""
    x, y = np.array(curve["curve_frequency"]), np.array(curve[f"curve_{what}"])
    ends = np.flatnonzero(~np.array(curve["continues"], bool)) + 1
    x, broken = (np.insert(values, ends, np.nan) for values in (x, y))
    unstable = np.insert(np.array(curve["unstable"], bool), ends, False)
    # The point next to a change belongs to both, so that the line has no gap.
    beside = unstable | np.roll(unstable, 1) | np.roll(unstable, -1)
    axes.plot(x, np.where(unstable, np.nan, broken), color=color, lw=width, label=label, zorder=3)
    axes.plot(x, np.where(beside, broken, np.nan), color=color, lw=width, ls=DASHES, zorder=3)


def finish(axes: Axes, title: str = "") -> None:
    axes.set_xlim(0.84, 1.32)
    axes.set_title(title, fontsize=LABEL - 1, loc="left")


def legend(figure: Figure, axes: Axes, columns: int) -> None:
    lines, labels = axes.get_legend_handles_labels()
    figure.legend(
        lines, labels, loc="outside lower center", ncols=columns, fontsize=SMALL, frameon=False
    )


def draw_coverage(results: dict[str, Any], path: Path) -> None:
    """Draw the estimates of every draw with their intervals, beside the truth."""
    cases = [k for k in ("damping 5e-05", "damping 2") if k in results]
    figure, axes = new(len(cases), 2, (12, 3.6 * len(cases)))
    for row, case in zip(axes, cases, strict=True):
        fits = results[case]["fits"]
        for one, name in zip(row, ("stiffness", "damping"), strict=True):
            truth = TRUE.get(name, TRUE[case])
            missed = 0
            for k, fit in enumerate(fits):
                low, high = fit["interval"][name]
                inside = low <= truth <= high
                missed += not inside
                color = BLUE if inside else ORANGE
                one.plot([k + 1] * 2, [low, high], color=color, lw=2.2, solid_capstyle="butt")
                one.plot(k + 1, fit["estimate"][name], "o", color=color, ms=4.5)
            one.axhline(truth, color="black", lw=1.2, ls=DASHES, zorder=1.5)
            one.set_ylabel(UNITS[name], fontsize=LABEL)
            one.set_xlabel("draw of the noise", fontsize=LABEL)
            words = f"truth {truth:g}: inside {len(fits) - missed} of {len(fits)}"
            one.set_title(words, fontsize=LABEL - 1, loc="left")
    figure.savefig(path)


def draw_early(results: dict[str, Any], curves: dict[str, Any], path: Path) -> None:
    """Draw one sweep that jumped early with the three fits, and the estimates of all draws."""
    case = "damping 5e-05"
    colors = {"distance": BLUE, "pointwise": ORANGE, "folds": GREEN}
    figure, axes = new(1, 2, (13, 5.8), width_ratios=(1.25, 1))
    close, spread = axes[0]
    shown = [o for o in colors if f"{case} {o} early" in curves]
    draw_points(close, curves[f"{case} {shown[0]} early"], color=GREY, ms=6)
    for objective in shown:
        curve = curves[f"{case} {objective} early"]
        draw_curve(close, curve, colors[objective], f'objective "{objective}"')
    finish(close, "One draw; the forward sweep jumps 3 points early")
    close.set_xlim(1.05, 1.3)
    close.set_ylabel("amplitude over drive amplitude", fontsize=LABEL)
    close.set_xlabel("frequency ratio", fontsize=LABEL)
    ticks = []
    for place, objective in enumerate(shown):
        for shift, kind in ((-0.2, "whole"), (0.2, "early")):
            found = results.get(f"{case} {objective} {kind}")
            if found is None:
                continue
            ticks.append((place + shift, kind))
            for k, fit in enumerate(found["fits"]):
                x = place + shift + 0.03 * (k - (len(found["fits"]) - 1) / 2)
                style = {"color": colors[objective], "alpha": 0.45 if kind == "whole" else 1.0}
                spread.plot([x, x], fit["interval"]["stiffness"], lw=1.8, **style)
                spread.plot(x, fit["estimate"]["stiffness"], "o", ms=4.5, **style)
    spread.axhline(TRUE["stiffness"], color="black", lw=1.2, ls=DASHES, zorder=1.5)
    spread.set_xticks([t for t, _ in ticks], [kind for _, kind in ticks])
    for place, objective in enumerate(shown):
        spread.text(
            place,
            -0.1,
            objective,
            transform=spread.get_xaxis_transform(),
            ha="center",
            va="top",
            fontsize=LABEL,
            color=colors[objective],
        )
    spread.set_ylabel(UNITS["stiffness"], fontsize=LABEL)
    spread.set_ylim(4000, 7000)  # some intervals of pointwise go far beyond
    spread.set_title(
        "Stiffness of 8 draws, cut off at 4000 and 7000", fontsize=LABEL - 1, loc="left"
    )
    legend(figure, close, 5)
    figure.savefig(path)


def draw_errors(results: dict[str, Any], curves: dict[str, Any], path: Path) -> None:
    """Draw fits of wrong models over the points, with the residuals below."""
    case = "damping 5e-05"
    wanted = [m for m in ("right", "1 mode", "as printed") if f"{case} {m}" in curves]
    figure, axes = new(
        2, len(wanted), (4.9 * len(wanted), 7), sharex=True, height_ratios=(2, 1), sharey="row"
    )
    for model, upper, lower in zip(wanted, axes[0], axes[1], strict=True):
        curve = curves[f"{case} {model}"]
        draw_points(upper, curve)
        draw_curve(upper, curve, "black", "fitted curve", 1.4)
        draw_points(lower, curve, "residual")
        lower.axhline(0, color=GREY, lw=0.8)
        lower.set_yscale("symlog", linthresh=3)
        lower.set_yticks([-30, -10, -3, 0, 3, 10, 30], ["-30", "-10", "-3", "0", "3", "10", "30"])
        reduced = results[f"{case} {model}"]["reduced_chi_square"]
        finish(upper, f"{model}: reduced chi-square {reduced:.3g}")
        lower.set_xlabel("frequency ratio", fontsize=LABEL)
    axes[0][0].set_ylim(0, 45)
    axes[0][0].set_ylabel("amplitude over drive amplitude", fontsize=LABEL)
    axes[1][0].set_ylabel("residual / deviation", fontsize=LABEL)
    legend(figure, axes[0][0], 3)
    figure.savefig(path)


def draw_gaps(results: dict[str, Any], curves: dict[str, Any], path: Path) -> None:
    """Draw three gaps fitted at once, each gap in a colour."""
    case = "damping 5e-05"
    figure, axes = new(1, 1, (10, 6))
    one = axes[0][0]
    fitted = curves[f"{case} together"]
    for (label, curve), color in zip(fitted.items(), (BLUE, GREEN, PURPLE), strict=False):
        draw_points(one, curve, color=color, alpha=0.55)
        draw_curve(one, curve, color, f"gap {label}, fitted")
    finish(one)
    one.set_ylim(0, None)
    one.set_ylabel("amplitude over drive amplitude", fontsize=LABEL)
    one.set_xlabel("frequency ratio", fontsize=LABEL)
    found = results[f"{case} together"]
    low, high = found["interval"]["stiffness"]
    words = f"one stiffness: {found['estimate']['stiffness']:.0f} ({low:.0f} to {high:.0f}) N/m"
    one.set_title(words, fontsize=LABEL - 1, loc="left")
    lines, labels = one.get_legend_handles_labels()
    kept = [k for k, text in enumerate(labels) if "fitted" in text]
    for sign in ("forward", "backward"):
        lines += one.plot([], [], ls="none", marker=MARKERS[sign], color=GREY)
        labels.append(f"measured, {sign}")
    kept += [len(labels) - 2, len(labels) - 1]
    figure.legend(
        [lines[k] for k in kept],
        [labels[k] for k in kept],
        loc="outside lower center",
        ncols=3,
        fontsize=SMALL,
        frameon=False,
    )
    figure.savefig(path)


def draw_whole(results: dict[str, Any], curves: dict[str, Any], path: Path) -> None:
    """Draw points along the whole branch with the fitted curve, amplitude and phase."""
    figure, axes = new(2, 1, (10, 8), sharex=True, height_ratios=(3, 2))
    curve, words = curves["complex"], ("first harmonic over drive", "phase, rad")
    for (one,), what, label in zip(axes, ("amplitude", "phase"), words, strict=True):
        draw_points(one, curve, what, color=BLUE)
        draw_curve(one, curve, "black", "fitted curve, dashed where no sweep stays", 1.6, what)
        one.set_ylabel(label, fontsize=LABEL)
    points, fit = results["points"], results["complex"]["fits"][0]
    (low, high), estimate = fit["interval"]["stiffness"], fit["estimate"]["stiffness"]
    title = f"{points['all']} points, {points['unstable']} of them unstable"
    finish(axes[0][0], f"{title}: stiffness {estimate:.0f} ({low:.0f} to {high:.0f}) N/m")
    axes[0][0].set_xlim(0.88, 1.33)
    axes[1][0].set_xlabel("frequency ratio", fontsize=LABEL)
    legend(figure, axes[0][0], 2)
    figure.savefig(path)


def draw_all(folder: Path) -> None:
    """Draw what there are numbers for."""
    read = {}
    for name in ("results", "curves"):
        path = folder / f"{name}.json"
        read[name] = json.loads(path.read_text()) if path.exists() else {}
    results, curves = read["results"], read["curves"]
    drawn = folder / "pictures"
    drawn.mkdir(exist_ok=True)
    if "coverage" in results:
        draw_coverage(results["coverage"], drawn / "coverage.png")
    parts = {"early_jump": draw_early, "model_error": draw_errors, "gaps": draw_gaps}
    parts["whole_curve"] = draw_whole
    for part, draw in parts.items():
        if part in curves:
            draw(results[part], curves[part], drawn / f"{part}.png")
