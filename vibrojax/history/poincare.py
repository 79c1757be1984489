"""Poincaré sections of a history: by the phase of the drive, or by crossings of a level."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrojax._tools.checks import check_choice, check_known, check_range
from vibrojax._tools.signatures import validated
from vibrojax.history.crossings import crossings, curve_through
from vibrojax.history.quantities import (
    observable_motion,
    observables_of,
    quantity_of,
    table,
    unit_and_label,
)
from vibrojax.history.samples import SampledMotion, times_of

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


DIRECTIONS = ("upwards", "downwards", "both")
NEWTON_STEPS = 4
"""Of finding when the drive has a phase; the phase between two samples is nearly straight."""


@dataclass(frozen=True, eq=False, repr=False)
class PoincareSection:
    """The points of one history in a section, in order of time."""

    time: Float[np.ndarray, " points"]
    """s."""
    drive_phase: Float[np.ndarray, " points"]
    """Phase of the drive, rad, from 0 to 2 pi."""
    values: dict[str, Float[np.ndarray, " points"]]
    """`displacement` (m) and `velocity` (m/s), and every observable with its `..._rate`."""
    quantity: str
    """What is drawn, or passes the level."""
    level: float | None
    """At which the quantity passes, in its unit; None: a section by the phase of the drive."""
    direction: str
    """Crossings counted: `upwards`, `downwards`, `both`; empty without a level."""

    def __len__(self) -> int:
        return self.time.size

    @property
    def title(self) -> str:
        """What the section is, in words."""
        if self.level is None:
            phase = float(self.drive_phase[0]) if len(self) else 0.0
            return f"once a drive period, at phase {phase:.4g} rad: {len(self)} points"
        units, label = unit_and_label(self.quantity)
        way = "crossed" if self.direction == "both" else f"crossed {self.direction}"
        return f"{label} {self.level:g} {units} {way}: {len(self)} points"

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over point, with units and long names."""
        columns = {n: (v, *_unit_and_label(n)) for n, v in self._columns.items()}
        return table("point", columns, {"section": self.title, "quantity": self.quantity})

    @property
    def _columns(self) -> dict[str, Float[np.ndarray, " points"]]:
        return {"time": self.time, "drive_phase": self.drive_phase} | self.values

    @validated
    def plot(self, x: str | None = None, y: str | None = None) -> "Figure":
        """Draw one variable against another, by default the rate of the quantity against it.

        Where the quantity has a given level: its rate against the phase of the drive. Raises
        `ValueError` for a variable that is not there.

        `x` and `y` are names of variables of the dataset: of the abscissa and the ordinate.
        """
        x = (self.quantity if self.level is None else "drive_phase") if x is None else x
        y = rate_name(self.quantity) if y is None else y
        for name in (x, y):
            check_known("variable", name, self._columns)
        from vibrojax.plot.history import plot_section

        return plot_section(self.to_xarray(), x, y)

    def __repr__(self) -> str:
        return f"PoincareSection({self.title}, {', '.join(self.values)})"


def rate_name(quantity: str) -> str:
    """Return the name of the rate of a quantity."""
    named = {"displacement": "velocity", "strain_energy": "strain_power"}
    return named.get(quantity, f"{quantity}_rate")


def _unit_and_label(name: str) -> tuple[str, str]:
    if name == "time":
        return "s", "Time"
    if name.endswith("_rate"):
        units, label = unit_and_label(name.removesuffix("_rate"))
        return f"{units}/s", f"Rate of {label[:1].lower()}{label[1:]}"
    return unit_and_label(name)


def section_of(
    history: SampledMotion,
    quantity: str,
    level: float | int | None,
    direction: str,
    phase: float | int,
    start: float | int,
) -> PoincareSection:
    """Return a Poincaré section; see `History.poincare`."""
    check_choice("direction", direction, DIRECTIONS)
    equations = history.motion.equations
    check_choice("quantity", quantity, ("displacement", *observables_of(equations)))
    time = times_of(history, "Poincaré sections")
    allowed = f"at most {time[-1]:.6g} s, the end of the history"
    check_range("start", start, -np.inf, float(time[-1]), allowed=allowed)
    if level is None:
        check_range("phase", phase, allowed="a finite number of rad")
        if history.system.drive.reference[1] == "m":
            raise ValueError(
                "Nothing drives this system, so it has no phase: give a level to cut the motion by."
            )
        times = strobe_times(history, float(phase))
    else:
        check_range("level", level, allowed="a finite number")
        curve = curve_through(time, *quantity_of(history, quantity))
        times = crossings(curve, float(level), direction)
    times = times[times >= start]
    values: dict[str, Float[np.ndarray, " points"]] = {}
    for name in ("displacement", *observables_of(equations)):
        value, rate, second = observable_motion(history, name)
        values[name] = curve_through(time, value, rate)(times)
        values[rate_name(name)] = curve_through(time, rate, second)(times)
    if level is None:
        drive_phase = np.full(len(times), float(phase) % (2 * np.pi))
    else:
        at, _, _ = history.motion.waveform.phase(jnp.asarray(times))
        drive_phase = np.asarray(at) % (2 * np.pi)
    return PoincareSection(
        time=times,
        drive_phase=drive_phase,
        values=values,
        quantity=quantity,
        level=None if level is None else float(level),
        direction="" if level is None else direction,
    )


def strobe_times(history: SampledMotion, phase: float) -> Float[np.ndarray, " strobes"]:
    """Return when the drive has a phase (rad, modulo 2 pi) within a history, s."""
    time = np.asarray(history.time)
    waveform = history.motion.waveform
    turned = np.asarray(waveform.phase(jnp.asarray(time))[0])
    slack = 1e-9  # of a period: the ends of a run are at whole periods to round-off
    first = np.ceil((turned[0] - phase) / (2 * np.pi) - slack)
    last = np.floor((turned[-1] - phase) / (2 * np.pi) + slack)
    wanted = phase + 2 * np.pi * np.arange(first, last + 1)
    times = np.interp(wanted, turned, time)
    for _ in range(NEWTON_STEPS):
        at, rate, _ = (np.asarray(part) for part in waveform.phase(jnp.asarray(times)))
        times = np.clip(times - (at - wanted) / rate, time[0], time[-1])
    return times
