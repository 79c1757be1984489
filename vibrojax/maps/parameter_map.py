"""Parametric maps: any number of axes, larger than memory, resumable, here or on a cluster."""

import inspect
import json
import os
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, Any, Literal, overload

import jax
import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_count, check_positive, nearest
from vibrojax._tools.interrupts import stoppable
from vibrojax._tools.signatures import validated
from vibrojax._tools.warn import warn
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.ensemble.arguments import Arguments, Zipped, arguments_of, default_of
from vibrojax.ensemble.frequencies import frequency_axis
from vibrojax.maps import store as stores
from vibrojax.maps.continuation_map import ContinuationMap
from vibrojax.maps.continuing import opened, same_map
from vibrojax.maps.measures import Measures, measures_of
from vibrojax.maps.periodic_map import PeriodicMap
from vibrojax.maps.planning import MapPlan, chunks_of, plan_of
from vibrojax.maps.regime_map import RegimeMap
from vibrojax.maps.responses import AbstractMapResponse, Grid
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.maps.running import Outcome, run_here, run_on_cluster
from vibrojax.maps.settings import (
    after_computing,
    attributes_of,
    settings_of,
    unread_of,
)
from vibrojax.maps.sweep_map import SweepMap
from vibrojax.maps.template import Template, template_of
from vibrojax.maps.work import MapSpec
from vibrojax.model.systems import AbstractSystem
from vibrojax.regime.bifurcation import diagram_settings
from vibrojax.regime.settings import RegimeSettings
from vibrojax.results.derived import add_derived
from vibrojax.steady.methods import PeriodicSettings
from vibrojax.sweep.settings import SweepSettings

if TYPE_CHECKING:
    import xarray

Response = (
    str
    | SweepSettings
    | PeriodicSettings
    | ContinuationSettings
    | RegimeSettings
    | AbstractMapResponse
)
RESPONSES: dict[str, tuple[Callable[[], Any], type, Callable[[Any], AbstractMapResponse]]] = {
    "sweep": (SweepSettings, SweepSettings, SweepMap),
    "periodic": (PeriodicSettings, PeriodicSettings, PeriodicMap),
    "continuation": (ContinuationSettings, ContinuationSettings, ContinuationMap),
    "regimes": (diagram_settings, RegimeSettings, RegimeMap),
}
"""By name: what makes the settings by default, their class, and the response that they are of."""


@overload
def parameter_map(
    make_system: Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    response: Response = "sweep",
    measures: Measures | None = None,
    keep_curves: bool | None = None,
    gradients: str | Sequence[str] = (),
    store: str | os.PathLike[str] | None = None,
    chunk_lanes: int | None = None,
    memory: float = 1e9,
    client: Any = None,
    progress: bool | None = None,
    dry_run: Literal[False] = False,
    **arguments: Any,
) -> "xarray.Dataset": ...


@overload
def parameter_map(
    make_system: Callable[..., AbstractSystem],
    *zipped: Zipped,
    dry_run: Literal[True],
    **settings: Any,
) -> MapPlan: ...


@validated
def parameter_map(
    make_system: Callable[..., AbstractSystem],
    *zipped: Zipped,
    frequency_ratio: ArrayLike | Sequence[float] | None = None,
    frequency: ArrayLike | Sequence[float] | None = None,
    response: Response = "sweep",
    measures: Measures | None = None,
    keep_curves: bool | None = None,
    gradients: str | Sequence[str] = (),
    store: str | os.PathLike[str] | None = None,
    chunk_lanes: int | None = None,
    memory: float = 1e9,
    client: Any = None,
    progress: bool | None = None,
    dry_run: bool = False,
    **arguments: Any,
) -> "xarray.Dataset | MapPlan":
    """Compute the response for every combination of arguments of a rig function.

        maps = vj.parameter_map(rig, frequency_ratio=..., taper=[0, 0.5], gap=[...], store="m.zarr")

    A *lane* is one combination; its curve is over the frequencies. Lanes are computed in chunks,
    and written to the store chunk by chunk. The same call again continues what was interrupted.

    Parameters:
        make_system: function from named numbers to a system. Written with jax.numpy (or plain
            arithmetic) it is traced once for all lanes; any other function is called for each.
        zipped: groups of arguments that go along one axis, `vj.zipped(taper=..., gap=...)`.
        frequency_ratio: drive frequencies over the first natural frequency of the unstopped
            system, increasing; or one number, which makes a map at one frequency.
        frequency: the same in Hz; give one of the two.
        response: what is computed, with which settings: `vj.SweepSettings(...)` (settled),
            `vj.PeriodicSettings(...)`, `vj.ContinuationSettings(...)`, `vj.RegimeSettings(...)`, as
            the single studies take them, or `vj.maps.BasinFractions(...)`; or by name with the
            settings by default, `sweep`, `periodic`, `continuation`, `regimes`.
        measures: what to keep of every curve: names (`peak_amplitude_ratio`, `jump_up`, ...) or
            functions from a curve (a dict of arrays by name) to a number, in a list, or in a dict
            by name. By default whole curves and all measures.
        keep_curves: keep the curves too; by default only where no measures are named.
        gradients: names of numbers of the rig; every measure (and curve) then comes with its
            derivative `d_<measure>_d_<number>`, implicit in the steady state.
        store: path of a Zarr store (a folder); without one the result is held in memory.
        chunk_lanes: most lanes of a chunk, in place of those chosen from memory and cache.
        memory: bytes that a chunk may take while it is computed.
        client: a `dask.distributed.Client`: chunks become its tasks, and its workers write to the
            store, whose path they have to see.
        progress: show a progress bar; by default in a terminal.
        dry_run: compute a few lanes only and return a `MapPlan`: lanes, chunks, memory, time.
        arguments: of the function: a list is an axis, one value is fixed, `vj.zipped(...)` is an
            axis of the keyword's name.

    Returns an `xarray.Dataset` with the axes in the order of the call, then `direction` or
    `crossing`, then the frequency. A chunk that fails twice is flagged in `lane_status`, with a
    warning, and the rest completes.

    Raises `ValueError`, before anything is computed, for an argument that the function does not
    take, an axis that is empty or given twice, zipped lists of unequal lengths, a path that is not
    a store, a store of other settings (the difference is named) or of another version;
    `StoreInUse` where another process writes to the store, `StoreReadOnly` where it cannot be
    written, `StoreFull` when the disk is full, after which the same call continues (`OSError`s).
    """
    grid = _grid(frequency_ratio, frequency)
    named = arguments_of(make_system, zipped, arguments)
    chosen = chosen_response(response)
    offered = chosen.layout.offered
    if measures is None and grid.single:
        offered = ("natural_frequency",)
    wanted = measures_of(measures, offered)
    keep = measures is None if keep_curves is None else keep_curves
    gradients = _gradients(make_system, named, gradients)
    if chunk_lanes is not None:
        check_count("chunk_lanes", chunk_lanes)
    check_positive("memory", memory, "bytes")
    if client is not None and store is None and not dry_run:
        raise ValueError("client= needs store=: the workers write their chunks there.")
    if client is not None and not hasattr(client, "submit"):
        raise ValueError(f"client must be a dask.distributed Client, got {client!r}.")
    found = None if store is None else stores.map_at(store)
    maker = RigMaker(make_system, named)
    maker.check()
    sample = maker.sample()
    chosen.check(sample, grid)
    workers = sum(client.nthreads().values()) if client else len(jax.local_devices())
    units = sample.drive.reference[1]
    template = template_of(named.dimensions, chosen, grid, wanted, keep, gradients, units)
    _check_names(template)
    chunks = chunks_of(maker, chosen, grid, chunk_lanes, memory, workers)
    spec = MapSpec(make_system, named, grid, chosen, wanted, keep, gradients, chunks, template)
    settings = settings_of(spec, maker)
    if dry_run:
        if found is not None:
            spec, _ = same_map(store, found, spec, settings, chunk_lanes)
        return stoppable(plan_of, spec, maker, workers)
    if store is None:
        place = stores.memory_store()
        made = stores.create(place, spec, attributes_of(spec, sample, settings))
        _run(spec, made, list(range(chunks.number)), place, None, progress)
        return _dataset(place, list(template.variables), in_memory=True)
    place = os.fspath(store)
    with opened(place, spec, settings, maker, chunk_lanes) as ready:
        for sentence in ready.warnings:
            warn(sentence)
        _tell_unread(spec)
        if ready.store is not None:
            try:
                _run(ready.spec, ready.store, ready.left, place, client, progress)
            finally:
                after = after_computing(spec, ready.settings)
                ready.store.change_settings(json.dumps(after))
    return _dataset(place, list(template.variables), in_memory=False)


def _tell_unread(spec: MapSpec) -> None:
    """Warn of what a store cannot identify."""
    unread = unread_of(spec)
    if unread:
        warn(
            f"{'; '.join(unread)} cannot be read. When it changes, the store is continued as if "
            "it were the same: give another path then."
        )


def _grid(ratio: Any, frequency: Any) -> Grid:
    single = np.ndim(ratio if ratio is not None else frequency) == 0
    axis, values = frequency_axis(ratio, frequency)
    return Grid(axis, values, single)


def _gradients(make: Any, named: Arguments, names: Any) -> tuple[str, ...]:
    """Return the names of the numbers to differentiate by.

    Raises `ValueError` for one that is no number of the function.
    """
    names = (names,) if isinstance(names, str) else tuple(names)
    axes = {n: v for d in named.dimensions for n, v in d.values.items()}
    parameters = inspect.signature(make).parameters
    for name in names:
        if name not in axes and name not in named.fixed and name not in parameters:
            known = [*axes, *(p for p in parameters if p not in axes)]
            raise ValueError(f"gradients: unknown argument {name!r}. {nearest(name, known)}")
        value = axes[name][0] if name in axes else named.fixed.get(name, default_of(make, name))
        if isinstance(value, bool | str | None) or np.asarray(value).dtype.kind not in "fiu":
            raise ValueError(f"gradients: {name} must be a number of the rig, got {value!r}.")
        if names.count(name) > 1:
            raise ValueError(f"gradients: {name} is named twice.")
    return names


def _check_names(template: Template) -> None:
    for name in (*template.coordinates, *template.variables):
        if name == stores.OWN:
            raise ValueError(f"{name} is the name of a folder in every store: give another name.")
    for name in template.coordinates:
        if name in template.variables:
            raise ValueError(
                f"{name} would be an axis and a result: rename the argument of the function, or "
                "the measure."
            )


def _run(
    spec: MapSpec,
    made: stores.MapStore,
    left: list[int],
    place: Any,
    client: Any,
    progress: bool | None,
) -> None:
    """Compute the chunks that are left, and say in the store what is missing."""
    from tqdm import tqdm

    lanes = [spec.chunks.at(k).lanes for k in range(spec.chunks.number)] if left else []
    total = spec.arguments.lanes
    outcomes: Generator[Outcome, None, None]
    if client is None:
        outcomes = run_here(spec, made, left)
    else:
        outcomes = run_on_cluster(spec, place, left, client, made)
    done = total - sum(lanes[k] for k in left)
    hidden = None if progress is None else not progress
    failures: dict[int, str] = {}
    with (
        closing(outcomes),
        tqdm(
            total=total, initial=done, desc="map", unit="lane", unit_scale=True, disable=hidden
        ) as bar,
    ):
        for outcome in outcomes:
            if outcome.failure is not None:
                failures[outcome.number] = outcome.failure
                bar.set_postfix_str(f"{len(failures)} chunks failed")
            bar.update(lanes[outcome.number])
    # Also where nothing was left: the call before may have been interrupted just before this.
    made.note(
        failures=json.dumps({str(k): text for k, text in sorted(failures.items())}),
        summary=_summary(spec, failures, lanes),
    )
    if failures:
        warn(_summary(spec, failures, lanes))


def _summary(spec: MapSpec, failures: dict[int, str], lanes: list[int]) -> str:
    total = spec.arguments.lanes
    if not failures:
        return f"All {total:,} lanes in {spec.chunks.number:,} chunks were computed."
    missing = sum(lanes[k] for k in failures)
    first = min(failures)
    return (
        f"{len(failures):,} of {spec.chunks.number:,} chunks failed twice ({missing:,} of "
        f"{total:,} lanes, lane_status 'failed'). Chunk {first} at {spec.where(first)}: "
        f"{failures[first]} The same call with the same store again computes only what is missing."
    )


def _dataset(place: Any, names: list[str], in_memory: bool) -> "xarray.Dataset":
    import xarray

    stored = xarray.open_zarr(place, chunks=None)
    # In the order of the template; with every coordinate, also of curves that were not kept.
    dataset = stored[names].assign_coords(stored.coords)
    if in_memory:
        dataset = dataset.load()
    # Zarr keeps texts of any length; everyone else is used to those of numpy.
    for name, values in dataset.coords.items():
        if values.dtype.kind not in "fiubU":
            texts = np.array([str(text) for text in values.values])
            dataset = dataset.assign_coords({name: (values.dims, texts, values.attrs)})
    return add_derived(dataset)


def chosen_response(response: Any) -> AbstractMapResponse:
    """Return the response asked for, by name or by its settings.

    Raises `ValueError` for what is neither.
    """
    if isinstance(response, AbstractMapResponse):
        return response
    for name, (default, kind, made) in RESPONSES.items():
        if isinstance(response, str) and response == name:
            return made(default())
        if isinstance(response, kind):
            return made(response)
    raise ValueError(
        f"response must be one of {', '.join(map(repr, RESPONSES))}, or one of "
        "vj.SweepSettings(), vj.PeriodicSettings(), vj.ContinuationSettings(), "
        f"vj.RegimeSettings(), vj.maps.BasinFractions(...), got {response!r}."
    )
