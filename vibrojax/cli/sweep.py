"""What `vibrojax sweep` and `vibrojax modes` do."""

import time
from pathlib import Path
from typing import NamedTuple

from vibrojax._tools.interrupts import stoppable
from vibrojax.cli.files import PICTURES, check_driven, read, target, watch_compilation
from vibrojax.cli.tables import modes_csv, modes_table, sweep_table, title
from vibrojax.io.rig_file import check_most, frequency_range
from vibrojax.io.rig_file_keys import MOST_MODES
from vibrojax.results.saving import whole_files

DEFAULT_RANGE = (0.8, 1.4, 121)


class SweepOptions(NamedTuple):
    """Options of `vibrojax sweep`, which explains them."""

    rig: Path | None
    frequency_ratio: tuple[float, float, int] | None
    frequency: tuple[float, float, int] | None
    direction: str | None
    tolerance: float | None
    steps_per_period: int | None
    output: Path
    picture: Path
    quiet: bool


def run_sweep(options: SweepOptions) -> int:
    """Sweep a rig, write data and picture, print the table. Raises `ValueError` for wrong input."""
    started = time.perf_counter()
    data = target("--output", options.output, (".nc",))
    drawing = target("--picture", options.picture, PICTURES)
    if options.frequency is not None and options.frequency_ratio is not None:
        raise ValueError("give --frequency or --frequency-ratio, one of the two.")
    from vibrojax.sweep.frequency_sweep import frequency_sweep

    system, settings = read(options.rig)
    check_driven(options.rig, system, "sweep")
    for name in ("frequency", "frequency_ratio"):
        given = getattr(options, name)
        if given is not None:
            settings.pop("frequency", None)
            settings.pop("frequency_ratio", None)
            settings[name] = frequency_range(f"--{name.replace('_', '-')}", given)
    if not {"frequency", "frequency_ratio"} & settings.keys():
        settings["frequency_ratio"] = frequency_range("--frequency-ratio", DEFAULT_RANGE)
    for name in ("direction", "tolerance", "steps_per_period"):
        if getattr(options, name) is not None:
            settings[name] = getattr(options, name)
    compiling = watch_compilation()
    progress = False if options.quiet else None
    response = stoppable(frequency_sweep, system, progress=progress, **settings)
    swept = time.perf_counter()
    with whole_files(data, drawing) as (data_part, drawing_part):
        if data_part is not None:
            response.save(data_part)
        if drawing_part is not None and drawing is not None:
            response.plot().savefig(drawing_part, format=drawing.suffix[1:])
    if not options.quiet:
        times = (swept - started, sum(compiling), time.perf_counter() - swept)
        table = sweep_table(title("Frequency sweep", options.rig), response, times, (data, drawing))
        print(table)
    return 0


def run_modes(
    rig: Path | None, num_modes: int | None, output: Path | None, picture: Path | None
) -> int:
    """Print the modes of a rig, write table and picture. Raises `ValueError` for wrong input."""
    table = target("--output", output, (".csv",))
    drawing = target("--picture", picture, PICTURES)
    from vibrojax.model.modes import modes as solve

    system, _ = read(rig)
    count = system.num_modes if num_modes is None else num_modes
    check_most("--num-modes", count, MOST_MODES)
    found = stoppable(solve, system.beam, count, system.formulation)
    with whole_files(table, drawing) as (table_part, drawing_part):
        if table_part is not None:
            table_part.write_text(modes_csv(found))
        if drawing_part is not None and drawing is not None:
            found.plot().savefig(drawing_part, format=drawing.suffix[1:])
    print(modes_table(title("Modes", rig), found))
    for path in (table, drawing):
        if path is not None:
            print(f"  written  {path}")
    return 0
