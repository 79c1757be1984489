"""The Zarr store of a map: one Zarr chunk for each block, written by region.

Single files appear at once or not at all, and the record of a chunk, a digest of every file of it
and of the numbers of its rigs, is written last. So a store can be interrupted at any moment, and it
matters neither which file was lost nor how. Every array has checksums, which readers check too.
"""

import functools
import json
import os
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vibrojax.maps.chunks import Block
from vibrojax.maps.store_files import (
    digest,
    disk_errors_named,
    file_digest,
    make_room,
    remove,
    write_file,
)
from vibrojax.maps.template import FAILED, MISSING
from vibrojax.maps.work import MapSpec

CREATING = {"vibrojax_map": ""}
"""Attributes of a store whose creation was interrupted: nothing is in it yet."""
OWN = "vibrojax"
"""The folder of what is not data: records, a copy of the attributes, the lock."""
COPY = f"{OWN}/map.json"
"""A second copy of the attributes, which knows by a digest whether it is as it was written."""
NOTES = ("failures", "summary")
"""Attributes that say how the last call ended; they are not there while a map is computed."""


def _zarr() -> Any:
    import zarr  # when a map is made: it takes half a second

    return zarr


class Condition(NamedTuple):
    """What was found of a chunk."""

    number: int
    rigs: str | None
    """Stands for the numbers of the rigs it was computed with; None where that is not known."""
    damage: tuple[str, ...] = ()
    """What is not as it was written."""

    @property
    def is_whole(self) -> bool:
        """Whether all of it is there."""
        return self.rigs is not None and not self.damage


class MapStore:
    """The arrays and records of a map, at a path (a text) or in memory, where nothing is recorded.

    What writes raises `StoreFull` and `StoreReadOnly`.
    """

    def __init__(self, store: Any, spec: MapSpec):
        self.store, self.spec = store, spec
        self.place = Path(store) if isinstance(store, str) else None

    @functools.cached_property
    def group(self) -> Any:
        """The group of Zarr's."""
        return _zarr().open_group(self.store, mode="r+")

    @functools.cached_property
    def arrays(self) -> dict[str, Any]:
        """The variables, by name."""
        return {name: self.group[name] for name in self.spec.template.variables}

    @disk_errors_named()
    def write(self, block: Block, values: dict[str, np.ndarray], rigs: str) -> None:
        """Write the results of a block, then `lane_status`, then its record.

        `rigs` stands for the numbers of its rigs.
        """
        for name in sorted(values, key=lambda name: name == "lane_status"):
            self.arrays[name][block.region] = values[name]
        if self.place is not None:
            files = {name: file_digest(file) for name, file in self._files(block.number).items()}
            made = {"chunk": block.number, "settings": self.spec.identity, "rigs": rigs}
            write_file(self._record(block.number), json.dumps(made | {"files": files}).encode())

    @disk_errors_named()
    def mark_failed(self, block: Block) -> None:
        """Say that a block was tried and failed."""
        self.arrays["lane_status"][block.region] = np.full(block.shape, FAILED, np.int8)

    @disk_errors_named()
    def begin(self) -> None:
        """Take back how the last call ended, since there is something to compute again.

        This is written in any case: what cannot be written is found out before computing.
        """
        own = {n: value for n, value in dict(self.group.attrs).items() if n not in NOTES}
        self.group.attrs.put(own)

    @disk_errors_named()
    def note(self, **attributes: Any) -> None:
        """Add to the attributes of the dataset, where they are not there yet."""
        found = dict(self.group.attrs)
        if found | attributes != found:
            self.group.attrs.put(found | attributes)

    def change_settings(self, settings: str) -> None:
        """Write other settings."""
        if self.place is not None and settings != self.group.attrs["vibrojax_map"]:
            copy = copy_in(self.place) or {}
            with disk_errors_named():
                write_file(self.place / COPY, copy_of(copy | {"vibrojax_map": settings}))
            self.note(vibrojax_map=settings)

    def _record(self, number: int) -> Path:
        assert self.place is not None
        return self.place / OWN / "chunks" / f"{number}.json"

    def _files(self, number: int) -> dict[str, Path]:
        """The file of a chunk for each variable."""
        assert self.place is not None
        chunks = self.spec.chunks
        lengths = zip(chunks.at(number).region, chunks.block, strict=True)
        outer = [str(part.start // length) for part, length in lengths]
        return {
            name: self.place.joinpath(name, "c", *outer, *("0" for _ in one.inner))
            for name, one in self.spec.template.variables.items()
        }

    def condition(self, number: int) -> Condition:
        """Find out whether a chunk is what it was."""
        try:
            made: Any = json.loads(self._record(number).read_bytes())
            rigs, digests = made["rigs"], dict(made["files"])
            known = made["chunk"] == number and made["settings"] == self.spec.identity
        except FileNotFoundError:
            return Condition(number, None)
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return Condition(number, None, ("its record",))
        if not known or not isinstance(rigs, str):
            return Condition(number, None, ("its record, which is of another chunk",))
        wrong = []
        for name, one in self._files(number).items():
            found = file_digest(one)
            if name not in digests or found != digests[name]:
                wrong.append(f"{name} ({'missing' if found is None else 'changed'})")
        return Condition(number, rigs, tuple(wrong))

    @disk_errors_named()
    def clear(self, number: int) -> None:
        """Remove all of a chunk: its lanes are missing then, not wrong."""
        assert self.place is not None
        remove(self._record(number))
        for file in self._files(number).values():
            make_room(file, self.place)


def memory_store(files: dict[str, Any] | None = None) -> Any:
    """Return a store that lives in memory; its files by name appear in `files`."""
    return _zarr().storage.MemoryStore(files)


@disk_errors_named()
def create(store: Any, spec: MapSpec, attributes: dict[str, Any]) -> MapStore:
    """Create all arrays of a map; the attributes are written last and make it a map.

    Raises `StoreFull`, `StoreReadOnly`.
    """
    zarr, template, made = _zarr(), spec.template, MapStore(store, spec)
    if made.place is not None:
        _clear(made.place)
    group = zarr.create_group(store, attributes=dict(CREATING))
    group.create_group(OWN)
    codecs = zarr.codecs
    checked = (codecs.ZstdCodec(level=0, checksum=False), codecs.Crc32cCodec())
    for name, (dims, values, described) in template.coordinates.items():
        values = np.asarray(values)
        text = values.dtype.kind == "U"  # which Zarr keeps as texts of any length
        array = group.create_array(
            name,
            shape=values.shape,
            dtype=str if text else values.dtype,
            compressors=checked,
            dimension_names=dims or None,
            attributes=described,
        )
        array[...] = values.astype(object) if text else values
    for name, one in template.variables.items():
        dims, inner = (*template.outer, *one.inner), tuple(one.inner.values())
        group.create_array(
            name,
            shape=(*spec.chunks.shape, *inner),
            dtype=one.dtype,
            chunks=(*spec.chunks.block, *inner) if dims else "auto",
            compressors=checked,
            fill_value=MISSING if name == "lane_status" else one.nothing,
            dimension_names=dims or None,
            attributes=one.attributes,
        )
    with warnings.catch_warnings():
        # Consolidated metadata are not in Zarr's standard yet, but xarray asks for them.
        warnings.simplefilter("ignore")
        made.group = zarr.consolidate_metadata(group.store)
    if made.place is not None:
        write_file(made.place / COPY, copy_of(attributes))
    made.group.attrs.put(attributes)
    return made


def _clear(place: Path) -> None:
    """Remove what was being created when it was interrupted, what says so last."""
    inside = [path for path in place.iterdir() if path.name not in (OWN, "zarr.json")]
    inside += [path for path in (place / OWN).iterdir() if path.name != "lock"]
    for path in (*inside, place / "zarr.json"):
        remove(path)


def files_of(spec: MapSpec, attributes: dict[str, Any]) -> dict[str, bytes]:
    """Return all files of a map when it is created, by name."""
    files: dict[str, Any] = {}
    create(memory_store(files), spec, attributes)
    return {name: buffer.to_bytes() for name, buffer in files.items()}


def map_at(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Return the attributes of the map at a path; None where there is nothing yet.

    Where their copy is as it was written it counts, whatever the store's own say. Raises
    `ValueError` where there is something else.
    """
    place = Path(path)
    if not place.exists():
        if not place.absolute().parent.is_dir():
            raise ValueError(f"store: the folder {str(place.absolute().parent)!r} does not exist.")
        return None
    wrong = f"store: {str(place)!r} is there already and is not a store of a map"
    if not place.is_dir():
        raise ValueError(f"{wrong}, but a file. Give another path.")
    own, copy = attributes_in(place / "zarr.json", "attributes"), copy_in(place)
    # The first file of all may have been interrupted before Zarr renamed it.
    begun = all(p.match("zarr.*.partial") or p.name == OWN for p in place.iterdir())
    if own == CREATING or (copy is None and begun):
        return None
    found = (own or {}) | (copy or {})
    if "vibrojax_map" not in found:
        raise ValueError(f"{wrong}. Give another path, or remove it.")
    return found


def attributes_in(file: Path, part: str | None = None) -> dict[str, Any] | None:
    """Return attributes that a file holds; None where it cannot be read."""
    try:
        found = json.loads(file.read_bytes())
        found = found if part is None else found[part]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def copy_of(attributes: dict[str, Any]) -> bytes:
    """Return what the copy of the attributes holds."""
    known = {"digest": digest(json.dumps(attributes)), "attributes": attributes}
    return json.dumps(known).encode()


def copy_in(place: Path) -> dict[str, Any] | None:
    """Return the copy of the attributes; None where it is not as it was written."""
    copy = attributes_in(place / COPY, "attributes")
    same = copy is not None and attributes_in(place / COPY) == json.loads(copy_of(copy))
    return copy if same else None
