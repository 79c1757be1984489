"""Units of measurements, and the headers that name them."""

import re
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np


class Unit(NamedTuple):
    """A unit: what it measures, and its size in SI units."""

    kind: str
    factor: float


UNITS = {
    "Hz": Unit("frequency", 1.0),
    "kHz": Unit("frequency", 1e3),
    "rad/s": Unit("frequency", 1 / (2 * np.pi)),
    "rpm": Unit("frequency", 1 / 60),
    "ratio": Unit("ratio", 1.0),
    "m": Unit("displacement", 1.0),
    "mm": Unit("displacement", 1e-3),
    "um": Unit("displacement", 1e-6),
    "m/s": Unit("velocity", 1.0),
    "mm/s": Unit("velocity", 1e-3),
    "m/s2": Unit("acceleration", 1.0),
    "g": Unit("acceleration", 9.80665),
    "N": Unit("force", 1.0),
    "mN": Unit("force", 1e-3),
    "kN": Unit("force", 1e3),
    "s": Unit("time", 1.0),
    "ms": Unit("time", 1e-3),
    "us": Unit("time", 1e-6),
    "rad": Unit("angle", 1.0),
    "deg": Unit("angle", np.pi / 180),
    "relative": Unit("relative", 1.0),
    "%": Unit("relative", 1e-2),
}
"""Units by name; frequencies become Hz, all others SI."""

_SPELLED = {
    "1": "ratio",
    "-": "ratio",
    "": "ratio",
    "m/m": "ratio",
    "m/n": "ratio",  # what our own datasets say of a displacement over a force amplitude
    "micron": "um",
    "m/s^2": "m/s2",
    "m/s**2": "m/s2",
    "ms-2": "m/s2",
    "m s-2": "m/s2",
    "rad/sec": "rad/s",
    "1/min": "rpm",
    "sec": "s",
    "seconds": "s",
    "radians": "rad",
    "degrees": "deg",
    "°": "deg",
    "percent": "%",
}
_BY_SPELLING = {name.lower(): name for name in UNITS} | _SPELLED
_AS_SUFFIX = {name.lower() for name in UNITS if name not in ("relative", "%")} | {"m/s^2"}


def find_unit(text: str) -> str | None:
    """Return the name of a unit in any usual spelling; None when it is not known."""
    plain = text.strip().replace("µ", "u").replace("μ", "u").replace("²", "2")
    if plain in UNITS:
        return plain
    if plain[:1] == "M" and plain.lower() in ("mn", "ms", "mm/s", "mhz"):
        return None  # mega, not milli
    return _BY_SPELLING.get(plain.lower())


def unit_named(name: str, text: Any, kinds: Iterable[str]) -> str:
    """Return a unit of one of the kinds; raise `ValueError` in the name of `name` otherwise."""
    found = find_unit(text) if isinstance(text, str) else None
    kinds = tuple(kinds)
    if found is None or UNITS[found].kind not in kinds:
        allowed = [unit for unit, of in UNITS.items() if of.kind in kinds]
        raise ValueError(
            f"Unit of {name} must be one of {', '.join(map(repr, allowed))}, got {text!r}. "
            f"Say it by units=dict({name}={allowed[0]!r})."
        )
    return found


_PART_OF = r"(?i)^(re|im|real|imag|abs|mag|arg|phase)\((\w+)\)"


class Header(NamedTuple):
    """A column header taken apart."""

    words: str
    """Lower case, without separators."""
    unit: str | None
    """As written, in brackets or as a suffix; None: there is none."""


def split_header(header: str) -> Header:
    """Take a header like `frequency [Hz]`, `f_Hz`, `tip/mm` or `rms_ratio` apart."""
    # Re(H) is a part of H, not "Re" in a unit H.
    name, unit = re.sub(_PART_OF, r"\1 \2", header.strip()), None
    bracket = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]", name)
    slash = name.partition("/")
    if bracket:
        name, unit = bracket[1], bracket[2]
    else:
        head, _, tail = name.replace(" ", "_").rpartition("_")
        if head and _is_suffix(tail):
            name, unit = head, tail
        elif slash[2] and _is_suffix(slash[2]):
            name, unit = slash[0], slash[2]
    return Header("".join(re.findall(r"[a-z0-9]+", name.lower())), unit)


def _is_suffix(text: str) -> bool:
    found = find_unit(text)
    return found is not None and found.lower() in _AS_SUFFIX and text.strip() not in ("1", "-", "")
