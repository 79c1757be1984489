"""The Zarr store of a map: one Zarr chunk for each block, written by region.

`lane_status` is written last of a block, so where it holds something the block is whole. Single
files appear at once or not at all (Zarr writes them beside and renames), so a store can be
interrupted at any moment.
"""

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from vibrojax.studies.maps.chunks import Block, Chunks
from vibrojax.studies.maps.template import FAILED, MISSING, Template

FORMAT = 1
"""Changes when older stores cannot be continued any more."""
CREATING = {"vibrojax_map": ""}
"""Attributes of a store whose creation was interrupted: nothing is in it yet."""


class StoreFull(OSError):
    """The disk of a store is full; what is whole stays."""


def is_full(error: BaseException) -> bool:
    """Whether an error says that there is no room left."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def _told_when_full() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if not is_full(error):
            raise
        raise StoreFull(
            error.errno,
            "The disk of the store is full. What is whole stays: make room and repeat the same "
            "call",
        ) from None


def _zarr() -> Any:
    import zarr  # when a map is made: it takes half a second

    return zarr


class MapStore:
    """The arrays of a map, on disk or in memory."""

    def __init__(self, group: Any, chunks: Chunks):
        self.group, self.chunks = group, chunks
        self.arrays: dict[str, Any] = {}

    def _array(self, name: str) -> Any:
        if name not in self.arrays:  # opening one reads its metadata anew
            self.arrays[name] = self.group[name]
        return self.arrays[name]

    def write(self, block: Block, values: dict[str, np.ndarray]) -> None:
        """Write the results of a block, `lane_status` last. Raises `StoreFull`."""
        with _told_when_full():
            for name, value in values.items():
                if name != "lane_status":
                    self._array(name)[block.region] = value
            self._array("lane_status")[block.region] = values["lane_status"]

    def mark_failed(self, block: Block) -> None:
        """Say that a block was tried and failed. Raises `StoreFull`."""
        with _told_when_full():
            self._array("lane_status")[block.region] = np.full(block.shape, FAILED, np.int8)

    def not_whole(self) -> list[int]:
        """Return the numbers of the blocks that are missing or failed."""
        return [k for k in range(self.chunks.number) if self._first_status(k) in (FAILED, MISSING)]

    def _first_status(self, number: int) -> int:
        first = tuple(part.start for part in self.chunks.at(number).region)
        return int(np.asarray(self._array("lane_status")[first]))

    def note(self, **attributes: Any) -> None:
        """Add to the attributes of the dataset, where they are not there yet.

        Raises `StoreFull`.
        """
        found = dict(self.group.attrs)
        if found | attributes != found:
            with _told_when_full():
                self.group.attrs.update(attributes)


def memory_store() -> Any:
    """Return a store that lives in memory."""
    return _zarr().storage.MemoryStore()


def create(store: Any, template: Template, chunks: Chunks, attributes: dict[str, Any]) -> MapStore:
    """Create all arrays of a map; the attributes are written last and make it a map.

    Raises `StoreFull`.
    """
    with _told_when_full():
        return _create(store, template, chunks, attributes)


def _create(store: Any, template: Template, chunks: Chunks, attributes: dict[str, Any]) -> MapStore:
    zarr = _zarr()
    if isinstance(store, str):
        _clear(Path(store))
    group = zarr.create_group(store, overwrite=True, attributes=dict(CREATING))
    for name, (dims, values, described) in template.coordinates.items():
        values = np.asarray(values)
        if values.dtype.kind == "U":
            values = values.astype(object)  # which Zarr keeps as texts of any length
        kind = str if values.dtype.kind == "O" else values.dtype
        array = group.create_array(
            name, shape=values.shape, dtype=kind, dimension_names=dims or None
        )
        array[...] = values
        array.attrs.update(described)
    for name, one in template.variables.items():
        inner = one.shape[len(template.outer) :]
        group.create_array(
            name,
            shape=one.shape,
            dtype=one.dtype,
            chunks=(*chunks.block, *inner) if one.shape else "auto",
            fill_value=MISSING if name == "lane_status" else one.nothing,
            dimension_names=one.dims or None,
            attributes=one.attributes,
        )
    group.attrs.put(attributes)
    return MapStore(group, chunks)


def _clear(place: Path) -> None:
    """Remove what was being created when it was interrupted, what says so last."""
    for inside in place.iterdir() if place.is_dir() else ():
        if inside.is_dir():
            shutil.rmtree(inside)
        elif inside.name != "zarr.json":
            inside.unlink()


def attributes_of(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Return the attributes of the map at a path; None where there is nothing yet.

    Raises `ValueError` where there is something else.
    """
    place = Path(path)
    if not place.exists():
        if not place.absolute().parent.is_dir():
            raise ValueError(f"store: the folder {str(place.absolute().parent)!r} does not exist.")
        return None
    wrong = f"store: {str(place)!r} is there already and is not a store of a map"
    if not place.is_dir():
        raise ValueError(f"{wrong}, but a file. Give another path.")
    # The first file of all may have been interrupted before Zarr renamed it.
    if all(p.match("zarr.*.partial") for p in place.iterdir()):
        return None
    if not (place / "zarr.json").is_file():
        raise ValueError(f"{wrong}. Give another path, or remove it.")
    try:
        found = dict(_zarr().open_group(str(place), mode="r").attrs)
    except Exception as error:
        raise ValueError(f"{wrong}: it cannot be read ({error}).") from None
    if "vibrojax_map" not in found:
        raise ValueError(f"{wrong}. Give another path, or remove it.")
    return None if found == CREATING else found


def open_map(store: Any, chunks: Chunks) -> MapStore:
    """Open a map that exists, to write into it."""
    if isinstance(store, str):  # readers would be warned of what was interrupted
        for left in Path(store).glob("zarr.*.partial"):
            left.unlink(missing_ok=True)
    return MapStore(_zarr().open_group(store, mode="r+"), chunks)


def check_same(path: Any, found: dict[str, Any], settings: dict[str, Any]) -> None:
    """Refuse, with a `ValueError` that names the difference, a store made with other settings."""
    made = json.loads(found["vibrojax_map"])
    if made.get("format") != settings["format"]:
        raise ValueError(
            f"store: {str(path)!r} has format {made.get('format')} (vibrojax "
            f"{made.get('vibrojax_version')}), this version writes format {settings['format']}. "
            "Give another path, or read it with xarray.open_zarr."
        )
    for name, value in settings.items():
        if made.get(name) != value:
            raise ValueError(
                f"store: {str(path)!r} was made with other settings. {name.replace('_', ' ')}: "
                f"{_difference(made.get(name), value)}. Give another path, or the same settings."
            )


def _difference(made: Any, asked: Any) -> str:
    """Say in what two settings differ, in few words."""
    if isinstance(made, dict) and isinstance(asked, dict):
        for key in [*made, *(k for k in asked if k not in made)]:
            if made.get(key) != asked.get(key):
                inside = _difference(made.get(key), asked.get(key))
                return inside if inside.startswith(f"{key}: ") else f"{key}: {inside}"
        return "the order of its parts"
    if isinstance(made, list) and isinstance(asked, list) and len(made) != len(asked):
        return f"{len(made)} values there, {len(asked)} now"
    if isinstance(made, list) and isinstance(asked, list):
        k = next(i for i, (a, b) in enumerate(zip(made, asked, strict=True)) if a != b)
        return f"value {k + 1} is {made[k]!r} there, {asked[k]!r} now"
    return f"{_short(made)} there, {_short(asked)} now"


def _short(value: Any) -> str:
    text = "nothing" if value is None else repr(value)
    return text if len(text) < 400 else f"{text[:400]}..."
