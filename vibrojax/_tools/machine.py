"""What this machine is like, as far as speed depends on it."""

import functools
import subprocess
from contextlib import suppress
from pathlib import Path

UNKNOWN = 2**20
"""Bytes of a cache that cannot be asked for."""
UNITS = {"K": 2**10, "M": 2**20, "G": 2**30}


@functools.cache
def second_level_cache() -> int:
    """Bytes of the second-level cache of a core."""
    with suppress(OSError, ValueError, IndexError):  # Linux
        for kind in Path("/sys/devices/system/cpu/cpu0/cache").glob("index*"):
            if (kind / "level").read_text().strip() == "2":
                size = (kind / "size").read_text().strip()
                return int(size[:-1]) * UNITS[size[-1]] if size[-1] in UNITS else int(size)
    for name in ("hw.perflevel0.l2cachesize", "hw.l2cachesize"):  # macOS
        with suppress(OSError, ValueError, subprocess.SubprocessError):
            answer = subprocess.run(["sysctl", "-n", name], capture_output=True, timeout=5)
            if answer.returncode == 0:
                return int(answer.stdout) or UNKNOWN
    return UNKNOWN


def mappings_used() -> float:
    """Share of the memory mappings that Linux allows a process which this one has; else 0.

    Every program takes hundreds of, by default, 65530; XLA crashes where it is refused one.
    """
    with suppress(OSError, ValueError):
        most = int(Path("/proc/sys/vm/max_map_count").read_text())
        return Path("/proc/self/maps").read_bytes().count(b"\n") / most
    return 0.0
