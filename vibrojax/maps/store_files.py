"""Files of a store: written whole or not at all, known by a digest; what a disk refuses, said."""

import errno
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

READ_ONLY = (errno.EROFS, errno.EACCES, errno.EPERM)
"""Errors of places where nothing can be written."""


class StoreFull(OSError):
    """The disk of a store is full; what is whole stays."""


class StoreReadOnly(OSError):
    """A store cannot be written; what is in it stays."""


class StoreInUse(OSError):
    """Another process writes to the store."""


def is_full(error: BaseException) -> bool:
    """Whether an error says that there is no room left."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def disk_errors_named() -> Iterator[None]:
    """Say in a sentence that a disk is full or cannot be written."""
    try:
        yield
    except (StoreFull, StoreReadOnly, StoreInUse):
        raise
    except OSError as error:
        if is_full(error):
            raise StoreFull(
                error.errno,
                "The disk of the store is full. What is whole stays: make room and repeat the "
                "same call",
            ) from None
        if error.errno in READ_ONLY:
            raise StoreReadOnly(
                error.errno,
                f"store: {os.fspath(error.filename or 'it')!r} cannot be written "
                f"({os.strerror(error.errno)}). What is whole stays: give another path, or make "
                "it writable and repeat the same call",
            ) from None
        raise


def write_file(path: Path, data: bytes) -> None:
    """Write a file, which appears whole or not at all; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{uuid.uuid4().hex}.partial")
    try:
        part.write_bytes(data)
        os.replace(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def remove(path: Path) -> None:
    """Remove a file, or a folder with what is in it, where there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def make_room(path: Path, inside: Path) -> None:
    """Remove what stands where a file is to be: a folder, or a file in place of its folders."""
    for folder in reversed(path.parents):
        if inside in folder.parents and not folder.is_dir():
            remove(folder)
    remove(path)


def digest(text: str) -> str:
    """Return a text that stands for another of any length."""
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def file_digest(path: Path) -> str | None:
    """Return what stands for the content of a file; None where there is none."""
    try:
        return hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest()
    except FileNotFoundError:
        return None
    except OSError as error:
        return f"unreadable: {error.strerror}"
