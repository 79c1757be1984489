"""What `vibrojax map` does: axes from options and rig file, the map, its pictures and table."""

import os
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from math import prod
from pathlib import Path
from typing import Any

import xarray

from vibrojax._tools.described import AbstractSettings
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.cli.files import (
    FREQUENCIES,
    PICTURES,
    changed,
    frequencies_of,
    picture,
    read,
    target,
    title,
    watch_compilation,
    write,
)
from vibrojax.cli.fit import check_names, number, rig_function
from vibrojax.cli.map_table import MapRun, map_table
from vibrojax.cli.options import Map
from vibrojax.ensemble.arguments import Zipped, zipped
from vibrojax.io.rig_file import check_most, read_map, spaced
from vibrojax.maps.parameter_map import chosen_response
from vibrojax.maps.store import map_at
from vibrojax.maps.store_files import is_full
from vibrojax.maps.template import FAILED
from vibrojax.model.impacting_beam import ImpactingBeam
from vibrojax.plot.maps import plot_map, plot_map_summary
from vibrojax.steady.methods import PeriodicSettings
from vibrojax.sweep.settings import SweepSettings

MOST_LANES = 1_000_000_000
_EXAMPLE = "such as gap=0.2e-3:1e-3:20 or taper=0,0.25,0.5"

Axes = dict[str, list[float]]


def run_map(options: Map) -> int:
    """Compute a map, draw it, print its table. Raises `ValueError` for wrong input."""
    started = time.perf_counter()
    drawing = target("--picture", options.picture, PICTURES)
    summary = target("--summary", options.summary, PICTURES)
    store = target("--store", options.store, ())
    make, groups, keywords = _call(options)
    from vibrojax.maps.parameter_map import parameter_map

    def compute(**more: Any) -> Any:
        with warnings.catch_warnings():
            # Said at the end instead.
            warnings.filterwarnings("ignore", message=r"[\d,]+ of [\d,]+ chunks failed")
            return parameter_map(make, *groups, store=store, **more, **keywords)

    if options.dry_run:
        print(compute(dry_run=True))
        return 0
    known = 0 if store is None else _lanes_known(store)
    compiling = watch_compilation()
    try:
        found: xarray.Dataset = compute(progress=False if options.quiet else None)
    except KeyboardInterrupt:
        if store is None or not store.exists():
            raise
        message = f"interrupted. Whole chunks are in {store}: the same command continues."
        raise KeyboardInterrupt(message) from None
    except OSError as error:
        if not is_full(error):
            raise
        message = "the disk is full. Whole chunks stay: make room, and the same command continues"
        raise OSError(error.errno, message, os.fspath(store or "")) from None
    computed = time.perf_counter()
    written, notes = _draw(found, {drawing: plot_map, summary: plot_map_summary})
    if not options.quiet:
        times = (computed - started, compiling(), time.perf_counter() - computed)
        files = [str(path) for path in (store, *written) if path is not None]
        axis = next(name for name in FREQUENCIES if name in keywords)
        ways = max(1, len(chosen_response(keywords["response"]).layout.ways))
        made = MapRun(axis, keywords[axis], ways, known, times, files, notes)
        print(map_table(title("Map", options.rig), found, made))
    return _tell_failures(found)


def _call(options: Map) -> tuple[Callable[..., ImpactingBeam], list[Zipped], dict[str, Any]]:
    """Return the rig, the groups and the keywords that `parameter_map` is called with.

    Raises `ValueError` for what does not fit together.
    """
    system, sweep = read(options.rig, "map")
    asked = {} if options.rig is None else read_map(options.rig)
    axes, groups = axes_of(options.axis, options.zipped, asked)
    gradients = options.gradients or tuple(asked.get("gradients", ()))
    labels = dict.fromkeys(axes, "--axis") | {n: "--zipped" for group in groups for n in group}
    labels |= {name: "--gradients" for name in gradients if name not in labels}
    where = {n: f"{option} {n} (or [map] in the rig file)" for n, option in labels.items()}
    check_names(system, where)
    if options.keep_curves and options.no_curves:
        raise ValueError("give --keep-curves or --no-curves, one of the two.")
    given = options.keep_curves or options.no_curves
    settings: dict[str, Any] = {
        **frequencies_of(options, 61, asked, sweep),
        "response": _response(options, asked, sweep),
        "measures": list(options.measures) or asked.get("measures"),
        "keep_curves": options.keep_curves if given else asked.get("keep_curves"),
        "gradients": gradients,
        "chunk_lanes": options.chunk_lanes,
    }
    try:
        together = [zipped(**group) for group in groups]
    except ValueError as error:
        raise ValueError(f"--zipped or [[map.zipped]]: {error}") from None
    return rig_function(system, list(labels)), together, settings | axes


def axes_of(
    crossed: Sequence[Sequence[str]], grouped: Sequence[Sequence[str]], asked: dict[str, Any]
) -> tuple[Axes, list[Axes]]:
    """Return the crossed axes and the groups that go together, options in place of the file's.

    Raises `ValueError` for what is no axis, a number given twice, a group of the file of which the
    options name only a part, no axis at all, or more than 1e9 lanes.
    """
    parts = [[read_axis("--axis", text) for text in texts] for texts in crossed]
    groups = [[read_axis("--zipped", text) for text in texts] for texts in grouped]
    names = [name for part in (*parts, *groups) for name, _ in part]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} is given twice: it goes along one axis only.")
    kept = []
    for group in asked.get("zipped", ()):
        left = [name for name in group if name not in names]
        if left and len(left) < len(group):
            taken = next(name for name in group if name in names)
            raise ValueError(
                f"The rig file has {' and '.join(group)} in one [[map.zipped]]: with another "
                f"{taken}, say what becomes of {' and '.join(left)}, by --axis or --zipped."
            )
        if left:
            kept.append(group)
    own = {name: v for name, v in asked.get("axes", {}).items() if name not in names}
    axes = own | dict(pair for part in parts for pair in part)
    groups = [*kept, *(dict(group) for group in groups if group)]
    if not axes and not groups:
        raise ValueError(
            f"a map needs an axis: give --axis, {_EXAMPLE}, or [map.axes] in the rig file. For a "
            "single curve: vibrojax sweep."
        )
    lengths = [len(v) for v in axes.values()] + [len(next(iter(g.values()))) for g in groups]
    check_most("Lanes of a map, one for every combination of its axes,", prod(lengths), MOST_LANES)
    return axes, groups


def read_axis(option: str, text: str) -> tuple[str, list[float]]:
    """Return name and values of NAME=LOW:HIGH:COUNT[:log] or NAME=VALUE,VALUE.

    Raises `ValueError`, naming the option, otherwise.
    """
    name, equals, values = text.partition("=")
    ends = values.split(":")
    if not (name and equals and values) or len(ends) not in (1, 3, 4):
        hint = " The rig file comes first." if text.endswith(".toml") else ""
        raise ValueError(
            f"{option} must be NAME=LOW:HIGH:COUNT[:log] or NAME=VALUE,VALUE, {_EXAMPLE}, got "
            f"{text!r}.{hint}"
        )
    label = f"{option} {name}"
    if len(ends) == 1:
        return name, [number(label, value) for value in values.split(",")]
    low, high = (number(label, end) for end in ends[:2])
    count = int(ends[2]) if ends[2].isdecimal() else ends[2]
    return name, spaced(label, low, high, count, *ends[3:])


def _response(options: Map, asked: dict[str, Any], sweep: dict[str, Any]) -> AbstractSettings:
    """Return the response with its settings; those of [sweep] hold for sweeps."""
    kind = options.response or asked.get("response", "sweep")
    if options.direction is not None and kind != "sweep":
        raise ValueError(f"--direction is for --response sweep, not {kind}: leave it out.")
    if kind == "sweep":
        settings = sweep.get("settings", SweepSettings())
        settings = changed(settings, options, ("direction", "tolerance"), asked)
    else:
        settings = PeriodicSettings() if kind == "periodic" else ContinuationSettings()
        settings = changed(settings, options, ("tolerance",), asked)
    return settings


def _lanes_known(store: Path) -> int:
    """Return how many lanes of a store are whole. Raises `ValueError` for what is no store."""
    if map_at(store) is None:
        return 0
    try:
        states = xarray.open_zarr(store, chunks=None)["lane_status"].values
    except Exception:  # damaged: the map itself reports and mends that
        return 0
    return int((states < FAILED).sum())


def _draw(found: xarray.Dataset, pictures: dict[Path | None, Any]) -> tuple[list[Path], list[str]]:
    """Draw what can be drawn; return the files, and for the others why not."""
    writers: dict[Path | None, Any] = {}
    notes: list[str] = []
    for path, draw in pictures.items():
        if path is None:
            continue
        if found["lane_status"].size == 1:
            notes.append(f"{path}: a single lane makes no map, vibrojax sweep draws its curve.")
            continue
        try:
            figure = draw(found)
        except ValueError as error:  # such as more axes than a picture has
            notes.append(f"{path}: {error}")
        else:
            writers[path] = picture(lambda figure=figure: figure, path)
    return write(writers), notes


def _tell_failures(found: xarray.Dataset) -> int:
    """Say on the error stream what failed, and return the exit code."""
    if not (found["lane_status"].values == FAILED).any():
        return 0
    summary = str(found.attrs.get("summary", "Chunks of the map failed."))
    summary = summary.replace("The same call with the same store again", "The same command again")
    print(f"vibrojax: {summary}", file=sys.stderr)
    return 1
