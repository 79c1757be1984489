"""Progress bars of studies."""

from typing import Any


def progress_bar(name: str, total: int, progress: bool | None, unit: str = "point") -> Any:
    """Return a progress bar; where it is not asked for, on long runs in a terminal."""
    from tqdm import tqdm

    hidden = None if progress is None else not progress
    delay = 2.0 if progress is None else 0.0
    return tqdm(total=total, desc=name, disable=hidden, delay=delay, unit=unit)
