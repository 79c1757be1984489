"""Which law explains force records: the one that made them; none, where another thing did."""

import importlib
from types import SimpleNamespace

import matplotlib.figure
import numpy as np
import pytest
from shown import check_result

import vibrojax as vj
from vibrojax.identification import Identification
from vibrojax.identification.law_comparison import Judged, LawComparison
from vibrojax.io import MeasuredHistory

LAWS = ["no_tension", "hunt_crossley"]


def cart(law, mass=0.58):
    return vj.model.Oscillator(mass, stops=(vj.Stop(None, 0.0, law),))


def record(law, velocity, seed, label):
    """Force of a cart that hits a stop, every 10 ms, with noise; the clock begins anywhere."""
    made = cart(law)
    state = made.state(velocity=[velocity])
    fine = vj.simulate(made, initial_state=state, duration=0.3, samples=1500)
    time = 0.01 * np.arange(30)
    force = np.interp(time - 0.0537, fine.time, np.sum(fine.contact_force, axis=1), left=0.0)
    noise = 0.03 * np.random.default_rng(seed).standard_normal(time.size)
    return MeasuredHistory(
        time + 3.0,
        contact_force=force + noise,
        deviation={"contact_force": 0.03},
        initial_velocity=velocity,
        initial_displacement=0.0,
        label=label,
    )


def law(damping):
    """A law of one's own: how it is made, and where its search begins."""
    make = lambda stiffness: vj.KelvinVoigt(stiffness, damping, tension=False)  # noqa: E731
    return make, {"stiffness": 200.0}


@pytest.mark.slow
def test_laws_of_ones_own_are_judged_too():
    """Two that differ by a number are one program."""
    lossy = vj.KelvinVoigt(250.0, 3.0, tension=False)
    runs = [record(lossy, v, k, f"{v} m/s") for k, v in enumerate((0.5, 0.9))]
    found = vj.compare_laws(cart, runs, laws={"lossless": law(0.0), "lossy": law(3.0)})
    assert found.best == "lossy"
    low, high = found.fits["lossy"].interval["stiffness"]
    assert low < 250.0 < high
    data = found.to_xarray()
    assert data["foretold"].sel(law="lossy").max() < 2.0
    assert data["foretold"].sel(law="lossless").mean() > 4.0
    assert data["akaike"].sel(law="lossy") == 0
    check_result(found)


@pytest.mark.slow
def test_a_number_of_the_law_may_be_private():
    """Each record has its own, which begins at the guess of the law."""
    runs = [record(vj.KelvinVoigt(k, 3.0, tension=False), 0.9, 1, f"{k}") for k in (200.0, 300.0)]
    laws = {"lossless": law(0.0), "lossy": law(3.0)}
    found = vj.compare_laws(cart, runs, laws=laws, private=["stiffness"])
    assert found.to_xarray()["foretold"].sel(law="lossy").max() < 2.0


def test_of_a_record_left_out_only_private_numbers_have_bounds(monkeypatch):
    def fitted(make, measured, guess, bounds=None, *, private=(), **others):
        asked.append((sorted(guess), sorted(bounds or ())))
        assert set(private) <= set(guess)
        made = object.__new__(Identification)  # what a comparison reads of it
        object.__setattr__(made, "estimate", {n: 1.0 for n in guess if n not in private})
        object.__setattr__(made, "chi_square", 1.0)
        return made

    asked, module = [], importlib.import_module("vibrojax.identification.compare_laws")
    monkeypatch.setattr(module, "identify", fitted)
    time = np.linspace(0.0, 1.0, 20)
    force = np.maximum(np.sin(6 * time), 0.0)
    runs = [MeasuredHistory(time, contact_force=force, initial_velocity=v) for v in (0.5, 0.9)]
    bounds = dict(stiffness=vj.Range(10.0, 1e4), initial_velocity=vj.Range(0.1, 2.0))
    vj.compare_laws(
        cart,
        runs,
        dict(initial_velocity=None),
        dict(lossless=law(0.0), lossy=law(3.0)),
        bounds,
        private=["initial_velocity"],
    )
    whole, left_out = (["initial_velocity", "stiffness"],) * 2, (["initial_velocity"],) * 2
    assert asked == [whole, whole, left_out, whole, left_out] * 2
    # A number that one of the laws has.
    asked.clear()
    bounds = dict(dissipation=vj.Range(0.01, 2.0))
    vj.compare_laws(cart, runs[0], None, LAWS, bounds, private=["dissipation"])
    no_tension, hunt_crossley = asked
    assert no_tension == (["damping", "stiffness"], [])
    assert hunt_crossley == (["dissipation", "stiffness"], ["dissipation"])


@pytest.mark.slow
@pytest.mark.long
def test_the_law_that_made_the_records_foretells_them_best(tmp_path):
    law = vj.HuntCrossley(250.0, 0.25)
    runs = [record(law, v, k, f"{v} m/s") for k, v in enumerate((0.5, 0.9))]
    found = vj.compare_laws(cart, runs, laws=LAWS)
    assert found.best == "hunt_crossley"
    fit = found.fits["hunt_crossley"]
    for name, value in dict(stiffness=250.0, dissipation=0.25).items():
        low, high = fit.interval[name]
        assert low < value < high
    data = found.to_xarray()
    assert data["foretold"].sel(law="hunt_crossley").max() < 2.0
    assert data["foretold"].sel(law="no_tension").mean() > 4.0
    assert data["akaike"].sel(law="hunt_crossley") == 0
    assert data["weight"].sum() == pytest.approx(1.0)
    assert not any("None of the laws" in text for text in found.warnings)
    assert "best: hunt_crossley" in repr(found)
    assert isinstance(found.plot(), matplotlib.figure.Figure)
    found.save(tmp_path / "laws.nc")
    # A law that cannot be: the deviations are small beside what it misses.
    one = found.fits["no_tension"]
    assert any("does not explain" in text for text in one.warnings)


def test_what_cannot_be_compared_is_refused():
    time = np.linspace(0.0, 1.0, 20)
    force = np.maximum(np.sin(6 * time), 0.0)
    run = MeasuredHistory(time, contact_force=force, initial_velocity=0.8)
    silent = MeasuredHistory(time, velocity=force, initial_velocity=0.8)
    cases = [
        (dict(make_system=lambda mass: cart(None, mass)), "must take an argument `law`"),
        (dict(measured=[]), "measured must be a MeasuredHistory"),
        (dict(measured=silent), "has no contact_force"),
        (dict(bounds=dict(mas=vj.Range(0.1, 2.0))), "bounds of 'mas': it is neither in guess nor"),
        (dict(private=["gap"]), "private of 'gap': it is neither in guess nor a number of one of"),
        (dict(laws=["hertz"]), "laws must be at least two"),
        (dict(laws=3), "laws must be names of kelvin_voigt.*got 3"),
        (dict(laws=["hertz", "herz"]), "there is no law 'herz'.*hertz"),
        (dict(laws=dict(hertz=None, mine=3)), "mine must be a function that makes a law"),
        (dict(laws=dict(hertz=None, mine=(vj.Hertz, dict(mass=1.0)))), "Rename one of them"),
    ]
    for settings, words in cases:
        call = dict(make_system=cart, measured=run) | settings
        with pytest.raises(ValueError, match=words):
            vj.compare_laws(call.pop("make_system"), call.pop("measured"), **call)


def test_it_is_said_when_no_law_explains_the_records_and_which_are_alike():
    def fit(chi_square, numbers):
        names = tuple(f"n{k}" for k in range(numbers))
        parts = dict(
            chi_square=chi_square,
            degrees_of_freedom=100 - numbers,
            estimate=dict.fromkeys(names, 1.0),
            interval=dict.fromkeys(names, (0.5, 2.0)),
            measured=(SimpleNamespace(label="run 1"), SimpleNamespace(label="")),
        )
        made = object.__new__(Identification)  # what a comparison reads of it
        for name, value in parts.items():
            object.__setattr__(made, name, value)
        return made

    def compared(*laws):
        return LawComparison({name: Judged(fit(*own), left) for name, own, left in laws})

    bad = compared(("hertz", (900.0, 1), (9.0, 11.0)), ("stiff", (880.0, 2), (12.0, 12.0)))
    assert bad.best == "hertz"
    first, alike = bad.warnings
    assert first.startswith("None of the laws explains the records: with the best, hertz")
    # Misfits that all share count for little: chi-square over the least reduced one.
    assert alike.endswith("do not distinguish hertz from stiff.")
    assert bad.to_xarray()["record"].values.tolist() == ["run 1", "2"]
    good = compared(("hertz", (100.0, 1), ()), ("stiff", (60.0, 2), ()))
    assert (good.best, good.warnings) == ("stiff", ())
    np.testing.assert_allclose(good.to_xarray()["akaike"], [38.0, 0.0])
