"""Units of measurements, and the headers that name them."""

import re
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np


class Unit(NamedTuple):
    """A unit: what it measures, and its size in SI units."""

    kind: str
    factor: float


_FACTORS = {
    "frequency": {"Hz": 1.0, "kHz": 1e3, "rad/s": 1 / (2 * np.pi), "rpm": 1 / 60},
    "ratio": {"ratio": 1.0},
    "displacement": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3},
    "acceleration": {"m/s2": 1.0, "g": 9.80665},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "power": {"W": 1.0, "mW": 1e-3, "uW": 1e-6},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "angle": {"rad": 1.0, "deg": np.pi / 180},
    "relative": {"relative": 1.0, "%": 1e-2},
}
UNITS = {name: Unit(kind, factor) for kind, own in _FACTORS.items() for name, factor in own.items()}
"""Units by name; frequencies become Hz, all others SI."""

_SPELLED = {
    # m/n is what our own datasets say of a displacement over a force amplitude
    "ratio": ("1", "-", "", "m/m", "m/n"),
    "um": ("micron",),
    "m/s2": ("m/s^2", "m/s**2", "ms-2", "m s-2"),
    "rad/s": ("rad/sec",),
    "rpm": ("1/min",),
    "s": ("sec", "seconds"),
    "rad": ("radians",),
    "deg": ("degrees", "°"),
    "%": ("percent",),
}
_BY_SPELLING = {name.lower(): name for name in UNITS} | {
    spelling: name for name, spellings in _SPELLED.items() for spelling in spellings
}
_NO_SUFFIX = ("1", "-", "", "v", "w")
"""What is no unit behind a name: v and w are displacements and velocities too."""
_AS_SUFFIX = {name.lower() for name in UNITS if name not in ("relative", "%")} | {"m/s^2"}

AXES = {
    "time": "time|t",
    "frequency": "(?:drive|driving|excitation)?(?:frequency|freq|f|hz|omega|rpm|ratio|r)",
}
"""Words of the headers of what a table goes along."""


def find_unit(text: str) -> str | None:
    """Return the name of a unit in any usual spelling; None when it is not known."""
    plain = text.strip().replace("µ", "u").replace("μ", "u").replace("²", "2")
    if plain in UNITS:
        return plain
    if plain[:1] == "M" and plain.lower() in ("mn", "ms", "mm/s", "mhz", "mv", "mw"):
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
    name = re.sub(_PART_OF, r"\1 \2", header.strip())
    bracket = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]", name)
    head, _, tail = name.replace(" ", "_").rpartition("_")
    before, _, after = name.partition("/")
    unit = None
    if bracket:
        name, unit = bracket[1], bracket[2]
    elif head and _is_suffix(tail):
        name, unit = head, tail
    elif after and _is_suffix(after):
        name, unit = before, after
    return Header("".join(re.findall(r"[a-z0-9]+", name.lower())), unit)


def _is_suffix(text: str) -> bool:
    found = find_unit(text)
    return found is not None and found.lower() in _AS_SUFFIX and text.strip() not in _NO_SUFFIX
