"""Misfit of measured time histories: zero at the truth, shifts, derivatives and refusals."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.identification.history_misfit import LOST, HistoryMisfit
from vibrojax.identification.trial_rigs import Maker
from vibrojax.measured.history import MeasuredHistory

NAMES = ("stiffness", "gap", "damping_ratio")
TRUE = np.array([5500.0, 0.4e-3, 0.018])
FIXED = {"damping": 5e-5}
DEVIATION = {
    "displacement": 1e-5,
    "velocity": 1e-3,
    "acceleration": 0.5,
    "contact_force": 0.05,
}


def sampled(history, channels, part, position=None):
    signals = {name: np.asarray(history.quantity(name, position))[part] for name in channels}
    return np.asarray(history.time)[part], signals


def settled(channels, *, samples, ratio=1.1, settling=600, position=None, **numbers):
    """The last two drive periods, timed from the start of a drive period."""
    history = vj.simulate(
        vj.default_rig(**numbers),
        frequency_ratio=ratio,
        periods=settling + 2,
        samples_per_period=samples,
        gradient="forward",
    )
    time, signals = sampled(history, channels, slice(-2 * samples - 1, -1), position)
    return time - time[0], signals


def misfit(time, signals, make=vj.default_rig, *, names=NAMES, fixed=FIXED, **facts):
    deviation = {name: DEVIATION[name] for name in signals}
    history = MeasuredHistory(time=time, deviation=deviation, **signals, **facts)
    return HistoryMisfit(Maker(make, names, fixed, {}), [history])


def at(values, target):
    """Residual and derivative of one rig."""
    residual, derivative = target.residuals(
        np.array([values]), np.zeros(1, int), 1.0, precisely=True
    )
    return residual[0], derivative[0]


def differences(target, values=TRUE, step=1e-4):
    rows = values * (1 + step * np.concatenate([np.eye(len(values)), -np.eye(len(values))]))
    residual, _ = target.residuals(rows, np.zeros(len(rows), int), 1.0, precisely=True)
    ahead, behind = np.split(residual, 2)
    return ((ahead - behind) / (2 * step * values[:, None])).T


def check_derivative(target, bound=1e-4):
    _, derivative = at(TRUE, target)
    error = np.abs(derivative - differences(target)).max(axis=0)
    assert (error < bound * np.abs(derivative).max(axis=0)).all()


@pytest.fixture(scope="module")
def shifted():
    """A settled history whose time axis began somewhere, and its shift (s)."""
    time, signals = settled(("displacement", "contact_force"), samples=32)
    # 19 samples are seen before what is time 0 of the drive.
    signals = {name: np.roll(values, 19) for name, values in signals.items()}
    return misfit(time, signals, frequency_ratio=1.1), -19 * time[1]


@pytest.mark.slow
def test_shifted_steady_motion_is_found(shifted):
    target, shift = shifted
    residual, _ = at(TRUE, target)
    period = 32 * shift / -19
    assert target.size == residual.size == 128
    assert np.abs(residual).max() < 1e-5
    np.testing.assert_allclose((target.shifts[0] - shift) / period % 1, 0.0, atol=1e-7)


def test_derivative_follows_the_shift(shifted):
    check_derivative(shifted[0])


def test_nonsense_lane_leaves_its_neighbour_alone(shifted):
    target, _ = shifted
    alone, slope = at(TRUE * 1.01, target)
    values = np.array([[np.nan] * 3, TRUE * 1.01, [np.inf, 0.0, 0.0]])
    residual, derivative = target.residuals(values, np.zeros(3, int), 1.0, precisely=True)
    np.testing.assert_array_equal(residual[1], alone)
    np.testing.assert_array_equal(derivative[1], slope)
    assert (residual[[0, 2]] == LOST).all()
    assert (derivative[[0, 2]] == 0).all()
    assert np.isnan(target.shifts[[0, 2]]).all()


@pytest.mark.slow
@pytest.mark.long  # to compile
def test_steady_motion_without_shift_at_a_place_in_space():
    channels = ("displacement", "velocity", "acceleration")
    time, signals = settled(channels, samples=40, position=0.7)
    rate = float(2 * np.pi * 2 / (time[-1] + time[1]))
    base = 0.2e-3 * np.exp(1j * rate * time)
    for order, name in enumerate(channels):
        signals[name] = signals[name] + (base * (1j * rate) ** order).imag
    target = misfit(
        time, signals, frequency_ratio=1.1, position=0.7, frame="absolute", align_phase=False
    )
    residual, _ = at(TRUE, target)
    assert np.abs(residual).max() < 1e-5
    check_derivative(target)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("start", [0.0, 1e-2])
def test_either_of_two_steady_motions_is_found(start):
    """Between the folds a free motion and one with contact coexist."""
    rig = vj.default_rig()
    history = vj.simulate(
        rig,
        frequency_ratio=1.15,
        periods=302,
        samples_per_period=32,
        initial_state=(rig.static_shape(-start), np.zeros(5)),
        gradient="forward",
    )
    time, signals = sampled(history, ("displacement", "contact_force"), slice(-65, -1))
    target = misfit(time - time[0], signals, frequency_ratio=1.15)
    residual, derivative = at(TRUE, target)
    assert np.abs(residual).max() < 1e-5
    touches = signals["contact_force"].max() > 0
    assert np.any(derivative[:, 0] != 0) == touches


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.0, 2.3e-3])
@pytest.mark.long  # to compile
def test_free_release_against_the_stop(late):
    history = vj.simulate(
        undriven(*TRUE, 5e-5), release=-3e-3, duration=0.3, samples=150, gradient="forward"
    )
    channels = ("displacement", "contact_force")
    time, signals = sampled(history, channels, slice(5, None))
    assert signals["contact_force"].max() > 0.1
    target = misfit(time - late, signals, release=-3e-3, align_phase=late > 0)
    residual, _ = at(TRUE, target)
    assert np.abs(residual).max() < 1e-5
    np.testing.assert_allclose(target.shifts[0], late, atol=1e-9)
    check_derivative(target)


@pytest.mark.slow
@pytest.mark.parametrize("aligned", [False, True])
def test_driven_from_rest(aligned):
    history = vj.simulate(
        vj.default_rig(), frequency_ratio=1.1, periods=8, samples_per_period=32, gradient="forward"
    )
    time, signals = sampled(history, ("displacement", "velocity"), slice(64, None))
    late = 4e-3 if aligned else 0.0
    target = misfit(time - late, signals, frequency_ratio=1.1, settled=False, align_phase=aligned)
    residual, _ = at(TRUE, target)
    assert np.abs(residual).max() < 1e-5
    np.testing.assert_allclose(target.shifts[0], late, atol=1e-9)
    check_derivative(target)


@pytest.mark.slow
@pytest.mark.long
def test_stops_that_are_not_linear():
    """Contact that only the splitting can step, at the splitting's own error."""

    def make(stiffness, gap, damping_ratio):
        rig = vj.default_rig()
        law = vj.KelvinVoigt(stiffness, 5e-5)
        stop = vj.Stop(0.5, gap, law, smoothing=1e-4)
        return vj.ImpactingBeam(rig.beam, (stop,), rig.drive, damping_ratio=damping_ratio)

    history = vj.simulate(
        make(*TRUE), frequency_ratio=1.0, periods=200, samples_per_period=32, tolerance=1e-4
    )
    time, signals = sampled(history, ("displacement",), slice(-33, -1))
    target = misfit(time - time[0], signals, make, fixed={}, frequency_ratio=1.0, align_phase=False)
    residual, _ = at(TRUE, target)
    size = np.abs(signals["displacement"]).max() / DEVIATION["displacement"]
    assert np.abs(residual).max() < 1e-3 * size
    check_derivative(target, 1e-2)


@pytest.mark.slow
def test_a_steady_motion_of_coupled_modes_and_a_hertz_stop():
    """Contact that only the linearly implicit stepper can step, at its own error."""

    def make(stiffness, damping):
        return vj.MatrixSystem(
            np.diag([1.0, 0.5]),
            [[8.0, -0.5], [-0.5, damping]],  # not proportional
            [[3e3, -1e3], [-1e3, 1e3]],
            response_map=[0.0, 1.0],
            stops=vj.Stop(None, 1e-3, vj.Hertz(stiffness)),
            stop_map=[[0.0, 1.0]],
            drive=vj.PointForce(1.0),
            input_map=[1.0, 0.0],
        )

    history = vj.simulate(make(1e7, 1.5), frequency=7.0, periods=80, samples_per_period=32)
    time, signals = sampled(history, ("displacement",), slice(-33, -1))
    assert history.contact_force[-33:].max() > 10.0
    target = misfit(
        time - time[0],
        signals,
        make,
        names=("stiffness", "damping"),
        fixed={},
        frequency=7.0,
        align_phase=False,
    )
    residual, _ = at(np.array([1e7, 1.5]), target)
    assert np.abs(residual).max() < 1e-2 * np.abs(signals["displacement"]).max() / 1e-5


TIME, SIGNALS = np.linspace(0.0, 0.1, 20), {"displacement": np.sin(np.linspace(0.0, 9.0, 20))}


def undriven(stiffness, gap, damping_ratio, damping):
    rig = vj.default_rig(stiffness=stiffness, gap=gap, damping=damping)
    return vj.ImpactingBeam(rig.beam, rig.stops, damping_ratio=damping_ratio)


def masses(stiffness, gap, damping_ratio, damping):
    stop = vj.Stop(None, gap, vj.KelvinVoigt(stiffness, damping))
    one = np.eye(1)
    return vj.MatrixSystem(
        one,
        damping_ratio * one,
        100 * one,
        stops=(stop,),
        stop_map=one,
        drive=vj.BaseMotion(1e-3),
        input_map=np.ones(1),
        response_map=np.ones(1),
        proportional=True,
    )


@pytest.mark.parametrize(
    ("make", "facts", "words"),
    [
        (undriven, {"frequency": 10.0}, "the system has none"),
        (masses, {"frequency": 10.0, "position": 0.5}, "only a beam has positions"),
        (masses, {"release": 1e-3}, "release is for the tip"),
        (vj.default_rig, {"frequency": 10.0, "window": (0.2, 0.3)}, "window must be"),
    ],
)
def test_refusals(make, facts, words):
    with pytest.raises(ValueError, match=words):
        misfit(TIME, SIGNALS, make, **facts)


def test_repetitions_have_the_same_samples():
    whole = MeasuredHistory(time=TIME, frequency=10.0, **SIGNALS)
    part = MeasuredHistory(time=TIME, frequency=10.0, window=(0.0, 0.05), **SIGNALS)
    with pytest.raises(ValueError, match="as many samples"):
        HistoryMisfit(Maker(vj.default_rig, NAMES, FIXED, {}), [whole, part])


@pytest.mark.slow
@pytest.mark.parametrize("between", [False, True])
def test_a_measured_drive(between):
    count, step = 300, 1e-3
    noise = np.random.default_rng(3).standard_normal(count + 1)
    drive = vj.Sampled(step * np.arange(count + 1), 2 * np.cumsum(noise))
    grid = {"samples": 2 * count if between else count, "gradient": "forward"}
    history = vj.simulate(vj.default_rig(), waveform=drive, **grid)
    assert np.max(history.contact_force) > 0
    time, signals = sampled(history, ("displacement", "contact_force"), slice(1, None, 6))
    target = misfit(time, signals, waveform=drive)
    assert target.plan.together != between
    residual, _ = at(TRUE, target)
    assert np.abs(residual).max() < 1e-5
    check_derivative(target)


def test_what_a_measured_drive_goes_with():
    drive = vj.Sampled([0.0, 1.0, 2.0], [0.0, 1.0, 0.0])
    signals = {"displacement": np.zeros(2)}
    with pytest.raises(ValueError, match="Give waveform or frequency, not both"):
        MeasuredHistory(time=np.array([0.0, 1.0]), waveform=drive, frequency=3.0, **signals)
    with pytest.raises(ValueError, match="time must begin with the waveform, at 0 s"):
        MeasuredHistory(time=np.array([-1.0, 1.0]), waveform=drive, **signals)
    with pytest.raises(ValueError, match="The absolute displacement needs that of the base"):
        misfit(np.array([0.0, 1.0]), signals, waveform=drive, frame="absolute")
