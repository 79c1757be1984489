"""Shared set-up: shapes of every annotated array are checked while the tests run."""

import gc
import inspect
import os
import signal
from collections import Counter
from importlib.metadata import version
from pathlib import Path

# What one worker compiled, the others and the next run need not compile again.
CACHE = Path(__file__).parents[1] / ".pytest_cache"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(CACHE / "jax"))
os.environ.setdefault("VIBROJAX_CACHE", str(CACHE / "vibrojax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# Tests compile much and compute little: XLA takes a third of the time where it hardly optimises.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
if tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11):  # an unknown flag ends the process
    flags = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
    os.environ.setdefault("XLA_FLAGS", flags)

from jaxtyping import install_import_hook  # noqa: E402

# Before anything imports vibrojax, so that all of it is checked.
_hook = install_import_hook("vibrojax", "checked_when_called.checked")

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from exact_propagation import Problem  # noqa: E402
from tiers import DEAREST, marks_of  # noqa: E402

import vibrojax as vj  # noqa: E402
from vibrojax._tools.compiled import make_room  # noqa: E402

MOST_MAPPINGS = 0.3
"""Share of what Linux allows a process; every compiled function takes several."""


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their markers
def pytest_collection_modifyitems(items):
    for item in items:
        for mark in marks_of(item.path.stem, item.name):
            if mark != "quick" or not item.get_closest_marker("slow"):
                item.add_marker(mark)
    # Quick ones first, so that a run fails early; then what takes longest, then files of many
    # tests, as few fill up gaps.
    many = Counter(item.path for item in items)

    def place(item):
        is_quick = item.get_closest_marker("quick") is not None
        return not is_quick, item.path.stem not in DEAREST, -many[item.path]

    items.sort(key=place)


def pytest_unconfigure():
    """Let a process end without looking through all that JAX has made, which takes seconds."""
    gc.freeze()


@pytest.fixture(autouse=True, scope="module")
def _room_for_compiled_code():
    """Forget what was compiled before the kernel refuses XLA more memory, which is a crash."""
    yield
    make_room(MOST_MAPPINGS)


@pytest.fixture(autouse=True, scope="session")
def _interrupts_are_heard():
    """A shell starts what runs in the background with interrupts switched off."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def on_a_cpu():
    """For tests of how wide programs are, which on a GPU are wider."""
    if jax.default_backend() != "cpu":
        pytest.skip("programs are wider on a GPU")


def make_rig(
    *,
    taper=0.5,
    mass_ratio=0.5,
    gap=0.4e-3,
    position=0.5,
    stiffness=5500.0,
    damping=5e-5,
    tension=True,
    side=1,
    amplitude=0.2e-3,
    damping_ratio=0.018,
    num_modes=5,
    formulation="consistent",
) -> vj.ImpactingBeam:
    """The default rig (design.md 2.2), any of its numbers changed by name."""
    beam = vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0, taper=taper, mass_ratio=mass_ratio)
    stop = vj.Stop(position, gap, vj.KelvinVoigt(stiffness, damping, tension), side=side)
    return vj.ImpactingBeam(
        beam,
        stops=(stop,),
        drive=vj.BaseMotion(amplitude),
        damping_ratio=damping_ratio,
        num_modes=num_modes,
        formulation=formulation,
    )


@pytest.fixture(scope="session")
def rig():
    """Builder of the default rig with any of its numbers changed by name."""
    return make_rig


def make_oscillator(
    *,
    frequency=1.0,
    damping_ratio=0.0,
    stiffness=50.0,
    damping=0.0,
    gap=1.0,
    mass=1.0,
    tension=True,
    sides=(1,),
) -> vj.model.LinearEquations:
    """One mass (kg) on a spring, natural frequency in rad/s, with a stop on each of the sides."""
    law = vj.KelvinVoigt(stiffness, damping, tension)
    towards = np.array(sides, float)[:, None]
    return vj.model.LinearEquations(
        stops=tuple(vj.Stop(1.0, gap, law, side=side) for side in sides),
        angular_frequency=jnp.asarray([frequency], float),
        damping_ratio=jnp.asarray([damping_ratio], float),
        input_map=jnp.ones(1) / mass,
        stop_map=jnp.asarray(towards),
        force_map=jnp.asarray(towards.T / mass),
        response_map=jnp.ones(1),
        modal_mass=mass * jnp.ones(1),
    )


def make_problem(rig: vj.ImpactingBeam) -> Problem:
    """The same rig for the oracle `exact_propagation`: a beam with one stop, driven at its base."""
    equations, (stop,) = rig.equations(), rig.stops
    return Problem(
        angular_frequency=np.asarray(equations.angular_frequency),
        damping_ratio=np.asarray(equations.damping_ratio),
        modal_mass=np.asarray(equations.modal_mass),
        participation=np.asarray(equations.input_map),
        shape_at_stop=stop.side * np.asarray(equations.stop_map[0]),
        shape_at_tip=np.asarray(equations.response_map),
        gap=float(stop.gap),
        stiffness=float(stop.law.stiffness),
        damping=float(stop.law.damping),
        base_amplitude=float(rig.drive.amplitude),
        side=float(stop.side),
        tension=stop.law.tension,
    )


@pytest.fixture(scope="session")
def oscillator():
    """Builder of the equations of one mass, any of its numbers changed by name."""
    return make_oscillator


@pytest.fixture(scope="session")
def problem():
    """Translator of a rig for the oracle."""
    return make_problem


@pytest.fixture(scope="session")
def rig_branch():
    """Branch of the default rig through both of its folds."""
    return vj.continue_response(make_rig(), frequency_ratio=vj.Range(0.85, 1.31))


@pytest.fixture(scope="session")
def small_branch():
    """Branch of the default rig with one mode: its folds are at 1.3813 and 1.0972."""
    return vj.continue_response(make_rig(num_modes=1), frequency_ratio=vj.Range(0.85, 1.4))


def public_names():
    """Everything public by name: `simulate`, and `history.History` of the room that holds it."""
    found = {name: getattr(vj, name) for name in dir(vj) if not name.startswith("_")}
    rooms = {
        name: room
        for name, room in vars(vj).items()
        if hasattr(room, "__path__") and room.__name__ == f"vibrojax.{name}"
    }
    for name, room in rooms.items():
        for own, value in vars(room).items():
            if inspect.isclass(value) or inspect.isfunction(value):
                found[f"{name}.{own}"] = value
    # A room of one module has imports beside its own.
    kind = vj.resolution.ResolutionCheck
    return found | {"resolution.ResolutionCheck": kind}
