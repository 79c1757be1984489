"""Files of measurements, by what they begin with: text, workbooks, MAT, HDF5, TDMS, UFF, NetCDF."""

import importlib
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from vibrojax._tools.files import path_of, read_bytes
from vibrojax.measured.datasets import of_dataset
from vibrojax.measured.groups import table_in
from vibrojax.measured.mat_files import read_mat
from vibrojax.measured.sheet_files import read_sheet
from vibrojax.measured.table import NoTable, Table, signs_in, with_signs, with_units_row
from vibrojax.measured.tdms_files import read_tdms
from vibrojax.measured.text_files import read_text
from vibrojax.measured.uff_files import looks_universal, read_uff

_START = 1024
_HDF = b"\x89HDF"


class Asked(NamedTuple):
    """What is asked of a file."""

    path: Path
    wanted: list[Any]
    """Columns: whole numbers are positions, counted from 0."""
    along: str | None
    """`time` for histories, None for curves."""
    decimal: str | None
    at: str | int | None

    @property
    def axis(self) -> str:
        """What the table goes along."""
        return self.along or "frequency"

    @property
    def by_position(self) -> bool:
        """Whether columns are asked for by position."""
        return any(isinstance(w, int) for w in self.wanted)


def table_of_file(
    source: str | os.PathLike[str],
    wanted: list[Any],
    along: str | None,
    decimal: str | None,
    at: str | int | None,
) -> Table:
    """Return the table of a file. Raises `ValueError` when there is none or it is not clear which.

    Raises `ImportError` for the format of a library that is not installed.
    """
    start = read_bytes("File", source, first=_START)
    path = path_of("File", source)
    kind, reader = _reader(path.suffix.lower(), start)
    asked = Asked(path, wanted, along, decimal, at)
    try:
        if at is not None and reader in (_text, _netcdf):
            raise NoTable(f"has one table, as {kind}: leave out at={at!r}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what readers say of files that they then read
            return reader(asked)._replace(label=path.stem)
    except NoTable as error:
        raise ValueError(f"{path.name!r} {error}.") from None
    except ImportError:
        raise
    except Exception as error:  # whatever libraries make of a file that is damaged
        said = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        raise ValueError(f"{path.name!r} cannot be read as {kind}: {said}.") from None


def _reader(suffix: str, start: bytes) -> tuple[str, Callable[[Asked], Table]]:
    """Return the name of the format, and what reads it: by the content, else by the name."""
    if start.startswith((b"MATLAB 7.3", _HDF)) or start[512:516] == _HDF:
        return "HDF5", _hdf
    if start.startswith(b"CDF") or suffix in (".nc", ".nc4"):
        return "NetCDF", _netcdf
    if suffix in (".h5", ".hdf5", ".hdf"):
        return "HDF5", _hdf
    if start.startswith(b"MATLAB ") or suffix == ".mat":
        return "MAT", _mat
    if start.startswith((b"TDSm", b"TDSh")) or suffix == ".tdms":
        return "TDMS", _tdms
    if start.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return "a workbook", _workbook
    if looks_universal(start) or suffix in (".uff", ".unv", ".bunv"):
        return "a universal file", _universal
    if start.startswith(b"\x1f\x8b"):
        return "text", _compressed
    return "text", _text


def _library(name: str, package: str, path: Path) -> ModuleType:
    """Return a library that is an extra. Raises `ImportError` where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f"Reading {path.name!r} needs {package}, which is not installed. Install it by "
            'pip install "vibrojax[formats]".'
        ) from error


def _text(asked: Asked) -> Table:
    return read_text(read_bytes("File", asked.path), asked.by_position, asked.decimal)


def _compressed(asked: Asked) -> Table:
    raise NoTable("is not text but compressed: unpack it")


def _netcdf(asked: Asked) -> Table:
    import xarray

    engine = "scipy" if read_bytes("File", asked.path, first=3) == b"CDF" else "h5netcdf"

    # Times stay numbers: xarray would make durations of "seconds".
    with xarray.open_dataset(asked.path, engine=engine, decode_times=False) as file:
        dataset = file.load()
    return of_dataset(dataset, asked.wanted, asked.along)


def _hdf(asked: Asked) -> Table:
    import h5py

    from vibrojax.measured.hdf_files import is_netcdf, read_hdf

    with h5py.File(asked.path, "r") as file:
        on_top = any(isinstance(item, h5py.Dataset) for item in file.values())
        if asked.at is None and on_top and is_netcdf(file):
            return _netcdf(asked)
        matlab = read_bytes("File", asked.path, first=6) == b"MATLAB"
        return table_in(read_hdf(file), asked.at, asked.wanted, asked.axis, "." if matlab else "/")


def _mat(asked: Asked) -> Table:
    held = read_mat(read_bytes("File", asked.path))
    return table_in(held, asked.at, asked.wanted, asked.axis, ".")


def _tdms(asked: Asked) -> Table:
    nptdms = _library("nptdms", "npTDMS", asked.path)
    # Given a path it leaves files open that it cannot read.
    with asked.path.open("rb") as raw, nptdms.TdmsFile.open(raw) as file:
        return table_in(read_tdms(file), asked.at, asked.wanted, asked.axis, "/")


def _workbook(asked: Asked) -> Table:
    calamine = _library("python_calamine", "python-calamine", asked.path)
    with asked.path.open("rb") as raw:
        workbook = calamine.CalamineWorkbook.from_filelike(raw)
        table = with_units_row(read_sheet(workbook, asked.at, asked.by_position))
    return with_signs(table, asked.decimal or signs_in(table), asked.decimal)


def _universal(asked: Asked) -> Table:
    pyuff = _library("pyuff", "pyuff", asked.path)
    return read_uff(pyuff.UFF(str(asked.path)), asked.at, asked.axis)
