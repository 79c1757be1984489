"""Measures of branches and their derivatives, on the default rig with one mode."""

import design_slopes
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax._tools.described import recipe
from vibrojax.design.measures import NoSuchPlace
from vibrojax.design.pieces import pieces_of

RANGE = vj.Range(0.9, 1.6)
pytestmark = pytest.mark.slow


GAP, STEPS = 4e-4, (4e-8, 2e-8)


def rig(gap=GAP, stiffness=5500.0):
    return vj.default_rig(gap=gap, stiffness=stiffness, num_modes=1)


def respond(gap=GAP, stiffness=5500.0):
    """The response of a rig, with derivatives in its gap."""
    return vj.design.respond(lambda gap: rig(gap, stiffness), gap=gap, frequency_ratio=RANGE)


@pytest.fixture(scope="module")
def response():
    return respond()


@pytest.fixture(scope="module")
def sweep():
    frequencies = np.linspace(0.9, 1.6, 281)
    return vj.frequency_sweep(rig(), frequency_ratio=frequencies, progress=False)


@pytest.mark.long
def test_derivatives_of_random_rigs_are_those_of_finite_differences():
    rows = [row for row in design_slopes.run(2, 3) if row["same_shape"]]
    assert rows
    for row in rows:
        compared = {name: own for name, own in row.items() if isinstance(own, dict)}
        assert len(compared) >= 14
        for name, own in compared.items():
            assert own["difference"] < 1e-5 + 3 * own["doubt"], name


@pytest.mark.parametrize("name", design_slopes.MEASURES)
def test_derivatives_are_those_of_finite_differences(name, response, moved):
    function = design_slopes.MEASURES[name]
    value, slopes = response.slopes(function)
    found = [float(function(each)) for each in moved]
    whole, half = (
        (a - b) / (2 * step) for a, b, step in zip(found[::2], found[1::2], STEPS, strict=True)
    )
    finite = half + (half - whole) / 3
    # Next to touches a force has corners, over which a step goes.
    near = 2e-3 if "force" in name and "mean" in name else 2e-5
    assert slopes["gap"] == pytest.approx(finite, rel=near, abs=1e-4 * abs(value))


@pytest.fixture(scope="module")
def moved():
    return [respond(gap=GAP + way * step) for step in STEPS for way in (1, -1)]


def test_measures_are_those_of_the_sweep(response, sweep):
    data = sweep.to_xarray()
    upper = data.amplitude_ratio.max("direction")
    assert response.peak() == pytest.approx(float(upper.max()), rel=1e-2)
    assert response.at("amplitude_ratio", 1.1) == pytest.approx(
        float(upper.sel(frequency_ratio=1.1, method="nearest")), rel=1e-6
    )
    lower = data.amplitude_ratio.min("direction")
    assert response.at("amplitude_ratio", 1.2, of="lower") == pytest.approx(
        float(lower.sel(frequency_ratio=1.2, method="nearest")), rel=1e-6
    )
    assert response.fold_frequency() == pytest.approx(float(sweep.jump_down), rel=1e-4)
    assert response.fold_frequency(0) == pytest.approx(float(sweep.jump_up), rel=1e-4)
    width = response.fold_frequency() - response.fold_frequency(0)
    assert response.hysteresis_width() == pytest.approx(width, rel=1e-9)
    x = data.frequency_ratio.values
    assert response.area() == pytest.approx(np.trapezoid(upper, x), rel=1e-2)
    assert response.mean() == pytest.approx(response.area() / 0.7)
    above = np.mean(upper.values >= 12.0) * 0.7
    assert response.bandwidth(12.0) == pytest.approx(above, abs=6e-3)
    assert response.resonance_shift() == pytest.approx(response.peak_frequency() - 1.0)


def test_a_stable_part_between_a_fold_and_a_touch_counts(response):
    """They are so close that no point of the branch lies between them."""
    low, high = sorted(response.branch.folds)
    assert [touch - low for touch in response.branch.grazings if touch > low] == [
        pytest.approx(6.6e-5, rel=1e-2)
    ]
    upper, lower = pieces_of(response.known)
    assert upper.high == pytest.approx(high, rel=1e-12)
    assert lower.low == pytest.approx(low, rel=1e-12)


def test_a_branch_says_which_rig_it_is_of(response):
    assert response.branch.attributes["rig"] == recipe(rig())


def test_impulse_is_what_the_history_says(response):
    motion = vj.periodic_response(rig(), frequency_ratio=1.1)
    contacts = motion.history().contacts()
    at = response.at("impulse", 1.1)
    assert at == pytest.approx(float(np.sum(contacts.impulse)), rel=1e-6)


def test_functions_of_measures_are_differentiated(response):
    value, slopes = response.slopes(lambda r: jnp.log(r.peak() / r.numbers["gap"]))
    whole, by_number = response.slopes(lambda r: r.peak())
    assert value == pytest.approx(np.log(whole / 4e-4))
    assert slopes["gap"] == pytest.approx(by_number["gap"] / whole - 1 / 4e-4)
    # A level that depends on the rig moves with it.
    half, moved = response.slopes(lambda r: r.bandwidth(r.peak() / jnp.sqrt(2.0)))
    width, by_gap = response.slopes(lambda r: r.half_power_bandwidth())
    assert (half, moved["gap"]) == pytest.approx((width, by_gap["gap"]), rel=1e-9)


def test_what_there_is_not_is_said(response):
    with pytest.raises(ValueError, match="no number 7"):
        response.fold_frequency(7)
    with pytest.raises(NoSuchPlace, match="no stable motion at 2"):
        response.at("amplitude_ratio", 2.0)
    with pytest.raises(ValueError, match="mean_power needs a Harvester"):
        response.peak("mean_power")
    with pytest.raises(ValueError, match="Unknown variable 'speed'"):
        response.peak("speed")
    with pytest.raises(ValueError, match="'upper' or 'lower'"):
        response.at("contact_force", 1.1, of="middle")
    with pytest.raises(ValueError, match="must return one number"):
        response.slopes(lambda r: jnp.ones(3))
    with pytest.raises(ValueError, match=r"without float\(\)"):
        response.slopes(lambda r: float(r.peak()))
    with pytest.raises(ValueError, match="low must be below high"):
        response.area(low=1.2, high=1.1)


def test_without_a_fold_there_is_no_hysteresis():
    quiet = respond(stiffness=50.0)
    assert quiet.slopes(lambda r: r.hysteresis_width()) == (0.0, {"gap": 0.0})
    with pytest.raises(NoSuchPlace, match="0 folds"):
        quiet.fold_frequency()


def test_rigs_that_have_no_measures_are_refused():
    def hertz(gap):
        stop = vj.Stop(0.5, gap, vj.Hertz(1e7))
        return vj.ImpactingBeam(vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0), stop, num_modes=1)

    with pytest.raises(ValueError, match="stops that are linear"):
        vj.design.respond(hertz, gap=1e-3, frequency_ratio=RANGE)
    with pytest.raises(ValueError, match="at least one number"):
        vj.design.respond(vj.default_rig, num_modes=1, frequency_ratio=RANGE)
    with pytest.raises(ValueError, match="damping of every mode, in contact too"):
        vj.design.respond(vj.default_rig, damping_ratio=0.0, num_modes=1, frequency_ratio=RANGE)


def test_a_design_by_gradient():
    """Force and amplitude both fall as the gap grows: the best design is where the bound is met."""
    best = vj.optimise(
        rig,
        lambda r: r.peak("contact_force"),
        variables={"gap": (3e-4, 6e-4)},
        constraints=[vj.design.Constraint(lambda r: r.peak(), least=42.5, name="amplitude")],
        frequency_ratio=RANGE,
        settings=vj.design.OptimiseSettings(starts=1, screened=4),
        stiffness=5500.0,
    )
    assert best.status in ("converged", "kink")
    assert best.constraints["amplitude"] == pytest.approx(42.5, abs=1e-4)
    assert best.value == pytest.approx(respond(best.numbers["gap"]).peak("contact_force"), rel=1e-9)
    history = best.history
    allowed = history.value[history.constraints[:, 0] >= 42.5]
    assert best.value <= allowed.min() + 1e-9


def test_the_band_of_a_tolerance(response):
    tolerance = {"gap": vj.design.Tolerance(1e-6)}
    band = vj.design.band(lambda gap=GAP: rig(gap), tolerance, frequency_ratio=RANGE)
    branch = vj.continue_response(rig(), frequency_ratio=RANGE)
    x, y = band.frequency_ratio.values, band.amplitude_ratio.values
    np.testing.assert_allclose(x, branch.values)
    k = int(np.argmin(np.abs(x[: len(x) // 2] - 1.15)))
    slope = np.gradient(y[k - 1 : k + 2], x[k - 1 : k + 2])[1]
    change = band.amplitude_ratio_change[0, k] - slope * band.frequency_change[0, k]
    _, by_gap = response.slopes(lambda r: r.at("amplitude_ratio", float(x[k])))
    assert float(change) == pytest.approx(1e-6 * by_gap["gap"], rel=2e-2)
    assert branch.plot(band=band).axes[0].get_legend_handles_labels()[1]
    with pytest.raises(ValueError, match="band must be one"):
        branch.plot("leading_multiplier", band=band)


def test_a_propagated_gap():
    import scipy.stats

    branches = []

    def force(response):
        branches.append(response.branch)
        return response.peak("contact_force")

    found = vj.propagate(
        rig,
        {"gap": scipy.stats.norm(4e-4, 2e-6)},
        {"contact_force": force},
        frequency_ratio=RANGE,
        settings=vj.design.PropagationSettings(samples=8),
    )
    assert found.deviation[0] == pytest.approx(found.first_order_deviation[0], rel=0.2)
    # Of rigs side by side the first is described, and each says in what it differs.
    gaps = [branch.labels["gap"] for branch in branches if branch.labels]
    assert sorted(gaps) == sorted(found.samples[:, 0])
