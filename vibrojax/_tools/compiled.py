"""Functions compiled as a whole, and kept between processes.

`compiled` is equinox's `filter_jit` with three things more. What was traced is kept on disk
(`jax.export`), so that another process need not trace it again; XLA's part is in JAX's own cache.
XLA compiles quickly where that costs no speed. And a long wait is explained.

Inside a transformation (jit, vmap, grad) it is `filter_jit`. So is what JAX cannot export, and what
depends on functions or classes from outside of the packages that the cache is named by: their
sources may change under the same name.
"""

import functools
import gc
import hashlib
import io
import pickle
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Generic, NamedTuple, ParamSpec, TypeVar, overload

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from vibrojax._tools import cache
from vibrojax._tools.machine import mappings_used
from vibrojax._tools.programs import Parts, Program, kinds_of, sorted_out, tracing
from vibrojax._tools.waiting import announced

Given = ParamSpec("Given")
Result = TypeVar("Result")

KNOWN = {*cache.MADE_BY, "vibrojax", "jaxtyping", "ml_dtypes", "builtins", "copyreg", "enum"} | {
    *("collections", "functools", "operator", "_operator", "types")
}
"""Packages whose sources are known by the name of the cache's folder."""
SETTINGS = (
    "enable_x64",
    "default_matmul_precision",
    "numpy_dtype_promotion",
    "numpy_rank_promotion",
    "default_prng_impl",
    "threefry_partitionable",
)
"""Of JAX, on which a traced program depends."""
STEP_BY_STEP = ("disable_jit", "debug_nans", "debug_infs", "check_tracer_leaks")
"""Of JAX, which need the function itself."""
MOST_MAPPINGS = 0.5
"""Share of the memory mappings of a process with which programs are dropped."""
ANY_CALLS = [
    jax.export.DisabledSafetyCheck.custom_call(f"lapack_{kind}{name}_ffi")
    for kind in "sdcz"
    for name in ("ormqr", "unmqr", "geqp3", "gtsv", "gees", "gehrd", "sytrd", "hetrd")
]
"""LAPACK's functions that JAX may change: here the same version reads what it wrote."""

_everything: "weakref.WeakSet[Compiled[..., Any]]" = weakref.WeakSet()


class Signature(NamedTuple):
    """What a program was traced for; equal signatures can share it."""

    structure: Any
    held: tuple[tuple[type, Any], ...]
    """Arguments that are no arrays, with their types; None in the place of arrays."""
    traced: tuple[tuple[tuple[int, ...], str] | None, ...]
    """Shape and kind of the arrays; None in the place of the others."""
    settings: tuple[Any, ...]
    device: int


def _is_known(named: Any) -> bool:
    return (getattr(named, "__module__", None) or "builtins").partition(".")[0] in KNOWN


class _Describing(pickle.Pickler):
    """Pickles what a program depends on; refuses functions and classes of unknown sources."""

    def persistent_id(self, obj: Any) -> None:  # called for every object
        named = isinstance(obj, type) or (callable(obj) and hasattr(obj, "__qualname__"))
        if named and not _is_known(obj):
            raise pickle.PicklingError(f"{obj!r} is from outside.")


def _described(thing: Any) -> bytes:
    """Return bytes that are equal in every process; raises where there are none."""
    buffer = io.BytesIO()
    pickler = _Describing(buffer, protocol=5)
    pickler.fast = True  # no reference to what came before: equal, not identical, decides
    pickler.dump(thing)
    return buffer.getvalue()


_new_array = jax.jit(lambda: 0.0)
"""Is traced where anything new is; the cheapest way to ask."""


def is_alone(arrays: Sequence[Any]) -> bool:
    """Whether a call with these arrays is a program, not a part of a transformation or a check."""
    # Inside of jit, and of loops and the like, every new array is traced.
    if any(isinstance(a, Tracer) for a in (*arrays, _new_array())):
        return False
    if any(getattr(jax.config, f"jax_{name}") for name in STEP_BY_STEP):
        return False
    if not all(isinstance(a.dtype, np.dtype) for a in arrays):  # keys of random numbers
        return False
    device = _device()
    if device.platform != jax.default_backend():
        return False
    if jax.device_count() == 1 and device.platform == "cpu":
        return True
    return all(a.devices() == {device} for a in arrays if isinstance(a, jax.Array))


def _device() -> Any:
    """Where programs run."""
    chosen = getattr(jax.config, "jax_default_device", None)
    if chosen is None:
        return jax.devices()[0]
    return jax.local_devices(backend=chosen)[0] if isinstance(chosen, str) else chosen


@functools.lru_cache
def _kind(dtype: Any, wide: bool) -> str:
    """Name of the kind of numbers that JAX makes of one; `wide` where it takes 64 bits."""
    return str(jax.dtypes.canonicalize_dtype(dtype))


def _signature(arrays: Sequence[Any], parts: Parts) -> Signature:
    wide = bool(jax.config.read("jax_enable_x64"))
    shapes = iter([(a.shape, _kind(a.dtype, wide)) for a in arrays])
    return Signature(
        parts.structure,
        # 1 and True are equal, NaN is not to itself.
        tuple((type(held), held if held == held else None) for held in parts.held),
        tuple(next(shapes) if a else None for a in parts.is_array),
        tuple(str(getattr(jax.config, f"jax_{name}")) for name in SETTINGS),
        _device().id,
    )


class Compiled(Generic[Given, Result]):
    """A function that is compiled when it is called; see `compiled`."""

    def __init__(self, function: Callable[Given, Result], lightly: bool):
        self.function, self.lightly = function, lightly
        self.plain = eqx.filter_jit(function)
        self.programs: dict[Signature, Program] = {}
        self.returned: dict[Signature, Any] = {}
        """With `jax.ShapeDtypeStruct` in the place of arrays, where no program was needed."""
        functools.update_wrapper(self, function)
        _everything.add(self)

    def __reduce__(self) -> str:
        return self.function.__qualname__  # by its name

    def __call__(self, *args: Given.args, **kwargs: Given.kwargs) -> Result:
        arrays, parts = sorted_out((args, kwargs))
        if not is_alone(arrays):
            return self.plain(*args, **kwargs)
        signature = _signature(arrays, parts)
        program = self.programs.get(signature)
        if program is None or program.call is None:
            with announced(self.function.__qualname__):
                program = self._program(signature, parts, arrays)
                program.compile(arrays)
        assert program.call is not None  # just compiled
        return program.returned[0].filled(program.call(*arrays))

    def bound(self, *args: Any) -> Callable[..., Any]:
        """Return the program for such arguments, as a function of the arrays in them.

        For what is called many times: nothing is looked at again but the arrays, as they come.
        """
        arrays, parts = sorted_out((args, {}))
        if not is_alone(arrays):
            plain: Any = self.plain
            return lambda *arrays: plain(*parts.filled(arrays)[0])
        signature = _signature(arrays, parts)
        with announced(self.function.__qualname__):
            program = self._program(signature, parts, arrays)
            if program.call is None:
                program.compile(arrays)
        call, returned = program.call, program.returned[0]
        assert call is not None  # just compiled
        return lambda *arrays: returned.filled(call(*arrays))

    def kinds(self, *args: Any, **kwargs: Any) -> Any:
        """Return what a call would, with `jax.ShapeDtypeStruct` in the place of arrays.

        Arrays may be given as such too, and be traced: only their shapes are looked at. Nothing is
        compiled.
        """
        arrays, parts = sorted_out((args, kwargs))
        shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in arrays]
        if not is_alone(shapes):
            return eqx.filter_eval_shape(self.plain, *args, **kwargs)
        signature = _signature(shapes, parts)
        program = self.programs.get(signature)
        if program is not None:
            return program.kinds(shapes)
        if signature not in self.returned:
            self.returned[signature] = self._read_or_looked_at(signature, parts, shapes)
        return self.returned[signature]

    def _read_or_looked_at(self, signature: Signature, parts: Parts, shapes: list[Any]) -> Any:
        """Take from disk what is returned, or trace the function; without making a program."""
        path = self._path(signature, parts)
        path = None if path is None else path.with_suffix(".kinds")
        content = None if path is None else cache.read(path)
        if content is not None:
            with suppress(Exception):  # a broken file is as good as none
                return pickle.loads(content)
        args, kwargs = parts.filled(shapes)
        with tracing():
            found, kind = sorted_out(eqx.filter_eval_shape(self.function, *args, **kwargs))
        kinds = kind.filled(kinds_of(found))
        if path is not None:
            with suppress(Exception):  # something is returned that cannot be read elsewhere
                cache.write(path, _described(kinds))
        return kinds

    def ahead(self, *args: Any, **kwargs: Any) -> Any:
        """Compile in the background what will be called with such arguments; return the `kinds`."""
        arrays, parts = sorted_out((args, kwargs))
        if not is_alone(arrays):
            return eqx.filter_eval_shape(self.plain, *args, **kwargs)
        signature = _signature(arrays, parts)
        program = self.programs.get(signature)
        if program is None or program.is_new:
            with announced(self.function.__qualname__):
                program = self._program(signature, parts, arrays)
                program.compile_ahead(arrays)
        return program.kinds(arrays)

    def _program(self, signature: Signature, parts: Parts, arrays: list[Any]) -> Program:
        """Take the program from memory or disk, or trace it and put it there."""
        known = self.programs.get(signature)
        if known is None:
            make_room(MOST_MAPPINGS)
            with tracing():
                known = self.programs[signature] = self._read_or_traced(signature, parts, arrays)
        return known

    def _read_or_traced(self, signature: Signature, parts: Parts, arrays: list[Any]) -> Program:
        path = self._path(signature, parts)
        kept = None if path is None else _read(path)
        if kept is not None:
            exported, kind = kept
            return Program(self._named(exported.call), [kind], self.lightly)
        returned: list[Parts] = []
        function: Any = self.function

        def flat(*arrays: Any) -> tuple[Any, ...]:
            args, kwargs = parts.filled(arrays)
            found, kind = sorted_out(function(*args, **kwargs))
            returned[:] = [kind]
            return tuple(found)

        traced = self._named(flat)
        exported = None if path is None else _exported(traced, arrays)
        if path is None or exported is None:
            return Program(traced, returned, self.lightly)
        _write(path, exported, returned[0])
        return Program(self._named(exported.call), returned, self.lightly)

    def _named(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def named(*arrays: Any) -> Any:
            return call(*arrays)

        named.__name__ = getattr(self.function, "__name__", "function")  # shown by JAX
        return named

    def _path(self, signature: Signature, parts: Parts) -> Path | None:
        """File of a program; None where it cannot be known in another process."""
        folder = cache.folder()
        local = "<" in self.function.__qualname__  # what it encloses is not known
        if folder is None or local or not _is_known(self.function):
            return None
        called = f"{self.function.__module__}.{self.function.__qualname__}"
        # An array differs from the None of a field that holds nothing.
        arguments = parts.filled([...] * len(signature.traced))
        where = jax.default_backend(), _device().device_kind
        try:
            known = _described((called, arguments, signature.traced, signature.settings, where))
        except Exception:  # whatever the classes of arguments raise
            return None
        return folder / hashlib.sha256(known).hexdigest()[:32]


def _exported(flat: Callable[..., Any], arrays: Sequence[Any]) -> jax.export.Exported | None:
    try:
        return jax.export.export(jax.jit(flat), disabled_checks=ANY_CALLS)(*kinds_of(arrays))
    except Exception:  # what is wrong is said when it is called
        return None


def _write(path: Path, program: jax.export.Exported, returned: Parts) -> None:
    like = returned.filled([np.zeros(0)] * sum(returned.is_array))
    try:
        cache.write(path, pickle.dumps((bytes(program.serialize()), _described(like))))
    except Exception:  # something is returned that cannot be read in another process
        return


def _read(path: Path) -> tuple[jax.export.Exported, Parts] | None:
    content = cache.read(path)
    if content is None:
        return None
    try:
        program, like = pickle.loads(content)
        return jax.export.deserialize(bytearray(program)), sorted_out(pickle.loads(like))[1]
    except Exception:  # a broken file is as good as none
        return None


def forget() -> None:
    """Drop all programs from memory, those of JAX too."""
    for function in _everything:
        function.programs.clear()
        function.returned.clear()
    jax.clear_caches()


def make_room(share: float) -> None:
    """Drop all programs if this process has used up a share of the mappings that it may have."""
    if mappings_used() > share:
        forget()
        gc.collect()


@overload
def compiled(function: Callable[Given, Result]) -> Compiled[Given, Result]: ...


@overload
def compiled(*, lightly: bool) -> Callable[[Callable[Given, Result]], Compiled[Given, Result]]: ...


def compiled(function: Any = None, *, lightly: bool = False) -> Any:
    """Compile a function of PyTrees when it is called; arrays are traced, all else is held.

    `lightly` is for what runs once in a call, for milliseconds: XLA then hardly optimises it.
    """
    if function is None:
        return functools.partial(compiled, lightly=lightly)
    return Compiled(function, lightly)
