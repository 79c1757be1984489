"""Tables of measurements: read from files, datasets, data frames or dictionaries of arrays."""

import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from vibrojax._tools.checks import check_choice
from vibrojax.measured.cells import DECIMALS, plain_array
from vibrojax.measured.datasets import of_dataset
from vibrojax.measured.files import table_of_file
from vibrojax.measured.table import Table, signs_in, with_signs


def read_table(
    source: Any,
    wanted: Iterable[Any] = (),
    along: str | None = None,
    decimal: str | None = None,
    at: str | int | None = None,
) -> Table:
    """Read a table from a path, a dataset, a data frame, a series or a dictionary of arrays.

    `wanted` are the columns asked for: whole numbers among them are positions in a file, counted
    from 0. With `along`, only variables along that dimension are taken from a dataset, and forces
    are summed over stops. `decimal` is the decimal sign of text, None: read off the cells. `at` is
    the place in a file that holds several tables. Raises `ValueError` when the source cannot be
    read, is no table, or holds several.
    """
    import xarray

    wanted = list(wanted)
    if decimal is not None:
        check_choice("decimal", decimal, DECIMALS)
    if isinstance(source, str | os.PathLike):
        return table_of_file(source, wanted, along, decimal, at)
    if at is not None:
        raise ValueError(
            f"at={at!r} is a place in a file, and source is a {type(source).__name__}."
        )
    if isinstance(source, xarray.DataArray):
        if source.name is None:
            raise ValueError(
                "The data array has no name: say what it holds, as in "
                "source.rename('amplitude [mm]')."
            )
        source = source.to_dataset()
    if isinstance(source, xarray.Dataset):
        return of_dataset(source, wanted, along)
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
        return of_dataset(source.to_xarray(), wanted, along)
    raise ValueError(
        "source must be a path, a dataset, a data frame, a series or a dict of arrays, got "
        f"{type(source)}."
    )


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
    return with_signs(table, decimal or signs_in(table), decimal)
