"""The text of a function, with all that it uses, makes the same again."""

import linecache
import math
import sys
from functools import partial
from types import ModuleType

import jax
import numpy as np
import pytest
from scipy import special

import vibrojax as vj
from vibrojax.identification.rig_source import Source
from vibrojax.model.laws import KelvinVoigt as Rubber

BEAM = vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0, point_masses=vj.PointMass(0.5, 0.01))
PLACES = np.array([0.5, 0.7])
NUMBERS = {"gap": np.float64(1e-3), "far": [np.inf, -2], "one": (3,)}
OPEN = object()
vj_stop = vj.Stop
unused = OPEN


class Spring(vj.model.AbstractContactLaw):
    stiffness: float

    def force(self, depth, rate):
        return self.stiffness * depth


def softer(stiffness, share=NUMBERS["one"][0]):
    return stiffness / share if stiffness > 1e9 else rig_of_springs(stiffness * 2, law=Rubber)


def rig_of_springs(stiffness=1e10, law=Spring):
    unused = math.pi  # a name of its own, not that of the module
    if stiffness < 1e9:
        return stiffness
    stop = vj_stop(PLACES[0], NUMBERS["gap"], law(softer(stiffness) * special.erf(unused)))
    return vj.ImpactingBeam(BEAM, stop, vj.BaseMotion(1e-4), 0.01, num_modes=1)


def made_in_place(width):
    def inner(gap):
        return vj.Stop(0.5, gap * width, vj.KelvinVoigt(1e3))

    return inner


def run(function):
    """Write a function, run its text, and return what it makes."""
    source = Source()
    name = source.add_function(function)
    assert not source.missing
    names = {}
    exec("\n".join(source.imports) + "\n" + source.text, names)
    return names[name], source


def test_all_that_a_function_uses_comes_with_it():
    again, source = run(rig_of_springs)
    names = {"NUMBERS", "softer", "PLACES", "BEAM", "Spring", "rig_of_springs"}
    assert set(source.definitions) == names
    wanted, found = (jax.tree.leaves(f()) for f in (rig_of_springs, again))
    assert len(wanted) == len(found)
    assert all(map(np.array_equal, wanted, found))


def test_a_function_of_a_package_is_imported():
    again, source = run(vj.default_rig)
    assert again is vj.default_rig
    assert not source.definitions


def test_a_function_made_by_another_takes_its_numbers_along():
    again, _ = run(made_in_place(2.0))
    assert again(1e-3).gap == 2e-3


def test_a_class_of_a_notebook_is_read_off_its_cell(monkeypatch):
    cell = """import functools
import vibrojax as vj

SHARE = 0.5

@functools.cache
def half(x):
    return SHARE * x

@functools.total_ordering
class Soft:
    def __lt__(self, other):
        return half(2.0) < 0

after = 1
"""
    module = ModuleType("cell")
    monkeypatch.setitem(sys.modules, "cell", module)
    monkeypatch.setitem(linecache.cache, "<cell>", (len(cell), None, cell.splitlines(True), ""))
    exec(compile(cell, "<cell>", "exec"), vars(module))
    source = Source()
    source.add("Soft", module.Soft)
    assert not source.missing
    assert list(source.definitions) == ["SHARE", "half", "Soft"]
    assert source.definitions["Soft"].startswith("@functools.total_ordering\nclass Soft:")
    names = {}
    exec("\n".join(source.imports) + "\n" + source.text, names)
    assert not names["Soft"]() < names["Soft"]()


@pytest.mark.parametrize(
    "value",
    [
        1,
        0.1,
        -np.inf,
        True,
        "a 'b'\n",
        None,
        (1,),
        [],
        {"a": (1.5, None)},
        BEAM,
        vj.Range(1.0, 2.0),
    ],
)
def test_values(value):
    source, names = Source(), {}
    text = source.value(value)
    exec("\n".join(source.imports) + f"\nvalue = {text}", names)
    assert names["value"] == value
    assert type(names["value"]) is type(value)


def test_arrays_keep_every_digit():
    source, names = Source(), {}
    values = np.random.default_rng(0).random((3, 2))
    exec(f"import numpy\nvalue = {source.value(values)}", names)
    assert np.array_equal(names["value"], values)
    assert source.value(np.zeros(5000)) is None  # too long to be read


def uses_what_has_no_text():
    return OPEN


def test_what_cannot_be_written_is_said():
    for function, words in (
        (lambda stiffness: stiffness, "a lambda, has no text of its own"),
        (partial(rig_of_springs, 1.0), "has no text of its own"),
        (uses_what_has_no_text, "OPEN, an object, cannot be written as text."),
        (eval("lambda: 1"), "a lambda"),
    ):
        source = Source()
        source.add_function(function)
        assert words in " ".join(source.missing)
    names = {}
    exec(compile("def rig():\n    return 1", "<nowhere>", "exec"), names)
    source = Source()
    source.add_function(names["rig"])
    assert [*source.missing] == ["The text of rig could not be had."]


def uses_other_numbers():
    return np.ones(2)


def test_names_with_two_meanings_are_said():
    source = Source(["np", "rig"])
    source.add_function(uses_other_numbers)
    assert [*source.missing] == ["np stands for two things: give one of them another name."]
    assert source.definitions.keys() == {"uses_other_numbers"}
