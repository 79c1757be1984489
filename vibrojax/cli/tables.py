"""The tables that the commands print."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vibrojax.model.modes import Modes
from vibrojax.results.status import Status
from vibrojax.sweep.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    import pandas


def sweep_table(
    title: str,
    response: FrequencyResponse,
    times: tuple[float, float, float],
    files: Sequence[Path],
) -> str:
    """Return peak, jumps, hysteresis and status of a sweep, with times and files."""
    natural = float(response.natural_frequency)
    hertz = 1.0 if response.axis == "frequency" else natural  # of one unit of the axis
    unit = "" if response.ratio_units == "1" else f" {response.ratio_units}"
    rows: list[tuple[str, str, str]] = [("", "ratio", "Hz")]

    def at(label: str, where: float) -> None:
        there = np.isfinite(where)
        ratio = f"{where * hertz / natural:.5f}" if there else "none"
        rows.append((label, ratio, f"{where * hertz:.4f}" if there else ""))

    at("first natural frequency", natural / hertz)
    peak = np.nan
    finite = bool(np.isfinite(response.amplitude_ratio).any())
    if finite:
        highest = np.nanmax(response.amplitude_ratio)
        peak = float(response.frequencies[np.argwhere(response.amplitude_ratio == highest)[0, -1]])
        at(f"peak, amplitude ratio {highest:.5g}{unit}", peak)
    at("jump up", float(response.jump_up))
    at("jump down", float(response.jump_down))
    at("hysteresis width", float(response.hysteresis_width))
    wide = max(len(row[0]) for row in rows)
    lines = [title, *(f"  {a:{wide}}  {b:>9}  {c:>10}".rstrip() for a, b, c in rows)]

    def say(label: str, text: str) -> None:
        lines.append(f"  {label:{wide}}  {text}")

    if finite:
        if len(response.directions) == 2:
            of = "ratio x Hz" if response.axis == "frequency" else "ratio x ratio"
            say("hysteresis area", f"{float(response.hysteresis_area):9.5g}  {of}")
        say("resonance shift", f"{100 * (peak * hertz / natural - 1):+9.2f}  %")
        say("largest contact force", f"{np.nanmax(response.contact_force):9.5g}  N")
    status, period = np.asarray(response.status), np.asarray(response.period)
    counts = {s: int((status == s.value).sum()) for s in Status}
    longer = int((period > 1).sum())
    inside = f" ({longer} of period 2 or longer)" if longer else ""
    points = f"{counts[Status.settled]} settled{inside}, {counts[Status.aperiodic]} aperiodic"
    points += f", {counts[Status.diverged]} diverged"
    for ended in (Status.unbounded, Status.gave_up):
        if counts[ended]:
            points += f", {counts[ended]} {ended.name.replace('_', ' ')}"
    say(f"points, {status.size}", points)
    total, compiling, writing = times
    say("time", f"{total:.1f} s (compiling {compiling:.1f} s), writing {writing:.1f} s")
    if files:
        say("written", ", ".join(map(str, files)))
    return "\n".join(lines)


def modes_rows(found: Modes) -> "pandas.DataFrame":
    """Return a row for every mode, to the last digit."""
    import pandas

    columns = {
        "mode": np.arange(1, len(found.frequency) + 1),
        "frequency_hz": found.frequency,
        "beta": found.beta,
        "modal_mass_kg": found.modal_mass,
        "participation": found.participation,
    }
    return pandas.DataFrame({name: np.asarray(values) for name, values in columns.items()})


def modes_table(title: str, found: Modes) -> str:
    """Return a line for every mode."""
    head = f"  {'mode':>4}  {'frequency, Hz':>13}  {'beta':>10}  {'modal mass, kg':>14}"
    lines = [f"{title}, {found.formulation} formulation", f"{head}  {'participation':>13}"]
    for i, frequency, beta, mass, participation in modes_rows(found).itertuples(index=False):
        row = f"  {i:4d}  {frequency:13.6g}  {beta:10.6f}  {mass:14.6g}  {participation:13.6f}"
        lines.append(row)
    return "\n".join(lines)
