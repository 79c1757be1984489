"""What public objects show of themselves: a few lines, pictures, datasets with units."""

import copy
import inspect
import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from conftest import public_names
from shown import check_result, readable
from unit_oscillator import oscillator

import vibrojax as vj
from vibrojax._tools.described import recipe
from vibrojax.model.systems import as_arrays

LAW = vj.KelvinVoigt(5500.0, 5e-5)
PARTS = {
    "Cantilever": (vj.default_rig().beam, "length=0.2 m", "density=8250 kg/m3"),
    "PointMass": (vj.PointMass(0.002, 0.5), "mass=0.002 kg"),
    "Stop": (vj.Stop(0.5, 4e-4, LAW), "gap=0.0004 m", "stiffness=5500 N/m"),
    "KelvinVoigt": (LAW, "damping=5e-05 N s/m"),
    "Hertz": (vj.Hertz(1e6), "N/m^exponent"),
    "HuntCrossley": (vj.HuntCrossley(1e6, 0.1), "dissipation=0.1 s/m"),
    "StandardLinearSolid": (vj.StandardLinearSolid(1.0, 2.0, 3.0), "relaxation_time=3 s"),
    "BaseMotion": (vj.BaseMotion(2e-4), "amplitude=0.0002 m"),
    "PointForce": (vj.PointForce(2.0), "amplitude=2 N"),
    "NoDrive": (vj.NoDrive(),),
    "Harmonic": (vj.Harmonic(12.0), "frequency=12 Hz"),
    "Chirp": (vj.Chirp(1.0, 2.0, 3.0), "duration=3 s"),
    "ImpactingBeam": (vj.default_rig(), "gap=0.0004 m", "num_modes=5", "amplitude=0.0002 m"),
    "MatrixSystem": (oscillator(), "stiffness", "gap=1 m"),
    "Oscillator": (vj.model.Oscillator(0.1, 20.0), "mass=0.1 kg", "stiffness=20 N/m"),
    "Joined": (
        vj.Joined(vj.default_rig(), vj.model.Oscillator(0.1, 20.0), vj.Stop(1.0, 1e-3, LAW)),
        "first: ImpactingBeam",
        "between[0]: Stop(position=1",
    ),
    "ElasticPendulum": (vj.default_pendulum(), "length=0.195 m", "height=0.04 m"),
    "LinearisedPendulum": (vj.default_pendulum().linearised(3), "num_modes=3", "tip_mass"),
    "Limiters": (vj.default_pendulum().limiters, "distance=0.012 m"),
    "Motion": (vj.motion(oscillator(), frequency=2.0), "frequency=2 Hz"),
    "ExactContact": (vj.ExactContact(), "tolerance=0.0001"),
    "ExponentialSplitting": (vj.ExponentialSplitting(), "tolerance=0.0001"),
    "LinearlyImplicit": (vj.LinearlyImplicit(longest_step=1e-4), "longest_step=0.0001 s"),
    "HarmonicBalance": (vj.HarmonicBalance(samples=256), "samples=256"),
    "Shooting": (vj.Shooting(), "steps_per_period=512"),
    "SweepSettings": (vj.SweepSettings(refine_jumps=None), "refine_jumps=None"),
    "PeriodicSettings": (vj.PeriodicSettings(), "period=1"),
    "ContinuationSettings": (vj.ContinuationSettings(), "max_points=10000"),
    "RegimeSettings": (vj.RegimeSettings(), "transient=200"),
    "BasinSettings": (vj.BasinSettings(), "period_tolerance=0.01"),
    "OptimiseSettings": (vj.design.OptimiseSettings(), "starts=4"),
    "PropagationSettings": (vj.design.PropagationSettings(), "samples=64"),
    "LinearEquations": (oscillator().equations(), "coordinates: 1", "rad/s"),
    "MatrixModes": (oscillator().modes(), "rad/s"),
    "LevenbergMarquardt": (vj.identification.LevenbergMarquardt(), "most_steps=60"),
    "Optax": (vj.identification.Optax(optax.adam(0.1)), "steps=200"),
    "Fold": (vj.branches.Fold(*map(jnp.asarray, (1.2, 3.0, 0.5, [0.0, 1.0], True))), "0.5 N"),
}
MODULES = [name for name, (part, *_) in PARTS.items() if isinstance(part, eqx.Module)]


@pytest.mark.parametrize("name", PARTS)
def test_objects_show_their_numbers_with_units(name):
    part, *words = PARTS[name]
    text = readable(repr(part), name)
    assert [word for word in words if word not in text] == []


@pytest.mark.parametrize("name", MODULES)
def test_objects_show_themselves_while_traced_and_as_placeholders(name):
    part, *_ = PARTS[name]
    numbers, rest = eqx.partition(part, lambda leaf: eqx.is_array(leaf) or isinstance(leaf, float))
    shown = []

    def look(numbers):
        shown.append(repr(eqx.combine(numbers, rest)))
        return numbers

    jax.eval_shape(look, numbers)
    like = jax.eval_shape(lambda numbers: numbers, numbers)
    for text in (*shown, repr(eqx.combine(like, rest))):
        readable(text, name)


def test_batches_show_their_range_once():
    rigs = jax.vmap(lambda gap: vj.default_rig(gap=gap))(jnp.linspace(1e-4, 1e-3, 7))
    text = readable(repr(rigs), "ImpactingBeam")
    assert "gap=0.0001 to 0.001 (7 values) m" in text
    assert "length=0.2 (7 values) m" in text


def test_equal_texts_mean_equal_numbers():
    gap = 4e-4
    assert repr(vj.default_rig(gap=gap)) != repr(vj.default_rig(gap=np.nextafter(gap, 1.0)))


def test_recipes_have_the_numbers_of_arrays():
    rig = vj.default_rig(num_modes=1)
    assert "gap=0.0004" in recipe(rig)
    assert recipe(as_arrays(rig)) == recipe(rig)
    assert "gap=f64[2]" in recipe(vj.default_rig(gap=jnp.array([1e-4, 2e-4])))


def test_objects_are_copied_and_pickled():
    rig = vj.default_rig()
    for twin in (copy.deepcopy(rig), pickle.loads(pickle.dumps(rig))):
        assert repr(twin) == repr(rig)


def contacts_by_hand():
    columns = inspect.signature(vj.history.Contacts).parameters
    numbers = {name: np.linspace(0.5, 1.0, 3) for name in columns}
    return vj.history.Contacts(**(numbers | {"stop": np.array([1, 2, 1])}))


def energy_by_hand():
    table = np.linspace(0.1, 1.0, 6).reshape(3, 2)
    return vj.history.EnergyFlow(
        np.arange(3.0), table, table[:, :1], table, table[:, :1], table[:, 0]
    )


def fold_curve_by_hand():
    x = np.linspace(1.0, 1.2, 4)
    return vj.branches.FoldCurve(
        4e-4 * x, x, 3 * x, x, ("end of the range", "the fold ends"), "gap"
    )


def propagation_by_hand():
    gap = np.linspace(2.6e-4, 3.4e-4, 16)
    return vj.design.Propagation(
        measures=("contact_force",),
        numbers=("gap",),
        means=np.array([3e-4]),
        deviations=np.array([2e-5]),
        value=np.array([1.0]),
        gradient=np.array([[-3e3]]),
        note="",
        samples=gap[:, None],
        values=1.9 - 3e3 * gap[:, None],
        notes=("",) * 16,
        sobol=None,
        evaluations=17,
    )


QUICK = {
    "Propagation": propagation_by_hand,
    "Modes": lambda: vj.modes(vj.default_rig().beam),
    "Contacts": contacts_by_hand,
    "EnergyFlow": energy_by_hand,
    "FoldCurve": fold_curve_by_hand,
    "LyapunovExponent": lambda: vj.regime.LyapunovExponent(
        *map(jnp.asarray, (0.05, 0.003, np.linspace(0.0, 0.1, 40), np.zeros(2), 7.0))
    ),
    "ResolutionCheck": lambda: vj.resolution.ResolutionCheck(
        {"fold": np.array(1.2)}, {"one more mode": {"fold": np.array(0.01)}}, {}
    ),
}


@pytest.mark.parametrize("name", QUICK)
def test_results_draw_themselves_and_become_datasets(name):
    check_result(QUICK[name]())


RESULTS = {
    name: kind
    for name, kind in public_names().items()
    if inspect.isclass(kind) and not name.startswith(("io.", "explorer.")) and hasattr(kind, "plot")
}


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_has_a_picture_and_a_dataset(name):
    assert inspect.isfunction(inspect.unwrap(RESULTS[name].to_xarray))


def test_results_are_found():
    assert len(RESULTS) >= 21


def made_by_programs():
    """Results that no test of their own rooms looks at by `check_result`."""
    body, frequency = oscillator(), 0.9 / (2 * np.pi)
    history = vj.simulate(body, frequency=frequency, periods=40)
    yield history
    yield history.contacts()
    yield history.energy()
    yield history.spectrum()
    yield history.cycles()
    yield history.poincare()
    yield vj.simulate(oscillator, gap=[0.9, 1.0], frequency=frequency, periods=3)
    yield vj.periodic_response(vj.default_rig(num_modes=1), frequency_ratio=1.1)


@pytest.mark.slow
def test_results_of_programs_draw_themselves_and_become_datasets():
    for result in made_by_programs():
        check_result(result)
