import importlib
import sys

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
import xarray
from analytic import Analytic

import vibrojax as vj
from vibrojax.design.distributions import distributions_of
from vibrojax.design.propagate import PropagationSettings, propagate, propagated
from vibrojax.design.quasi_random import sobol_sequence

GAP = scipy.stats.norm(3e-4, 2e-5)
STIFFNESS = scipy.stats.uniform(4000.0, 3000.0)
RANGE = vj.Range(0.9, 1.3)
FORCE = {"force": lambda response: response.peak("contact_force")}


def scattered(functions, lost=lambda place: "", distributions=None, **settings):
    uncertain = distributions_of(distributions or {"gap": GAP, "stiffness": STIFFNESS})
    evaluator = Analytic(uncertain.names, functions, lost)
    return propagated(evaluator, uncertain, PropagationSettings(**settings))


def test_of_a_linear_measure_first_order_and_samples_agree():
    slopes = np.array([5e4, 2e-3])
    found = scattered({"contact_force": lambda x: 1.0 + slopes @ x}, samples=256)
    parts = slopes * [2e-5, 3000 / np.sqrt(12)]
    assert found.value == pytest.approx(1.0 + slopes @ [3e-4, 5500.0])
    assert found.gradient[0] == pytest.approx(slopes)
    assert found.first_order_deviation == pytest.approx(np.hypot(*parts))
    assert found.share[0] == pytest.approx(parts**2 / np.sum(parts**2))
    assert found.mean == pytest.approx(found.value, rel=1e-4)
    assert found.deviation == pytest.approx(found.first_order_deviation, rel=0.01)
    # The sum of a normal and a uniform number, by many draws of another generator.
    draws = np.random.default_rng(1).normal(0, parts[0], 400_000)
    draws += np.random.default_rng(2).uniform(-0.5, 0.5, 400_000) * 3000 * slopes[1]
    wanted = found.value + np.quantile(draws, [0.05, 0.5, 0.95])
    assert found.quantiles[0] == pytest.approx(wanted, abs=0.05 * np.std(draws))
    assert found.lost.tolist() == [0]
    assert not found.warnings
    assert "nearly linear" in found.findings["contact_force"]
    assert "contact_force (N)" in repr(found)
    assert found.evaluations == 257


def test_indices_of_ishigami_are_those_in_closed_form():
    pytest.importorskip("SALib")
    a, b = 7.0, 0.1
    angle = scipy.stats.uniform(-np.pi, 2 * np.pi)
    found = scattered(
        {
            "ishigami": lambda x: (1 + b * x[2] ** 4) * jnp.sin(x[0]) + a * jnp.sin(x[1]) ** 2,
            "constant": lambda x: 0.0 * x[0] + 3.0,
        },
        distributions={"one": angle, "two": angle, "three": angle},
        sobol=2048,
    )
    # Ishigami and Homma 1990; Sobol and Levitan 1999.
    both = b * np.pi**4 / 5
    alone = np.array([(1 + both) ** 2 / 2, a**2 / 8, 0.0])
    together = b**2 * np.pi**8 * 8 / 225
    whole = alone.sum() + together
    indices = found.sobol
    assert indices.first[0] == pytest.approx(alone / whole, abs=0.02)
    total = (alone + np.array([together, 0.0, together])) / whole
    assert indices.total[0] == pytest.approx(total, abs=0.02)
    assert (indices.total_confidence[0] < 0.08).all()
    assert (indices.first[1] == 0).all()
    assert found.findings["constant"] == "It does not scatter with these numbers."
    assert found.evaluations == 1 + 64 + 2048 * 5
    data = found.to_xarray()
    assert data["sobol_total"].dims == ("measure", "number")
    assert "Sobol, with others: one" in repr(found)
    found.plot()


def test_jumps_and_bends_are_said():
    found = scattered(
        {
            "jumping": lambda x: jnp.where(x[0] > 3.1e-4, 5.0, 1.0) + 1e-3 * x[1],
            "bending": lambda x: ((x[0] - 3e-4) / 2e-5) ** 2,
        }
    )
    above = int(np.sum(found.samples[:, 0] > 3.1e-4))
    sentence = f"it jumps: {above} of 64 rigs lie 4 above the line of the others, none between."
    assert sentence in found.findings["jumping"]
    bending = found.findings["bending"]
    assert bending.startswith("First order gives 0 % of the scatter: within these")
    assert "it is not linear. Go by the samples." in bending


def test_lost_rigs_are_counted_and_left_out(tmp_path):
    pytest.importorskip("SALib")

    def lost(place):
        return "The branch ended early." if place[0] > 3.3e-4 else ""

    found = scattered({"contact_force": lambda x: 1e5 * x[0]}, lost, sobol=64)
    at = found.samples[:, 0] > 3.3e-4
    assert 0 < at.sum() == found.lost[0] < 10
    assert found.mean[0] == pytest.approx(1e5 * found.samples[~at, 0].mean())
    assert f"{at.sum()} of 64 rigs have no value" in found.warnings[0]
    assert "The branch ended early." in found.warnings[0]
    assert f"gap = {found.samples[at, 0][0]:.6g}, stiffness = " in found.warnings[0]
    assert found.sobol.base[0] < 64
    assert found.sobol.first[0] == pytest.approx([1.0, 0.0], abs=0.15)
    assert f"{found.sobol.base[0]} of 64 base samples" in found.warnings[1]
    found.save(tmp_path / "scatter.nc")
    with xarray.open_dataset(tmp_path / "scatter.nc", engine="h5netcdf") as data:
        assert data["lost"].item() == at.sum()
        assert (data["note"].values == "The branch ended early.").sum() == at.sum()
        assert data["mean"].attrs["units"] == "N"
        for name, variable in data.data_vars.items():
            assert variable.attrs["units"], name
            assert variable.attrs["long_name"], name


def test_nothing_has_a_value():
    found = scattered({"force": lambda x: x[0]}, lambda place: "No branch.", samples=4)
    assert np.isnan([found.value, found.mean, found.deviation, found.least]).all()
    assert found.findings["force"] == "None of the rigs has a value."
    assert found.lost == [4]
    repr(found)
    found.plot()
    found = scattered({"force": lambda x: x[0]}, lambda x: "No." if abs(x[1] - 5500) < 1e-6 else "")
    assert found.findings["force"].endswith("the rig at the means has no value: No.")
    found.plot()


def test_rigs_go_side_by_side_and_a_seed_repeats_them():
    uncertain = distributions_of({"gap": GAP})
    evaluator = Analytic(["gap"], {"force": lambda x: x[0]})
    settings = PropagationSettings(samples=32, lanes=12, seed=3)
    first = propagated(evaluator, uncertain, settings)
    assert evaluator.batches == [1, 12, 12, 8]
    again = propagated(evaluator, uncertain, settings)
    other = propagated(evaluator, uncertain, PropagationSettings(samples=32))
    assert (first.samples == again.samples).all()
    assert not np.isin(first.samples, other.samples).any()


def test_the_call_makes_the_evaluator(monkeypatch):
    asked = {}

    def evaluator(make_system, functions, names, **others):
        asked.update(others, make=make_system, names=names)
        found = Analytic(names, {name: lambda x: x[0] for name in functions})
        found.check = lambda place: asked.update(place=place)
        return found

    def draw(*given):
        drawn.append(given)
        return sobol_sequence(*given)

    drawn, module = [], importlib.import_module("vibrojax.design.propagate")
    monkeypatch.setattr(module, "RigEvaluator", evaluator)
    monkeypatch.setattr(module, "sobol_sequence", draw)
    found = propagate(
        vj.default_rig, {"gap": GAP}, FORCE, frequency_ratio=RANGE, taper=0.3, num_modes=2
    )
    assert drawn == [(64, 1, 0)]  # once, for the rigs that are checked and those evaluated
    assert asked.pop("settings").max_points == 10_000
    assert asked.pop("place") == pytest.approx([3e-4])
    assert asked == {
        "make": vj.default_rig,
        "names": ("gap",),
        "axis": "frequency_ratio",
        "range": RANGE,
        "numbers": {"taper": 0.3, "num_modes": 2},
    }
    assert found.mean == pytest.approx(3e-4, rel=1e-3)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"distributions": {}}, "distributions is empty: give at least one"),
        ({"distributions": {"gap": 3e-4}}, r"distributions\['gap'\] must be a continuous distrib.*"
         r"got 0.0003\."),
        ({"distributions": {"gap": scipy.stats.norm}}, r"Call it first: scipy.stats.norm\("),
        ({"distributions": {"gap": scipy.stats.poisson(3)}}, r"must be a continuous distribution"),
        ({"distributions": {"gap": scipy.stats.norm([1.0, 2.0], 1.0)}}, "must be of one number"),
        ({"distributions": {"gap": scipy.stats.cauchy(3e-4, 1e-5)}}, "must have a finite mean"),
        ({"distributions": {"gap": scipy.stats.uniform(3e-4, 0)}}, "must have a finite mean"),
        ({"distributions": {"gpa": GAP}}, "Unknown argument 'gpa' of the rig in distributions. Did "
         "you mean 'gap'"),
        ({"distributions": {"taper": scipy.stats.norm(0.5, 0.3)}},
         r"distributions\['taper'\] reaches -.*no rig can be built: taper must"),
        ({"distributions": {"num_modes": scipy.stats.uniform(2, 3)}}, "num_modes must be a whole"),
        ({"gap": 3e-4}, "gap has a distribution and is also given as a fixed number"),
        ({"stiffness": [1e3, 2e3]}, "stiffness must be one value"),
        ({"stiffness": vj.Range(1e3, 2e3)}, "stiffness is a range"),
        ({"stifness": 1e3}, "Unknown argument 'stifness' of the rig"),
        ({"measures": {}}, "measures is empty"),
        ({"measures": {"force": "peak"}}, r"measures\['force'\] must be a function, got 'peak'"),
        ({"measures": FORCE["force"]}, "measures must be a dict of functions by name"),
        ({"frequency_ratio": None}, "Give frequency_ratio or frequency, one of the two"),
        ({"frequency": RANGE}, "Give frequency_ratio or frequency, one of the two"),
        ({"frequency_ratio": 1.1}, "frequency_ratio must be a Range"),
        ({"frequency_ratio": vj.Range(0, 1)}, "frequency_ratio must be above 0"),
        ({"base_amplitude": 0.0}, "needs a drive with an amplitude above 0"),
    ],
)  # fmt: skip
def test_wrong_calls(changed, said):
    call = {"distributions": {"gap": GAP}, "measures": FORCE, "frequency_ratio": RANGE}
    with pytest.raises(ValueError, match=said):
        propagate(vj.default_rig, **(call | changed))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"samples": 100}, "samples must be a power of two.*got 100. Nearest: 64 and 128"),
        ({"samples": 2}, "samples must be a whole number of at least 4"),
        ({"sobol": True}, "sobol must be how many base samples"),
        ({"sobol": 24}, "sobol must be a power of two"),
        ({"lanes": 0}, "lanes must be a whole number of at least 1"),
        ({"seed": -1}, "seed must be a whole number of at least 0"),
    ],
)
def test_wrong_settings(settings, said):
    with pytest.raises(ValueError, match=said):
        PropagationSettings(**settings)


def test_without_salib_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "SALib.sample", None)
    settings = PropagationSettings(sobol=64)
    with pytest.raises(ImportError, match=r'pip install "vibrojax\[design\]"'):
        propagate(vj.default_rig, {"gap": GAP}, FORCE, frequency_ratio=RANGE, settings=settings)
