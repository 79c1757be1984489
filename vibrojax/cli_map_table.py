"""The table that `vibrojax map` prints."""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray

from vibrojax.results.map_axes import coordinates_along, units_of
from vibrojax.studies.maps.chunks import Chunks

_FREQUENCIES = ("frequency_ratio", "frequency")
_SHOWN = 6
"""Values of an axis that are written out."""


def map_table(
    title: str,
    found: xarray.Dataset,
    known: int,
    times: tuple[float, float, float],
    files: Sequence[str],
    notes: Sequence[str],
) -> str:
    """Return axes, status, range of every measure, times and files of a map.

    `known` counts the lanes that were in the store before, `notes` say what was not drawn.
    """
    status = found["lane_status"]
    names = _ranged(found)
    wide = max(len(row) for row in (*(_labelled(found, n) for n in names), "frequency ratio"))
    lines = [title]

    def say(label: str, text: str) -> None:
        lines.append(f"  {label:{wide}}  {text}".rstrip())

    for dimension in map(str, status.dims):
        along = [n for n in coordinates_along(found, dimension) if found[n].dtype.kind in "fiubU"]
        say(" with ".join(along), ", with ".join(_values(found, n) for n in along))
    axis = next(name for name in _FREQUENCIES if name in found.coords)
    say(axis.replace("_", " "), _values(found, axis))
    words = str(status.attrs["flag_meanings"]).split()
    counts = {word: int((status.values == k).sum()) for k, word in enumerate(words)}
    shown = [f"{n:,} {word}" for word, n in counts.items() if n or word != "missing"]
    say(f"lanes, {status.size:,}", f"{', '.join(shown)}; each by its worst point")
    if known:
        new = counts[words[0]] + counts[words[1]] + counts[words[2]] - known
        left = f"{new:,} computed now" if new else "nothing was left to compute"
        say("", f"{known:,} were in the store, {left}")
    chunks = Chunks(status.shape, tuple(json.loads(found.attrs["block"])))
    each = f"{chunks.number:,} of up to {chunks.lanes_per_block:,} lanes"
    say(f"points, {_points(found):,}", f"in chunks, {each}")
    lines += _ranges(found, names, wide)
    total, compiling, drawing = times
    say("time", f"{total:.1f} s (compiling {compiling:.1f} s), drawing {drawing:.1f} s")
    if files:
        say("written", ", ".join(files))
    for note in notes:
        say("not drawn", note)
    return "\n".join(lines)


def _values(found: xarray.Dataset, name: str) -> str:
    """Return the values of an axis, or its ends where they are many."""
    values = np.atleast_1d(found[name].values)
    units = units_of(found, name)
    if len(values) <= _SHOWN:
        text = ", ".join(_word(value) for value in values)
    else:
        text = f"{_word(values[0])} to {_word(values[-1])}"
    text = f"{text} {units}" if units else text
    return text if len(values) <= _SHOWN else f"{text}, {len(values)} values"


def _word(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float | np.floating) else str(value)


def _points(found: xarray.Dataset) -> int:
    """Return how many responses the map has: lanes times frequencies times directions."""
    inner = [d for d in (*_FREQUENCIES, "direction", "crossing") if d in found.coords]
    return found["lane_status"].size * math.prod(found[d].size for d in inner)


def _ranged(found: xarray.Dataset) -> list[str]:
    """Return the names of the variables that are no curves."""
    return [
        str(name)
        for name, variable in found.data_vars.items()
        if variable.dtype.kind == "f" and not set(_FREQUENCIES) & set(variable.dims)
    ]


def _labelled(found: xarray.Dataset, name: str) -> str:
    units = units_of(found, name)
    return f"{name}, {units}" if units else name


def _ranges(found: xarray.Dataset, names: Sequence[str], wide: int) -> list[str]:
    """Return a line for every measure: its least and largest value, and where they are."""
    rows = [("", "lanes", "least", "at", "largest", "at")]
    for name in names:
        variable = found[name]
        values = variable.values  # read once: it may lie on disk
        there = np.isfinite(values)
        inner = tuple(k for k, d in enumerate(variable.dims) if d not in found["lane_status"].dims)
        lanes = f"{int(there.any(axis=inner).sum()):,}"
        label = _labelled(found, name)
        if not there.any():
            rows.append((label, lanes, "none", "", "", ""))
            continue
        ends = []
        for pick in (np.nanargmin, np.nanargmax):
            place = np.unravel_index(int(pick(np.where(there, values, np.nan))), values.shape)
            ends += [f"{values[place]:.5g}", _where(found, variable, place)]
        if ends[0] == ends[2]:
            ends[1:] = ["everywhere", "", ""]
        rows.append((label, lanes, *ends))
    if not names:
        return []
    columns = [max(len(row[k]) for row in rows) for k in range(6)]
    return [
        (
            f"  {a:{wide}}  {b:>{columns[1]}}  {c:>{columns[2]}}  {d:{columns[3]}}  "
            f"{e:>{columns[4]}}  {f}"
        ).rstrip()
        for a, b, c, d, e, f in rows
    ]


def _where(found: xarray.Dataset, variable: xarray.DataArray, place: Sequence[Any]) -> str:
    """Return the coordinates of one value; axes of a single value say nothing."""
    parts = []
    for dimension, k in zip(map(str, variable.dims), place, strict=True):
        if found.sizes[dimension] == 1:
            continue
        for name in coordinates_along(found, dimension) or [dimension]:
            value = found[name].values[k] if name in found.coords else k
            parts.append(str(value) if name == "direction" else f"{name} {_word(value)}")
    return ", ".join(parts)
