"""Fingerprints of functions, and of any values: their text and all that they read.

A function is known by its source and by the values of the globals, closures, defaults and modules
that it reads, functions of the user's followed. What belongs to a library is known by its name and
version.
"""

import ast
import dis
import functools
import hashlib
import importlib
import inspect
import sys
import sysconfig
import textwrap
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.maps.store_files import digest

MOST = 1_000_000
"""Values that are looked into; what holds more has no fingerprint."""
LONGEST = 1_000
"""Characters of what is read that are kept beside its digest."""
SHOWN = 8
"""Numbers of an array that are written out."""
PLAIN = (type(None), bool, int, float, complex, str, bytes, type(Ellipsis), type(NotImplemented))


class Unreadable(Exception):
    """A value whose content cannot be found out."""


class Identity(NamedTuple):
    """What a function is known by."""

    source: str
    reads: dict[str, str]
    """What it reads, by name."""
    unknown: tuple[str, ...]
    """Names of what cannot be read: changes of it are not noticed."""


def identity_of(function: Callable[..., Any]) -> Identity:
    """Return what identifies a function."""
    reads: dict[str, str] = {}
    unknown = []
    reader = _Reader()
    try:
        source, parts = reader.opened(function)
    except Unreadable:
        kind = type(function).__qualname__
        return Identity(f"a {kind}", {}, (f"what this {kind} holds",))
    for name, value in parts:
        try:
            text = reader.text(value)
            long = len(text) > LONGEST
            reads[name] = f"{text[:LONGEST]}... {digest(text)}" if long else text
        except Exception:  # objects of others may do anything when they are looked at
            reads[name] = f"<a {type(value).__name__} that cannot be read>"
            unknown.append(f"{name} (a {type(value).__name__})")
    return Identity(source, reads, tuple(unknown))


def value_digest(value: Any) -> str:
    """Return what stands for a system: the same for equal ones only."""
    try:
        text = _Reader().text(value)
    except Exception:  # something in it that is not data; its numbers are
        numbers = [leaf for leaf in jax.tree.leaves(value) if eqx.is_array_like(leaf)]
        text = f"{type(value).__qualname__} {_Reader().text(numbers)}"
    return digest(text)


def source_of(function: Callable[..., Any]) -> str:
    """Return the text of a function, or what stands for it where there is none."""
    try:
        return inspect.getsource(function).strip()
    except (OSError, TypeError):
        kind = type(function)
        code = getattr(function, "__code__", None)
        return f"{kind.__module__}.{kind.__qualname__}" if code is None else _code_text(code)


@functools.lru_cache(1024)
def _code_source(code: CodeType) -> str:
    """The source of a function without its comments."""
    try:
        source = inspect.getsource(code)
    except (OSError, TypeError):
        return _code_text(code)
    tree = None
    for text in (textwrap.dedent(source).strip(), f"f({source.strip()})"):  # or an argument
        with suppress(SyntaxError):
            tree = tree or ast.parse(text)
    if code.co_name != "<lambda>":
        return ast.unparse(tree) if tree else source.strip()
    # Its lines have more on them, perhaps another one.
    own = [n for n in (ast.walk(tree) if tree else ()) if isinstance(n, ast.Lambda)]
    return f"{ast.unparse(own[0]) if len(own) == 1 else 'lambda'} {_code_text(code)}"


def _code_text(code: CodeType) -> str:
    inner = [_code_text(c) if isinstance(c, CodeType) else repr(c) for c in code.co_consts]
    text = " ".join([code.co_code.hex(), *inner, *code.co_names, *code.co_freevars])
    return f"<code {digest(text)}>"


@functools.lru_cache(1024)
def _names(code: CodeType) -> dict[str, tuple[Any, ...]]:
    """Names in the code of a function and of those inside it: `globals`, `attributes`, `modules`.

    What is imported there has two: how far up from its own package (0: from the top), and a name.
    """
    found: dict[str, list[Any]] = {"globals": [], "modules": [], "attributes": []}
    steps = list(dis.get_instructions(code))
    for k, step in enumerate(steps):
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            found["globals"].append(step.argval)
        elif step.opname == "IMPORT_NAME":
            found["modules"].append((steps[k - 2].argval, step.argval))
        elif step.opname in ("LOAD_ATTR", "LOAD_METHOD", "IMPORT_FROM"):
            found["attributes"].append(step.argval)
    for inner in filter(lambda part: isinstance(part, CodeType), code.co_consts):
        for kind, names in _names(inner).items():
            found[kind] += names
    return {kind: tuple(dict.fromkeys(names)) for kind, names in found.items()}


_LIBRARIES = [
    Path(__file__).resolve().parents[1],
    *(
        Path(sysconfig.get_path(k)).resolve()
        for k in ("stdlib", "platstdlib", "purelib", "platlib")
    ),
]
"""Folders of what is installed, and of this package."""


@functools.cache
def _is_library(file: str | None) -> bool:
    """Whether a file of code belongs to a library; what has no file is the user's."""
    if file is None or file.startswith("<"):
        return (file or "").startswith("<frozen")
    return any(folder in Path(file).resolve().parents for folder in _LIBRARIES)


def _library_of(module: str | None) -> str | None:
    """Name and version of the library a module belongs to; None for the user's own."""
    found = sys.modules.get(module or "")
    top = (module or "").partition(".")[0]
    if top in sys.builtin_module_names or top in sys.stdlib_module_names:
        return top
    if found is None or not _is_library(getattr(found, "__file__", None)):
        return None
    return f"{top} {getattr(sys.modules.get(top), '__version__', '')}".strip()


class _Reader:
    """Writes values down as texts, equal for equal values in whatever process."""

    def __init__(self) -> None:
        self.open: dict[int, str] = {}
        """What is being written: it may hold itself."""
        self.written: dict[int, tuple[Any, str]] = {}
        """Functions and classes already written, by identity."""
        self.count = 0

    def text(self, value: Any) -> str:
        """Return the text of a value. Raises `Unreadable`."""
        self.count += 1
        if self.count > MOST:
            raise Unreadable
        if type(value) in PLAIN:
            return repr(value)
        if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
            keys: Any = value
            value = jax.random.key_data(keys)
        if isinstance(value, np.ndarray | np.generic | jax.Array):
            return self._array(np.asarray(value))
        if isinstance(value, ModuleType):
            return f"module {_library_of(value.__name__) or value.__name__}"
        if id(value) in self.written:
            return self.written[id(value)][1]
        if id(value) in self.open:
            return f"<{self.open[id(value)]} itself>"
        self.open[id(value)] = type(value).__name__
        try:
            text = self._inside(value)
        finally:
            del self.open[id(value)]
        if isinstance(value, FunctionType | type):
            self.written[id(value)] = value, text
        return text

    def _array(self, values: np.ndarray) -> str:
        if values.dtype.hasobject:
            return f"array {values.shape} {self.text(values.tolist())}"
        if values.size <= SHOWN:
            return f"{values.dtype} {values.tolist()!r}"
        data = hashlib.blake2b(np.ascontiguousarray(values).tobytes(), digest_size=8)
        return f"{values.dtype} {values.shape} {data.hexdigest()}"

    def _inside(self, value: Any) -> str:
        if type(value) in (tuple, list):
            return f"{type(value).__name__}({', '.join(map(self.text, value))})"
        if type(value) in (set, frozenset):
            return f"{type(value).__name__}({', '.join(sorted(map(self.text, value)))})"
        if type(value) is dict:
            pairs = sorted(f"{self.text(k)}: {self.text(v)}" for k, v in value.items())
            return f"dict({', '.join(pairs)})"
        source, parts = self.opened(value)
        inside = "; ".join(f"{name} = {self.text(part)}" for name, part in parts)
        return f"{source} | {inside}" if inside else source

    def opened(self, value: Any) -> tuple[str, list[tuple[str, Any]]]:
        """Return what a value is, in words, and what it holds by name. Raises `Unreadable`."""
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, type):
            return self._class(value)
        wrapped = getattr(value, "__wrapped__", None)
        if callable(wrapped):  # compiled by JAX, or cached
            return type(value).__name__, [("function", wrapped)]
        return self._object(value)

    def _function(self, function: FunctionType) -> tuple[str, list[tuple[str, Any]]]:
        code = function.__code__
        parts: list[tuple[str, Any]] = []
        library = _is_library(code.co_filename)
        if not library:
            parts += _read_by(function)
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            try:
                parts.append((name, cell.cell_contents))
            except ValueError:  # nothing is in it yet
                parts.append((name, None))
        if library:
            return f"{code.co_qualname} of {Path(code.co_filename).stem}", parts
        parameters = inspect.signature(function, follow_wrapped=False).parameters.values()
        parts += [(p.name, p.default) for p in parameters if p.default is not p.empty]
        return _code_source(code), [*parts, *vars(function).items()]

    def _class(self, kind: type) -> tuple[str, list[tuple[str, Any]]]:
        library = _library_of(kind.__module__)
        if library is not None:
            return f"{kind.__module__}.{kind.__qualname__} of {library}", []
        parts: list[tuple[str, Any]] = [("bases", kind.__bases__)]
        for name, member in sorted(vars(kind).items()):
            if isinstance(member, staticmethod | classmethod):
                member = member.__func__
            elif isinstance(member, property):
                member = (member.fget, member.fset)
            elif isinstance(member, functools.cached_property):
                member = member.func
            # Of the names that Python makes itself only functions decide anything.
            if isinstance(member, FunctionType) or not name.startswith(("__", "_abc_")):
                parts.append((name, member))
        return f"class {kind.__qualname__}", parts

    def _object(self, value: Any) -> tuple[str, list[tuple[str, Any]]]:
        try:  # as it would be pickled, but without pickling
            reduced = value.__reduce_ex__(4)
        except Exception:
            raise Unreadable from None
        if isinstance(reduced, str):
            return f"{getattr(value, '__module__', type(value).__module__)}.{reduced}", []
        make, given, *more = reduced
        parts: list[tuple[str, Any]] = [("class", type(value)), ("made by", make)]
        parts += [(f"argument {k}", own) for k, own in enumerate(given) if own is not type(value)]
        state = more[0] if more else None
        if isinstance(state, dict):
            parts += sorted((str(name), own) for name, own in state.items())
        elif state is not None:
            parts.append(("state", state))
        parts += [("items", list(own)) for own in more[1:3] if own is not None]
        return f"a {type(value).__name__}", parts


def _read_by(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """What a function reads beside its arguments, by name."""
    names, known = _names(function.__code__), function.__globals__
    found = {name: known[name] for name in names["globals"] if name in known}
    for level, name in names["modules"]:
        found[name] = None
        with suppress(Exception):  # the function itself will say so when it is called
            found[name] = importlib.import_module("." * level + name, known.get("__package__"))
    yield from _with_modules(found, names["attributes"], ())


def _with_modules(
    found: dict[str, Any], attributes: tuple[str, ...], above: tuple[ModuleType, ...]
) -> Iterator[tuple[str, Any]]:
    """Values by name, modules of the user's followed by what is read of them."""
    for name, value in found.items():
        yield name, value
        if not isinstance(value, ModuleType) or value in above or _library_of(value.__name__):
            continue
        own = {f"{name}.{n}": getattr(value, n) for n in attributes if hasattr(value, n)}
        yield from _with_modules(own, attributes, (*above, value))
