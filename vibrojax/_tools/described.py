"""How the parts of a system show themselves: numbers with units, never a dump of arrays.

Numbers are shown in as few digits as no other number has, so that equal texts mean equal
numbers. What JAX is tracing, and placeholders, show their shape.
"""

import dataclasses
import reprlib
from importlib.metadata import version
from types import FunctionType, ModuleType
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

WIDTH = 100
"""Longest text that stays on one line."""
SHOWN = 4
"""Values of a batch that are all shown."""


def shown_value(value: Any, units: str = "", exact: bool = True) -> str:
    """Return one number, a batch of them, or anything else, in words.

    What was computed has digits enough for the eye when it is not `exact`.
    """
    tail = f" {units}" if units else ""
    if isinstance(value, bool | str | type(None)):
        return repr(value)
    if isinstance(value, Tracer | jax.ShapeDtypeStruct):
        return f"<traced{f' {value.shape}' if value.shape else ''}>{tail}"
    if isinstance(value, int | float):
        return _digits(value, exact) + tail
    if isinstance(value, jax.Array | np.ndarray | np.generic) and np.size(value):
        return _shown_array(np.asarray(value), exact) + tail
    if isinstance(value, eqx.Module):
        if type(value).__repr__ is not eqx.Module.__repr__:
            return repr(value)
        text = repr(value)
        return text if len(text) <= WIDTH else f"{type(value).__name__}(...)"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(shown_value, value))})"
    text = repr(value)
    return text if len(text) <= WIDTH else f"<{type(value).__name__}>"


def _shown_array(values: np.ndarray, exact: bool) -> str:
    if values.ndim == 0:
        return _digits(values[()], exact)
    if values.ndim == 1 and values.size <= SHOWN:
        return f"[{', '.join(_digits(value, exact) for value in values)}]"
    low, high = _digits(values.min(), exact), _digits(values.max(), exact)
    shape = " x ".join(map(str, values.shape))
    return f"{low if low == high else f'{low} to {high}'} ({shape} values)"


def _digits(value: Any, exact: bool) -> str:
    """Return the shortest text that stands for this number only, without an empty fraction."""
    if isinstance(value, int | np.integer | np.bool_):
        return str(value)
    short = f"{value:.6g}"
    return short if not exact or type(value)(short) == value or value != value else str(value)


def described(module: Any) -> str:
    """Return the name of a module with its fields: on one line, or parts of it on lines below.

    Fields that hold None or nothing are left out where that is the default.
    """
    numbers, parts = [], []
    for field in dataclasses.fields(module):
        value = getattr(module, field.name, None)
        nothing = value is None or (isinstance(value, tuple) and not value)
        if nothing and field.default in (value, dataclasses.MISSING):
            continue
        if isinstance(value, tuple) and all(isinstance(v, eqx.Module) for v in value):
            parts += [(f"{field.name}[{k}]", v) for k, v in enumerate(value)]
        elif isinstance(value, eqx.Module):
            parts.append((field.name, value))
        else:
            numbers.append(f"{field.name}={shown_value(value, field.metadata.get('units', ''))}")
    shown = [(name, shown_value(value)) for name, value in parts]
    line = ", ".join([*numbers, *(f"{name}={text}" for name, text in shown)])
    name = type(module).__name__
    if not any("\n" in text for _, text in shown) and len(line) + len(name) <= WIDTH:
        return f"{name}({line})"
    below = [f"  {part}: " + text.replace("\n", "\n  ") for part, text in shown]
    return "\n".join([f"{name}({', '.join(numbers)})", *below])


def in_short(value: Any) -> str:
    """Return a value on one line of a sentence, however large it is, and whatever it is."""
    kind = type(value).__name__
    if isinstance(value, type | FunctionType | ModuleType):
        kind = "class" if isinstance(value, type) else kind
        return f"the {kind} {value.__name__}"
    try:
        if isinstance(value, eqx.Module | jax.Array | np.ndarray | np.generic):
            text = shown_value(value)
        else:
            text = reprlib.repr(value)
    except Exception:  # what cannot show itself, such as an integer of 5,000 digits
        text = ""
    if 0 < len(text) <= WIDTH and "\n" not in text and "object at 0x" not in text:
        return text
    return f"{'an' if kind[0] in 'AEIOUaeiou' or kind == 'ndarray' else 'a'} {kind}"


def recipe(value: Any) -> str:
    """Return the text from which Python makes the value again, as files keep it.

    Of arrays of several numbers it has the shape alone.
    """
    if not isinstance(value, eqx.Module):
        return repr(value)
    return eqx.tree_pformat(jax.tree.map(_plain, value))


def _plain(leaf: Any) -> Any:
    """Return an array of one number as that number, for else its text says only that it is one."""
    known = isinstance(leaf, jax.Array | np.ndarray | np.generic) and not isinstance(leaf, Tracer)
    return leaf.item() if known and not np.ndim(leaf) else leaf


def provenance(study: str, rig: str) -> dict[str, str]:
    """Return the attributes of a result that say what was run, on which rig, by which versions."""
    return {
        "title": f"vibrojax {study}",
        "rig": rig,
        "vibrojax_version": version("vibrojax"),
        "jax_version": version("jax"),
    }


class AbstractSettings(eqx.Module):
    """Settings, which show themselves as `described` does."""

    def __repr__(self) -> str:
        return described(self)
