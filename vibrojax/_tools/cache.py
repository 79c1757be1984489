"""Where compiled programs are kept between processes, and for whom they are good.

XLA's programs are in JAX's own persistent cache, whose folder is set here unless the user has set
one. Traced programs (`compiled`) are beside them. Both are in a folder named by what made them, so
that no other version of vibrojax, JAX or the processor's instructions reads them.
"""

import functools
import hashlib
import os
import platform
import re
import shutil
import tempfile
import warnings
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

import jax
import platformdirs
from jax.experimental.compilation_cache import compilation_cache

SWITCH = "VIBROJAX_CACHE"
"""Environment variable: 0 for no cache, or the folder to use."""
LARGEST = 512 * 2**20
"""Bytes of XLA's programs, and as many of traced ones; what was not used for longest goes first."""
KEPT = 3
"""Folders of other versions that stay when a new one is made."""
PROBE = 2**16
FOLDER = re.compile(r"jax-.+-[0-9a-f]{16}")
"""Names that `maker` gives; what else is in the folder is not ours to delete."""
MADE_BY = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")


def root() -> Path | None:
    """Folder of the cache; None where the user has switched it off."""
    asked = os.environ.get(SWITCH, "").strip()
    if asked.lower() in ("0", "false", "off", "no"):
        return None
    if asked and asked.lower() not in ("1", "true", "on", "yes"):
        # pathlib raises for a home that there is not; a process may change its folder.
        return Path(os.path.expanduser(asked)).absolute()
    return platformdirs.user_cache_path("vibrojax", appauthor=False)


@functools.cache
def maker() -> str:
    """What programs depend on beside their arguments: sources, versions and processor."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[1]
    for path in sorted(package.rglob("*.py")):
        digest.update(str(path.relative_to(package)).encode() + path.read_bytes())
    for name in MADE_BY:
        with suppress(PackageNotFoundError):
            digest.update(f"{name} {version(name)}".encode())
    digest.update(_processor().encode())
    digest.update(os.environ.get("XLA_FLAGS", "").encode())
    return f"jax-{version('jax')}-{digest.hexdigest()[:16]}"


def _processor() -> str:
    """The processor's instructions, as far as the system says: programs are made for them."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith(("flags", "Features")):
                return line
    return f"{platform.machine()} {platform.processor()}"


def start() -> Path | None:
    """Begin to use the cache; return the folder of traced programs, None where there is none.

    JAX's own cache is left alone where the user has set one. A folder that cannot be written to is
    a warning.
    """
    where = root()
    if where is None:
        return None
    try:
        own = where / maker()
        new = not own.exists()
        traced, xla = own / "traced", own / "xla"
        for part in (traced, xla):
            part.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=xla) as probe:
            probe.write(bytes(PROBE))
        if new:
            _drop_others(where, own)
        _mend(xla)
        os.utime(own)
    except OSError as error:
        warnings.warn(
            f"vibrojax cannot keep compiled programs in {where} ({error.strerror or error}), so "
            f"every process compiles anew. Set {SWITCH} to a folder that can be written to, or to "
            "0 to do without.",
            stacklevel=2,
        )
        return None
    if getattr(jax.config, "jax_compilation_cache_dir", None) is None:
        jax.config.update("jax_compilation_cache_dir", str(xla))
        compilation_cache.reset_cache()  # JAX looks once only, when it first compiles
        jax.config.update("jax_compilation_cache_max_size", LARGEST)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        # A disk that fills up is no reason to say so for every program.
        warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")
    return traced


folder = functools.cache(start)
"""Returns the folder of traced programs of this process; begins to use the cache once."""


def _folders(where: Path) -> list[Path]:
    """Folders of all versions, used last ones last. Raises `OSError` where they cannot be read."""
    found = []
    with suppress(FileNotFoundError), os.scandir(where) as entries:
        for entry in entries:
            with suppress(FileNotFoundError):  # another process has just deleted it
                if FOLDER.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False):
                    found.append((entry.stat().st_mtime, Path(entry.path)))
    return [path for _, path in sorted(found)]


def _drop_others(where: Path, own: Path) -> None:
    for path in [path for path in _folders(where) if path != own][:-KEPT]:
        shutil.rmtree(path, ignore_errors=True)


def _mend(xla: Path) -> None:
    """Delete what a process was killed in writing: JAX reads its time before it writes any more."""
    names = set(os.listdir(xla))
    for name in names:
        if name.endswith("-cache") and f"{name.removesuffix('-cache')}-atime" not in names:
            (xla / name).unlink(missing_ok=True)


class Amount(NamedTuple):
    """How many, and their bytes together."""

    number: int
    size: int


class Kept(NamedTuple):
    """What is kept in a folder."""

    traced: Amount
    xla: Amount
    others: Amount
    """Folders of other versions."""


def kept(where: Path) -> Kept:
    """Count what is kept in a folder. Raises `OSError` where it cannot be read."""
    own = where / maker()
    others = [_sizes(path) for path in _folders(where) if path != own]
    traced, xla = _sizes(own / "traced"), _sizes(own / "xla", "-cache")
    return Kept(
        Amount(len(traced), sum(traced)),
        Amount(len(xla), sum(xla)),
        Amount(len(others), sum(map(sum, others))),
    )


def _sizes(folder: Path, ending: str = "") -> list[int]:
    """Bytes of the files in a folder and below it; none where there is no folder."""

    def refuse(error: OSError) -> None:
        if not isinstance(error, FileNotFoundError):
            raise error

    sizes = []
    for where, _, names in os.walk(folder, onerror=refuse):
        for name in names:
            with suppress(FileNotFoundError):  # another process has just deleted it
                if name.endswith(ending):
                    sizes.append(os.stat(os.path.join(where, name)).st_size)
    return sizes


def clear() -> None:
    """Delete all that is kept, of every version. Raises `OSError` where that cannot be done."""
    where = root()
    for path in _folders(where) if where is not None else ():
        shutil.rmtree(path)


def write(path: Path, content: bytes) -> None:
    """Write a file at once or not at all, whatever other processes do, and keep within the size."""
    with suppress(OSError):
        handle, part = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(part, path)
        except BaseException:
            Path(part).unlink(missing_ok=True)
            raise
        _bound(path.parent)


def read(path: Path) -> bytes | None:
    """Return what was written; None where nothing was, or it cannot be read."""
    with suppress(OSError):
        content = path.read_bytes()
        os.utime(path)  # as it was used
        return content
    return None


def _bound(folder: Path) -> None:
    with os.scandir(folder) as entries:
        found = [(e.stat().st_mtime, e.stat().st_size, e.path) for e in entries]
    left = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if left <= LARGEST:
            return
        Path(path).unlink(missing_ok=True)
        left -= size


folder()  # before anything compiles
