"""Public calls checked against their annotations before anything else is done.

One decorator answers what does not fit a signature: an argument that is missing or unknown, one of
another kind than its annotation allows, a batch of systems where one is asked for, and values that
JAX is tracing where they cannot be. What a number has to be is checked by the function itself.
"""

import dataclasses
import functools
import inspect
import math
import sys
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, overload

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from vibrojax._tools.checks import nearest
from vibrojax._tools.described import in_short
from vibrojax._tools.kinds import LARGEST, TEXT, Kind, axes_of, kind_of

Checked = TypeVar("Checked", bound=Callable[..., Any])

TRACEABLE = "modes, motion, simulate, periodic_response, lyapunov_exponent and fold_response"
"""The studies that JAX can trace."""
OWNERS = ("self", "cls")
"""Arguments that nobody gives by name."""


@overload
def validated(function: Checked) -> Checked: ...


@overload
def validated(*, traceable: bool) -> Callable[[Checked], Checked]: ...


def validated(function: Any = None, *, traceable: bool = False) -> Any:
    """Make a function, or the constructor of a class, refuse what its annotations do not allow.

    It raises `ValueError` then, with a sentence that names the argument, what it has to be and what
    it was. Values that JAX is tracing are for modules, and for functions that are `traceable`.
    """
    if function is None:
        return functools.partial(validated, traceable=traceable)
    if isinstance(function, type):
        started: Any = vars(function)["__init__"]
        function.__init__ = _checking(started, function, issubclass(function, eqx.Module))
        return function
    return _checking(function, None, traceable)


def _checking(function: Any, owner: type | None, traceable: bool) -> Any:
    @functools.cache  # read at the first call, so that importing costs nothing
    def call() -> Call:
        return _call_of(function, owner)

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        known = call()
        for name, value in known.given(args, kwargs):
            if name in OWNERS:
                continue
            kind = known.kinds.get(name, known.others)
            if kind is not None and not kind.accepts(value):
                refuse_kind(name, value, kind, known.defaults.get(name, ...))
            if not traceable:
                check_not_traced(known.name, name, value)
            if owner is None and isinstance(value, eqx.Module):
                check_one_lane(name, value)
        return function(*args, **kwargs)

    return checked


class Call(NamedTuple):
    """What is known of a signature."""

    name: str
    positional: tuple[str, ...]
    rest: str | None
    """Name of `*rest`."""
    named: frozenset[str]
    """Names that can be given."""
    needed: tuple[str, ...]
    any_name: bool
    kinds: dict[str, Kind]
    others: Kind | None
    """Kind of `**others`."""
    defaults: dict[str, Any]

    def given(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> list[tuple[str, Any]]:
        """Return the arguments with their names. Raises `ValueError` where they do not fit."""
        found = [*zip(self.positional, args, strict=False), *kwargs.items()]
        beyond = args[len(self.positional) :]
        if beyond and self.rest is None:
            shown = [name for name in self.positional if name not in OWNERS]
            raise ValueError(
                f"Only {', '.join(shown) or 'nothing'} may be given to {self.name} without a "
                f"name, got {in_short(beyond[0])} beyond. Name the others."
            )
        present = {name for name, _ in found}
        if len(present) < len(found):
            twice = next(name for name, _ in found if name in kwargs)
            raise ValueError(f"{twice} is given twice to {self.name}.")
        if not self.any_name and not self.named.issuperset(kwargs):
            name = next(name for name in kwargs if name not in self.named)
            advice = nearest(name, sorted(self.named))
            raise ValueError(f"Unknown argument {name!r} of {self.name}. {advice}")
        for name in self.needed:
            if name not in present:
                words = f", {self.kinds[name].words}" if name in self.kinds else ""
                raise ValueError(f"{self.name} needs {name}{words}: it has no default.")
        return found + [(self.rest or "", one) for one in beyond]


def _call_of(function: Any, owner: type | None) -> Call:
    signature = inspect.signature(function)
    parameters = list(signature.parameters.values())
    names = dict(vars(sys.modules[function.__module__ if owner is None else owner.__module__]))
    fields = {}
    if owner is not None and dataclasses.is_dataclass(owner):
        fields = {f.name: f for f in dataclasses.fields(owner)}
    kinds = {}
    for p in parameters:
        annotation: Any = p.annotation
        field = fields.get(p.name)
        if field is not None and "converter" in field.metadata and annotation is Any:
            # Equinox has put in what the converter takes.
            annotation = field.type
        kind = None if annotation is p.empty else kind_of(annotation, names)
        if kind is not None:
            kinds[p.name] = kind
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    rest, others = (next((p.name for p in parameters if p.kind is k), None) for k in several)
    if rest in kinds and kinds[rest] is not TEXT:
        del kinds[rest]  # who takes other things there says what they are
    plain = [p for p in parameters if p.kind not in several]
    return Call(
        name=owner.__name__ if owner is not None else function.__qualname__,
        positional=tuple(p.name for p in plain if p.kind is not p.KEYWORD_ONLY),
        rest=rest,
        named=frozenset(p.name for p in plain if p.name not in OWNERS),
        needed=tuple(p.name for p in plain if p.default is p.empty),
        any_name=others is not None,
        kinds=kinds,
        others=kinds.pop(others, None) if others is not None else None,
        defaults={p.name: p.default for p in plain if p.default is not p.empty},
    )


def refuse_kind(name: str, value: Any, kind: Kind, default: Any = ...) -> None:
    """Raise the `ValueError` that a value is not of a kind, or the first part of it that is not."""
    for where, part, wanted in kind.parts(value):
        if not wanted.accepts(part):
            refuse_kind(f"{name}{where}", part, wanted)
    words = kind.words
    if kind.or_none and default is not None:  # else it may be left out, which says the same
        words += ", or None"
    if isinstance(value, float) and not math.isfinite(value):
        words = words.replace("a number", "a finite number", 1)
    elif isinstance(value, int | float) and abs(value) > LARGEST:
        words = words.replace("a number", f"a number of at most {LARGEST:g}", 1)
    if kind is TEXT and isinstance(default, str):
        words += f", such as {default!r}"
    advice = _advice(value, kind)
    raise ValueError(f"{name} must be {words}, got {in_short(value)}.{advice and ' '}{advice}")


def _advice(value: Any, kind: Kind) -> str:
    if isinstance(value, Tracer):
        return "JAX is tracing it (jit, vmap, grad), but it has to be known before."
    if isinstance(value, list | tuple) and len(value) == 1 and kind.accepts(value[0]):
        return "Give what is in the list."
    wanted = kind.made_by
    if wanted is None:
        return ""
    if isinstance(value, type):
        return f"Call it first: {value.__name__}(...)." if issubclass(value, wanted) else ""
    if inspect.isfunction(value) and issubclass(wanted, eqx.Module):
        return f"Call it first: {value.__name__}(...)."
    held = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
    owned = [f.name for f in held if isinstance(getattr(value, f.name, None), wanted)]
    return f"Give its {owned[0]}." if owned else ""


def check_not_traced(function: str, name: str, value: Any) -> None:
    """Raise `ValueError` where a value, or a part of it, is traced by JAX."""
    if isinstance(value, str | int | float | None):
        return
    try:
        leaves = jax.tree.leaves(value)
    except (TypeError, ValueError):  # keys of a dict that cannot be sorted
        return
    if any(isinstance(leaf, Tracer) for leaf in leaves):
        raise ValueError(
            f"{function} cannot be traced by JAX (jit, vmap, grad): {name} holds a value that is. "
            f"These studies can: {TRACEABLE}. parameter_map(gradients=...) gives derivatives of "
            "maps."
        )


def check_one_lane(name: str, module: Any) -> None:
    """Raise `ValueError` where a number of a module is a batch, in what takes one system."""
    if not any(kind.__module__.startswith("vibrojax") for kind in type(module).__mro__):
        return
    for field, axes in _number_axes(type(module)):
        value = getattr(module, field, None)
        if isinstance(value, eqx.Module):
            check_one_lane(name, value)
        elif isinstance(value, tuple):
            for part in value:
                check_one_lane(name, part)
        elif axes is not None and value is not None and np.ndim(value) > axes:
            raise ValueError(
                f"{name} holds a batch, and this call takes one: its {field} has the shape "
                f"{np.shape(value)}. Map over it with jax.vmap (equinox.filter_vmap), or give a "
                f"study of several a function of {field} and the list of its values."
            )


@functools.cache
def _number_axes(kind: type) -> list[tuple[str, int | None]]:
    """Fields of a module, with the number of axes that the numbers of one system have there."""
    if not dataclasses.is_dataclass(kind):
        return []
    return [(f.name, axes_of(f.type)) for f in dataclasses.fields(kind)]
