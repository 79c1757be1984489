"""The Zarr store of a map: one Zarr chunk for each block, written by region.

Single files appear at once or not at all, and the record of a block is written last (see
`records`), so a store can be interrupted at any moment. Every array has checksums, which readers
check too.
"""

import json
import os
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from vibrojax.maps.chunks import Block, Chunks
from vibrojax.maps.records import OWN, Records
from vibrojax.maps.store_files import disk_errors_named, remove, write_file
from vibrojax.maps.template import FAILED, MISSING
from vibrojax.maps.work import MapSpec

CREATING = {"vibrojax_map": ""}
"""Attributes of a store whose creation was interrupted: nothing is in it yet."""
COPY = "map.json"
"""A second copy of the attributes, in the folder of what is not data."""
NOTES = ("failures", "summary")
"""Attributes that say how the last call ended; they are not there while a map is computed."""


def _zarr() -> Any:
    import zarr  # when a map is made: it takes half a second

    return zarr


class MapStore:
    """The arrays of a map, on disk or in memory."""

    def __init__(self, group: Any, chunks: Chunks, records: Records | None):
        self.group, self.chunks = group, chunks
        self.records = records
        """None for a store in memory, which no other call will see."""
        self.arrays: dict[str, Any] = {}

    def _array(self, name: str) -> Any:
        if name not in self.arrays:
            self.arrays[name] = self.group[name]
        return self.arrays[name]

    def write(self, block: Block, values: dict[str, np.ndarray], rigs: str) -> None:
        """Write the results of a block, then `lane_status`, then its record.

        `rigs` stands for the numbers of its rigs. Raises `StoreFull`, `StoreReadOnly`.
        """
        with disk_errors_named():
            for name, value in values.items():
                if name != "lane_status":
                    self._array(name)[block.region] = value
            self._array("lane_status")[block.region] = values["lane_status"]
            if self.records is not None:
                self.records.write(block.number, rigs)

    def mark_failed(self, block: Block) -> None:
        """Say that a block was tried and failed. Raises `StoreFull`, `StoreReadOnly`."""
        with disk_errors_named():
            self._array("lane_status")[block.region] = np.full(block.shape, FAILED, np.int8)

    def begin(self) -> None:
        """Take back how the last call ended, since there is something to compute again.

        This is written in any case: what cannot be written is found out before computing. Raises
        `StoreFull`, `StoreReadOnly`.
        """
        with disk_errors_named():
            own = {n: value for n, value in dict(self.group.attrs).items() if n not in NOTES}
            self.group.attrs.put(own)

    def note(self, **attributes: Any) -> None:
        """Add to the attributes of the dataset, where they are not there yet.

        Raises `StoreFull`, `StoreReadOnly`.
        """
        found = dict(self.group.attrs)
        if found | attributes != found:
            with disk_errors_named():
                self.group.attrs.put(found | attributes)

    def change_settings(self, settings: str) -> None:
        """Write other settings. Raises `StoreFull`, `StoreReadOnly`."""
        if self.records is not None and settings != self.group.attrs["vibrojax_map"]:
            file = self.records.place / OWN / COPY
            copy = (attributes_in(file) or {}) | {"vibrojax_map": settings}
            with disk_errors_named():
                write_file(file, json.dumps(copy).encode())
            self.note(vibrojax_map=settings)


def memory_store(files: dict[str, Any] | None = None) -> Any:
    """Return a store that lives in memory; its files by name appear in `files`."""
    return _zarr().storage.MemoryStore(files)


def create(store: Any, spec: MapSpec, attributes: dict[str, Any]) -> MapStore:
    """Create all arrays of a map; the attributes are written last and make it a map.

    Raises `StoreFull`, `StoreReadOnly`.
    """
    with disk_errors_named():
        return _create(store, spec, attributes)


def _create(store: Any, spec: MapSpec, attributes: dict[str, Any]) -> MapStore:
    zarr, template, chunks = _zarr(), spec.template, spec.chunks
    place = Path(store) if isinstance(store, str) else None
    if place is not None:
        _clear(place)
    group = zarr.create_group(store, attributes=dict(CREATING))
    group.create_group(OWN)
    codecs = zarr.codecs
    checked = (codecs.ZstdCodec(level=0, checksum=False), codecs.Crc32cCodec())
    for name, (dims, values, described) in template.coordinates.items():
        values = np.asarray(values)
        if values.dtype.kind == "U":
            values = values.astype(object)  # which Zarr keeps as texts of any length
        array = group.create_array(
            name,
            shape=values.shape,
            dtype=str if values.dtype.kind == "O" else values.dtype,
            compressors=checked,
            dimension_names=dims or None,
            attributes=described,
        )
        array[...] = values
    for name, one in template.variables.items():
        inner = one.shape[len(template.outer) :]
        group.create_array(
            name,
            shape=one.shape,
            dtype=one.dtype,
            chunks=(*chunks.block, *inner) if one.shape else "auto",
            compressors=checked,
            fill_value=MISSING if name == "lane_status" else one.nothing,
            dimension_names=one.dims or None,
            attributes=one.attributes,
        )
    with warnings.catch_warnings():
        # Consolidated metadata are not in Zarr's standard yet, but xarray asks for them.
        warnings.simplefilter("ignore")
        group = zarr.consolidate_metadata(group.store)
    if place is None:
        group.attrs.put(attributes)
        return MapStore(group, chunks, None)
    write_file(place / OWN / COPY, json.dumps(attributes).encode())
    group.attrs.put(attributes)
    return MapStore(group, chunks, Records(place, spec))


def _clear(place: Path) -> None:
    """Remove what was being created when it was interrupted, what says so last."""
    for inside in place.iterdir():
        if inside.name != OWN and inside.name != "zarr.json":
            remove(inside)
    for inside in (place / OWN).iterdir():
        if inside.name != "lock":
            remove(inside)
    remove(place / "zarr.json")


def files_of(spec: MapSpec, attributes: dict[str, Any]) -> dict[str, bytes]:
    """Return all files of a map when it is created, by name."""
    files: dict[str, Any] = {}
    create(memory_store(files), spec, attributes)
    return {name: buffer.to_bytes() for name, buffer in files.items()}


def map_at(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Return the attributes of the map at a path; None where there is nothing yet.

    Those of the copy where the store's own cannot be read. Raises `ValueError` where there is
    something else.
    """
    place = Path(path)
    if not place.exists():
        if not place.absolute().parent.is_dir():
            raise ValueError(f"store: the folder {str(place.absolute().parent)!r} does not exist.")
        return None
    wrong = f"store: {str(place)!r} is there already and is not a store of a map"
    if not place.is_dir():
        raise ValueError(f"{wrong}, but a file. Give another path.")
    copy = attributes_in(place / OWN / COPY)
    # The first file of all may have been interrupted before Zarr renamed it.
    if copy is None and all(p.match("zarr.*.partial") or p.name == OWN for p in place.iterdir()):
        return None
    own = attributes_in(place / "zarr.json", "attributes")
    found = own if own is not None and "vibrojax_map" in own else copy
    if found is None or "vibrojax_map" not in found:
        raise ValueError(f"{wrong}. Give another path, or remove it.")
    return None if own == CREATING else found


def attributes_in(file: Path, part: str | None = None) -> dict[str, Any] | None:
    """Return attributes that a file holds; None where it cannot be read."""
    try:
        found = json.loads(file.read_bytes())
        found = found if part is None else found[part]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def block_of(place: Path, chunks: Chunks) -> tuple[int, ...]:
    """Return the lengths of the blocks of a store, as most of the places say that hold them."""
    found: Counter[tuple[int, ...]] = Counter()
    described = attributes_in(place / "lane_status" / "zarr.json", "chunk_grid") or {}
    for one in (
        attributes_in(place / "zarr.json", "attributes"),
        attributes_in(place / OWN / COPY),
        {"block": described.get("configuration")},
    ):
        block = (one or {}).get("block")
        try:
            block = block["chunk_shape"] if isinstance(block, dict) else json.loads(str(block))
            block = tuple(block)
        except (ValueError, KeyError, TypeError):
            continue
        if len(block) == len(chunks.shape) and all(
            type(b) is int and 1 <= b <= n for b, n in zip(block, chunks.shape, strict=True)
        ):
            found[block] += 1
    return found.most_common(1)[0][0] if found else chunks.block


def open_map(store: str, spec: MapSpec) -> MapStore:
    """Open a map that exists, to write into it."""
    group = _zarr().open_group(store, mode="r+")
    return MapStore(group, spec.chunks, Records(Path(store), spec))
