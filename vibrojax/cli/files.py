"""What the commands share: reading rig and frequencies, writing files, watching the clock."""

import dataclasses
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from vibrojax._tools.interrupts import in_background
from vibrojax._tools.kinds import listed
from vibrojax.cli.options import Map, Sweep
from vibrojax.io.rig_file import frequency_range, one_frequency, read_rig
from vibrojax.model.drives import NoDrive
from vibrojax.model.examples import default_rig
from vibrojax.model.impacting_beam import ImpactingBeam
from vibrojax.results.saving import whole_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES = (".png", ".svg", ".pdf")
FREQUENCIES = ("frequency", "frequency_ratio")

Settings = TypeVar("Settings", bound=Any)


def read(rig: Path | None, command: str) -> tuple[ImpactingBeam, dict[str, Any]]:
    """Return the rig of a file, else the default rig, and the keywords of its sweep.

    Raises `ValueError` for a rig that nothing drives, but where a command computes modes.
    """
    system, keywords = (default_rig(), {}) if rig is None else read_rig(rig)
    if isinstance(system.drive, NoDrive) and command not in ("modes", "simulate"):
        raise ValueError(f"Rig file {str(rig)!r}: a {command} needs the table [drive].")
    return system, keywords


def title(what: str, rig: Path | None) -> str:
    """Return the first line of a table."""
    return f"{what} of {'the default rig (dimensions assumed)' if rig is None else rig}"


def frequencies_of(options: Sweep | Map, points: int, *tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the frequencies of the options, else of a table of the rig file, else so many.

    Raises `ValueError` where they are given twice, or are none.
    """
    given = {name: getattr(options, name) for name in FREQUENCIES if getattr(options, name)}
    if len(given) > 1:
        raise ValueError("give --frequency or --frequency-ratio, one of the two.")
    for name, values in given.items():
        label = f"--{name.replace('_', '-')}"
        if len(values) == 1:
            return {name: one_frequency(label, values[0])}
        if len(values) != 3:
            raise ValueError(
                f"{label} must be START END POINTS, or one value, got {len(values)} numbers."
            )
        count = int(values[2]) if float(values[2]).is_integer() else values[2]
        return {name: frequency_range(label, (*values[:2], count))}
    for table in tables:
        if found := {name: table[name] for name in FREQUENCIES if name in table}:
            return found
    return {"frequency_ratio": frequency_range("--frequency-ratio", (0.8, 1.4, points))}


def changed(
    settings: Settings, options: Sweep | Map, names: tuple[str, ...], table: Mapping[str, Any]
) -> Settings:
    """Return settings with those that the options give, else a table of the rig file."""
    given = {name: getattr(options, name) for name in names}
    given = {name: table.get(name) if v is None else v for name, v in given.items()}
    return dataclasses.replace(settings, **{n: v for n, v in given.items() if v is not None})


def target(option: str, path: Path | None, suffixes: tuple[str, ...]) -> Path | None:
    """Refuse a file that could not be written, or a folder, which has no suffix, in time."""
    if path is None or str(path).lower() == "none":
        return None
    if suffixes and path.suffix.lower() not in suffixes:
        raise ValueError(f"{option} must end in {listed([*suffixes])}, got {str(path)!r}.")
    if suffixes and path.is_dir():
        raise ValueError(f"{option}: {str(path)!r} is a folder.")
    folder = path if path.is_dir() else path.absolute().parent
    if not folder.is_dir():
        raise ValueError(f"{option}: the folder {str(path.parent)!r} does not exist.")
    if not os.access(folder, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise ValueError(f"{option}: {str(path)!r} cannot be written, for lack of permission.")
    return path


def picture(draw: "Callable[[], Figure]", path: Path | None) -> Callable[[Path], None]:
    """Return what writes a picture in the format of a path."""
    ending = "" if path is None else path.suffix[1:]
    return lambda part: draw().savefig(part, format=ending)


def write(writers: Mapping[Path | None, Callable[[Path], object]]) -> list[Path]:
    """Write files, all of them or none, and return their paths; None is no file."""
    wanted = {path: writer for path, writer in writers.items() if path is not None}
    with whole_files(*wanted) as parts:
        for part, writer in zip(parts, wanted.values(), strict=True):
            assert part is not None
            writer(part)
    return list(wanted)


def watch_compilation() -> Callable[[], float]:
    """Return a function that says in how many seconds from now on something was compiled."""
    import jax.monitoring

    spans: list[tuple[float, float]] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.endswith(("backend_compile_duration", "jaxpr_to_mlir_module_duration")):
            now = time.perf_counter()
            spans.append((now - duration_secs, now))

    def seconds() -> float:
        total, until = 0.0, 0.0
        for begun, ended in sorted(spans):  # some side by side
            total += max(0.0, ended - max(begun, until))
            until = max(until, ended)
        return total

    jax.monitoring.register_event_duration_secs_listener(listen)
    return seconds


def import_ahead() -> None:
    """Import in the background what files and pictures will be made with."""

    def work() -> None:
        import h5netcdf  # noqa: F401
        import xarray

        import vibrojax.plot.frequency_response  # noqa: F401

        xarray.Variable((), 0.0)  # the first one looks for other packages of arrays

    in_background(work)
