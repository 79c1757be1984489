"""Results to files: whole or not at all."""

import io
import os
import uuid
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx

from vibrojax._tools.files import path_of
from vibrojax._tools.signatures import validated

if TYPE_CHECKING:
    import xarray

_OTHER_FORMATS = (".csv", ".txt", ".json", ".png", ".svg", ".pdf", ".zarr", ".xlsx", ".mat", ".npz")


@contextmanager
def whole_files(*paths: str | os.PathLike[str] | None) -> Iterator[list[Path | None]]:
    """Give temporary names beside files; all take their places when the block ends, or none does.

    None among `paths` stays None. What is there stays where anything fails. Raises `ValueError` for
    a path at which no file can be; `OSError`, with the path, where writing fails: a full disk.
    """
    targets = [None if path is None else _target(path) for path in paths]
    own = uuid.uuid4().hex
    parts = [t and t.with_name(f".{t.name[:200]}.{own}.part") for t in targets]
    pairs = [(part, target) for part, target in zip(parts, targets, strict=True) if part and target]
    try:
        yield parts
        for part, _ in pairs:
            with part.open("rb+") as written:
                os.fsync(written.fileno())
        for part, target in pairs:
            os.replace(part, target)
    except OSError as error:
        if error.filename not in (None, *(str(part) for part, _ in pairs)):
            raise
        names = ", ".join(str(target) for _, target in pairs)
        why = error.strerror or str(error)
        raise OSError(error.errno or 0, f"{why}; what was there before stays", names) from error
    finally:
        for part, _ in pairs:
            part.unlink(missing_ok=True)


def _target(path: str | os.PathLike[str]) -> Path:
    """Return where a file goes, through links. Raises `ValueError` where it cannot be."""
    target = Path(os.path.realpath(path_of("path", path)))
    if target.is_dir():
        raise ValueError(f"path {os.fspath(path)!r} is a folder: give the name of a file in it.")
    if not target.parent.is_dir():
        raise ValueError(f"The folder of path {os.fspath(path)!r} does not exist: make it first.")
    if target.exists() and not target.is_file():
        raise ValueError(f"path {os.fspath(path)!r} is a pipe or a device, not a file.")
    if not os.access(target.parent, os.W_OK):
        raise ValueError(f"path {os.fspath(path)!r} cannot be written: its folder is read-only.")
    return target


def save_dataset(dataset: "xarray.Dataset", path: str | os.PathLike[str]) -> None:
    """Write a dataset to a NetCDF file, whole or not at all.

    Raises as `whole_files` does, and `ValueError` for the ending of another format.
    """
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    ending = path_of("path", path).suffix.lower()
    if ending in _OTHER_FORMATS:
        raise ValueError(f"path must end in .nc, as NetCDF is written, got {os.fspath(path)!r}.")
    # Made in memory: on a full disk HDF5 ends the whole process.
    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))
    with whole_files(path) as (part,):
        assert part is not None
        part.write_bytes(content.getvalue())


class AbstractSaved(eqx.Module):
    """A result that can be written to a file."""

    @abstractmethod
    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset with named dimensions, units and long names."""

    @validated
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the dataset to a NetCDF file, whole or not at all.

        `path` is that of the file, such as `curve.nc`; what is there is replaced. Raises
        `ValueError` for a path that cannot be a file's, `OSError` where writing fails.
        """
        save_dataset(self.to_xarray(), path)
