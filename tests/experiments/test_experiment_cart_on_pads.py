"""A cart on measured pads: its records, its fits, and what its page says."""

import importlib.util
import json
from pathlib import Path

import pytest

import vibrojax as vj

FOLDER = Path(__file__).parents[2] / "experiments" / "cart_on_pads"
RESULTS = json.loads((FOLDER / "results.json").read_text())


@pytest.fixture(scope="module")
def pads():
    spec = importlib.util.spec_from_file_location("cart_on_pads", FOLDER / "cart.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_records_are_those_of_the_file(pads):
    for pad, peak in ((40, 5.33), (4, 6.78)):
        runs = pads.records(pad)
        assert list(runs) == list(pads.RUNS)
        for run in runs.values():
            assert list(run.channels) == ["contact_force"]
            assert abs(run.offset["contact_force"]) < 0.06
            assert 0.4 < run.window[1] - run.window[0] < 0.6
        assert -runs["Run 1"].contact_force.min() == pytest.approx(peak, abs=0.01)
    assert (FOLDER / "data" / "LICENSE").read_text().startswith("MIT License")


def test_mass_by_the_impulse(pads):
    for pad, low, high in ((40, 0.57, 0.59), (4, 0.55, 0.63)):
        found = pads.mass_by_impulse(pad)
        assert found == RESULTS["mass"][f"{pad} mm"]
        assert all(low < run["beside_contact"] < high for run in found.values())


@pytest.mark.slow
@pytest.mark.long  # the notebook of it fits too
def test_runs_on_the_thick_pad_agree_and_the_thin_pad_is_refused(pads):
    thick, thin = pads.records(40), pads.records(4)
    for name in ("Run 4", "Run 5"):
        fit = vj.identify(pads.cart, thick[name], pads.GUESS, mass=pads.MASS)
        assert 80.0 < fit.estimate["stiffness"] < 83.0
        assert 0.4 < fit.estimate["damping"] < 1.1
        assert not any("does not explain" in text for text in fit.warnings)
    fit = vj.identify(pads.cart, thin["Run 3"], pads.GUESS, mass=pads.MASS)
    assert any("does not explain" in text for text in fit.warnings)


@pytest.mark.slow
@pytest.mark.long  # the notebook of it fits too
def test_the_force_alone_does_not_know_the_mass(pads):
    """A heavier and slower cart on a stiffer pad makes the same force."""
    run = pads.records(40)["Run 4"]
    fit = vj.identify(pads.cart, run, pads.GUESS | {"mass": 0.5})
    assert not any(fit.identifiable.values())


def test_warnings_and_tables_of_the_page_are_the_results():
    page = (FOLDER / "README.md").read_text()
    for pad, runs in RESULTS["alone"].items():
        for name, run in runs.items():
            k, c = run["estimate"]["stiffness"], run["estimate"]["damping"]
            low, high = run["interval"]["stiffness"]
            if pad == "40 mm":
                assert not run["misfit_warning"]
                assert run["rms"]["contact_force"] < 0.12
                least, most = run["interval"]["damping"]
                words = f"{k:.1f} ({low:.1f} to {high:.1f}) | {c:.2f} ({least:.2f} to {most:.2f})"
            else:
                assert run["misfit_warning"]
                words = f"{k:.0f} | {c:.2f}"
            rms, chi = run["rms"]["contact_force"], run["reduced_chi_square"]
            assert f"| {name[4:]} | {words} | {rms:.3f} | {chi:.3g} |" in page
    for left_out, fit in RESULTS["together"].items():
        words = " | ".join(f"{fit['estimate'][n]:.2f}" for n in ("stiffness", "damping"))
        assert f"| {left_out} | {words} |" in page
    for pad in ("40mm", "04mm"):
        for law, row in RESULTS[f"laws_{pad}"]["laws"].items():
            left_out = sum(row["left_out"]) / len(row["left_out"])
            words = f"{row['reduced_chi_square']:.3g} | {row['akaike']:.3g} | {left_out:.3g}"
            assert f"| {law} | {words} |" in page
