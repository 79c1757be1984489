"""Functions that are compiled as a whole: by what their programs differ, and where they run."""

import functools
import gc
import sys
import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax._tools import cache, interrupts, programs, waiting
from vibrojax._tools import compiled as compiled_module
from vibrojax._tools.compiled import _signature as signature_of
from vibrojax._tools.compiled import compiled, forget, is_alone, sorted_out
from vibrojax.model.laws import KelvinVoigt
from vibrojax.model.systems import as_arrays, equations_of


def power(x, exponent, *, offset=0.0):
    return x**exponent + offset, type(exponent).__name__


def test_what_is_no_array_is_held_with_its_type():
    function = compiled(power)
    for exponent in (2, 2.0, 1, True, 1.0):
        value, name = function(jnp.asarray(3.0), exponent)
        assert (float(value), name) == (3.0**exponent, type(exponent).__name__)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux counts mappings")
def test_programs_make_room_before_the_kernel_refuses_memory(monkeypatch):
    function, other = compiled(power), compiled(power)
    function(jnp.ones(3), 2)
    monkeypatch.setattr(compiled_module, "MOST_MAPPINGS", 1e-9)
    value, _ = other(jnp.full(3, 2.0), 3)
    np.testing.assert_array_equal(value, 8.0)
    assert not function.programs
    assert function(jnp.ones(3), 2)[0].tolist() == [1.0] * 3


def test_new_numbers_do_not_trace_again():
    traced = []

    def count(x):
        traced.append(x.shape)
        return x + 1

    function = compiled(count)
    for x in (np.zeros(3), jnp.ones(3), jax.jit(lambda: 2 * jnp.ones(3))()):
        np.testing.assert_array_equal(function(x), x + 1)
    assert traced == [(3,)]
    function(np.zeros(4))
    assert traced == [(3,), (4,)]


def test_a_number_of_python_is_like_any_other():
    def doubled(x):
        return x * jnp.ones(2, jnp.float32)

    function = compiled(doubled)
    weak, strong = jnp.asarray(1.0), jnp.ones((), jnp.float64)
    for x in (weak, strong, weak):
        assert function(x).dtype == jnp.float64


def test_a_field_that_holds_nothing_is_no_array():
    """What is kept on disk for one of two optional numbers is not taken for the other."""

    def file_of(*args):
        arrays, parts = sorted_out((args, {}))
        return equations_of._path(signature_of(arrays, parts), parts)

    x = jnp.zeros(2)
    files = [file_of(x, None), file_of(None, x), file_of(x, ...), file_of(None, None, x)]
    assert None not in files
    assert len(set(files)) == len(files)
    assert file_of(x, None) == file_of(x + 1, None)


def test_on_a_chosen_device_the_program_is_a_kept_one_too(rig):
    """Else a map on several devices, or on a cluster, differs from others by round-off."""
    systems = as_arrays(rig(num_modes=1))

    def where():
        arrays, parts = sorted_out((systems,))
        signature = signature_of(arrays, parts)
        return signature, equations_of._path(signature, parts)

    usual = where()
    for chosen in (jax.devices()[0], "cpu"):
        with jax.default_device(chosen):
            assert is_alone(sorted_out(systems)[0])
            assert where() == usual


def test_inside_of_transformations_it_is_the_function():
    function = compiled(power)

    def value(x):
        return function(x, 3, offset=1.0)[0]

    assert jax.grad(value)(2.0) == pytest.approx(12.0)
    np.testing.assert_allclose(jax.vmap(value)(jnp.arange(3.0)), [1.0, 2.0, 9.0])
    assert jax.jit(value)(2.0) == pytest.approx(9.0)
    with jax.disable_jit():
        assert value(jnp.asarray(2.0)) == pytest.approx(9.0)


def test_what_is_compiled_ahead_is_what_is_called(rig):
    systems = as_arrays(rig(num_modes=1))
    kinds = equations_of.ahead(systems)
    programs = len(equations_of.programs)
    found = equations_of(systems)
    assert len(equations_of.programs) == programs
    assert jax.tree.map(lambda a: (a.shape, a.dtype), kinds) == jax.tree.map(
        lambda a: (a.shape, a.dtype), found
    )
    assert equations_of.kinds(systems).angular_frequency == kinds.angular_frequency


def test_what_is_returned_is_known_without_a_program(rig, monkeypatch):
    """Of a traced system too, and in another process from disk."""
    systems = as_arrays(rig(num_modes=3))
    forget()
    shape = equations_of.kinds(systems).angular_frequency.shape
    assert shape == (3,)
    assert not equations_of.programs

    def value(taper):
        kinds = equations_of.kinds(eqx.tree_at(lambda s: s.beam.taper, systems, taper))
        return taper * kinds.angular_frequency.size

    @functools.wraps(equations_of.function)
    def fail(*args):
        raise AssertionError("It is traced again.")

    forget()  # as another process
    monkeypatch.setattr(equations_of, "function", fail)
    assert jax.grad(value)(jnp.asarray(0.5)) == 3.0


def test_tracing_leaves_python_as_it_was():
    seen = []

    def look(x):
        seen.append((gc.isenabled(), jax.config.jax_traceback_in_locations_limit))
        return x + 1

    before = gc.isenabled(), jax.config.jax_traceback_in_locations_limit
    compiled(look)(np.zeros(7))
    assert seen[0] == (False, 0)
    assert (gc.isenabled(), jax.config.jax_traceback_in_locations_limit) == before


def test_programs_are_compiled_side_by_side(monkeypatch):
    monkeypatch.setattr(interrupts, "_cores", threading.Semaphore(2))
    meet = threading.Barrier(2, timeout=30)  # which one after the other would never pass
    both = [interrupts.in_background(meet.wait) for _ in range(2)]
    assert sorted(future.result() for future in both) == [0, 1]


def test_what_a_function_raises_is_raised():
    @compiled
    def refuse(x):
        raise ValueError(f"{x.shape} is refused.")

    with pytest.raises(ValueError, match=r"\(2,\) is refused"):
        refuse(jnp.zeros(2))
    with pytest.raises(ValueError, match=r"\(2,\) is refused"):
        refuse.ahead(jnp.zeros(2))


def test_functions_and_classes_from_outside_are_not_kept(rig, monkeypatch):
    written = []
    monkeypatch.setattr(cache, "write", lambda path, content: written.append(path))
    compiled(power)(jnp.zeros(7), 2)

    class Own(KelvinVoigt):
        pass

    (stop,) = rig(num_modes=1).stops
    here = eqx.tree_at(lambda s: s.law, stop, Own(*stop.law.linear_coefficients()))
    system = eqx.tree_at(lambda s: s.stops, rig(num_modes=1), (here,))
    equations_of(as_arrays(system))
    assert not written


@pytest.fixture
def watched(monkeypatch):
    monkeypatch.setattr(waiting, "PATIENCE", 0.02)
    monkeypatch.setattr(waiting, "_ended", -np.inf)
    monkeypatch.setattr(waiting, "_is_watched", lambda: True)


def wait(seconds=0.3):
    with waiting.announced("_point_slopes"):
        waiting.time.sleep(seconds)


def test_a_wait_is_announced_once(watched, capsys):
    wait()
    wait()
    assert capsys.readouterr().err == "compiling, once: point slopes ...\n"


def test_tracing_what_is_compiled_ahead_is_waiting_too(watched, capsys):
    @compiled
    def slow_to_trace(x):
        waiting.time.sleep(0.3)
        return x + 1

    slow_to_trace.ahead(np.zeros(3))
    assert capsys.readouterr().err.endswith("slow to trace ...\n")
    waiting._said = False
    slow_to_trace.ahead(np.zeros(3))  # there is nothing left to wait for
    assert capsys.readouterr().err == ""


def test_a_later_wait_is_announced_again(watched, capsys, monkeypatch):
    monkeypatch.setattr(waiting, "PAUSE", 0.0)
    wait()
    waiting.time.sleep(0.01)
    wait()
    assert capsys.readouterr().err.count("compiling, once") == 2


def test_nothing_is_said_of_short_waits_or_where_nobody_reads(watched, capsys, monkeypatch):
    monkeypatch.setattr(waiting, "PATIENCE", 10.0)
    wait(0.0)
    monkeypatch.setattr(waiting, "PATIENCE", 0.02)
    monkeypatch.setattr(waiting, "_is_watched", lambda: False)
    wait()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("wide", [True, False])
def test_wide_vectors_are_asked_for_where_the_processor_has_them(monkeypatch, wide):
    monkeypatch.setattr(programs, "_has_wide_vectors", lambda: wide)
    assert (programs.WIDE.items() <= programs.options.__wrapped__().items()) is wide


def test_options_that_are_not_known_are_left_out(monkeypatch):
    monkeypatch.setattr(programs, "QUICK", {"xla_cpu_no_such_option": True})
    assert "xla_cpu_no_such_option" not in programs.options.__wrapped__()
