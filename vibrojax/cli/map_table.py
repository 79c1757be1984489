"""The table that `vibrojax map` prints."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray

from vibrojax.cli.files import FREQUENCIES
from vibrojax.maps.chunks import Chunks
from vibrojax.maps.template import FAILED
from vibrojax.plot.map_axes import units_of
from vibrojax.results.axes import coordinates_along

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
    names = [
        str(name)
        for name, variable in found.data_vars.items()
        if variable.dtype.kind == "f" and not set(FREQUENCIES) & set(variable.dims)
    ]
    labels = {n: ", ".join(filter(None, (n, units_of(found, n)))) for n in names}
    wide = max(map(len, (*labels.values(), "frequency ratio")))
    lines = [title]

    def say(label: str, text: str) -> None:
        lines.append(f"  {label:{wide}}  {text}".rstrip())

    for dimension in map(str, status.dims):
        along = [n for n in coordinates_along(found, dimension) if found[n].dtype.kind in "fiubU"]
        texts = [_values(found[n].values, units_of(found, n)) for n in along]
        say(" with ".join(along), ", with ".join(texts))
    # Not read off the map: without curves it has no frequencies.
    frequencies = np.atleast_1d(run.frequencies)
    say(run.axis.replace("_", " "), _values(frequencies, "Hz" * (run.axis == "frequency")))
    words = str(status.attrs["flag_meanings"]).split()
    counts = {word: int((status.values == k).sum()) for k, word in enumerate(words)}
    shown = [f"{n:,} {word}" for word, n in counts.items() if n or word != "missing"]
    say(f"lanes, {status.size:,}", f"{', '.join(shown)}; each by its worst point")
    if run.known:
        new = int((status.values < FAILED).sum()) - run.known
        left = f"{new:,} computed now" if new else "nothing was left to compute"
        say("", f"{run.known:,} were in the store, {left}")
    chunks = Chunks(status.shape, tuple(json.loads(found.attrs["block"])))
    each = f"{chunks.number:,} of up to {chunks.lanes_per_block:,} lanes"
    say(f"points, {status.size * run.ways * len(frequencies):,}", f"in chunks, {each}")
    if names:
        rows = [("", "lanes", "least", "at", "largest", "at")]
        rows += [(labels[name], *_ends(found, name)) for name in names]
        columns = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for label, *row in rows:
            sides = zip(row, ">><><", columns[1:], strict=True)
            say(label, "  ".join(f"{text:{side}{width}}" for text, side, width in sides))
    total, compiling, drawing = run.times
    say("time", f"{total:.1f} s (compiling {compiling:.1f} s), drawing {drawing:.1f} s")
    if run.files:
        say("written", ", ".join(run.files))
    for note in run.notes:
        say("not drawn", note)
    return "\n".join(lines)


def _values(values: np.ndarray, units: str) -> str:
    """Return the values of an axis, or its ends where they are many."""
    units = f" {units}" if units else ""
    if len(values) <= _SHOWN:
        return ", ".join(_word(value) for value in values) + units
    return f"{_word(values[0])} to {_word(values[-1])}{units}, {len(values)} values"


def _word(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float | np.floating) else str(value)


def _ends(found: xarray.Dataset, name: str) -> list[str]:
    """Return lanes with a value, its least and its largest value, and where they are."""
    variable = found[name]
    values = variable.values  # read once: it may lie on disk
    there = np.isfinite(values)
    inner = tuple(k for k, d in enumerate(variable.dims) if d not in found["lane_status"].dims)
    lanes = f"{int(there.any(axis=inner).sum()):,}"
    if not there.any():
        return [lanes, "none", "", "", ""]
    ends = []
    for pick in (np.nanargmin, np.nanargmax):
        place = np.unravel_index(int(pick(np.where(there, values, np.nan))), values.shape)
        ends += [f"{values[place]:.5g}", _where(found, variable, place)]
    return [lanes, *ends] if ends[0] != ends[2] else [lanes, ends[0], "everywhere", "", ""]


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
