"""Pictures of chirps, of cycles against frequency, and of Poincaré sections."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax._tools.checks import check_count
from vibrojax.history.crossings import check_whole
from vibrojax.history.quantities import check_quantity, observables_of, unit_and_label
from vibrojax.model.drives import BaseMotion
from vibrojax.plot.style import (
    COLORS,
    DPI,
    GREY,
    LABEL,
    SMALL,
    Picture,
    new_picture,
    outside_legend,
)

if TYPE_CHECKING:
    from vibrojax.history.cycles import Cycles
    from vibrojax.history.history import History
    from vibrojax.history.poincare import PoincareSection

BLUE = COLORS["forward"]
SMALLER = {"m": ("mm", 1e-3), "J": ("mJ", 1e-3), "W": ("mW", 1e-3)}
"""Units of axes in which the numbers of small rigs are short."""
SHOWN = 1.6
"""Drive periods shown above the highest order, at least."""


def _shown(values: np.ndarray, units: str) -> tuple[np.ndarray, str]:
    """Return values and their unit as an axis shows them: in thousandths where they are small."""
    if units in SMALLER and np.max(np.abs(values), initial=0.0) < 0.1:
        smaller, factor = SMALLER[units]
        return values / factor, smaller
    return values, units


def plot_chirp(history: "History", quantities: tuple[str, ...]) -> Figure:
    """Draw drive, quantities and frequency against time; see `History.plot_chirp`."""
    check_whole(history, "Pictures of a chirp")
    motion = history.motion
    for name in quantities:
        check_quantity(motion.equations, name)
    drive = history.system.drive
    if drive.reference[1] == "m":
        raise ValueError("Nothing drives this system: use history.plot() for its motion.")
    seen = observables_of(motion.equations)
    if not quantities:
        angle = "bearing_angle" if "bearing_angle" in seen else "displacement"
        bent = "chord_reduction" if "chord_reduction" in seen else "strain_energy"
        quantities = (angle, bent)
    time = np.asarray(history.time)
    phase, rate, _ = motion.waveform.phase(jnp.asarray(time))
    if isinstance(drive, BaseMotion):
        rows = [(np.asarray(drive.amplitude * jnp.sin(phase)), "m", "Base displacement")]
    else:
        rows = [(np.asarray(drive.input(motion.waveform, jnp.asarray(time))), "N", "Drive force")]
    rows += [(np.asarray(history.quantity(n)), *unit_and_label(n)) for n in quantities]
    rows.append((np.asarray(rate) / (2 * np.pi), "Hz", "Drive frequency"))
    figure = Picture(figsize=(10.0, 1.2 + 1.75 * len(rows)), dpi=DPI, layout="constrained")
    panels = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for panel, (values, units, label) in zip(panels, rows, strict=True):
        values, units = _shown(values, units)
        panel.plot(time, values, color=BLUE, linewidth=0.8)
        panel.set_ylabel(f"{_broken(label)}\n({units})", fontsize=SMALL)
        panel.grid(True, color="#d9d9d9", linewidth=0.7)
        panel.set_axisbelow(True)
        panel.tick_params(labelsize=SMALL)
    panels[-1].set_xlim(float(time[0]), float(time[-1]))
    panels[-1].set_xlabel("Time (s)", fontsize=LABEL)
    figure.align_ylabels(panels)
    return figure


def _broken(label: str) -> str:
    """Break a label that is longer than a panel is high."""
    if len(label) < 20:
        return label
    at = label.rfind(" ", 0, 18)
    return label if at < 0 else f"{label[:at]}\n{label[at + 1 :]}"


def plot_cycles(cycles: "Cycles", orders: Sequence[int]) -> Figure:
    """Draw the lengths of cycles against the drive frequency; see `Cycles.plot`."""
    for order in orders:
        check_count("orders", order)
    figure, axes = new_picture()
    top = max([order + SHOWN for order in orders] + [SHOWN])
    if len(cycles):
        top = max(top, float(np.quantile(cycles.drive_periods, 0.98)) * 1.08)
    over = cycles.drive_periods > top
    points = {"linestyle": "none", "color": BLUE, "markersize": 5, "alpha": 0.6}
    axes.plot(cycles.drive_frequency[~over], cycles.drive_periods[~over], "o", **points)
    for order in orders:
        axes.axhline(order, color=GREY, linewidth=1.0, linestyle=(0, (6, 3)), zorder=0.9)
    handles = [Line2D([], [], marker="o", **points)]
    labels = [f"a cycle of {unit_and_label(cycles.quantity)[1].lower()} ({len(cycles)})"]
    if over.any():
        above = points | {"alpha": 1.0, "markerfacecolor": "white"}
        axes.plot(cycles.drive_frequency[over], np.full(over.sum(), 0.99 * top), "^", **above)
        handles.append(Line2D([], [], marker="^", **above))
        labels.append(f"longer than shown ({over.sum()})")
    if orders:
        handles.append(Line2D([], [], color=GREY, linewidth=1.0, linestyle=(0, (6, 3))))
        plural = "" if list(orders) == [1] else "s"
        labels.append(f"{', '.join(str(order) for order in orders)} drive period{plural}")
    axes.set_ylim(0.0, top)
    axes.set_yticks(np.arange(0, np.ceil(top), 1 if top < 16 else 5))
    axes.set_xlabel("Drive frequency at the middle of the cycle (Hz)", fontsize=LABEL)
    axes.set_ylabel("Length of the cycle (drive periods)", fontsize=LABEL)
    outside_legend(axes, handles, labels)
    return figure


def plot_section(section: "PoincareSection", x: str, y: str) -> Figure:
    """Draw a Poincaré section; see `PoincareSection.plot`."""
    figure, axes = new_picture()
    across, across_label = section.column(x)
    up, up_label = section.column(y)
    size = 6.0 if len(section) < 200 else 3.0
    axes.plot(across, up, "o", color=BLUE, markersize=size, markeredgewidth=0, alpha=0.7)
    axes.set_xlabel(across_label, fontsize=LABEL)
    axes.set_ylabel(up_label, fontsize=LABEL)
    axes.set_title(section.title, fontsize=SMALL, loc="left")
    return figure
