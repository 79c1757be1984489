"""What `vibrojax simulate` does: one motion of a rig, under a measured drive or a harmonic one."""

import time
from typing import Any

import numpy as np

from vibrojax._tools.interrupts import stoppable
from vibrojax.cli.files import PICTURES, picture, read, target, title, watch_compilation, write
from vibrojax.cli.fit import as_options, columns_of, pairs
from vibrojax.cli.options import Simulate
from vibrojax.history.history import History
from vibrojax.measured.record import read_drive
from vibrojax.model.drives import NoDrive, PointForce
from vibrojax.model.impacting_beam import ImpactingBeam
from vibrojax.model.signals import Sampled
from vibrojax.results.saving import save_dataset
from vibrojax.results.status import Status

PERIODS = 100
"""Drive periods of a harmonic drive, unless given otherwise."""


def run_simulate(options: Simulate) -> int:
    """Simulate a motion, write data and picture, print what happened.

    Raises `ValueError` for wrong input, and where the motion diverged.
    """
    started = time.perf_counter()
    data = target("--output", options.output, (".nc",))
    drawing = target("--picture", options.picture, PICTURES)
    from vibrojax.history.simulate import simulate

    system, _ = read(options.rig, "simulate")
    drive = _drive(options, system)
    grid: dict[str, Any] = {
        name: getattr(options, name)
        for name in ("duration", "periods", "samples", "sampling_rate")
        if getattr(options, name) is not None
    }
    if not isinstance(drive.get("waveform"), Sampled) and not {"duration", "periods"} & {*grid}:
        grid["periods"] = PERIODS
    compiling = watch_compilation()
    release = options.release
    history = stoppable(simulate, system, release=release, gradient="forward", **drive, **grid)
    simulated = time.perf_counter()
    if int(history.status) != Status.completed.value:
        raise ValueError(f"The motion {Status(int(history.status)).name}: nothing is written.")

    def draw():
        return history.plot(options.quantity, options.position)

    def save(part):
        save_dataset(history.to_xarray(), part)

    written = write({data: save, drawing: picture(draw, drawing)})
    if not options.quiet:
        times = simulated - started, compiling(), time.perf_counter() - simulated
        print(_table(title("Motion", options.rig), history, times, written))
    return 0


def _drive(options: Simulate, system: ImpactingBeam) -> dict[str, Any]:
    """Return what drives the motion, as keywords of `simulate`."""
    names = ("drive", "frequency", "frequency_ratio")
    given = [name for name in names if getattr(options, name) is not None]
    undriven = isinstance(system.drive, NoDrive)
    if undriven and (given or options.release is None):
        raise ValueError(
            f"Rig file {str(options.rig)!r}: it has no table [drive], so give --release (m), and "
            "no drive."
        )
    if len(given) != 1 and not undriven:
        raise ValueError("give one of --drive RECORD.csv, --frequency and --frequency-ratio.")
    if options.drive is None:
        return {name: getattr(options, name) for name in given}
    kind = "force" if isinstance(system.drive, PointForce) else "acceleration"
    columns = columns_of(options.columns, f"{kind}=2")
    units = pairs("--units", options.units, f"{kind}=N" if kind == "force" else f"{kind}=g")
    how: dict[str, Any] = {name: getattr(options, name) for name in ("decimal", "at", "run")}
    how |= {"columns": columns, "units": units}
    try:
        return {"waveform": read_drive(options.drive, quantity=kind, **how)}
    except ValueError as error:
        raise ValueError(as_options(str(error))) from None


def _table(title: str, history: History, times: tuple[float, float, float], files: list) -> str:
    """Return the extent of the motion, its largest values and its contacts."""
    time, force = np.asarray(history.time), np.asarray(history.contact_force)
    shown = np.asarray(history.displacement())
    rows = [
        ("time", f"{time[0]:.6g} to {time[-1]:.6g} s, {time.size} samples"),
        ("largest displacement", f"{np.max(np.abs(shown)):.5g} m, relative to the base"),
    ]
    if force.shape[1]:
        touched = force != 0
        begun = int(np.sum(touched[1:] & ~touched[:-1]) + np.sum(touched[0]))
        rows.append(("largest contact force", f"{np.max(force):.5g} N"))
        rows.append(("contacts at samples", f"{begun}, {100 * np.mean(touched):.3g} % of the time"))
    total, compiling, writing = times
    rows.append(("took", f"{total:.1f} s (compiling {compiling:.1f} s), writing {writing:.1f} s"))
    if files:
        rows.append(("written", ", ".join(map(str, files))))
    return "\n".join([title, *(f"  {label:21}  {text}" for label, text in rows)])
