"""The table that `vibrojax map` prints."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray

from vibrojax.maps.chunks import Chunks
from vibrojax.plot.map_axes import coordinates_along, units_of

_FREQUENCIES = ("frequency_ratio", "frequency")
_SHOWN = 6
"""Values of an axis that are written out."""


class MapRun(NamedTuple):
    """What a map itself does not say of how it was made."""

    axis: str
    frequencies: float | np.ndarray
    ways: int
    """Directions or crossings at a frequency."""
    known: int
    """Lanes that were in the store before."""
    times: tuple[float, float, float]
    """All, compiling, drawing; s."""
    files: Sequence[str]
    notes: Sequence[str]
    """What was not drawn, and why."""


def map_table(title: str, found: xarray.Dataset, run: MapRun) -> str:
    """Return axes, status, range of every measure, times and files of a map."""
    status = found["lane_status"]
    names = _ranged(found)
    wide = max(len(row) for row in (*(_labelled(found, n) for n in names), "frequency ratio"))
    lines = [title]

    def say(label: str, text: str) -> None:
        lines.append(f"  {label:{wide}}  {text}".rstrip())

    for dimension in map(str, status.dims):
        along = [n for n in coordinates_along(found, dimension) if found[n].dtype.kind in "fiubU"]
        texts = [_values(found[n].values, units_of(found, n)) for n in along]
        say(" with ".join(along), ", with ".join(texts))
    # Not read off the map: without curves it has no frequencies.
    frequencies = np.atleast_1d(run.frequencies)
    units = "Hz" if run.axis == "frequency" else ""
    say(run.axis.replace("_", " "), _values(frequencies, units))
    words = str(status.attrs["flag_meanings"]).split()
    counts = {word: int((status.values == k).sum()) for k, word in enumerate(words)}
    shown = [f"{n:,} {word}" for word, n in counts.items() if n or word != "missing"]
    say(f"lanes, {status.size:,}", f"{', '.join(shown)}; each by its worst point")
    if run.known:
        new = counts[words[0]] + counts[words[1]] + counts[words[2]] - run.known
        left = f"{new:,} computed now" if new else "nothing was left to compute"
        say("", f"{run.known:,} were in the store, {left}")
    chunks = Chunks(status.shape, tuple(json.loads(found.attrs["block"])))
    each = f"{chunks.number:,} of up to {chunks.lanes_per_block:,} lanes"
    say(f"points, {status.size * run.ways * len(frequencies):,}", f"in chunks, {each}")
    lines += _ranges(found, names, wide)
    total, compiling, drawing = run.times
    say("time", f"{total:.1f} s (compiling {compiling:.1f} s), drawing {drawing:.1f} s")
    if run.files:
        say("written", ", ".join(run.files))
    for note in run.notes:
        say("not drawn", note)
    return "\n".join(lines)


def _values(values: np.ndarray, units: str) -> str:
    """Return the values of an axis, or its ends where they are many."""
    if len(values) <= _SHOWN:
        text = ", ".join(_word(value) for value in values)
    else:
        text = f"{_word(values[0])} to {_word(values[-1])}"
    text = f"{text} {units}" if units else text
    return text if len(values) <= _SHOWN else f"{text}, {len(values)} values"


def _word(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float | np.floating) else str(value)


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
