"""Refusals of wrong input, in one voice: name the argument, the value, what is allowed, what to do.

Only concrete values are checked: under `jit`, `vmap` or `grad` a value is a tracer and passes.
"""

import difflib
import inspect
from collections.abc import Callable, Iterable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from vibrojax._tools.described import in_short
from vibrojax._tools.kinds import NUMBERS, is_list


def as_number(value: Any) -> Any:
    """Make a Python float of a whole number; leave arrays, and what JAX puts there, as they are."""
    # A Python float keeps its weak type, so construction costs no device transfer.
    return float(value) if isinstance(value, int) else value


def number_field(units: str = "", **default: Any) -> Any:
    """Make a field of a Module that holds one number: sweepable, batchable, differentiable.

    The `units` are what the `repr` of the Module shows behind the number.
    """
    return eqx.field(converter=as_number, metadata={"units": units}, **default)


def is_traced(value: Any) -> bool:
    """Whether JAX is tracing the value, so that it has no number yet."""
    return isinstance(value, Tracer)


def concrete(value: Any) -> np.ndarray | None:
    """Return the value as a float array, or None while JAX is tracing it."""
    if is_traced(value) or value is None:
        return None
    if not isinstance(value, int | float | np.ndarray | np.generic | jax.Array):
        return None  # a placeholder put in by a tree transformation
    return np.asarray(value, dtype=float)


def _refuse(name: str, value: Any, allowed: str, advice: str) -> None:
    tail = f" {advice}" if advice else ""
    raise ValueError(f"{name} must be {allowed}, got {in_short(value)}.{tail}")


def nearest(name: str, known: Iterable[str]) -> str:
    """Advice for an unknown name: the nearest known one, and all of them."""
    known = list(known)
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"Did you mean {close[0]!r}? " if close else ""
    return f"{hint}Known: {', '.join(known) or 'nothing'}."


def _shown(values: np.ndarray, bad: np.ndarray | np.bool_) -> Any:
    return values.item() if values.ndim == 0 else values[bad].flat[0].item()


def check_range(
    name: str,
    value: Any,
    low: float = -np.inf,
    high: float = np.inf,
    *,
    include_low: bool = True,
    include_high: bool = True,
    allowed: str,
    advice: str = "",
) -> None:
    """Raise `ValueError` unless every entry of `value` is finite and inside the interval."""
    values = concrete(value)
    if values is None:
        return
    above = values >= low if include_low else values > low
    below = values <= high if include_high else values < high
    bad = ~(above & below & np.isfinite(values))
    if bad.any():
        _refuse(name, _shown(values, bad), allowed, advice)


def check_positive(name: str, value: Any, unit: str, advice: str = "") -> None:
    """Raise `ValueError` unless the value is finite and above 0."""
    check_range(name, value, 0.0, include_low=False, allowed=f"above 0 {unit}", advice=advice)


def check_not_negative(name: str, value: Any, unit: str) -> None:
    """Raise `ValueError` unless the value is finite and at least 0."""
    check_range(name, value, 0.0, allowed=f"at least 0 {unit}")


def check_one(name: str, value: Any, unit: str, advice: str = "") -> None:
    """Raise `ValueError` where there are several numbers, traced or not."""
    if is_list(value):
        _refuse(name, value, f"one number ({unit})", advice)


def check_one_number(name: str, value: Any, unit: str, advice: str) -> None:
    """Raise `ValueError` unless the value is one finite number above 0, traced or not."""
    check_one(name, value, unit, advice)
    check_positive(name, value, unit)


def axis_of(name: str, values: Any) -> np.ndarray:
    """Return a list of finite numbers as an array. Raises `ValueError` for anything else."""
    known = NUMBERS.accepts(values) and not any(map(is_traced, jax.tree.leaves(values)))
    axis = np.asarray(values, float) if known else np.empty(0)
    if axis.ndim != 1 or not axis.size or not np.isfinite(axis).all():
        _refuse(name, values, "a non-empty list of finite numbers", "")
    return axis


def name_of(function: Any) -> str:
    """Return what a sentence calls a function."""
    return f"The function {getattr(function, '__name__', type(function).__name__)}"


def check_names(function: Callable[..., Any], given: Iterable[str], where: str = "") -> None:
    """Raise `ValueError` for a name, given there, that a function does not take."""
    parameters = inspect.signature(function).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return
    known = [p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    for name in given:
        if name not in known:
            within = f" in {where}" if where else ""
            raise ValueError(
                f"Unknown argument {name!r} of the rig{within}. {nearest(name, known)}"
            )


def check_needed_arguments(function: Callable[..., Any], given: Iterable[str]) -> None:
    """Raise `ValueError` when an argument without a default of a function is not given."""
    given = set(given)
    for p in inspect.signature(function).parameters.values():
        named = p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
        if named and p.default is p.empty and p.name not in given:
            raise ValueError(
                f"{name_of(function)} needs a value of {p.name!r}. Give it in the call, "
                f"{p.name}=..., or as a default there."
            )


def check_position(name: str, value: Any) -> None:
    """Raise `ValueError` unless the value is a place on the beam off its root, x/L in (0, 1]."""
    check_range(
        name,
        value,
        0.0,
        1.0,
        include_low=False,
        allowed="above 0 (root) and at most 1 (tip)",
        advice="It is x/length.",
    )


def check_count(name: str, value: Any, least: int = 1, most: int = 10**9) -> None:
    """Raise `ValueError` unless the value is a whole number from `least` to `most`."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        _refuse(name, value, f"a whole number of at least {least}", "")
    if value > most:
        _refuse(name, value, f"a whole number of at most {most:,}", "")


def check_index(name: str, value: int, size: int, first: int = 0) -> None:
    """Raise `ValueError` unless the value is the number of one of so many, counted from `first`."""
    if not first <= value < first + size:
        _refuse(name, value, f"a whole number from {first} to {first + size - 1}", "")


def check_seed(seed: Any) -> None:
    """Raise `ValueError` unless random numbers can be drawn from the seed."""
    check_count("seed", seed, least=0, most=2**63 - 1)


def check_choice(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    """Raise `ValueError` unless the value is one of the named choices."""
    if value not in choices:
        listed = ", ".join(repr(c) for c in choices)
        _refuse(name, value, f"one of {listed}", "")


def check_frequencies(name: str, values: Any, unit: str, advice: str = "Sort it.") -> np.ndarray:
    """Return a frequency axis as a 1-D array: finite, above 0, strictly increasing, not empty.

    Raises `ValueError` otherwise.
    """
    if not NUMBERS.accepts(values):
        _refuse(name, values, f"a sequence of numbers ({unit})", "")
    axis = np.asarray(values, dtype=float)
    if axis.ndim > 1:
        raise ValueError(f"{name} must be one-dimensional, got an array of shape {axis.shape}.")
    axis = np.atleast_1d(axis)
    if axis.size == 0:
        raise ValueError(f"{name} is empty: give at least one value.")
    for wrong, allowed in ((~np.isfinite(axis), "finite"), (axis <= 0, f"above 0 {unit}")):
        if wrong.any():
            bad = int(np.argmax(wrong))
            raise ValueError(f"{name} must be {allowed}, got {axis[bad]} at index {bad}.")
    falls = np.diff(axis) <= 0
    if falls.any():
        bad = int(np.argmax(falls))
        raise ValueError(
            f"{name} must increase strictly, got {axis[bad]} then {axis[bad + 1]} at index "
            f"{bad + 1}. {advice}"
        )
    return axis
