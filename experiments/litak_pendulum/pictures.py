"""Pictures of the experiment."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from common import finish
from matplotlib.colors import BoundaryNorm, ListedColormap, TwoSlopeNorm
from matplotlib.patches import Patch
from pendulum import FREQUENCIES, INFERRED, PRINTED
from PIL import Image

import vibrojax as vj

BLUE, RED, GREEN, GREY, GOLD = "#0072b2", "#d55e00", "#009e73", "#7f7f7f", "#e69f00"
SMALL, LABEL = 10, 11
KINDS = {0: ("nonperiodic", RED, "^"), 1: ("period 1", BLUE, "o"), 3: ("period 3", GREEN, "s")}
KINDS |= {5: ("period 5", GOLD, "*"), -1: ("other period", GREY, "D")}


def _figure(rows: int, columns: int, width: float, height: float, **more):
    figure, axes = plt.subplots(
        rows, columns, figsize=(width, height), layout="constrained", squeeze=False, **more
    )
    for panel in axes.flat:
        finish(panel)
    return figure, axes


def _label(panel, x: str, y: str, title: str = "") -> None:
    panel.set_xlabel(x, fontsize=LABEL)
    panel.set_ylabel(y, fontsize=LABEL)
    panel.set_title(title, fontsize=LABEL, loc="left")


def save(figure, path: Path) -> None:
    figure.savefig(path, dpi=100)
    plt.close(figure)
    shrink(path)


def shrink(path: Path) -> None:
    """Keep 64 colours, which is a third of the size."""
    with Image.open(path) as image:
        small = image.convert("RGB").quantize(64)
    small.save(path, optimize=True)


def draw_potential(found: dict, path: Path) -> None:
    figure, axes = _figure(1, 2, 13, 4.8)
    angle = np.array(found["bearing_angle_rad"])
    for panel in axes[0]:
        panel.plot(angle, 1e3 * np.array(found["rigid_normalised"]), color=BLUE, lw=2.2)
        style = {"color": RED, "lw": 1.8, "ls": (0, (5, 2))}
        panel.plot(angle, 1e3 * np.array(found["elastic_normalised"]), **style)
    whole, near = axes[0]
    whole.set_ylim(-13, 6)
    whole.legend(["rigid", "elastic, bent as it rests"], fontsize=SMALL, loc="upper center")
    _label(whole, "bearing angle (rad)", "V / (weight moment), 0 upright (1e-3)", "two wells")
    well = found["well"]
    near.plot(
        well["bearing_angle_rad"], -1e3 * well["depth_J"] / found["weight_J"], "o", color=RED, ms=8
    )
    near.set(xlim=(0.1465, 0.1495), ylim=(-11.4, -10.6))
    words = f"elastic: rests at {well['bearing_angle_rad']:.4f} rad, {1e6 * well['depth_J']:.1f} µJ"
    _label(near, "bearing angle (rad)", "V / (weight moment) (1e-3)", words)
    save(figure, path)


def draw_chirp(history: vj.history.History, path: Path) -> None:
    save(history.plot_chirp(), path)


def draw_cycles(found: dict, reference: dict | None, path: Path) -> None:
    """Cycle lengths beside the reference table, which is that of another program."""
    figure, axes = _figure(2, 1, 10, 8, sharex=True, height_ratios=(1.5, 1))
    top, bottom = axes[:, 0]
    cycle, rows = found["cycle"], found["bins"]
    length = np.array(cycle["drive_periods"])
    shown = np.minimum(length, 10.7)
    top.plot(cycle["frequency_Hz"], shown, "o", ms=4, alpha=0.45, color=BLUE, mew=0)
    middle = [(row["from_Hz"] + row["to_Hz"]) / 2 for row in rows]
    top.plot(middle, [row["median"] for row in rows], "D", color="k", ms=6, label="median")
    for order in (1, 3, 5):
        top.axhline(order, color=GREY, lw=0.9, ls=(0, (5, 3)), zorder=0.5)
    top.set(ylim=(0, 11), yticks=range(0, 12))
    words = f"{found['cycles']} cycles of the bearing angle, {found['starts']} starts"
    _label(top, "", "cycle length (drive periods)", words)
    top.legend(fontsize=SMALL)
    for name, colour, label in (("share_of_3", GREEN, "of 3"), ("share_of_5", GOLD, "of 5")):
        value = [row[name] for row in rows]
        bottom.plot(middle, value, "o-", color=colour, label=f"cycles {label} drive periods")
        if reference:
            key = "frac3" if name == "share_of_3" else "frac5"
            other = [bin[key] for bin in reference["table"].values()]
            bottom.plot(middle, other, "x--", color=colour, ms=8, label=f"{label}, reference")
    bottom.set(ylim=(-0.05, 1.05), xlim=(2, 9))
    bottom.legend(fontsize=SMALL, ncols=2, loc="center right")
    _label(bottom, "drive frequency (Hz)", "share of cycles")
    save(figure, path)


def draw_waveforms(histories: vj.history.Histories, found: dict, path: Path) -> None:
    figure, axes = _figure(5, 1, 12, 13)
    links = found["links"]
    for k, (frequency, panel) in enumerate(zip(FREQUENCIES, axes[:, 0], strict=True)):
        history = histories[k]
        time = np.asarray(history.time)
        shown = time >= time[-1] - 15.0 / frequency
        angle = np.asarray(history.quantity("bearing_angle"))[shown]
        base = 6.33 * np.sin(2 * np.pi * frequency * time[shown])
        moment = time[shown] - time[shown][0]
        panel.plot(moment, angle, color=RED, lw=1.6)
        panel.set_ylim(-0.2, 0.2)
        panel.set_xlim(0, moment[-1])
        other = panel.twinx()
        other.plot(moment, base, color=BLUE, lw=1.0, ls=(0, (4, 1.5)))
        other.set_ylim(-16, 16)
        other.set_ylabel("base (mm)", fontsize=SMALL, color=BLUE)
        period = links["period"][k]
        words = _periods(period)
        exponent = links["lyapunov_per_s"][k]
        printed = PRINTED[frequency]
        title = (
            f"{frequency:g} Hz: {words} from {len(period)} starts, exponent "
            f"{np.mean(exponent):+.1f} 1/s (printed: {f'period {printed}' if printed else 'none'})"
        )
        _label(panel, "time (s)" if k == 4 else "", "bearing (rad)", title)
        panel.yaxis.label.set_color(RED)
    save(figure, path)


def _periods(period: list[int]) -> str:
    values = sorted(set(period))
    return " or ".join("no period" if p == 0 else f"period {p}" for p in values)


def draw_map(found: dict, path: Path) -> None:
    """Period numbers and exponents over frequency and base amplitude."""
    figure, axes = _figure(2, 1, 11, 9.5, sharex=True)
    x, y = np.array(found["frequency_Hz"]), 1e3 * np.array(found["base_amplitude_m"])
    period, exponent = np.array(found["period"]), np.array(found["lyapunov_per_s"])
    category = np.select(
        [period == 0, period == 1, period == 2, period == 3, period == 5], [0, 1, 2, 3, 4], 6
    )
    category = np.where((period > 3) & (period % 3 == 0), 5, category)
    words = ["no period", "period 1", "period 2", "period 3", "period 5", "6, 9, ...", "other"]
    colours = ["#f0e0d6", BLUE, "#56b4e9", GREEN, "#000000", "#7fcfb5", GREY]
    upper, lower = axes[:, 0]
    shades = ListedColormap(colours)
    norm = BoundaryNorm(np.arange(8) - 0.5, 7)
    upper.pcolormesh(x, y, category, cmap=shades, norm=norm, rasterized=True)
    present = [k for k in range(7) if (category == k).any()]
    handles = [Patch(fc=colours[k], ec="0.4", label=words[k]) for k in present]
    place = {"loc": "lower right", "bbox_to_anchor": (1, 1), "ncols": len(present)}
    upper.legend(handles=handles, fontsize=SMALL, frameon=False, **place)
    _label(upper, "", "base amplitude (mm)")
    most = np.nanmax(np.abs(exponent))
    norm = TwoSlopeNorm(0.0, max(np.nanmin(exponent), -most), most)
    drawn = lower.pcolormesh(x, y, exponent, cmap="RdBu_r", norm=norm, rasterized=True)
    bar = figure.colorbar(drawn, ax=lower, pad=0.01)
    bar.set_label("largest Lyapunov exponent (1/s)", fontsize=SMALL)
    _label(lower, "drive frequency (Hz)", "base amplitude (mm)")
    for panel in (upper, lower):
        panel.grid(False)
        panel.axhline(1e3 * INFERRED["base_amplitude"][0], color="k", lw=0.8, ls=(0, (5, 3)))
        for frequency in FREQUENCIES:
            panel.plot(frequency, 1e3 * INFERRED["base_amplitude"][0], "kx", ms=8, mew=1.8)
    save(figure, path)


def draw_bifurcation(diagram: vj.regime.BifurcationDiagram, path: Path) -> None:
    figure, axes = _figure(2, 1, 11, 8.5, sharex=True, height_ratios=(2, 1))
    upper, lower = axes[:, 0]
    x = np.asarray(diagram.values)
    points = np.asarray(diagram["displacement"])
    styles = {"forward": (BLUE, "o", "upwards"), "backward": (RED, "x", "downwards")}
    for k, way in enumerate(diagram.directions):
        colour, mark, word = styles[way]
        shift = (k - 0.5) * 0.3 * (x[1] - x[0])
        places = np.repeat(x + shift, points.shape[-1])
        style = {"color": colour, "marker": mark, "ls": "none", "mew": 0.6 if k else 0}
        upper.plot(places, 1e3 * points[k].ravel(), ms=2.5, alpha=0.7, **style)
        size = {"ms": 6, "mfc": "none", "mew": 1.3}
        lower.plot(x, diagram.period[k], color=colour, marker=mark, ls="none", label=word, **size)
    _label(upper, "", "tip displacement at phase 0 (mm)", "carried along the frequency")
    longest = max(3, int(np.max(diagram.period)))
    orders = [n for n in (1, 3, 6, 9, 12, 15, 18) if n <= longest]
    lower.set_yticks([0, *orders], ["none", *map(str, orders)])
    lower.set_ylim(-0.5, longest + 0.8)
    _label(lower, "drive frequency (Hz)", "period (drive periods)")
    lower.legend(fontsize=SMALL, ncols=2)
    save(figure, path)


def draw_energies(found: dict, path: Path) -> None:
    figure, axes = _figure(3, 1, 11, 11, sharex=True)
    x = np.array(found["frequency_Hz"])
    kind = np.array(found["kind"])
    rows = (
        ("chord_reduction_max", 1e3, "largest chord\nreduction (mm)"),
        ("strain_energy_mean", 1e6, "mean strain\nenergy (µJ)"),
        ("strain_power_rms", 1e3, "strain power,\nrms (mW)"),
    )
    for panel, (name, factor, label) in zip(axes[:, 0], rows, strict=True):
        values = factor * np.array(found[name])
        for key, (word, colour, mark) in KINDS.items():
            own = kind == key
            if own.any():
                places = np.broadcast_to(x, kind.shape)[own]
                style = {"ls": "none", "ms": 5.5, "alpha": 0.6, "mew": 0}
                panel.plot(places, values[own], mark, color=colour, label=word, **style)
        _label(panel, "", label)
    axes[0, 0].legend(fontsize=SMALL, loc="upper left")
    axes[-1, 0].set_xlabel("drive frequency (Hz)", fontsize=LABEL)
    save(figure, path)


def draw_basins(found: vj.regime.Basins, path: Path) -> None:
    save(found.plot(), path)


def draw_search(found: dict, sensitivity: dict, path: Path) -> None:
    """How often each regime is as printed, and what the inferred numbers do."""
    figure, axes = _figure(1, 2, 14, 7.5, width_ratios=(1, 1.5))
    left, right = axes[0]
    names = [*found["all"]["each_as_printed"], "all four", "7.8: period 5"]
    for k, (part, colour) in enumerate((("wide", BLUE), ("near_the_inferred", RED))):
        one = found[part]
        values = [*one["each_as_printed"].values(), one["share_kept"]]
        values.append(one["period_5_at_7.8"] / one["draws"])
        places = np.arange(len(names)) + 0.36 * (k - 0.5)
        bars = left.barh(places, values, 0.34, color=colour, label=part.replace("_", " "))
        left.bar_label(bars, [f"{100 * v:.1f} %" for v in values], fontsize=SMALL, padding=3)
    left.set_yticks(
        range(len(names)), [f"{n} Hz" if "." in n and ":" not in n else n for n in names]
    )
    left.invert_yaxis()
    left.set_xlim(0, 1.15)
    left.legend(fontsize=SMALL, loc="lower right")
    _label(left, "share of draws", "", f"{found['all']['draws']} draws: regime as printed")
    rows = sensitivity["rows"]
    table = np.array([list(row["share_as_printed"].values()) for row in rows])
    right.imshow(table, cmap="Greens", vmin=0, vmax=1.4, aspect="auto")
    words = [
        "as inferred" if r["number"] == "none" else f"{r['number']} {100 * r['change']:+.0f} %"
        for r in rows
    ]
    right.set_yticks(range(len(rows)), words, fontsize=9)
    right.set_xticks(range(5), [f"{f:g} Hz" for f in FREQUENCIES])
    right.grid(False)
    for i, row in enumerate(rows):
        for j, f in enumerate(FREQUENCIES):
            periods = sorted(set(row["period"][str(f)]))
            text = ", ".join("none" if p == 0 else str(p) for p in periods)
            right.text(j, i, text, ha="center", va="center", fontsize=8)
    _label(right, "", "", "period found; shade: share of starts as printed")
    save(figure, path)
