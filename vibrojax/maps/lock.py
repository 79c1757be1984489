"""One process at a time writes to a store.

The operating system holds the lock and lets go of it when the process ends, however it ends. What
is in its file says who has it. Where the file system knows no locks, the file itself is the lock.
"""

import errno
import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from vibrojax.maps.store_files import StoreInUse

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None

NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)


@contextmanager
def held(file: Path, store: str) -> Iterator[None]:
    """Hold the lock of a store in a file, which is removed at the end.

    Raises `StoreInUse`, which says who has it.
    """
    descriptor = _taken(file, store)
    try:
        me = {
            "process": os.getpid(),
            "host": socket.gethostname(),
            "since": time.strftime("%Y-%m-%d %H:%M:%S"),
        }
        os.ftruncate(descriptor, 0)
        os.write(descriptor, json.dumps(me).encode())
        yield
    finally:
        try:
            if fcntl is not None:  # still held: who opened it before sees that it is gone
                file.unlink(missing_ok=True)
        finally:
            os.close(descriptor)
        if fcntl is None:  # Windows removes no file that is open
            file.unlink(missing_ok=True)


def _taken(file: Path, store: str) -> int:
    """Open and lock a file."""
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(descriptor, file, store)
            # Its last owner may have removed the file at this path.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.stat(file), os.fstat(descriptor)):
                    return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _lock(descriptor: int, file: Path, store: str) -> None:
    if fcntl is not None:
        try:
            return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _in_use(store, _owner(file, wait=1.0)) from None
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
    owner = _owner(file)
    if owner and not _is_dead(owner):
        raise _in_use(store, owner, f". If it has ended, remove {str(file)!r}")


def _owner(file: Path, wait: float = 0.0) -> dict[str, Any]:
    """What the file of a lock says of who has it; nothing where that is not written in time (s)."""
    until = time.monotonic() + wait
    while True:
        with suppress(OSError, ValueError):
            found = json.loads(file.read_text())
            if isinstance(found, dict):
                return found
        if time.monotonic() >= until:
            return {}
        time.sleep(0.02)


def _is_dead(owner: dict[str, Any]) -> bool:
    """Whether the owner is known to have ended: a process of this host that is not there."""
    if fcntl is not None and owner.get("host") == socket.gethostname():
        try:
            os.kill(int(owner["process"]), 0)
        except ProcessLookupError:
            return True
        except (PermissionError, KeyError, ValueError, TypeError):
            pass
    return False


def _in_use(store: str, owner: dict[str, Any], more: str = "") -> StoreInUse:
    who = "another process"
    if owner:
        who = f"process {owner.get('process')} on {owner.get('host')}, since {owner.get('since')}"
    return StoreInUse(
        errno.EBUSY,
        f"store: {store!r} is being written by {who}. Wait for it and repeat the same call, which "
        f"then returns its map, or give another path{more}",
    )
