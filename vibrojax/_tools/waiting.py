"""One line for those who wait for the compiler, in a terminal or a notebook."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

PATIENCE = 2.0
"""Seconds of compiling before something is said."""
PAUSE = 5.0
"""Seconds without compiling after which it is said again."""

_lock = threading.Lock()
_spent, _ended, _said = 0.0, 0.0, False


@contextmanager
def announced(program: str) -> Iterator[None]:
    """Say that a program compiles where that, with those just before, takes longer than a while."""
    global _spent, _ended, _said
    with _lock:
        if time.monotonic() - _ended > PAUSE:
            _spent, _said = 0.0, False
        timer = threading.Timer(max(PATIENCE - _spent, 0.0), _say, (program,))
        timer.daemon = True
    started = time.monotonic()
    if not _said and _is_watched():
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
        with _lock:
            _ended = time.monotonic()
            _spent += _ended - started


def _say(program: str) -> None:
    global _said
    from tqdm import tqdm

    with _lock:
        if _said:
            return
        _said = True
    words = program.rpartition(".")[2].strip("_").replace("_", " ")
    tqdm.write(f"compiling, once: {words} ...", file=sys.stderr)  # above a bar that is shown


def _is_watched() -> bool:
    """Whether somebody reads what is written: in a terminal, or in a notebook."""
    stream = sys.stderr
    return (stream is not None and stream.isatty()) or "ipykernel" in sys.modules
