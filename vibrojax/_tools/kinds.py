"""Kinds of arguments: what an annotation allows, in words, and whether a value is of that kind.

Kinds only: whether a number is above 0, say, is checked where it is used.
"""

import collections.abc
import inspect
import math
import os
import re
import sys
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeGuard

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import AbstractArray

LARGEST_COUNT = 2**63 - 1
"""Largest whole number that an array holds."""
LARGEST = 1e100
"""Largest number: products of a few are numbers still."""


def _nothing_inside(value: Any) -> Iterator[Any]:
    return iter(())


class Kind(NamedTuple):
    """What an argument may be."""

    words: str
    accepts: Callable[[Any], bool]
    parts: "Callable[[Any], Iterator[tuple[str, Any, Kind]]]" = _nothing_inside
    """What a container holds: where, what, and the kind that it has to be."""
    plural: str = ""
    made_by: type | None = None
    """The class of which it is an instance."""
    or_none: bool = False
    """Whether None is another way to say that it is left out."""


def _is_array(value: Any) -> TypeGuard[jax.Array | np.ndarray | np.generic]:
    return isinstance(value, jax.Array | np.ndarray | np.generic)


def _is_real(array: Any) -> bool:
    kinds = (np.integer, np.floating)  # by jax, which knows of short floats too
    return any(jax.numpy.issubdtype(array.dtype, kind) for kind in kinds)


def is_number(value: Any) -> bool:
    """Whether it is one real number that is known (not traced), finite and not beyond use."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return bool(abs(value) <= LARGEST)  # not so for NaN either
    if isinstance(value, Tracer) or not _is_array(value):
        return False
    return value.ndim == 0 and _fits(value)


def _fits(array: Any) -> bool:
    """Whether an array holds real numbers, and is finite if it is one number that is known.

    Who takes a list says at which index of it something is not finite.
    """
    if array.ndim or isinstance(array, Tracer) or not _is_real(array):
        return _is_real(array)
    return bool(np.abs(np.asarray(array)) <= LARGEST)


def _is_number_or_batch(value: Any) -> bool:
    if isinstance(value, float) and not math.isfinite(value):
        return True  # refused with the unit, by what it is a number of
    if is_number(value):
        return True
    if not _is_array(value) or not value.size or not _fits(value):
        return False
    return isinstance(value, Tracer) or not bool((np.abs(np.asarray(value)) > LARGEST).any())


def _are_numbers(value: Any) -> bool:
    """Whether it is a number, or an array, a list or a series of them, perhaps of none."""
    if is_number(value):
        return True
    if not _is_array(value) and (is_list(value) or hasattr(value, "__array__")):
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value)):
            return True
        try:
            value = np.asarray(value)
        except (TypeError, ValueError, OverflowError):
            return False
    return _is_array(value) and (value.size == 0 or _fits(value))


def _are_complex(value: Any) -> bool:
    """Whether it is an array, or numbers that make one, complex ones too."""
    if isinstance(value, np.ndarray) or _are_numbers(value):
        return True
    return is_list(value) and all(isinstance(one, int | float | complex) for one in value)


def _is_whole(value: Any) -> bool:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    return whole and abs(int(value)) <= LARGEST_COUNT


def _has_names(value: Any) -> bool:
    """Whether it can be called and Python knows the names of its arguments."""
    try:
        return callable(value) and inspect.signature(value) is not None
    except (TypeError, ValueError):
        return False


NUMBER = Kind("a number", is_number, plural="numbers")
NUMBER_OR_BATCH = Kind("a number", _is_number_or_batch)
ONE_OF_NUMBERS = Kind("a number", _are_numbers)  # who asks for one says what takes several
NUMBERS = Kind("a number or a list of numbers", _are_numbers, plural="numbers")
ARRAY = Kind("a number or an array of numbers", _are_numbers)
TEXT = Kind("a text", lambda value: isinstance(value, str), plural="texts")
FUNCTION = Kind("a function", callable, plural="functions")
BY_NAME = Kind("a function of named numbers", _has_names)
PATH = Kind("a path", lambda value: isinstance(value, os.PathLike), plural="paths")
_PLAIN = {
    float: NUMBER,
    int: Kind("a whole number", _is_whole, plural="whole numbers"),
    str: TEXT,
    bool: Kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
    type(None): Kind("None", lambda value: value is None),
    np.ndarray: Kind("an array of numbers", _are_complex),
}
_ARRAY_LIKE = (jax.Array, np.ndarray, np.bool_, np.number, bool, int, float, complex)


def kind_of(annotation: Any, names: dict[str, Any]) -> Kind | None:
    """Return the kind that an annotation asks for; None where it allows anything.

    `names` are those that a text in place of an annotation may use.
    """
    if isinstance(annotation, str):
        try:
            annotation = eval(annotation, dict(names))
        except NameError:  # imported for the type checker only
            return None
    if annotation is Any:
        return None
    annotation = type(None) if annotation is None else annotation
    origin, inside = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is None:
        if annotation in _PLAIN:
            return _PLAIN[annotation]
        return _instance_of(annotation) if _is_class(annotation) else None
    if origin in (typing.Union, types.UnionType):
        return _one_of(inside, names)
    if origin is collections.abc.Callable:
        if inside[0] is not Ellipsis:
            return FUNCTION
        made = inside[-1]
        ours = isinstance(made, type) and made.__module__.startswith("vibrojax")
        return BY_NAME._replace(words=f"a function that makes {_noun(made)}") if ours else BY_NAME
    if origin in (collections.abc.Mapping, dict):
        return _dict_of(kind_of(inside[0], names) or TEXT, kind_of(inside[1], names))
    if origin is tuple and inside[-1] is not Ellipsis:
        return _row_of([kind_of(item, names) for item in inside])
    if origin in (tuple, list, collections.abc.Sequence):
        return _list_of(kind_of(inside[0], names))
    return _instance_of(origin) if _is_class(origin) else None


def _is_class(annotation: Any) -> bool:
    return isinstance(annotation, type) and annotation is not object


def _one_of(members: tuple[Any, ...], names: dict[str, Any]) -> Kind | None:
    left, kinds = list(members), []
    if type(None) in left:
        left.remove(type(None))
        kind = _one_of(tuple(left), names) if len(left) > 1 else kind_of(left[0], names)
        if kind is None:
            return None
        accepts = kind.accepts
        return kind._replace(accepts=lambda value: value is None or accepts(value), or_none=True)
    numbers: list[Kind] = []
    lists = [m for m in left if typing.get_origin(m) is collections.abc.Sequence]
    arrays = [m for m in left if _is_batch(m)]
    if jax.Array in left and complex in left:  # what jaxtyping calls ArrayLike
        nested = any(typing.get_args(m)[0] is Any for m in lists)
        numbers.append(ARRAY if nested else NUMBERS if lists else ONE_OF_NUMBERS)
        left = [m for m in left if m not in (*_ARRAY_LIKE, *lists)]
    elif float in left:
        numbers.append(NUMBER_OR_BATCH if arrays else NUMBER)
        left = [m for m in left if m not in (float, int, np.number, *arrays)]
    for member in left:
        kind = kind_of(member, names)
        if kind is None:
            return None
        kinds.append(kind)
    kinds += numbers  # what has words of its own comes first
    # A path is a text, or an object that is one: the same to a reader.
    words = list(dict.fromkeys(k.words for k in kinds if not (k is TEXT and PATH in kinds)))
    return Kind(
        words=listed(words),
        accepts=lambda value: any(kind.accepts(value) for kind in kinds),
        parts=lambda value: (part for kind in kinds for part in kind.parts(value)),
        plural=listed(list(dict.fromkeys(k.plural for k in kinds if k.plural))),
        made_by=next((k.made_by for k in kinds if k.made_by is not None), None),
    )


def listed(words: list[str]) -> str:
    """Return "a, b or c"."""
    return " or ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def is_list(value: Any) -> bool:
    """Whether it holds several values in an order, one after the other."""
    if isinstance(value, str | bytes):
        return False
    return isinstance(value, Sequence) or (hasattr(value, "__array__") and np.ndim(value) > 0)


def _list_of(item: Kind | None) -> Kind:
    def parts(value: Any) -> Iterator[tuple[str, Any, Kind]]:
        if item is not None and is_list(value):
            yield from ((f"[{k}]", one, item) for k, one in enumerate(value))

    def accepts(value: Any) -> bool:
        if item is TEXT and not isinstance(value, Sequence):
            return False
        if item is NUMBER:  # at once: there may be a million
            flat = is_list(value) and getattr(value, "ndim", 1) == 1
            return flat and not any(map(is_list, value[:1])) and _are_numbers(value)
        return is_list(value) and all(kind.accepts(one) for _, one, kind in parts(value))

    inside = f" of {item.plural}" if item is not None and item.plural else ""
    return Kind(f"a list{inside}", accepts, parts)


def _held(words: str, fits: Callable[[Any], bool], parts: Any, plural: str = "") -> Kind:
    """Return the kind of a container that fits, with parts that do."""

    def accepts(value: Any) -> bool:
        return fits(value) and all(kind.accepts(one) for _, one, kind in parts(value))

    return Kind(words, accepts, parts, plural)


def _row_of(items: list[Kind | None]) -> Kind:
    def fits(value: Any) -> bool:
        return is_list(value) and len(value) == len(items)

    def parts(value: Any) -> Iterator[tuple[str, Any, Kind]]:
        for k, kind in enumerate(items if fits(value) else ()):
            if kind is not None:
                yield f"[{k}]", value[k], kind

    held = "numbers" if all(kind is NUMBER for kind in items) else "values"
    return _held(f"a tuple of {len(items)} {held}", fits, parts, f"tuples of {len(items)} {held}")


def _dict_of(key: Kind, item: Kind | None) -> Kind:
    def parts(value: Any) -> Iterator[tuple[str, Any, Kind]]:
        for name, one in value.items() if isinstance(value, Mapping) else ():
            if not key.accepts(name):
                yield " (a key of it)", name, key
            if item is not None:
                yield f"[{name!r}]", one, item

    inside = f" of {item.plural}" if item is not None and item.plural else ""
    words = f"a dict{inside} by {'name' if key is TEXT else 'number'}"
    return _held(words, lambda value: isinstance(value, Mapping), parts)


def _instance_of(wanted: type) -> Kind:
    if wanted is os.PathLike:
        return PATH
    if _is_batch(wanted):
        # Not the shape of a value that is traced: lanes may be mapped over it.
        return Kind(
            f"an array of shape ({', '.join(wanted.dim_str.split())})",
            lambda value: isinstance(value, (Tracer, wanted)),
        )
    return Kind(
        _noun(wanted) + _choice(wanted),
        lambda value: isinstance(value, wanted),
        plural=f"{wanted.__name__} objects",
        made_by=wanted,
    )


def axes_of(annotation: Any) -> int | None:
    """Return how many axes the numbers of one system have in such a field; None where it is open.

    A field that may be a plain float holds one number, however its arrays are annotated.
    """
    inside = typing.get_args(annotation)
    if inside:
        return 0 if float in inside and any(map(_is_batch, inside)) else None
    if not _is_batch(annotation) or "..." in annotation.dim_str or "*" in annotation.dim_str:
        return None
    return len(annotation.dim_str.split())


def _is_batch(annotation: Any) -> bool:
    return isinstance(annotation, type) and AbstractArray in annotation.__mro__


def _noun(wanted: type) -> str:
    """Return what a class is called: "a contact law" of an abstract one, "a Cantilever"."""
    name = wanted.__name__
    if name.startswith("Abstract"):
        name = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name.removeprefix("Abstract")).lower()
    package = wanted.__module__.partition(".")[0]
    name = name if package in ("vibrojax", "builtins") else f"{package} {name}"
    return name if re.search("[^s]s$", name) else f"{'an' if name[0] in 'AEIOaeio' else 'a'} {name}"


def _choice(wanted: type) -> str:
    """Return the public classes that one may take for an abstract one, in brackets."""
    public = vars(sys.modules["vibrojax"])
    found, left = set(), [wanted]
    while left:
        below = left.pop().__subclasses__()
        left += below
        found |= {c.__name__ for c in below if public.get(c.__name__) is c}
    found = sorted(name for name in found if not name.startswith("Abstract"))
    return f" ({listed(found)})" if found and wanted.__name__.startswith("Abstract") else ""
