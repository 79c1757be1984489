"""What `vibrojax sweep` and `vibrojax modes` do."""

import time

from vibrojax._tools.interrupts import stoppable
from vibrojax.cli.files import (
    PICTURES,
    changed,
    frequencies_of,
    import_ahead,
    picture,
    read,
    target,
    title,
    watch_compilation,
    write,
)
from vibrojax.cli.options import Modes, Sweep
from vibrojax.cli.tables import modes_rows, modes_table, sweep_table
from vibrojax.io.rig_file import check_most
from vibrojax.io.rig_file_keys import MOST_MODES
from vibrojax.sweep.settings import SweepSettings


def run_sweep(options: Sweep) -> int:
    """Sweep a rig, write data and picture, print the table. Raises `ValueError` for wrong input."""
    started = time.perf_counter()
    data = target("--output", options.output, (".nc",))
    drawing = target("--picture", options.picture, PICTURES)
    from vibrojax.sweep.frequency_sweep import frequency_sweep

    system, asked = read(options.rig, "sweep")
    frequencies = frequencies_of(options, 121, asked)
    names = ("direction", "tolerance", "steps_per_period")
    settings = changed(asked.get("settings", SweepSettings()), options, names, {})
    compiling = watch_compilation()
    if data or drawing:
        import_ahead()
    progress = False if options.quiet else None
    response = stoppable(
        frequency_sweep, system, progress=progress, settings=settings, **frequencies
    )
    swept = time.perf_counter()
    written = write({data: response.save, drawing: picture(response.plot, drawing)})
    if not options.quiet:
        times = (swept - started, compiling(), time.perf_counter() - swept)
        print(sweep_table(title("Frequency sweep", options.rig), response, times, written))
    return 0


def run_modes(options: Modes) -> int:
    """Print the modes of a rig, write table and picture. Raises `ValueError` for wrong input."""
    table = target("--output", options.output, (".csv",))
    drawing = target("--picture", options.picture, PICTURES)
    from vibrojax.model.modes import modes

    system, _ = read(options.rig, "modes")
    count = system.num_modes if options.num_modes is None else options.num_modes
    check_most("--num-modes", count, MOST_MODES)
    found = stoppable(modes, system.beam, count, system.formulation)
    rows, drawn = modes_rows(found), picture(found.plot, drawing)
    written = write({table: lambda part: rows.to_csv(part, index=False), drawing: drawn})
    print(modes_table(title("Modes", options.rig), found))
    for path in written:
        print(f"  written  {path}")
    return 0
