"""What `vibrojax map` does: axes from options and rig file, the map, its pictures and table."""

import os
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import xarray

from vibrojax._tools.checks import nearest
from vibrojax.cli.files import PICTURES, check_driven, read, target, watch_compilation
from vibrojax.cli.fit import rig_function, rig_numbers
from vibrojax.cli.map_table import MapRun, map_table
from vibrojax.cli.tables import title
from vibrojax.ensemble.arguments import Zipped, zipped
from vibrojax.io.rig_file import check_most, frequency_range, one_frequency, read_map, spaced
from vibrojax.maps.continuation_curves import ContinuationCurve
from vibrojax.maps.periodic_points import PeriodicPoints
from vibrojax.maps.responses import AbstractMapResponse
from vibrojax.maps.settled_sweep import SettledSweep
from vibrojax.maps.store import map_at
from vibrojax.maps.store_files import is_full
from vibrojax.maps.template import FAILED
from vibrojax.model.impacting_beam import ImpactingBeam
from vibrojax.results.saving import whole_files

MOST_LANES = 1_000_000_000
DEFAULT_RANGE = (0.8, 1.4, 61)
_FREQUENCIES = ("frequency", "frequency_ratio")
_EXAMPLE = "such as gap=0.2e-3:1e-3:20 or taper=0,0.25,0.5"

Axes = dict[str, list[float]]


class MapOptions(NamedTuple):
    """Options of `vibrojax map`, which explains them."""

    rig: Path | None
    axis: tuple[tuple[str, ...], ...]
    zipped: tuple[tuple[str, ...], ...]
    frequency_ratio: tuple[float, ...]
    frequency: tuple[float, ...]
    response: str | None
    direction: str | None
    tolerance: float | None
    measures: tuple[str, ...]
    keep_curves: bool
    no_curves: bool
    gradients: tuple[str, ...]
    store: Path
    picture: Path
    summary: Path
    chunk_lanes: int | None
    dry_run: bool
    quiet: bool


class MapCall(NamedTuple):
    """How `parameter_map` is called."""

    make: Callable[..., ImpactingBeam]
    groups: tuple[Zipped, ...]
    keywords: dict[str, Any]
    """Settings, and the axes by name."""


def run(options: MapOptions) -> int:
    """Compute a map, draw it, print its table. Raises `ValueError` for wrong input."""
    started = time.perf_counter()
    drawing = target("--picture", options.picture, PICTURES)
    summary = target("--summary", options.summary, PICTURES)
    store = _store(options.store)
    call = call_of(options)
    from vibrojax.maps.parameter_map import parameter_map

    def compute(**more: Any) -> Any:
        with warnings.catch_warnings():
            # Said at the end instead.
            warnings.filterwarnings("ignore", message=r"[\d,]+ of [\d,]+ chunks failed")
            return parameter_map(call.make, *call.groups, store=store, **more, **call.keywords)

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
    written, notes = _draw(found, {drawing: "plot_map", summary: "plot_map_summary"})
    if not options.quiet:
        times = (computed - started, sum(compiling), time.perf_counter() - computed)
        files = [str(path) for path in (store, *written) if path is not None]
        axis = next(name for name in _FREQUENCIES if name in call.keywords)
        ways = max(1, len(call.keywords["response"].ways()[1]))
        made = MapRun(axis, call.keywords[axis], ways, known, times, files, notes)
        print(map_table(title("Map", options.rig), found, made))
    return _tell_failures(found)


def call_of(options: MapOptions) -> MapCall:
    """Return how `parameter_map` is called. Raises `ValueError` for what does not fit together."""
    system, sweep = read(options.rig)
    check_driven(options.rig, system, "map")
    asked = {} if options.rig is None else read_map(options.rig)
    axes, groups = axes_of(options.axis, options.zipped, asked)
    gradients = options.gradients or tuple(asked.get("gradients", ()))
    labels = {name: "--axis" for name in axes} | {name: "--zipped" for g in groups for name in g}
    labels |= {name: "--gradients" for name in gradients if name not in labels}
    _check_names(system, labels)
    if options.keep_curves and options.no_curves:
        raise ValueError("give --keep-curves or --no-curves, one of the two.")
    given = options.keep_curves or options.no_curves
    settings: dict[str, Any] = {
        **_frequencies(options, asked, sweep),
        "response": _response(options, asked, sweep),
        "measures": list(options.measures) or asked.get("measures"),
        "keep_curves": options.keep_curves if given else asked.get("keep_curves"),
        "gradients": gradients,
        "chunk_lanes": options.chunk_lanes,
    }
    return MapCall(rig_function(system, list(labels)), _zipped(groups), settings | axes)


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
        return name, [_number(label, value) for value in values.split(",")]
    low, high = (_number(label, end) for end in ends[:2])
    count = int(ends[2]) if ends[2].isdecimal() else ends[2]
    return name, spaced(label, low, high, count, *ends[3:])


def _number(label: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{label} must be a number, got {text!r}.") from None


def _zipped(groups: list[Axes]) -> tuple[Zipped, ...]:
    try:
        return tuple(zipped(**group) for group in groups)
    except ValueError as error:
        raise ValueError(f"--zipped or [[map.zipped]]: {error}") from None


def _check_names(system: ImpactingBeam, labels: dict[str, str]) -> None:
    known = rig_numbers(system)
    for name, option in labels.items():
        if name in known:
            continue
        where = f"{option} {name} (or [map] in the rig file)"
        if name in ("position", "gap", "stiffness", "damping") and not system.stops:
            raise ValueError(f"{where}: the rig has no stop. Give it a table [[stop]].")
        raise ValueError(f"{where}: no such number of the rig. {nearest(name, known)}")


def _frequencies(
    options: MapOptions, asked: dict[str, Any], sweep: dict[str, Any]
) -> dict[str, Any]:
    """Return the frequencies of the options, else of [map], else of [sweep], else the default."""
    if options.frequency and options.frequency_ratio:
        raise ValueError("give --frequency or --frequency-ratio, one of the two.")
    for name in _FREQUENCIES:
        given: tuple[float, ...] = getattr(options, name)
        label = f"--{name.replace('_', '-')}"
        if len(given) == 1:
            return {name: one_frequency(label, given[0])}
        if len(given) == 3:
            count = int(given[2]) if float(given[2]).is_integer() else given[2]
            return {name: frequency_range(label, (*given[:2], count))}
        if given:
            raise ValueError(
                f"{label} must be START END POINTS, or one value, got {len(given)} numbers."
            )
    for table in (asked, sweep):
        for name in _FREQUENCIES:
            if name in table:
                return {name: table[name]}
    return {"frequency_ratio": frequency_range("--frequency-ratio", DEFAULT_RANGE)}


def _response(
    options: MapOptions, asked: dict[str, Any], sweep: dict[str, Any]
) -> AbstractMapResponse:
    """Return the response with its settings; those of [sweep] hold for sweeps."""
    kind = options.response or asked.get("response", "sweep")
    if options.direction is not None and kind != "sweep":
        raise ValueError(f"--direction is for --response sweep, not {kind}: leave it out.")
    settings: dict[str, Any] = {}
    if kind == "sweep":
        settings = {name: v for name, v in sweep.items() if name not in _FREQUENCIES}
    for name in ("direction", "tolerance") if kind == "sweep" else ("tolerance",):
        given = getattr(options, name)
        if given is None:
            given = asked.get(name)
        if given is not None:
            settings[name] = given
    if kind == "sweep":
        return SettledSweep(**settings)
    return (PeriodicPoints if kind == "periodic" else ContinuationCurve)(**settings)


def _store(path: Path) -> Path | None:
    """Refuse a store that could not be written, before anything is computed."""
    if str(path).lower() == "none":
        return None
    folder = path.absolute().parent
    if not folder.is_dir():
        raise ValueError(f"--store: the folder {str(path.parent)!r} does not exist.")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise ValueError(f"--store: {str(path)!r} cannot be written, for lack of permission.")
    return path


def _lanes_known(store: Path) -> int:
    """Return how many lanes of a store are whole. Raises `ValueError` for what is no store."""
    if map_at(store) is None:
        return 0
    try:
        states = xarray.open_zarr(store, chunks=None)["lane_status"].values
    except Exception:  # damaged: the map itself reports and mends that
        return 0
    return int((states < FAILED).sum())


def _draw(found: xarray.Dataset, pictures: dict[Path | None, str]) -> tuple[list[Path], list[str]]:
    """Draw what can be drawn; return the files, and for the others why not."""
    from vibrojax.plot import map_plot, map_summary

    modules: dict[str, Any] = {"plot_map": map_plot, "plot_map_summary": map_summary}
    written: dict[Path, Any] = {}
    notes: list[str] = []
    for path, function in pictures.items():
        if path is None:
            continue
        if found["lane_status"].size == 1:
            notes.append(f"{path}: a single lane makes no map, vibrojax sweep draws its curve.")
            continue
        try:
            written[path] = getattr(modules[function], function)(found)
        except ValueError as error:  # such as more axes than a picture has
            notes.append(f"{path}: {error}")
    with whole_files(*written) as parts:
        for part, (path, figure) in zip(parts, written.items(), strict=True):
            figure.savefig(part, format=path.suffix[1:])
    return list(written), notes


def _tell_failures(found: xarray.Dataset) -> int:
    """Say on the error stream what failed, and return the exit code."""
    if not (found["lane_status"].values == FAILED).any():
        return 0
    summary = str(found.attrs.get("summary", "Chunks of the map failed."))
    summary = summary.replace("The same call with the same store again", "The same command again")
    print(f"vibrojax: {summary}", file=sys.stderr)
    return 1
