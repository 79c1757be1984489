"""Pictures of the experiment."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import rig
from common import finish
from forced import NAMED, SAMPLES
from matplotlib.lines import Line2D
from rig import CONTACT_DAMPING, PRINTED

import vibrojax as vj

COLOURS = ["#0060a8", "#d1590a", "#2a7f3f", "#8a3b9b", "#7a6000", "#c2185b", "#444444"]
MODES = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9"]
SMALL, LABEL = 10, 11


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


def _save(figure, path: Path) -> None:
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _histories(panels, shown, end: float, start: float = 0.0, shift: float = 0.0) -> None:
    """Draw displacement, acceleration and contact force of some runs below each other."""
    for (name, history), colour in shown:
        time = np.asarray(history.time)
        inside = (time >= start) & (time <= end)
        moment = time[inside] - shift
        values = (
            1e3 * np.asarray(history.displacement())[inside],
            np.asarray(history.acceleration())[inside] / rig.GRAVITY,
            np.asarray(history.quantity("contact_force"))[inside],
        )
        for panel, value in zip(panels, values, strict=True):
            panel.plot(moment, value, lw=1.1, color=colour, label=name)
    panels[0].axhline(-1e3 * rig.GAP, color="k", lw=0.9, ls=(0, (4, 2)))
    _label(panels[0], "", "tip displacement (mm)", "dashed: the support")
    _label(panels[1], "", "tip acceleration (g)")
    _label(panels[2], "time (s)", "contact force (N)")
    panels[0].legend(fontsize=SMALL, loc="lower right", ncols=len(shown), bbox_to_anchor=(1, 1.0))


def draw_releases(found, rows: list[dict], path: Path) -> None:
    figure, axes = _figure(3, 2, 15, 10.5)
    some = [found[0], found[3], found[6]]
    names = [f"{1e3 * one.height:g} mm" for one in some]
    shown = list(zip(zip(names, (o.history for o in some), strict=True), COLOURS, strict=False))
    _histories(axes[:, 0], shown, 0.3)
    times, peaks, spectra = axes[:, 1]
    for one in found:
        for touch, departure in zip(one.contacts.touch, one.contacts.departure, strict=True):
            height = 1e3 * one.height
            times.plot(
                [touch, departure], [height, height], lw=9, color=COLOURS[1], solid_capstyle="butt"
            )
    for row in rows:
        end = max(row["departure_s"], default=0.0)
        times.text(
            end + 0.006, 1e3 * row["release_m"], f"{row['contacts']}", fontsize=SMALL, va="center"
        )
    times.set(xlim=(0, 0.32), ylim=(3.5, 10.5))
    _label(times, "time (s)", "release (mm)", "contacts and their number")
    height = [1e3 * row["release_m"] for row in rows]
    values = [row["peak_acceleration_g"] for row in rows]
    peaks.plot(height, values, "o-", color=COLOURS[0], label="peak acceleration")
    peaks.plot(10, PRINTED["free_acceleration"]["theory"], "*", ms=14, color=COLOURS[0])
    _label(peaks, "release (mm)", "peak tip acceleration (g)", "stars: printed theory")
    peaks.set_ylim(0, 125)
    right = peaks.twinx()
    right.plot(height, [row["peak_force_N"] for row in rows], "s--", color=COLOURS[1])
    right.plot(10, PRINTED["free_force"]["theory"], "*", ms=14, color=COLOURS[1])
    right.set_ylabel("peak contact force (N)", fontsize=LABEL, color=COLOURS[1])
    right.set_ylim(0, 12.5)
    right.tick_params(labelsize=SMALL)
    peaks.yaxis.label.set_color(COLOURS[0])
    for one, name, colour in zip(some, names, COLOURS, strict=False):
        spectra.semilogy(one.spectrum.frequency, one.spectrum.amplitude, color=colour, label=name)
    for k, natural in enumerate(some[0].spectrum.natural_frequencies[:3]):
        spectra.axvline(natural, color="0.5", lw=0.8, ls=":")
        spectra.text(natural + 4, 12, f"mode {k + 1}", fontsize=SMALL, color="0.3", va="top")
    spectra.set(xlim=(0, 500), ylim=(3e-4, 15))
    _label(spectra, "frequency (Hz)", "acceleration, peak (g)", "3.2 s, 1600 lines, no window")
    spectra.legend(fontsize=SMALL, loc="upper right")
    _save(figure, path)


def draw_forced(runs: dict, tables: dict, path: Path) -> None:
    figure, axes = _figure(3, 2, 15, 10.5)
    some = [runs["amplitude"][k] for k in (0, 4, 9)]
    end = float(some[0].history.time[-1])
    shown = [
        ((f"{one.force:g} N", one.history), colour)
        for one, colour in zip(some, COLOURS, strict=False)
    ]
    start = end - 2.2 * SAMPLES / (2 * 2.56 * 800)
    _histories(axes[:, 0], shown, end, start, shift=start)
    axes[0, 0].set_title("last 2 periods; dashed: the support", fontsize=LABEL, loc="left")
    quantities = (("acceleration_g", "peak tip acceleration (g)"), ("force_N", "peak force (N)"))
    for (reading, rows), colour in zip(tables.items(), COLOURS, strict=False):
        force = [row["force_N"] for row in rows]
        for panel, (name, label) in zip(axes[:2, 1], quantities, strict=True):
            panel.plot(
                force,
                [r[f"peak_{name}"] for r in rows],
                "o-",
                color=colour,
                label=f"F is the {reading}: steady",
            )
            panel.plot(
                force,
                [r[f"start_up_{name}"] for r in rows],
                "^--",
                color=colour,
                mfc="w",
                label=f"F is the {reading}: first 2 s from rest",
            )
            _label(panel, "force F of Table 1 (N)", label)
        style = {"color": colour, "marker": "o", "label": f"F is the {reading}"}
        for side, line in ((1, "-"), (0, "--")):
            axes[2, 1].plot(force, [1e3 * r["tip_m"][side] for r in rows], ls=line, **style)
            style["label"] = None
    for panel, name in zip(axes[:2, 1], ("forced_acceleration", "forced_force"), strict=True):
        panel.plot(12, PRINTED[name]["theory"], "*", ms=15, color="k", label="printed theory, 12 N")
        panel.plot(12, PRINTED[name]["experiment"], "X", ms=10, color="k", label="experiment, 12 N")
        panel.set_ylim(0, None)
    axes[0, 1].set_ylim(0, 330)
    axes[0, 1].legend(fontsize=SMALL, ncols=2, loc="upper left")
    axes[2, 1].axhline(-1e3 * rig.GAP, color="k", lw=0.9, ls=(0, (4, 2)))
    axes[2, 1].set_ylim(-6, 12)
    title = "steady highest (solid) and lowest (dashed) tip displacement"
    _label(axes[2, 1], "force F of Table 1 (N)", "tip displacement (mm)", title)
    axes[2, 1].legend(fontsize=SMALL, loc="upper left")
    _save(figure, path)


def draw_spectra(runs, tables: dict, path: Path) -> None:
    some = [runs[k] for k in (0, 4, 9)]
    figure, axes = _figure(4, 1, 14, 14, height_ratios=(1, 1, 1, 1.5))
    for panel, one, colour in zip(axes[:3, 0], some, COLOURS, strict=False):
        panel.semilogy(one.spectrum.frequency, one.spectrum.amplitude, lw=1.1, color=colour)
        for k, natural in enumerate(one.spectrum.natural_frequencies[:4]):
            panel.axvline(natural, color="0.5", lw=0.8, ls=":")
            if one is some[0]:
                words = f"mode {k + 1}, {natural:.1f} Hz"
                panel.text(natural + 4, 70, words, fontsize=SMALL, color="0.3")
        for peak in one.spectrum.peaks(40):
            if peak.drive_order in NAMED:
                at = (peak.frequency, peak.amplitude)
                panel.annotate(
                    f"{peak.drive_order:g}x",
                    at,
                    xytext=(0, 2),
                    fontsize=SMALL,
                    textcoords="offset points",
                    ha="center",
                )
        panel.set(xlim=(0, 800), ylim=(1e-3, 200))
        _label(panel, "", "acceleration, peak (g)", f"{one.force:g} N")
    axes[0, 0].set_title(
        f"{some[0].force:g} N; 6x: six times the 16 Hz of the force", fontsize=LABEL, loc="left"
    )
    axes[2, 0].set_xlabel("frequency (Hz)", fontsize=LABEL)
    bottom, rows = axes[3, 0], tables["amplitude"]
    marks = ("o-", "s-", "^-", "D--", "v--")
    force = [row["force_N"] for row in rows]
    for (order, name), style, colour in zip(NAMED.items(), marks, COLOURS, strict=False):
        values = [r["lines_over_16_Hz"][f"{order}"] * r["line_at_16_Hz_g"] for r in rows]
        bottom.semilogy(force, values, style, color=colour, label=f"{order}x: {name}")
    bottom.set(ylim=(0.2, 30), xlim=(0, 36))
    bottom.set_yticks([0.2, 0.5, 1, 2, 5, 10, 20], ["0.2", "0.5", "1", "2", "5", "10", "20"])
    _label(bottom, "force amplitude (N)", "line, peak (g)", "lines of the tip acceleration")
    bottom.legend(fontsize=SMALL, loc="center right")
    _save(figure, path)


def draw_receptance(
    curve: vj.sweep.FrequencyResponse, rest, forces: list[float], path: Path
) -> None:
    figure, axes = _figure(1, 2, 16, 8.2, sharey=True)
    fixed, swept = axes[0]
    fine = np.linspace(10, 25, 1501)
    for panel in (fixed, swept):
        panel.semilogy(fine, 1e3 * rig.linear_receptance(fine), color="k", lw=1.0, ls=":")
    for k, colour in zip(range(len(forces)), COLOURS, strict=False):
        fixed.semilogy(rest.frequency, 1e3 * rest.receptance[k], "o-", color=colour, lw=1.5, ms=5)
        for d, (mark, style) in enumerate((((">", "-")), ("<", (0, (5, 1.6))))):
            values = 1e3 * np.asarray(curve.receptance[k, d])
            swept.semilogy(curve.frequencies, values, color=colour, ls=style, lw=1.5)
            shown = np.arange((3 * k) % 7, len(values), 7)
            swept.plot(curve.frequencies[shown], values[shown], mark, color=colour, ms=6)
            odd = np.asarray(curve.period[k, d]) == 0
            swept.plot(curve.frequencies[odd], values[odd], "o", mfc="w", mec=colour, ms=4.5)
            jump = float((curve.jump_down, curve.jump_up)[d][k])
            if np.isfinite(jump):
                ends = np.interp([jump - 0.25, jump + 0.25], curve.frequencies, values)
                ends = ends if d == 0 else ends[::-1]
                style = {"arrowstyle": "-|>", "color": colour, "lw": 1.2}
                swept.annotate("", (jump, ends[1]), (jump, ends[0]), arrowprops=style)
    _label(
        fixed,
        "frequency (Hz)",
        "rms of tip displacement over rms of force (mm/N)",
        "every whole frequency by itself, from rest",
    )
    _label(swept, "frequency (Hz)", "", "swept up (>, solid) and down (<, dashed)")
    handles = [
        Line2D([], [], color=c, lw=3, label=f"{f:g} N rms")
        for f, c in zip(forces, COLOURS, strict=False)
    ]
    handles.append(Line2D([], [], color="k", ls=":", label="linear"))
    fixed.legend(handles=handles, fontsize=SMALL, loc="upper left")
    more = [
        Line2D([], [], color="0.3", marker=">", label="up"),
        Line2D([], [], color="0.3", marker="<", ls=(0, (5, 1.6)), label="down"),
        Line2D([], [], color="0.3", marker="o", mfc="w", ls="none", label="no period found"),
        Line2D([], [], color="0.3", marker=r"$\updownarrow$", ms=11, ls="none", label="jump"),
    ]
    swept.legend(handles=more, fontsize=SMALL, loc="upper left", ncols=2)
    fixed.set(xlim=(10, 25), ylim=(0.1, 20))
    swept.set_xlim(10, 25)
    fixed.set_yticks([0.1, 0.2, 0.5, 1, 2, 5, 10], ["0.1", "0.2", "0.5", "1", "2", "5", "10"])
    _save(figure, path)


def draw_energy(
    energies: dict[str, vj.history.EnergyFlow], driven: vj.history.EnergyFlow, path: Path
) -> None:
    figure, axes = _figure(2, 2, 15, 10)
    shares, totals, losses, forced = axes.flat
    with_stop, without = energies["with"], energies["without"]
    _shares(shares, with_stop, 0.0, 0.25, "10 mm release: share of every mode")
    for name, energy, style in (("with", with_stop, "-"), ("without", without, "--")):
        left = energy.total / energy.total[0]
        totals.semilogy(energy.time, left, style, color=COLOURS[0], label=f"{name} the support")
    totals.set(xlim=(0, 1.6), ylim=(1e-3, 1.5))
    _label(totals, "time (s)", "energy left (1)", "10 mm release: energy of beam and support")
    totals.legend(fontsize=SMALL)
    lines = [("contact", with_stop.contact_loss.sum(axis=1), "k", "-")]
    lines += [(f"mode {m + 1}", with_stop.beam_loss[:, m], MODES[m], "-") for m in range(5)]
    lines += [("mode 1, without the support", without.beam_loss[:, 0], MODES[0], "--")]
    for name, values, colour, style in lines:
        losses.semilogy(
            with_stop.time, np.maximum(values, 1e-9) * 1e3, style, color=colour, label=name
        )
    losses.set(xlim=(0, 1.6), ylim=(1e-3, 30))
    _label(losses, "time (s)", "energy lost so far (mJ)", "10 mm release: where it was lost")
    losses.legend(fontsize=SMALL, loc="lower right", ncols=2)
    end = float(driven.time[-1])
    _shares(
        forced, driven, end - 4 / 16, end, "11.8 N at 16 Hz, last 4 periods: share of every mode"
    )
    _save(figure, path)


def _shares(panel, energy: vj.history.EnergyFlow, start: float, end: float, title: str) -> None:
    inside = (energy.time >= start) & (energy.time <= end)
    for m in range(energy.share.shape[1]):
        share = np.maximum(energy.share[inside, m], 1e-7)
        panel.semilogy(energy.time[inside] - start, share, color=MODES[m], label=f"mode {m + 1}")
    panel.set(xlim=(0, end - start), ylim=(1e-5, 2))
    _label(panel, "time (s)", "share of the energy of the beam (1)", title)
    panel.legend(fontsize=SMALL, loc="lower right", ncols=5)


def draw_peaks(results: dict, path: Path) -> None:
    figure, axes = _figure(2, 2, 15, 10.5)
    (acceleration, modes), (force, filtered) = axes
    table = results["against_damping"]
    damping, within = table["damping"], table["within_3_percent"]["both"]
    acceleration.plot(damping, table["acceleration_g"], "o-", color=COLOURS[0], label="peak", ms=4)
    acceleration.plot(
        damping,
        table["analyser_g"],
        "s--",
        color=COLOURS[2],
        ms=4,
        label="through the analyser's 500 Hz",
    )
    force.plot(damping, table["force_N"], "o-", color=COLOURS[0], label="peak", ms=4)
    pairs = ((acceleration, "free_acceleration", "g"), (force, "free_force", "N"))
    for panel, name, unit in pairs:
        printed = PRINTED[name]["theory"]
        panel.axhspan(
            0.97 * printed,
            1.03 * printed,
            color=COLOURS[1],
            alpha=0.2,
            label=f"printed theory {printed:g} {unit}, 3 %",
        )
        if within:
            panel.axvspan(
                *within,
                color="0.5",
                alpha=0.25,
                label=f"both hold: {within[0]:g} to {within[1]:g} N s/m",
            )
        panel.axvline(CONTACT_DAMPING, color="k", lw=1, ls=":", label=f"chosen {CONTACT_DAMPING:g}")
        panel.set_xlim(0, max(damping))
    _label(
        acceleration,
        "contact damping c1 (N s/m)",
        "peak tip acceleration (g)",
        "10 mm release, 5 modes",
    )
    _label(force, "contact damping c1 (N s/m)", "peak contact force (N)", "10 mm release, 5 modes")
    acceleration.legend(fontsize=SMALL, loc="upper left")
    force.legend(fontsize=SMALL, loc="upper right")
    for (name, rows), colour in zip(results["against_modes"].items(), COLOURS, strict=False):
        modes.plot(rows["modes"], rows["first_contact_g"], "o-", color=colour, label=name)
        filtered.plot(rows["modes"], rows["analyser_g"], "s-", color=colour, label=name)
    _label(
        modes,
        "number of modes",
        "peak tip acceleration (g)",
        "first contact: no limit where the force jumps at touch",
    )
    _label(
        filtered,
        "number of modes",
        "peak tip acceleration (g)",
        "through the analyser's 500 Hz: a limit for every law",
    )
    for panel in (modes, filtered):
        panel.set_xticks(rows["modes"])
        panel.set_ylim(0, None)
        panel.legend(fontsize=SMALL)
    _save(figure, path)
