"""What `vibrojax cache` does."""

import os

from vibrojax._tools import cache
from vibrojax.cli.options import Cache

JAX_FOLDER = "JAX_COMPILATION_CACHE_DIR"


def run_cache(options: Cache) -> int:
    """Print what is kept of compiled programs, or delete it. Raises `OSError` where it cannot."""
    where = cache.root()
    if where is None:
        print(f"Compiled programs are not kept: {cache.SWITCH}={os.environ[cache.SWITCH]}.")
        return 0
    traced, xla, others = cache.kept(where)
    folders = f"{others.number} folder{'s' * (others.number != 1)}"
    elsewhere = os.environ.get(JAX_FOLDER)
    if options.clear:
        cache.clear()
        print(
            f"Freed {_megabytes(traced.size + xla.size + others.size)} in {where}: {traced.number} "
            f"traced programs, {xla.number} XLA programs, {folders} of other versions."
        )
        if elsewhere:
            print(f"XLA programs in {elsewhere} ({JAX_FOLDER}) are left.")
        return 0
    limit = _megabytes(cache.LARGEST)
    rows = {
        "folder": where,
        "traced programs": f"{traced.number}, {_megabytes(traced.size)}",
        "XLA programs": f"{xla.number}, {_megabytes(xla.size)}",
        "other versions": f"{folders}, {_megabytes(others.size)}",
        "limit": f"{limit} of traced programs, {limit} of XLA programs, in each folder",
        "to clear it": "vibrojax cache --clear",
        "to move it": f"{cache.SWITCH}=FOLDER",
        "to do without": f"{cache.SWITCH}=0",
    }
    if elsewhere:
        rows["XLA programs"] += f"; now kept in {elsewhere} instead ({JAX_FOLDER})"
    print("Compiled programs, kept for the next process")
    for label, text in rows.items():
        print(f"  {label:15}  {text}")
    return 0


def _megabytes(size: int) -> str:
    return f"{size / 2**20:.{0 if size >= 2**26 else 1}f} MB"
