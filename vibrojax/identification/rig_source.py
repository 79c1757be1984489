"""The Python text of a function and of all that it uses, for a script that repeats a fit."""

import ast
import builtins
import dataclasses
import inspect
import linecache
import math
import symtable
import sys
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import equinox as eqx
import jax
import numpy as np

LONGEST = 10_000
"""Characters of a value that is written out."""


class Source:
    """Python text: imports, then definitions in an order in which they can be run.

    What cannot be written is in `missing`, in sentences; the text then lacks it. Names that are
    `taken` have another meaning where the text will stand.
    """

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self.names: dict[str, Any] = dict.fromkeys(taken, self)
        self.imports: dict[str, None] = {}
        self.definitions: dict[str, str] = {}
        self.missing: dict[str, None] = {}

    @property
    def text(self) -> str:
        """The definitions."""
        return "\n\n\n".join(self.definitions.values())

    def add_function(self, function: Any) -> str:
        """Add a function; returns the name it goes by."""
        name = getattr(function, "__name__", "")
        if not isinstance(inspect.unwrap(function), FunctionType) or not name.isidentifier():
            self.lack(f"The function of the rig, {kind_of(function)}, has no text of its own")
            return "rig"
        self.add(name, function)
        return name

    def value(self, value: Any) -> str | None:
        """Return the text of a value, adding imports that it needs; None where there is none."""
        before = dict(self.imports)
        text = self._text(value)
        if text is None or len(text) > LONGEST:
            self.imports = before
            return None
        return text

    def _text(self, value: Any) -> str | None:
        value = value.item() if isinstance(value, np.generic) else value
        if isinstance(value, float) and not math.isfinite(value):
            return f'float("{value}")'
        if value is None or isinstance(value, bool | int | float | str):
            return repr(value)
        if isinstance(value, np.ndarray | jax.Array):
            inner = self._text(np.asarray(value).tolist())
            if inner is None or not np.ndim(value):
                return inner
            self.imports["import numpy"] = None
            return f"numpy.array({inner})"
        if isinstance(value, tuple | list | dict):
            return self._gathered(value)
        return self._module(value)

    def _gathered(self, value: Any) -> str | None:
        entries = value.items() if isinstance(value, dict) else [(None, one) for one in value]
        texts = [(self._text(key), self._text(one)) for key, one in entries]
        if any(text is None for _, text in texts):
            return None
        if isinstance(value, dict):
            return f"{{{', '.join(f'{key}: {text}' for key, text in texts)}}}"
        inside = ", ".join(str(text) for _, text in texts)
        if isinstance(value, list):
            return f"[{inside}]"
        return f"({inside},)" if len(texts) == 1 else f"({inside})"

    def _module(self, value: Any) -> str | None:
        """Text of a beam, a stop, a law: the class with its fields."""
        if not dataclasses.is_dataclass(value) or isinstance(value, type):
            return None
        given = []
        for field in dataclasses.fields(value):
            held = getattr(value, field.name, None)
            if not field.init or is_default(held, field.default):
                continue
            text = self._text(held)
            if text is None:
                return None
            given.append(f"{field.name}={text}")
        name = type(value).__name__
        self.add(name, type(value))
        return f"{name}({', '.join(given)})"

    def lack(self, what: str) -> None:
        """Note what cannot be written."""
        self.missing[f"{what}."] = None

    def add(self, name: str, value: Any) -> None:
        """Add what a name stands for: an import, a definition, or a value."""
        if name in self.names:
            if self.names[name] is not value:
                self.lack(f"{name} stands for two things: give one of them another name")
            return
        self.names[name] = value
        if isinstance(value, ModuleType):
            if not _is_installed(value):
                self.lack(f"{value.__name__} is a file of its own: put it beside this one")
            same = value.__name__ == name
            self.imports[f"import {value.__name__}" + ("" if same else f" as {name}")] = None
        elif isinstance(value, type) or (callable(value) and not isinstance(value, eqx.Module)):
            self._add_callable(name, value)
        elif (text := self.value(value)) is not None:
            self.definitions[name] = f"{name} = {text}"
        else:
            self.lack(f"{name}, {kind_of(value)}, cannot be written as text")

    def _add_callable(self, name: str, value: Any) -> None:
        own = getattr(value, "__name__", name)
        module = sys.modules.get(getattr(value, "__module__", None) or "")
        if module is not None and _is_installed(module) and getattr(module, own, None) is value:
            renamed = "" if own == name else f" as {name}"
            self.imports[f"from {module.__name__} import {own}{renamed}"] = None
            return
        if own != name and own.isidentifier():
            self.add(own, value)
            self.definitions[name] = f"{name} = {own}"
            return
        try:
            text = textwrap.dedent(_text_of(value))
            tree = ast.parse(text)
        except (OSError, TypeError, SyntaxError):
            self.lack(f"The text of {name} could not be had")
            return
        defined = tree.body[0]
        if not isinstance(defined, ast.FunctionDef | ast.ClassDef) or defined.name != name:
            self.lack(f"{name}, {kind_of(value)}, has no text of its own")
            return
        known = _names(value)
        for used in dict.fromkeys(_used(symtable.symtable(text, name, "exec"))):
            if used in known:
                self.add(used, known[used])
        self.definitions[name] = text.strip()  # behind all that it uses


def kind_of(value: Any) -> str:
    """Say of what kind a value is."""
    kind = "lambda" if getattr(value, "__name__", "") == "<lambda>" else type(value).__name__
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def is_default(value: Any, default: Any) -> bool:
    """Whether a field has the value that it has when it is left out."""
    if value is default:
        return True
    return isinstance(value, bool | int | float | str | tuple) and value == default


def _text_of(value: Any) -> str:
    """Return the text of a function or class. Raises `OSError` or `TypeError` where it has none."""
    try:
        return inspect.getsource(value)
    except (OSError, TypeError):
        if not isinstance(value, type):
            raise
    # A class of a notebook has no file, but its methods know the cell that it stands in.
    for method in (getattr(value, name) for name in vars(value)):
        if not isinstance(method, FunctionType):
            continue
        lines = linecache.getlines(method.__code__.co_filename)
        for node in ast.parse("".join(lines)).body:
            if isinstance(node, ast.ClassDef) and node.name == value.__name__:
                first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
                return "".join(lines[first - 1 : node.end_lineno])
    raise OSError(f"{value.__name__} has no text")


def _used(table: symtable.SymbolTable) -> Iterator[str]:
    """Names from outside that a text reads, in the order of its scopes."""
    outermost = table.get_type() == "module"
    for symbol in table.get_symbols():
        if symbol.is_referenced() and (outermost or symbol.is_global()):
            yield symbol.get_name()
    for inner in table.get_children():
        yield from _used(inner)


def _names(value: Any) -> dict[str, Any]:
    """What the names in the text of a function or class stand for, but for those of Python."""
    if isinstance(value, type):
        module = sys.modules.get(value.__module__)
        return dict(vars(module)) if module else {}
    function = inspect.unwrap(value)
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    inner = {name: cell.cell_contents for name, cell in cells}
    found = function.__globals__ | inner
    return {n: v for n, v in found.items() if vars(builtins).get(n) is not v}


def _is_installed(module: ModuleType) -> bool:
    """Whether a module is of Python or of an installed package, not a file of the user's."""
    name = module.__name__.partition(".")[0]
    if name in sys.stdlib_module_names or name == __name__.partition(".")[0]:
        return name != "__main__"
    file = Path(getattr(module, "__file__", None) or "")
    return not {"site-packages", "dist-packages"}.isdisjoint(file.parts)
