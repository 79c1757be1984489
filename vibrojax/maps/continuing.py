"""Starting the store of a map, or continuing one: what is damaged or of other rigs is found first.

A call knows all of its store but the values: settings, coordinates, the description of every
array. They are compared and written again where they differ; chunks are known by their records.
"""

import json
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vibrojax._tools.interrupts import stoppable
from vibrojax.maps import settings as known
from vibrojax.maps import store as stores
from vibrojax.maps.lock import held
from vibrojax.maps.rig_maker import NO_RIGS, RigMaker
from vibrojax.maps.store import COPY, OWN, Condition, MapStore
from vibrojax.maps.store_files import (
    READ_ONLY,
    disk_errors_named,
    make_room,
    remove,
    write_file,
)
from vibrojax.maps.template import Template
from vibrojax.maps.work import MapSpec

LOCK = f"{OWN}/lock"
READERS = 8
"""Threads that read a store to check it."""
NAMED = 5
"""Places of damage that are named."""


class Ready(NamedTuple):
    """A store, and what is to be computed into it."""

    spec: MapSpec
    settings: dict[str, Any]
    store: MapStore | None
    """None where the map is complete and sound: nothing is written."""
    left: list[int]
    """Chunks to compute."""
    warnings: list[str]
    """What was found, in sentences."""


def same_map(
    path: Any, found: dict[str, Any], spec: MapSpec, settings: dict[str, Any], asked: int | None
) -> tuple[MapSpec, dict[str, Any]]:
    """Return a map and its settings as its store has them, which chooses the chunks.

    `asked` are the lanes of a chunk that were asked for. Raises `ValueError` for a store of other
    settings.
    """
    made, block = known.settings_in(path, found)
    settings = known.with_changing(settings, made)
    known.check_same(path, made, settings)
    if asked is not None and block != spec.chunks.block:
        raise ValueError(
            f"chunk_lanes = {asked} makes chunks of shape {spec.chunks.block}, but the store has "
            f"{block}. Leave chunk_lanes out to continue it."
        )
    return spec._replace(chunks=spec.chunks._replace(block=block)), settings


@contextmanager
def opened(
    path: str, spec: MapSpec, settings: dict[str, Any], maker: RigMaker, asked: int | None
) -> Iterator[Ready]:
    """Start or continue the store of a map, which no other process writes to meanwhile.

    Raises `ValueError` for a store of other settings, `StoreInUse`, `StoreReadOnly` where
    something is left to be written, `StoreFull`.
    """
    place = Path(path)
    spec = spec._replace(identity=known.identity_of_chunks(settings))
    found = stores.map_at(path)
    if found is not None and _is_complete(found):  # it may lie where nothing can be written
        same, own = same_map(path, found, spec, settings, asked)
        if stoppable(_checked, place, found, same, own, maker).is_sound:
            if (place / LOCK).exists():  # its owner was killed at the very end
                with suppress(OSError), held(place / LOCK, path):
                    pass
            yield Ready(same, own, None, [], [])
            return
    with _locked(place):
        found = stores.map_at(path)
        if found is None:
            made = stores.create(path, spec, known.attributes_of(spec, maker.sample(), settings))
            yield Ready(spec, settings, made, list(range(spec.chunks.number)), [])
        else:
            spec, settings = same_map(path, found, spec, settings, asked)
            findings = stoppable(_checked, place, found, spec, settings, maker)
            made = _mended(place, spec, findings)
            yield Ready(spec, settings, made, findings.left, _sentences(place, spec, findings))


def _is_complete(found: dict[str, Any]) -> bool:
    """Whether a store says that all of it was computed."""
    return "summary" in found and found.get("failures") == "{}"


@contextmanager
def _locked(place: Path) -> Iterator[None]:
    """Hold the lock of a store, after making its folder.

    Raises `StoreInUse`, `StoreReadOnly`, `StoreFull`.
    """
    with ExitStack() as stack:
        with disk_errors_named():
            place.mkdir(exist_ok=True)
            if not (place / OWN).is_dir():
                remove(place / OWN)
                (place / OWN).mkdir()
            stack.enter_context(held(place / LOCK, str(place)))
            _check_writable(place)
        yield


def _check_writable(place: Path) -> None:
    """Raise `PermissionError` for a folder of a store in which nothing can be written."""
    inside = [*place.iterdir(), *place.glob("*/c"), place / OWN / "chunks"]
    for folder in (place, *inside):
        if folder.is_dir() and not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(READ_ONLY[1], "", str(folder))


class Findings(NamedTuple):
    """What was found of a store that is continued."""

    left: list[int]
    """Chunks to compute, those that follow included."""
    damaged: dict[int, tuple[str, ...]]
    """Chunks that are not what they were, and what of them."""
    other: list[int]
    """Chunks that were computed with other rigs."""
    wrong: list[str]
    """Arrays whose description or coordinates are not those of the call."""
    root: "_Root"
    reference: dict[str, bytes]
    """The files of the store as the call would create it."""

    @property
    def is_sound(self) -> bool:
        """Whether nothing is to be done."""
        return not (self.left or self.wrong or self.root.damaged)


def _checked(
    place: Path, found: dict[str, Any], spec: MapSpec, settings: dict[str, Any], maker: RigMaker
) -> Findings:
    """Compare a store with the call and with its own records.

    Raises `ValueError` where the rigs of all its chunks are others.
    """
    store = MapStore(str(place), spec)
    with ThreadPoolExecutor(READERS) as pool:
        conditions = list(pool.map(store.condition, range(spec.chunks.number)))
    other = _of_other_rigs(conditions, spec, maker)
    if len(other) == sum(c.is_whole for c in conditions):
        made, _ = known.settings_in(place, found)
        for name in known.RIGS:
            known.check_one(place, name, made, settings)
    damaged = {c.number: c.damage for c in conditions if c.damage}
    damaged = {n: ("missing",) for n in _lost(conditions, found)} | damaged
    left = sorted({c.number for c in conditions if not c.is_whole} | set(other))
    attributes = known.attributes_of(spec, maker.sample(), settings)
    reference = stores.files_of(spec, attributes)
    wrong = _wrong_files(place, reference, spec.template)
    root = _root(place, attributes, reference)
    return Findings(left, damaged, other, wrong, root, reference)


def _mended(place: Path, spec: MapSpec, findings: Findings) -> MapStore:
    """Write again what a call knows, and remove the chunks that are not what they should be."""
    with disk_errors_named():
        _tidy(place)
        for name in findings.wrong:
            _put_back(place, name, findings.reference, name in spec.template.coordinates)
        if findings.root.is_other:
            _put_root(place, findings.root, findings.reference)
    store = MapStore(str(place), spec)
    if findings.left:
        store.begin()
        for number in (*findings.damaged, *findings.other):
            store.clear(number)
    return store


def _of_other_rigs(conditions: Sequence[Condition], spec: MapSpec, maker: RigMaker) -> list[int]:
    """Return the chunks that are whole, but whose rigs are no longer those of the function."""
    whole = [c for c in conditions if c.is_whole]
    now = maker.digests(spec.chunks.at(c.number) for c in whole)
    pairs = zip(whole, now, strict=True)
    return [c.number for c, rigs in pairs if rigs != c.rigs or rigs == NO_RIGS]


def _lost(conditions: Sequence[Condition], found: dict[str, Any]) -> list[int]:
    """Return the chunks without a record in a store that was complete."""
    if "summary" not in found:
        return []
    try:
        failures = dict(json.loads(found["failures"]))
    except (ValueError, KeyError, TypeError):
        failures = {}
    return [c.number for c in conditions if c.rigs is None and str(c.number) not in failures]


# ------------------------------------------------------------------------ all but the values


def _wrong_files(place: Path, reference: dict[str, bytes], template: Template) -> list[str]:
    """Return the arrays and groups whose description or coordinates are not those of a call."""
    wrong = []
    for name in (*template.coordinates, *template.variables, OWN):
        meant = json.loads(reference[f"{name}/zarr.json"])
        same = stores.attributes_in(place / name / "zarr.json") == meant
        if name in template.coordinates:
            same = same and _has_values(place / name, template.coordinates[name][1])
        if not same:
            wrong.append(name)
    return wrong


def _has_values(place: Path, values: Any) -> bool:
    """Whether a coordinate can be read and has these values, to the last bit."""
    import zarr

    meant = np.asarray(values)
    try:
        found = np.asarray(zarr.open_array(str(place), mode="r")[...])
    except Exception:  # Zarr, its codecs and the disk have many
        return False
    if meant.dtype.kind == "U":
        return found.astype(object).tolist() == meant.tolist()
    return found.tobytes() == meant.tobytes()


def _put_back(place: Path, name: str, reference: dict[str, bytes], with_values: bool) -> None:
    """Write the files of an array again that a call knows; chunks stay."""
    if with_values or not (place / name).is_dir():
        remove(place / name)
    for file, data in reference.items():
        if file.startswith(f"{name}/"):
            make_room(place / file, place)
            write_file(place / file, data)


class _Root(NamedTuple):
    """What was found of the attributes of a store."""

    is_other: bool
    """Whether they are not those of the call."""
    damaged: list[str]
    """Files that are not as they were written."""
    others: dict[str, Any]
    """Attributes that are not the call's."""


def _root(place: Path, attributes: dict[str, Any], reference: dict[str, bytes]) -> _Root:
    """Compare the attributes of a store, their copy and the call's."""
    whole = stores.attributes_in(place / "zarr.json") or {}
    meant, copy = json.loads(reference["zarr.json"]), stores.copy_in(place)
    found = whole.get("attributes")
    found = found if isinstance(found, dict) else {}
    own = {n: found[n] for n in attributes if n in found}
    others = {n: value for n, value in found.items() if n not in own}
    # Written together: one alone means that the key of the other looks like one of the user's.
    renamed = len(others.keys() & set(stores.NOTES)) == 1
    other = whole | {"attributes": {}} != meant | {"attributes": {}} or own != (copy or own)
    damaged = ["zarr.json"] * (renamed or other) + [COPY] * (copy is None)
    return _Root(bool(damaged) or own != attributes, damaged, {} if renamed or other else others)


def _put_root(place: Path, root: _Root, reference: dict[str, bytes]) -> None:
    whole = json.loads(reference["zarr.json"])
    write_file(place / COPY, stores.copy_of(whole["attributes"]))
    whole["attributes"] |= root.others
    if (place / "zarr.json").is_dir():
        remove(place / "zarr.json")
    write_file(place / "zarr.json", json.dumps(whole, indent=2).encode())


def _tidy(place: Path) -> None:
    """Remove what was being written when it was interrupted; readers would be warned of it."""
    for pattern in ("*.partial", f"{OWN}/*.partial", f"{OWN}/chunks/*.partial"):
        for left in place.glob(pattern):
            left.unlink(missing_ok=True)


def _sentences(place: Path, spec: MapSpec, findings: Findings) -> list[str]:
    """Say what was found and what is done about it."""
    files = [*findings.root.damaged, *findings.wrong]
    damaged, other = findings.damaged, findings.other
    warnings = []
    if files or damaged:
        chunks = [f"{_chunk(spec, k)}: {', '.join(what)}" for k, what in damaged.items()]
        done = []
        if files:
            done.append("What the call itself knows was written again.")
        if damaged:
            done.append(f"{len(damaged):,} of {spec.chunks.number:,} chunks are computed again.")
        warnings.append(
            f"store: {str(place)!r} was damaged: {_first([*files, *chunks])}. {' '.join(done)}"
        )
    if other:
        warnings.append(
            f"store: {str(place)!r} has chunks of other rigs than the function makes now: "
            f"{_first([_chunk(spec, k) for k in other])}. These {len(other):,} of "
            f"{spec.chunks.number:,} chunks are computed again, the others kept."
        )
    return warnings


def _chunk(spec: MapSpec, number: int) -> str:
    return f"chunk {number} at {spec.where(number)}"


def _first(places: list[str]) -> str:
    """Return the first of some places, and how many more there are."""
    more = f" and {len(places) - NAMED:,} more places" if len(places) > NAMED else ""
    return "; ".join(places[:NAMED]) + more
