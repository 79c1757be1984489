"""Files that are given by their paths: read whole, or refused in one voice."""

import os
import reprlib
import stat
from pathlib import Path
from typing import Any


def path_of(what: str, path: Any) -> Path:
    """Return a path. Raises `ValueError`, in the name of `what`, for anything that is none."""
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    if not isinstance(text, str) or not text or "\0" in text:
        raise ValueError(f"{what} must be the path of a file, got {reprlib.repr(path)}.")
    return Path(text)


def read_bytes(what: str, path: Any, most: int | None = None, first: int = -1) -> bytes:
    """Return what is in a file of at most `most` bytes, or the `first` bytes of it.

    Raises `ValueError`, in the name of `what`, when there is no such file, or it cannot be read.
    """
    path = path_of(what, path)
    name = f"{what} {os.fspath(path)!r}"
    try:
        there = path.stat()
        if stat.S_ISDIR(there.st_mode):
            raise ValueError(f"{name} is a folder: give the path of a file.")
        if not stat.S_ISREG(there.st_mode):
            raise ValueError(f"{name} is a pipe or a device: give the path of a file.")
        if most is not None and there.st_size > most:
            raise ValueError(
                f"{name} is too large: {there.st_size / 1e6:.0f} MB, at most {most / 1e6:g} MB."
            )
        with path.open("rb") as file:
            return file.read(first)
    except FileNotFoundError:
        raise ValueError(f"{name} does not exist.") from None
    except OSError as error:
        raise ValueError(f"{name} cannot be read: {error.strerror}.") from None
