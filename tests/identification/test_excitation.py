"""The excitation as measured: a drive at every point, phases, points that no sweep reaches."""

import dataclasses

import jax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.identification.as_measured import (
    channels_of,
    deviations_of,
    drive_levels,
    drive_of_rig,
    sensor_of,
)
from vibrojax.identification.curve_misfit import CurveMisfit
from vibrojax.identification.findings import early_jumps
from vibrojax.identification.sensor import Sensor, seen_back, seen_from
from vibrojax.identification.trial_rigs import (
    Curve,
    Maker,
    free_and_touching,
    frequency_path,
    observe_points,
    together,
)
from vibrojax.model.systems import as_arrays

TRUTH = {"stiffness": 5500.0, "damping": 2.0}
WHICH = np.zeros(1, int)
BASE = 2e-4
SEEN = dict(is_ratio=False, amplitude_deviation=[1e-5])


@pytest.fixture(scope="module")
def make(rig):
    def make(stiffness=5500.0, damping=2.0, drive=BASE):
        made = rig(stiffness=stiffness, damping=damping, num_modes=1)
        return dataclasses.replace(made, drive=vj.BaseMotion(drive))

    return make


def true_curve(make, drive, **about):
    """The curve of the true rig at some drives, stable and unstable, as the sensor sees it."""
    size = len(drive)
    blank = vj.io.MeasuredCurve(
        np.linspace(0.9, 1.45, size),
        "frequency_ratio",
        np.ones(size),
        drive_amplitude=drive,
        **about,
    )
    misfit = CurveMisfit(Maker(make, tuple(TRUTH), {}, {}), [blank])
    misfit.levels = np.unique(drive)
    return misfit.curves(misfit.lanes(np.array([list(TRUTH.values())])).made)[0]


def wandering(make, seed=0, points=70):
    """Points measured while the drive fell by a fifth with the response, and noise of 2 %."""
    curve = true_curve(make, BASE * np.linspace(0.8, 1.0, 17), is_ratio=False)
    amplitude = curve.channels[:, 0]
    wanted = BASE * (1 - 0.2 * amplitude / amplitude.max())
    near = np.flatnonzero(np.abs(np.log(curve.drive / wanted)) < 0.013)
    rng = np.random.default_rng(seed)
    at = np.sort(rng.choice(near, points, replace=False))
    deviation = np.hypot(0.02 * amplitude[at], 1e-5)
    return vj.io.MeasuredCurve(
        curve.frequency[at],
        "frequency_ratio",
        np.abs(amplitude[at] + deviation * rng.standard_normal(points)),
        deviation,
        is_ratio=False,
        drive_amplitude=curve.drive[at],
        drive_signal="displacement",
    )


@pytest.mark.slow
def test_a_drive_that_wanders_biases_nothing_where_it_is_known(make):
    data = wandering(make)
    assert np.ptp(data.drive_amplitude) > 0.14 * BASE
    guess = dict(stiffness=4000.0, damping=1.0)
    fit = vj.identify(make, data, guess, drive=1.0)  # the rig's own drive is not used
    for name, true in TRUTH.items():
        assert fit.interval[name][0] < true < fit.interval[name][1]
    assert fit.estimate["stiffness"] == pytest.approx(5500, rel=0.03)
    assert fit.estimate["damping"] == pytest.approx(2.0, rel=0.15)
    assert all("num_modes=1" in warning for warning in fit.warnings)
    assert any("at the drive that was measured there" in note for note in fit.notes)
    shown = fit.predictions[0]
    np.testing.assert_allclose(shown["fitted_amplitude"], data.amplitude, rtol=0.12)
    labels = [line.get_label() for line in fit.plot().axes[0].lines]
    assert "fitted, at the drive of each point" in labels
    assert fit.what_next("damping").best.deviation < 1
    ignored = vj.identify(
        make, dataclasses.replace(data, drive_amplitude=None), guess, drive=0.93 * BASE
    )
    assert ignored.interval["damping"][0] > 2.2
    assert ignored.reduced_chi_square > 1.3


@pytest.mark.slow
@pytest.mark.long
def test_ratios_are_over_the_drive_of_their_point(make):
    data = wandering(make)
    ratio = dataclasses.replace(
        data,
        amplitude=data.amplitude / data.drive_amplitude,
        amplitude_deviation=data.amplitude_deviation / data.drive_amplitude,
        is_ratio=True,
    )
    residuals = []
    for one in (data, ratio):
        misfit = CurveMisfit(Maker(make, tuple(TRUTH), {}, {}), [one])
        values = np.array([list(TRUTH.values())])
        residuals.append(misfit.residuals(values, WHICH, 1e-3, precisely=True)[0][0])
        free = misfit.without_contact(values, 0)
        assert np.isfinite(free).all()
    assert residuals[0] @ residuals[0] < 1.3 * data.size
    # But next to a touch, where the curve has a corner.
    assert np.mean(np.abs(residuals[0] - residuals[1]) < 1e-4) > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("signal", [pytest.param("force", marks=pytest.mark.long), "acceleration"])
def test_other_drives_than_a_displacement(rig, signal):
    """A force, and an acceleration of the base that stays the same while its displacement falls."""
    drive = vj.PointForce(0.05) if signal == "force" else vj.BaseMotion(BASE)
    usual = 0.05 if signal == "force" else 0.8  # N, m/s2

    def make(stiffness=5500.0, damping=2.0):
        made = rig(stiffness=stiffness, damping=damping, num_modes=1)
        return dataclasses.replace(made, drive=drive)

    unit = float(make().equations().angular_frequency[0]) / (2 * np.pi)
    size = 30
    blank = vj.io.MeasuredCurve(
        unit * np.linspace(0.9, 1.3, size),
        "frequency",
        drive_amplitude=[usual],
        drive_signal=signal,
        amplitude=np.ones(size),
        **SEEN,
    )
    misfit = CurveMisfit(Maker(make, tuple(TRUTH), {}, {}), [blank])
    misfit.unit = unit
    values = np.array([list(TRUTH.values())])
    (curve,) = misfit.curves(misfit.lanes(values).made)
    at = np.linspace(2, len(curve.frequency) - 3, size).astype(int)
    data = dataclasses.replace(
        blank, frequency=curve.frequency[at], amplitude=curve.channels[at, 0]
    )
    misfit = CurveMisfit(Maker(make, tuple(TRUTH), {}, {}), [data])
    misfit.unit = unit
    residual, _ = misfit.residuals(values, WHICH, 1e-3, precisely=True)
    assert np.abs(residual).max() < 1e-3
    if signal == "acceleration":  # where sweeps at this acceleration settle
        motion = drive_of_rig(data)
        assert motion[0] / motion[-1] == pytest.approx(
            (data.frequency[-1] / data.frequency[0]) ** 2
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    "quantity", ["first_harmonic", pytest.param("peak", marks=pytest.mark.long)]
)
def test_the_derivative_with_a_drive_per_point_and_phases(rig, quantity):
    def make(stiffness=5500.0, damping=2.0):
        return rig(stiffness=stiffness, damping=damping, num_modes=1)

    levels = BASE * np.array([0.9, 0.93, 1.0])
    curve = true_curve(make, levels, quantity=quantity, phase=np.zeros(3), is_ratio=True)
    # Away from touches, where the least residual has a corner.
    smooth = np.flatnonzero((curve.channels[:, 0] > 8.5) & (curve.frequency > 0.95))
    at, rng = smooth[:: len(smooth) // 24], np.random.default_rng(1)
    phase = curve.channels[at, 1] + 0.02 * rng.standard_normal(len(at))
    phase[3] = np.nan
    data = vj.io.MeasuredCurve(
        curve.frequency[at],
        "frequency_ratio",
        curve.channels[at, 0] * (1 + 0.02 * rng.standard_normal(len(at))),
        [0.3],
        quantity=quantity,
        phase=phase,
        phase_deviation=[0.02],
        drive_amplitude=curve.drive[at] * (1 + 0.005 * rng.standard_normal(len(at))),
    )
    misfit = CurveMisfit(Maker(make, tuple(TRUTH), {}, {}), [data])

    def both(numbers):
        residual, slope = misfit.residuals(numbers[None], WHICH, 1e-3, precisely=True)
        return residual.reshape(data.size, 3), slope.reshape(data.size, 3, 2)

    def squares(numbers):
        return np.sum(both(numbers)[0] ** 2, axis=1)

    at = np.array([5300.0, 1.8])
    residual, slope = both(at)
    assert residual[3, 2] == 0  # no phase
    derivative = 2 * np.einsum("pc,pcn->pn", residual, slope)
    for k, step in enumerate((2.5, 5e-4)):
        way = np.eye(2)[k] * step

        def central(h, way=way, step=step):
            return (squares(at + h * way) - squares(at - h * way)) / (2 * h * step)

        richardson = (4 * central(1.0) - central(2.0)) / 3
        off = np.sort(np.abs(derivative[:, k] - richardson)) / np.abs(richardson).max()
        assert off[-4] < 1e-6
        assert off[-1] < 1e-3  # where a step changes what touches


@pytest.mark.slow
@pytest.mark.long
def test_a_whole_curve_with_its_unstable_part_and_phases(rig):
    """As held by stepped phase: exact motions, in their order, of no sweep."""

    def make(stiffness=5500.0, damping=2.0):
        return rig(stiffness=stiffness, damping=damping, num_modes=1)

    branch = vj.continue_response(make(), frequency_ratio=vj.Range(0.9, 1.4)).to_xarray()
    along = branch["arclength"].values
    at = np.unique(
        np.interp(np.linspace(0, along[-1], 40), along, np.arange(len(along))).astype(int)
    )
    assert 8 < np.sum(branch["stable"].values[at] == 0) < len(at) - 8
    frequency = branch["frequency_ratio"].values[at]
    response = []
    for ratio, state in zip(frequency, branch["initial_state"].values[at], strict=True):
        run = vj.simulate(
            make(), frequency_ratio=float(ratio), initial_state=state, periods=1, samples=128
        )
        turn = np.exp(-2j * np.pi * np.arange(128) / 128)
        # Of y = Re(c exp(i w t)), over a drive that is a sine.
        response.append(1j * 2 / 128 * np.sum(np.asarray(run.displacement())[:128] * turn) / BASE)
    amplitude = np.abs(response)
    np.testing.assert_allclose(amplitude, branch["first_harmonic_ratio"].values[at], rtol=2e-3)
    deviation, rng = np.hypot(0.02 * amplitude, 0.05), np.random.default_rng(0)
    noise = rng.standard_normal((2, len(at)))
    noisy = np.array(response) + deviation * (noise[0] + 1j * noise[1])
    held = vj.io.MeasuredCurve(frequency, "frequency_ratio", noisy, deviation)
    assert held.noise().sentence is None
    guess = dict(stiffness=4000.0, damping=1.0)
    whole, stable = (
        vj.identify(
            make,
            dataclasses.replace(held, **{n: getattr(held, n)[kept] for n in ARRAYS}),
            guess,
        )
        for kept in (np.ones(len(at), bool), branch["stable"].values[at] == 1)
    )
    for fit in (whole, stable):
        for name, true in TRUTH.items():
            assert fit.interval[name][0] < true < fit.interval[name][1]
        assert 0.5 < fit.reduced_chi_square < 1.4
    assert whole.degrees_of_freedom == 2 * len(at) - 2
    assert whole.standard_deviation["stiffness"] < stable.standard_deviation["stiffness"]
    without = vj.identify(make, dataclasses.replace(held, phase=None), guess)
    assert whole.standard_deviation["damping"] < without.standard_deviation["damping"]
    assert whole.what_next("damping").best.deviation < 1
    assert np.ptp(whole.predictions[0]["curve_phase"].values) < np.pi
    assert len(whole.plot().axes) == len(without.plot().axes) + 1


ARRAYS = ("frequency", "amplitude", "amplitude_deviation", "phase", "direction", "lines")


@pytest.mark.parametrize(
    ("drive", "signal", "absolute"),
    [
        (vj.BaseMotion(BASE), "displacement", True),
        (vj.BaseMotion(BASE), "velocity", False),
        (vj.BaseMotion(BASE), "acceleration", True),
        (vj.PointForce(0.01), "velocity", False),
    ],
)
def test_phases_lead_the_drive(rig, drive, signal, absolute):
    """Beside one mode in closed form."""
    system = dataclasses.replace(rig(num_modes=1, gap=1.0), drive=drive)
    equations = system.equations()
    natural, zeta = float(equations.angular_frequency[0]), 0.018
    gain = float(equations.input_map[0] * equations.response_map[0])
    w = 1.3 * natural
    entered = BASE * w**2 if isinstance(drive, vj.BaseMotion) else 0.01
    moved = gain * entered / (natural**2 - w**2 + 2j * zeta * natural * w)
    order = ("displacement", "velocity", "acceleration").index(signal)
    wanted = (moved + absolute * BASE) * (1j * w) ** order
    sensor = Sensor("first_harmonic", signal, False, absolute, with_phase=True)
    path = jax.tree.map(lambda a: np.asarray(a)[None], frequency_path(as_arrays(system), True))
    with jax.disable_jit():
        depth, _ = free_and_touching(path, np.array([1.3]))
        (seen,) = np.asarray(observe_points(path, sensor, depth, np.array([1.3])))
    np.testing.assert_allclose(seen, [abs(wanted), np.angle(wanted)], rtol=1e-9)


def test_a_phase_is_ahead_of_what_the_drive_was_measured_as():
    frequency, response = np.array([8.0, 9.0]), np.array([1 + 1j, -2j])
    for order, signal in enumerate(("displacement", "velocity", "acceleration")):
        # The same motion beside a drive that leads the displacement by a quarter turn an order.
        curve = vj.io.MeasuredCurve(
            frequency, "frequency", response * (-1j) ** order, drive_signal=signal, **SEEN
        )
        channels = channels_of(curve)
        np.testing.assert_allclose(np.exp(1j * channels[:, 1]), response / np.abs(response))
        np.testing.assert_allclose(deviations_of(curve), 1e-5)
    both = vj.io.MeasuredCurve(
        frequency, "frequency", response * 1j, drive_amplitude=np.array([3j, 2j]), **SEEN
    )
    np.testing.assert_allclose(both.phase, np.angle(response))
    np.testing.assert_allclose(both.drive_amplitude, [3, 2])


@pytest.mark.parametrize("quantity", ["first_harmonic", "rms"])
def test_channels_are_turned_by_the_phase_and_back(quantity):
    curve = vj.io.MeasuredCurve(
        [1.0, 1.1], "frequency_ratio", [2.0, 3.0], quantity=quantity, phase=[3.0, np.nan]
    )
    sensor = sensor_of(curve)
    phase, other = np.array([3.0, -3.0]), np.array([[2.0, -3.1], [3.0, 3.0]])
    seen = seen_from(sensor, other, phase)
    turned = other[:, 1] - phase + [2 * np.pi, -2 * np.pi]
    pair = [np.cos(turned), np.sin(turned)] * other[:, 0] if sensor.is_complex else None
    wanted = np.transpose(pair) if sensor.is_complex else np.stack([other[:, 0], turned], axis=1)
    np.testing.assert_allclose(seen, wanted)
    back = seen_back(sensor, seen, phase)
    np.testing.assert_allclose(np.exp(1j * back[:, 1]), np.exp(1j * other[:, 1]))
    np.testing.assert_allclose(seen_from(sensor, other, phase * np.nan), other * [1, 0])
    assert np.isinf(deviations_of(curve)[1, 1])


def test_a_drive_level_is_near_every_drive():
    drive = BASE * np.exp(np.random.default_rng(0).uniform(-0.15, 0.15, (2, 40)))
    levels = drive_levels(drive)
    assert len(levels) <= 11
    assert np.abs(np.log(drive[..., None] / levels)).min(axis=-1).max() <= 0.016
    np.testing.assert_allclose(drive_levels(np.full((1, 5), BASE)), [BASE])
    assert len(drive_levels(np.array([[1.0, 100.0]]))) == 2


def test_a_jump_is_judged_at_the_drive_before_it(make):
    """A sweep that jumped early for the usual drive did not for its own, which was less."""
    ratio = np.linspace(1.0, 1.2, 21)
    amplitude = np.where(ratio < 1.105, 10.0, 3.0) * (1 + 0.001 * np.cos(40 * ratio))
    curve = vj.io.MeasuredCurve(
        ratio, "frequency_ratio", amplitude, direction=np.ones(21), drive_amplitude=[0.8 * BASE]
    )

    def folded(at):
        frequency = np.array([1.0, at, 1.09, 1.3])
        channels, joined = np.ones((4, 1)), np.array([True, True, True, False])
        return Curve(frequency, channels, channels, joined)

    both = together([folded(1.11), folded(1.16)], BASE * np.array([0.8, 1.0]))
    assert early_jumps(curve, both, 1.0, 2e-3) == []
    usual = dataclasses.replace(curve, drive_amplitude=None)
    assert "5 points before the fold at 1.16" in early_jumps(usual, folded(1.16), 1.0, 2e-3)[0]


@pytest.mark.parametrize(
    ("parts", "unstable"),
    [
        ([[1.0, 1.1, 1.2, 1.1, 1.3]], [0, 0, 1, 0, 0]),
        # The range ends between the folds: down to the lower one and back, then up from below.
        ([[1.3, 1.2, 1.1, 1.2, 1.3], [1.0, 1.1, 1.3]], [0, 0, 1, 1, 1, 0, 0, 0]),
        ([[1.0, 1.1, 1.3], [1.3, 1.2, 1.1, 1.2, 1.3]], [0, 0, 0, 0, 0, 1, 1, 1]),
        # It begins between them.
        ([[1.0, 1.1, 1.2, 1.1, 1.0], [1.0, 1.2, 1.3]], [0, 0, 1, 1, 1, 0, 0, 0]),
        # A part is missing on the way back.
        ([[1.0, 1.1, 1.2, 1.15], [1.1, 1.05, 1.3]], [0, 0, 1, 1, 1, 0, 0]),
    ],
)
def test_what_is_unstable_of_a_traced_curve(parts, unstable):
    frequency = np.concatenate(parts)
    joined = np.concatenate([[True] * (len(part) - 1) + [False] for part in parts])
    curve = Curve(frequency, frequency[:, None], frequency[:, None], joined)
    assert curve.unstable.astype(int).tolist() == unstable


REFUSED = [
    (dict(drive_amplitude=[1.0], drive_signal="force"), {}, "but the base moves the system"),
    (dict(drive_signal="force"), {}, "but the base moves the system"),
    (dict(drive_amplitude=[BASE]), dict(objective="folds"), "Use objective='distance'"),
]


@pytest.mark.parametrize(("about", "how", "sentence"), REFUSED)
def test_drives_that_do_not_go_with_the_rig_are_refused(make, about, how, sentence):
    data = vj.io.MeasuredCurve(np.linspace(0.9, 1.3, 9), "frequency_ratio", np.ones(9), **about)
    with pytest.raises(ValueError, match=sentence):
        vj.identify(make, data, dict(stiffness=4000.0), **how)


def test_curves_fitted_one_by_one_are_alike(make):
    data = vj.io.MeasuredCurve(np.linspace(0.9, 1.3, 9), "frequency_ratio", np.ones(9))
    driven = dataclasses.replace(data, drive_amplitude=[BASE])
    with pytest.raises(ValueError, match="the same quantities, phase and drive"):
        vj.identify(make, [data, driven], dict(stiffness=4000.0), together=False)


@pytest.mark.slow
def test_a_number_that_only_drives_is_not_fitted_to_a_measured_drive(make):
    data = vj.io.MeasuredCurve(np.linspace(0.9, 1.3, 9), "frequency_ratio", np.ones(9))
    driven = dataclasses.replace(data, drive_amplitude=[BASE])
    with pytest.raises(ValueError, match="drive changes nothing but the drive of the system"):
        vj.identify(make, driven, dict(stiffness=4000.0, drive=BASE))
