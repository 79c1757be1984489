"""The pictures: Figs 6 to 12 in both formulations."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from curves import Study
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from paper_rig import FORMULATIONS, SIGMA, mode_shapes, stop_amplitude

import vibrojax as vj

matplotlib.use("Agg")
import matplotlib.pyplot as plt

NAMES = {"consistent": "consistent", "as_printed": "as printed"}
FORWARD, BACKWARD = "#1f5fa8", "#d9541e"
TAPER_COLOURS = ("#1b1b1b", "#1f5fa8", "#2f9e44", "#d9541e")
RATIO_LABEL = "drive frequency / first natural frequency"
PEAK_LABEL = "peak ratio  max|y tip| / σ"


def _save(figure, folder: Path, name: str) -> None:
    figure.savefig(folder / f"{name}.png", dpi=90)
    plt.close(figure)


def draw_shapes(folder: Path) -> None:
    """Fig. 6: five mode shapes at taper 0.25 and mass ratio 0.5."""
    s, shapes, squares = mode_shapes(0.25, 0.5)
    figure, axes = plt.subplots(figsize=(9, 4.2), layout="constrained")
    styles = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
    for i, style in enumerate(styles):
        axes.plot(s, shapes[:, i], ls=style, lw=1.8, label=f"mode {i + 1}, β² = {squares[i]:.3f}")
    axes.axhline(0, color="0.7", lw=0.8)
    axes.set(xlabel="place on the beam  s = x/L", ylabel="mode shape, largest value 1", xlim=(0, 1))
    axes.set_title(
        "Fig. 6: taper 0.25, mass ratio 0.5 (the same in both formulations)", fontsize=11
    )
    figure.legend(fontsize=9, loc="outside right center")
    _save(figure, folder, "fig6_mode_shapes")


def draw_curve(axes: Axes, curve: vj.sweep.FrequencyResponse, lane: tuple[int, ...]) -> None:
    """Both directions of one lane: periodic points as lines, the others marked, jumps as arrows."""
    ratios = np.asarray(curve.frequencies)
    peak, period, status = (
        np.asarray(x)[lane] for x in (curve.peak_ratio, curve.period, curve.status)
    )
    for k, (colour, marker) in enumerate(((FORWARD, ">"), (BACKWARD, "<"))):
        axes.plot(ratios, peak[k], color=colour, lw=1.6 - 0.4 * k, zorder=2 + k)
        # Signs of direction, evenly along the axis.
        at = np.searchsorted(ratios, np.linspace(ratios[0], ratios[-1], 12)[1:-1] + 0.013 * k)
        axes.plot(ratios[at], peak[k][at], marker, color=colour, ms=5, zorder=2 + k)
        odd, multiple = status[k] != vj.Status.settled.value, period[k] > 1
        axes.plot(ratios[odd], peak[k][odd], "x", color="k", ms=5, mew=1.2, zorder=5)
        axes.plot(ratios[multiple], peak[k][multiple], "o", mfc="none", color="#2f9e44", zorder=5)
    for jump, colour, name, side in (
        (float(curve.jump_up[lane]), BACKWARD, "up", "right"),
        (float(curve.jump_down[lane]), FORWARD, "down", "left"),
    ):
        if np.isfinite(jump):
            k = 1 if name == "up" else 0
            at = int(np.searchsorted(ratios, jump))
            low, high = (f(peak[k][max(at - 3, 0) : at + 3]) for f in (np.min, np.max))
            start, end = (low, high) if name == "up" else (high, low)
            axes.annotate(
                "",
                (jump, end),
                (jump, start),
                arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.4, "ls": "-"},
                zorder=6,
            )
            if jump > ratios[0] + 0.88 * np.ptp(ratios):
                side = "right"  # beyond the jump there is no room
            offset = -0.01 if side == "right" else 0.01
            axes.text(
                jump + offset, high, f"{jump:.3f}", color=colour, fontsize=9, ha=side, va="bottom"
            )
    axes.set_xlim(ratios[0], ratios[-1])
    axes.grid(color="0.92", lw=0.7)


def _legend(figure, ncols: int = 5) -> None:
    entries = [
        Line2D([], [], color=FORWARD, marker=">", label="forward sweep"),
        Line2D([], [], color=BACKWARD, marker="<", label="backward sweep"),
        Line2D([], [], color="0.4", marker=r"$\downarrow$", ls="", label="jump, at its ratio"),
        Line2D([], [], color="k", marker="x", ls="", label="no period found"),
        Line2D([], [], color="#2f9e44", marker="o", mfc="none", ls="", label="period above 1"),
    ]
    figure.legend(
        handles=entries, loc="outside lower center", ncols=ncols, fontsize=10, frameon=False
    )


def draw_fig7(studies: Sequence[Study], folder: Path) -> None:
    """Fig. 7: the printed gap of 4 mm, which is out of reach, beside 0.4 mm."""
    figure, grid = plt.subplots(2, 2, figsize=(11, 7), layout="constrained", squeeze=False)
    for row, study in zip(grid, studies, strict=True):
        reach = stop_amplitude(
            study.formulation, np.linspace(0.9, 1.1, 2001), mass_ratio=1.5, taper=0.0
        )
        for axes, (i, gap) in zip(row, enumerate(study.curve.axes["gap"]), strict=True):
            draw_curve(axes, study.curve, (i,))
            axes.set_ylim(0, 1.12 * np.nanmax(study.curve.peak_ratio[i]))
            touch = (
                ""
                if gap < reach.max()
                else f": never touched, stop place moves {1e3 * reach.max():.2f} mm"
            )
            axes.set_title(f"{NAMES[study.formulation]}, gap {1e3 * gap:g} mm{touch}", fontsize=10)
            axes.set(xlabel=RATIO_LABEL, ylabel=PEAK_LABEL)
    figure.suptitle("Fig. 7: uniform beam, mass ratio 1.5, stop at s1 = 0.5")
    _legend(figure)
    _save(figure, folder, "fig7_gap_4mm")


def draw_responses(studies: Sequence[Study], folder: Path) -> None:
    """Figs 8 to 10: a row per formulation, a panel per taper, one limit for all panels of a row."""
    masses = studies[0].curve.axes["mass_ratio"]
    tapers = studies[0].curve.axes["taper"]
    for j, mass_ratio in enumerate(masses):
        figure, grid = plt.subplots(
            2, len(tapers), figsize=(4 * len(tapers), 8), layout="constrained", sharey="row"
        )
        for row, study in zip(grid, studies, strict=True):
            for i, axes in enumerate(row):
                draw_curve(axes, study.curve, (i, j))
                axes.set_title(f"{NAMES[study.formulation]}, taper {tapers[i]:g}", fontsize=11)
                axes.set_xlabel(RATIO_LABEL)
            row[0].set_ylabel(PEAK_LABEL)
            row[0].set_ylim(0, 1.1 * np.nanmax(study.curve.peak_ratio[:, j]))
        figure.suptitle(
            f"Fig. {8 + j}: mass ratio {mass_ratio:g}, gap 0.4 mm at s1 = 0.5, σ = 0.2 mm"
        )
        _legend(figure, 5 if len(tapers) > 2 else 3)
        _save(figure, folder, f"fig{8 + j}_mass_ratio_{mass_ratio:g}")


def draw_peaks(summary: pd.DataFrame, study: str, folder: Path) -> None:
    """Figs 11 and 12: forward peak and its frequency against gap or stop position."""
    name, along, label = {
        "gap": ("fig11_gap", "gap", "gap / σ"),
        "position": ("fig12_stop_position", "position", "stop position  s1 = x/L"),
    }[study]
    rows = summary[summary["study"] == study]
    figure, grid = plt.subplots(2, 2, figsize=(11, 7.5), layout="constrained", sharex=True)
    for column, formulation in enumerate(FORMULATIONS):
        own = rows[rows["formulation"] == formulation]
        for (taper, group), colour, marker in zip(
            own.groupby("taper"), TAPER_COLOURS, "os^D", strict=False
        ):
            x = group[along] / SIGMA if study == "gap" else group[along]
            style = {"color": colour, "marker": marker, "ms": 5, "label": f"taper {taper:g}"}
            grid[0, column].plot(x, group["peak_ratio"], **style)
            grid[1, column].plot(x, group["peak_frequency"] - 1, **style)
        grid[0, column].set_title(NAMES[formulation])
        grid[1, column].set_xlabel(label)
        for axes in grid[:, column]:
            axes.grid(color="0.92", lw=0.7)
            axes.set_ylim(0, None)
    grid[0, 0].set_ylabel(f"largest {PEAK_LABEL}")
    grid[1, 0].set_ylabel("shift of the peak  (ratio - 1)")
    grid[0, 0].legend(fontsize=9)
    other = "stop at s1 = 0.5" if study == "gap" else "gap 0.4 mm = 2 σ"
    figure.suptitle(f"Fig. {11 if study == 'gap' else 12}: forward sweeps, mass ratio 0.5, {other}")
    _save(figure, folder, name)
