"""Every public name: documented, shown in a few lines, drawn, and offered by completion."""

import ast
import functools
import inspect
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from types import ModuleType

import pytest
from conftest import public_names

import vibrojax as vj
from vibrojax.cli import options as cli
from vibrojax.io import rig_file_keys
from vibrojax.results.variables import PARAMETER_UNITS, VARIABLES

PUBLIC = public_names()
CLASSES = {name: value for name, value in PUBLIC.items() if inspect.isclass(value)}


def ours(value):
    return (getattr(value, "__module__", None) or "").startswith("vibrojax")


def function_of(attribute):
    """The function behind a method or property, as it was written; None for something else."""
    if isinstance(attribute, property):
        attribute = attribute.fget
    attribute = getattr(attribute, "__func__", attribute)
    attribute = getattr(attribute, "method", attribute)  # as equinox wraps methods
    attribute = inspect.unwrap(attribute) if callable(attribute) else attribute
    return attribute if inspect.isfunction(attribute) and ours(attribute) else None


def members():
    """(class, name, attribute) of every public method and property written here."""
    for owner, kind in CLASSES.items():
        for name in dir(kind):
            if not name.startswith("_"):
                attribute = inspect.getattr_static(kind, name)
                if function_of(attribute) is not None:
                    yield pytest.param(kind, name, attribute, id=f"{owner}.{name}")


def docstring(kind, name):
    """What a method says of itself, together with what the methods say that it overrides."""
    texts = []
    for base in kind.__mro__:
        if name in vars(base) and ours(base):
            attribute = vars(base)[name]
            texts.append(getattr(function_of(attribute) or attribute, "__doc__", None) or "")
    return "\n".join(texts)


def comes_from_elsewhere(kind, name):
    """Whether another package asks for the method and says what its arguments are (diffrax)."""
    return any(name in vars(base) for base in kind.__mro__ if not ours(base) and base is not object)


@functools.cache
def classes_of(path):
    """Every class of a file, parsed."""
    body = ast.parse(Path(path).read_text()).body
    return {node.name: node for node in body if isinstance(node, ast.ClassDef)}


def fields_of(kind):
    """Every public field with the text below it, by `ast`: at run time that text is gone."""
    found = {}
    for base in kind.__mro__:
        if not ours(base):
            continue
        # Not `inspect.getsource`, which does not find classes that the import hook rewrote.
        tree = classes_of(sys.modules[base.__module__].__file__)[base.__name__]
        for field, below in zip(tree.body, [*tree.body[1:], None], strict=True):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                said = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
                text = str(below.value.value) if said else ""
                found[field.target.id] = found.get(field.target.id) or text
    return {name: text for name, text in found.items() if not name.startswith("_")}


def says(text, name):
    return re.search(rf"\b{re.escape(name)}\b", text) is not None


def unsaid(function, text):
    parameters = inspect.signature(function).parameters
    return [p for p in parameters if p not in ("self", "cls") and not says(text, p)]


def refuses(function):
    """Whether a function, as it stands, raises or calls what refuses an argument."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise):
            return True
        if isinstance(node, ast.Call):
            called = getattr(node.func, "id", getattr(node.func, "attr", ""))
            if called.lstrip("_").startswith(("check_", "refuse")):
                return True
    return False


def gives_errors(text):
    said = r"([Rr]aises|[Rr]efuse.*with)\s+(an?\s+)?`\w+(Error|Full)`"
    return re.search(said, text) is not None


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_are_documented(name):
    value = PUBLIC[name]
    text = vars(value).get("__doc__") if inspect.isclass(value) else value.__doc__
    assert text, f"{name} has no docstring"
    if not inspect.isclass(value):
        function = inspect.unwrap(value)
        assert not unsaid(function, text)
        assert gives_errors(text) or not refuses(function), "an error is not documented"


@pytest.mark.parametrize("name", CLASSES)
def test_fields_and_arguments_of_classes_are_documented(name):
    kind = CLASSES[name]
    text = kind.__doc__ or ""
    fields = fields_of(kind)
    silent = [field for field, below in fields.items() if not below and not says(text, field)]
    assert not silent, "fields without a text below them"
    started = function_of(vars(kind).get("__init__"))
    if started is not None and Path(started.__code__.co_filename).exists():  # not a dataclass's
        arguments = [p for p in unsaid(started, text) if not fields.get(p)]
        assert not arguments or comes_from_elsewhere(kind, "__init__")
        assert gives_errors(text) or not refuses(started)
    for check in ("__check_init__", "__post_init__"):
        if check in vars(kind) and refuses(vars(kind)[check]):
            assert gives_errors(text), "an error of the constructor is not documented"


@pytest.mark.parametrize(("kind", "name", "attribute"), members())
def test_methods_are_documented(kind, name, attribute):
    text = docstring(kind, name)
    function = function_of(attribute)
    assert text.strip(), "no docstring"
    if comes_from_elsewhere(kind, name):
        return
    assert isinstance(attribute, property) or not unsaid(function, text)
    assert gives_errors(text) or not refuses(function), "an error is not documented"


def test_completion_offers_public_names_only():
    names = dir(vj)
    assert names == sorted(set(names))
    assert not [n for n in names if isinstance(getattr(vj, n), ModuleType)]
    assert [n for n in names if n.startswith("_")] == ["__version__"]
    assert set(vj.__all__) == set(names)


def test_submodules_are_reached_all_the_same():
    program = "import vibrojax.plot.style as p, vibrojax as vj; assert vj.plot.style is p"
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


def test_an_import_brings_nothing_that_only_some_calls_need():
    program = "import sys, vibrojax; print(*sys.modules)"
    run = [sys.executable, "-c", program]
    done = subprocess.run(run, check=True, timeout=120, capture_output=True, text=True)
    needless = {"matplotlib", "pandas", "scipy.linalg", "scipy.stats", "tqdm", "xarray", "zarr"}
    assert not needless & set(done.stdout.split())


def arguments(*functions):
    return {name for f in functions for name in inspect.signature(f).parameters}


COMMAND_ONLY = {
    "rig",
    "axis",
    "no_curves",
    "summary",
    "output",
    "picture",
    "report",
    "quiet",
    "curve",
    "fit",
} | {"clear"}

"""Options that name files or spell lists: what Python passes as objects and arguments."""


def test_options_of_commands_are_named_as_arguments():
    python = {
        "sweep": arguments(vj.frequency_sweep, vj.SweepSettings),
        "simulate": arguments(vj.simulate, vj.io.read_drive, vj.history.History.plot) | {"drive"},
        "map": arguments(vj.parameter_map, vj.SweepSettings),
        "modes": arguments(vj.modes),
        "fit": arguments(vj.identify, vj.io.read_measured_curve),
        "cache": set(),
    }
    for command, function in cli.COMMANDS.items():
        assert arguments(function) - COMMAND_ONLY <= python[command], command


def test_keys_of_rig_files_are_named_as_arguments():
    python = {
        "beam": arguments(vj.Cantilever),
        "beam.point_masses": arguments(vj.PointMass),
        "stop": arguments(vj.Stop),
        "drive": arguments(vj.BaseMotion, vj.PointForce) | {"kind"},  # which of the two
        "model": arguments(vj.ImpactingBeam),
        "sweep": arguments(vj.frequency_sweep, vj.SweepSettings),
    }
    for table, keys in rig_file_keys.KEYS.items():
        assert set(keys) <= python[table], table
    lists = {"axes"}  # the further keywords of a map
    known = arguments(vj.parameter_map, vj.SweepSettings) | lists
    assert set(rig_file_keys.MAP_KEYS) <= known
    for law, keys in rig_file_keys.LAWS.values():
        assert set(keys) <= arguments(law)


@pytest.mark.parametrize(
    "kind", [vj.sweep.FrequencyResponse, vj.branches.Branch, vj.steady.PeriodicResponse]
)
def test_variables_of_datasets_are_named_as_fields(kind):
    curves = {n for n in fields_of(kind) if n.endswith("_ratio") or n.startswith("contact")}
    assert {"amplitude_ratio", "peak_ratio", "contact_force", "contacts_per_period"} <= curves
    assert curves - {"frequency_ratio"} <= set(VARIABLES)


@pytest.mark.parametrize("name", ["KelvinVoigt", "default_rig"])
def test_arguments_and_units_of_parameters_are_the_same(name):
    """What is drawn over an argument of the rig has the unit that its docstring says."""
    for argument in inspect.signature(PUBLIC[name]).parameters:
        if argument in PARAMETER_UNITS:
            texts = fields_of(PUBLIC[name]) if name in CLASSES else {argument: PUBLIC[name].__doc__}
            assert PARAMETER_UNITS[argument] in texts[argument]
