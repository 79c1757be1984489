"""Branches of all reference rigs, and of two published systems, against what is known of them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.branches import what_follows

DATA = Path(__file__).parents[1] / "data"
CASES = json.loads((DATA / "sweeps.json").read_text())["cases"]
SINGLE = json.loads((DATA / "single_contact.json").read_text())["cases"]
UNIT = 2 * np.pi
SHARE = 0.94
"""Least share of listed points of period 1 that lie on a curve."""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def traced(rig):
    """The branch of a reference rig over its range, at the frequencies listed; made once."""
    kept = {}

    def trace(name):
        if name not in kept:
            p = CASES[name]["parameters"]
            one = rig(
                taper=p["mu"],
                mass_ratio=p["mr"],
                gap=p["lam"],
                position=p["s1"],
                formulation=p["variant"],
                num_modes=p["n_modes"],
            )
            listed = sorted(
                {r for way in ("forward", "backward") for r in CASES[name][way]["ratio"]}
            )
            margin = 5e-3  # so that the ends themselves are inside
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(what_follows, "MOST", 0)  # nothing is listed of it
                branch = vj.continue_response(
                    one, frequency_ratio=vj.Range(listed[0] - margin, listed[-1] + margin)
                )
            kept[name] = branch, branch.resample(listed)
        return kept[name]

    return trace


def on_the_curve(name, data):
    """Whether each listed point of period 1 is a crossing of the branch, to 1e-4."""
    amplitude, force = data.amplitude_ratio.values, data.contact_force.values
    ratios = data.frequency_ratio.values.tolist()
    found = []
    for way in ("forward", "backward"):
        listed = CASES[name][way]
        for k, ratio in enumerate(listed["ratio"]):
            if listed["period"][k] != 1:
                continue
            at = ratios.index(ratio)
            off = np.abs(amplitude[at] / listed["half_pp_ratio"][k] - 1)
            wanted = listed["max_contact_force"][k]
            off_force = np.abs(force[at] - wanted) / max(wanted, 1e-3)
            found.append(((off < 1e-4) & (off_force < 1e-4)).any())
    return found


def assert_exact(branch):
    """All but one point in twenty: within 1e-4 of a touch rounding can decide against one."""
    assert branch.exact_points.mean() > 0.95
    assert branch.residual[branch.exact_points].max() < 1e-9


@pytest.mark.parametrize("name", CASES)
def test_folds_are_the_refined_jumps(traced, name):
    branch, _ = traced(name)
    assert branch.completed, branch.sentence
    assert_exact(branch)
    assert (np.diff(branch.arclength) > 0).all()
    for jump in ("jump_up", "jump_down"):  # all are folds in the reference
        assert np.abs(branch.folds / CASES[name][jump] - 1).min() < 1e-4, jump


@pytest.mark.parametrize("name", CASES)
def test_leading_multipliers(traced, name):
    _, data = traced(name)
    ratios, single = data.frequency_ratio.values.tolist(), SINGLE[name]
    compared = 0
    for k, ratio in enumerate(single["ratio"]):
        at = ratios.index(ratio)
        off = np.abs(data.amplitude_ratio.values[at] / single["half_pp_ratio"][k] - 1)
        if not np.nanmin(off, initial=np.inf) < 1e-4:
            continue
        crossing = np.nanargmin(off)
        compared += 1
        for ours, theirs, tolerance in (
            ("leading_multiplier", "max_multiplier", 1e-3),
            ("contact_fraction", "contact_fraction", 1e-4),
        ):
            wanted = pytest.approx(single[theirs][k], abs=tolerance)
            assert data[ours].values[at, crossing] == wanted, f"{ratio} {ours}"
        assert data.stable.values[at, crossing] == 1
    assert compared >= SHARE * len(single["ratio"])


def test_listed_points_lie_on_the_curves(traced):
    found = {name: on_the_curve(name, traced(name)[1]) for name in CASES}
    for name, hits in found.items():
        print(f"{name}: {sum(hits)} of {len(hits)}")
    hits = [hit for some in found.values() for hit in some]
    print(f"together {np.mean(hits):.4f} of {len(hits)}")
    assert len(hits) > 700
    assert np.mean(hits) >= SHARE


# NLvib, example 03: two masses, one of which hits a spring


@pytest.fixture(scope="module")
def two_masses():
    stiffness = np.array([[1.0, -1.0], [-1.0, 2.0]])
    system = vj.MatrixSystem(
        np.eye(2),
        0.03 * stiffness,
        stiffness,
        stops=vj.Stop(None, 1.0, vj.KelvinVoigt(100.0)),
        stop_map=[[1.0, 0.0]],
        drive=vj.PointForce(0.1),
        input_map=[0.0, 1.0],
        response_map=[0.0, 1.0],
    )
    return vj.continue_response(system, frequency=vj.Range(0.5 / UNIT, 0.9 / UNIT))


def test_two_masses_of_nlvib(two_masses):
    branch = two_masses
    assert branch.completed
    assert branch.ratio_units == "m/N"
    # Printed from a balance of few harmonics; the touches are exact.
    np.testing.assert_allclose(branch.folds[0] * UNIT, 0.75563, rtol=1e-3)
    np.testing.assert_allclose(np.abs(branch.folds * UNIT / 0.65348 - 1).min(), 0.0, atol=1e-3)
    touches = np.sort(branch.grazings * UNIT)
    np.testing.assert_allclose(touches, [0.58189964, 0.65344014], rtol=1e-7)
    first = branch.first_harmonic_ratio * 0.1
    assert first.max() == pytest.approx(0.93631, rel=2e-3)
    assert branch.values[np.argmax(first)] * UNIT == pytest.approx(0.7512, rel=5e-3)
    amplitudes = {
        round(p.parameter * UNIT, 4): p.amplitude_ratio * 0.1
        for p in branch.special_points
        if p.kind == "grazing"
    }
    assert amplitudes[0.6534] == pytest.approx(0.57324107, rel=2e-2)  # of the point before it
    assert amplitudes[0.5819] == pytest.approx(0.66152236, rel=2e-2)


# x'' + 0.1 x' + x + 50 max(x - 1, 0) = 0.3 cos(w t)


@pytest.fixture(scope="module")
def oscillator():
    return vj.MatrixSystem(
        [[1.0]],
        [[0.1]],
        [[1.0]],
        response_map=[1.0],
        stops=vj.Stop(None, 1.0, vj.KelvinVoigt(50.0)),
        stop_map=[[1.0]],
        drive=vj.PointForce(0.3),
        input_map=[1.0],
    )


@pytest.fixture(scope="module")
def oscillator_branch(oscillator):
    return vj.continue_response(oscillator, frequency=vj.Range(0.8 / UNIT, 1.5 / UNIT))


def test_oscillator(oscillator_branch):
    branch = oscillator_branch
    assert branch.completed
    assert branch.folds.max() * UNIT == pytest.approx(1.4484, abs=1e-4)
    # The other fold is just behind the touch: the curve bends sharply there, but has no corner.
    assert branch.folds.min() * UNIT == pytest.approx(1.1304366, rel=3e-6)
    assert branch.folds.min() < branch.grazings.max()
    np.testing.assert_allclose(np.sort(branch.grazings) * UNIT, [0.8438679, 1.1304366], atol=1e-7)
    assert branch.period_doublings[-1] * UNIT == pytest.approx(0.9285, abs=2e-4)
    assert branch.neimark_sackers.size == 0
    upper = next(p for p in branch.special_points if p.kind == "fold")
    assert upper.contact_force / 50 + 1 == pytest.approx(1.3126, abs=2e-3)
    w = branch.values * UNIT
    touching = branch.contact_fraction > 0
    doubled = touching & (w > 0.85) & (w < 0.928)
    assert doubled.sum() > 3
    assert not branch.stable[doubled].any()
    assert (branch.floquet_multipliers[doubled].real.min(axis=1) < -1).all()
    # With one degree of freedom the product of the multipliers is known.
    exact = branch.exact_points
    product = np.prod(branch.floquet_multipliers, axis=1).real
    np.testing.assert_allclose(product[exact], np.exp(-0.1 * UNIT / w)[exact], rtol=1e-9)


def test_what_follows_where_stability_is_lost(oscillator, oscillator_branch):
    points = oscillator_branch.special_points
    first, *_, last = [p for p in points if p.kind == "period_doubling"]
    assert (first.follows, last.follows) == ("period 3", "period 2")
    assert last.follows_at < last.parameter  # on the side where the branch is unstable
    assert first.follows_at > first.parameter
    assert not any(p.follows for p in points if p.kind in ("fold", "grazing"))
    data = oscillator_branch.to_xarray()
    assert data.period_doubling_follows.values.tolist()[-1] == "period 2"
    assert f"then period 2 at {last.follows_at:.6g}" in repr(last)


def test_of_many_losses_of_stability_the_first_are_labelled(oscillator_branch, monkeypatch):
    monkeypatch.setattr(what_follows, "MOST", 1)
    silent = tuple(replace(p, follows="") for p in oscillator_branch.special_points)
    (labelled,) = what_follows.with_what_follows(
        [replace(oscillator_branch, special_points=silent)]
    )
    assert [p.follows for p in labelled.special_points if p.follows] == ["period 3"]


def test_settled_sweeps_have_what_follows_too(oscillator, oscillator_branch):
    points = oscillator_branch.special_points
    first, *_, last = [p for p in points if p.kind == "period_doubling"]
    curve = vj.frequency_sweep(oscillator, frequency=[first.follows_at, last.follows_at])
    assert curve.period.max(axis=0).tolist() == [3, 2]


def test_the_doubled_branch(oscillator, oscillator_branch):
    """Motions of period 2 leave at 0.9285; at 0.9275 they are stable."""
    doubled = oscillator_branch.switch(oscillator_branch.period_doublings.size - 1)
    assert doubled.period == 2
    assert_exact(doubled)
    assert doubled.values[0] * UNIT == pytest.approx(0.9285, abs=1e-3)
    there = doubled.resample([0.9275 / UNIT])
    assert (there.stable.values[0] == 1).sum() == 1


def test_the_doubled_branch_is_that_of_periodic_responses(oscillator, oscillator_branch):
    doubled = oscillator_branch.switch(oscillator_branch.period_doublings.size - 1)
    there = doubled.resample([0.9275 / UNIT])
    (at,) = np.flatnonzero(there.stable.values[0] == 1)
    state = there.initial_state.values[0, at]
    direct = vj.periodic_response(
        oscillator, frequency=0.9275 / UNIT, settings=vj.PeriodicSettings(period=2)
    )
    assert direct.stable
    assert float(direct.amplitude_ratio) == pytest.approx(
        there.amplitude_ratio.values[0, at], rel=1e-8
    )
    # The same motion, from either of its two drive periods.
    once = vj.simulate(
        oscillator, frequency=0.9275 / UNIT, periods=1, initial_state=(state[:1], state[1:])
    )
    states = [state, np.array([once.displacement()[-1], once.velocity()[-1]])]
    assert min(np.abs(np.asarray(direct.initial_state) - s).max() for s in states) < 1e-4
