"""Tables of measurements: read from files, datasets, data frames or dictionaries of arrays."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vibrojax._tools.checks import check_choice
from vibrojax._tools.files import read_bytes
from vibrojax.measured.cells import DECIMALS, decimal_signs, joined, plain_array, sign_of
from vibrojax.measured.text_files import read_text

if TYPE_CHECKING:
    import xarray


class Table(NamedTuple):
    """Columns of equal length, as read: numbers, or text that may hold them."""

    columns: dict[str, np.ndarray]
    units: dict[str, str]
    """Units that came with the columns other than in their names."""
    lines: np.ndarray
    """Line of the file, or row counted from 1."""
    counted: str
    """What `lines` counts: `line` or `row`."""
    label: str
    attached: dict[str, float]
    """Numbers that hold for the whole table."""
    inner: tuple[str, ...] = ()
    """Columns that were axes of a dataset besides direction and frequency, with several values."""
    notes: tuple[str, ...] = ()
    signs: Mapping[str, str] = {}
    """Decimal signs of columns of text, as `sign_of` has them; columns left out have points."""


_NETCDF = (".nc", ".nc4", ".h5", ".hdf5")


def read_table(
    source: Any,
    wanted: Iterable[Any] = (),
    along: str | None = None,
    decimal: str | None = None,
) -> Table:
    """Read a table from a path, a dataset, a data frame, a series or a dictionary of arrays.

    `wanted` are the columns asked for: whole numbers among them are positions in a file, counted
    from 0. With `along`, only variables along that dimension are taken from a dataset, and forces
    are summed over stops. `decimal` is the decimal sign of text, None: read off the cells. Raises
    `ValueError` when the source cannot be read or is no table.
    """
    import xarray

    wanted = list(wanted)
    if decimal is not None:
        check_choice("decimal", decimal, DECIMALS)
    if isinstance(source, str | os.PathLike):
        return _of_file(source, wanted, along, decimal)
    if isinstance(source, xarray.DataArray):
        if source.name is None:
            raise ValueError(
                "The data array has no name: say what it holds, as in "
                "source.rename('amplitude [mm]')."
            )
        source = source.to_dataset()
    if isinstance(source, xarray.Dataset):
        return _of_dataset(source, wanted, along)
    if hasattr(source, "to_frame") and hasattr(source, "index"):  # a pandas series
        source = source.to_frame()
        if source.index.names == [None] or source.columns[0] == 0:
            raise ValueError(
                "The series does not say what its index and values are: "
                "source.rename_axis('frequency [Hz]').rename('amplitude [mm]')."
            )
    if hasattr(source, "columns") and hasattr(source, "to_numpy"):
        return _of_arrays(_of_frame(source), decimal)
    if isinstance(source, Mapping):
        return _of_arrays(source, decimal)
    if hasattr(source, "to_xarray"):
        return _of_dataset(source.to_xarray(), wanted, along)
    raise ValueError(
        "source must be a path, a dataset, a data frame, a series or a dict of arrays, got "
        f"{type(source)}."
    )


def _of_file(
    source: str | os.PathLike[str], wanted: list[Any], along: str | None, decimal: str | None
) -> Table:
    import xarray

    raw = read_bytes("File", source)
    path = Path(source)
    if path.suffix.lower() in _NETCDF or raw.startswith(b"\x89HDF"):
        engine = "scipy" if raw.startswith(b"CDF") else "h5netcdf"
        try:
            # Times stay numbers: xarray would make durations of "seconds".
            with xarray.open_dataset(path, engine=engine, decode_times=False) as file:
                dataset = file.load()
        except Exception as error:  # whatever the readers make of a file that is none
            said = str(error).split("\n")[0].rstrip(".")
            raise ValueError(f"{path.name!r} cannot be read as NetCDF: {said}.") from None
        return _of_dataset(dataset, wanted, along)._replace(label=path.stem)
    try:
        text = read_text(raw, any(isinstance(w, int) for w in wanted), decimal)
    except ValueError as error:
        raise ValueError(f"{path.name!r} {error}.") from None
    table = Table(text.columns, {}, text.lines, "line", path.stem, {})
    return _with_signs(table, text.signs, decimal)


def _with_signs(table: Table, of_file: str | None, decimal: str | None) -> Table:
    """Add the decimal signs of columns of text, and a note where the cells showed them."""
    if of_file is None:
        return table
    texts = {n: joined(c) for n, c in table.columns.items() if c.dtype.kind in "OUT"}
    signs = {name: decimal or sign_of(text, of_file) for name, text in texts.items()}
    notes = []
    if decimal is None and any("," in sign for sign in (of_file, *signs.values())):
        notes.append("Commas were read as decimal points.")
    if decimal is None:
        thousands = [n for n, sign in signs.items() if sign == "." and "," in texts[n]]
        notes += [f"Commas of column {n!r} were read as marks of thousands." for n in thousands]
    return table._replace(signs=signs, notes=(*table.notes, *notes))


def _of_frame(frame: Any) -> list[tuple[Any, Any]]:
    """Return names and values of the columns of a data frame, and of its index if it has a name."""
    index = getattr(frame, "index", None)
    if index is not None and any(name is not None for name in index.names):
        frame = frame.reset_index()
    return [(name, frame[name].to_numpy()) for name in frame.columns]


def _of_arrays(values: Any, decimal: str | None) -> Table:
    pairs = list(values.items() if isinstance(values, Mapping) else values)
    names = [str(name) for name, _ in pairs]
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise ValueError(f"There are several columns named {', '.join(double)}.")
    columns = {}
    for name, (_, given) in zip(names, pairs, strict=True):
        try:
            columns[name] = plain_array(given)
        except (TypeError, ValueError) as error:
            raise ValueError(f"Column {name!r} is no array: {error}.") from None
    sizes = {name: column.shape for name, column in columns.items()}
    if len(set(sizes.values())) != 1 or any(len(shape) != 1 for shape in sizes.values()):
        raise ValueError(f"Columns must be one-dimensional and equally long, got shapes {sizes}.")
    rows = next(iter(sizes.values()))[0]
    table = Table(columns, {}, np.arange(1, rows + 1), "row", "", {})
    texts = [joined(column) for column in columns.values() if column.dtype.kind in "OUT"]
    return _with_signs(table, decimal or decimal_signs("\n".join(texts)), decimal)


OWN = ("amplitude_ratio", "peak_ratio", "rms_ratio", "first_harmonic_ratio")
"""Variables by which a frequency response of our own is known."""


def _of_dataset(dataset: "xarray.Dataset", wanted: list[Any], along: str | None) -> Table:
    import xarray

    if along is not None and along in dataset.dims:
        if "stop" in dataset.dims and "contact_force" in dataset:
            force = dataset["contact_force"]
            dataset = dataset.assign(contact_force=force.sum("stop", keep_attrs=True))
        dataset = dataset[[n for n in dataset.data_vars if dataset[n].dims == (along,)]]

    asked = [name for name in wanted if isinstance(name, str) and name in dataset.data_vars]
    names = [n for n in asked if dataset[n].ndim] or [n for n in dataset.data_vars]
    own = set(OWN) <= set(dataset.data_vars)
    names = [OWN[0]] if own else names
    if not names:
        raise ValueError("The dataset has no variables.")
    dims = max((dataset[name].dims for name in names), key=len)
    needed = set(dims) - {"direction"}
    kept = {}
    for name, variable in dataset.variables.items():
        is_axis = name in dataset.coords and variable.ndim > 0
        if set(variable.dims) <= set(dims) and (is_axis or needed <= set(variable.dims)):
            kept[str(name)] = dataset[name]
    spread = xarray.broadcast(*(array.reset_coords(drop=True) for array in kept.values()))
    columns = {n: a.transpose(*dims).values.ravel() for n, a in zip(kept, spread, strict=True)}
    units = {n: str(a.attrs["units"]) for n, a in kept.items() if "units" in a.attrs}
    inner = tuple(str(d) for d in dims[:-1] if d != "direction" and dataset.sizes[d] > 1)
    attached = {}
    if own:
        for name, value in dataset.coords.items():
            single = value.size == 1 and name not in ("direction", *dims[-1:])
            if single and value.dtype.kind in "fiu":
                attached[str(name)] = float(value.values.ravel()[0])
    rows = int(np.prod([dataset.sizes[d] for d in dims]))
    return Table(columns, units, np.arange(1, rows + 1), "row", "", attached, inner)
