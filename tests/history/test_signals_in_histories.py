"""Histories under signals: samples, contacts, energies, spectra, derivatives, refusals."""

import dataclasses

import jax
import numpy as np
import pytest

import vibrojax as vj

STEP = 1e-3
TIME = STEP * np.arange(301)
ACCELERATION = 5 * np.cumsum(np.random.default_rng(2).standard_normal(301))
SIGNAL = vj.Sampled(TIME, ACCELERATION)


@pytest.fixture(scope="module")
def rig():
    return dataclasses.replace(vj.default_rig(), num_modes=3, drive=vj.BaseMotion())


@pytest.fixture(scope="module")
def history(rig):
    return vj.simulate(rig, waveform=SIGNAL)


def test_samples_are_those_of_the_record(history):
    np.testing.assert_allclose(history.time, TIME, atol=1e-12)
    shown = history.to_xarray()["base_acceleration"]
    np.testing.assert_allclose(shown, ACCELERATION, atol=1e-9)
    assert shown.attrs["units"] == "m/s2"
    assert float(np.max(history.contact_force)) > 0


@pytest.mark.slow
def test_other_samples_of_the_same_motion(rig, history):
    contacts = history.contacts()
    other = vj.simulate(rig, waveform=SIGNAL, samples=117)
    assert len(contacts) > 2
    np.testing.assert_allclose(other.contacts().touch, contacts.touch, rtol=1e-9)
    np.testing.assert_allclose(other.contacts().impulse, contacts.impulse, rtol=1e-7)
    place = vj.simulate(rig, waveform=SIGNAL, samples=100)
    size = np.max(np.abs(history.coordinates), axis=0)
    assert np.max(np.abs(place.coordinates - history.coordinates[::3]) / size) < 1e-10


@pytest.mark.slow
def test_energy_is_accounted_for(history):
    energy = history.energy()
    assert np.max(np.abs(energy.balance)) < 1e-8
    assert energy.input_work[-1] > 0


def test_spectrum_and_picture(history):
    assert history.spectrum(span=400.0).frequency[-1] <= 400.0
    labels = [axes.get_ylabel() for axes in history.plot().axes]
    assert labels[0].split() == ["Base", "acceleration", "(m/s2)"]
    assert len(history.plot("contact_force").axes) == len(labels) - 1  # not once more below


@pytest.mark.slow
def test_one_tone_is_a_harmonic_drive(rig):
    shaken = dataclasses.replace(rig, drive=vj.BaseMotion(3e-3))
    grid = {"duration": 0.5, "samples": 400}
    tone = vj.simulate(shaken, waveform=vj.Tones([11.0]), **grid)
    harmonic = vj.simulate(shaken, frequency=11.0, **grid)
    assert float(np.max(harmonic.contact_force)) > 0
    size = np.max(np.abs(harmonic.coordinates), axis=0)
    assert np.max(np.abs(tone.coordinates - harmonic.coordinates) / size) < 1e-9


@pytest.mark.slow
def test_two_tones_with_contacts_close_their_energy(rig):
    shaken = dataclasses.replace(rig, drive=vj.BaseMotion(1e-3))
    history = vj.simulate(shaken, waveform=vj.Tones([9.0, 17.5], [1.0, 0.5]), duration=1.0)
    assert len(history.contacts()) > 2
    assert np.max(np.abs(history.energy().balance)) < 2e-5


@pytest.mark.slow
def test_lists_are_axes(rig, history):
    def make(gap):
        return dataclasses.replace(rig, stops=(dataclasses.replace(rig.stops[0], gap=gap),))

    histories = vj.simulate(make, waveform=SIGNAL, gap=[2e-4, float(rig.stops[0].gap)])
    difference = np.asarray(histories[1].coordinates - history.coordinates)
    assert np.max(np.abs(difference)) < 1e-12
    assert np.any(np.asarray(histories[0].coordinates) != np.asarray(history.coordinates))


@pytest.mark.slow
@pytest.mark.parametrize("gradient", ["forward", "reverse"])
def test_derivatives_are_those_of_differences(rig, gradient):
    def end(gap, level):
        made = dataclasses.replace(rig, stops=(dataclasses.replace(rig.stops[0], gap=gap),))
        signal = vj.Sampled(TIME[:101], level * ACCELERATION[:101])
        history = vj.simulate(made, waveform=signal, gradient=gradient)
        return history.displacement()[-1], history.contact_force.max()

    where, shift = (4e-4, 2.0), (4e-9, 2e-5)
    derive = jax.jacfwd if gradient == "forward" else jax.jacrev
    found = derive(lambda gap, level: end(gap, level)[0], argnums=(0, 1))(*where)
    assert float(end(*where)[1]) > 0
    for i in range(2):
        low, high = list(where), list(where)
        low[i], high[i] = low[i] - shift[i], high[i] + shift[i]
        expected = (end(*high)[0] - end(*low)[0]) / (2 * shift[i])
        assert float(found[i]) == pytest.approx(float(expected), rel=1e-4)


@pytest.mark.slow
def test_other_laws_follow_the_signal_too(rig):
    import diffrax

    stop = dataclasses.replace(rig.stops[0], law=vj.Hertz(5e5))
    hard = dataclasses.replace(rig, stops=(stop,))
    found = vj.simulate(hard, waveform=SIGNAL)
    expected = vj.simulate(hard, waveform=SIGNAL, stepper=diffrax.Dopri8(), tolerance=1e-9)
    size = float(np.max(np.abs(expected.displacement())))
    assert float(np.max(found.contact_force)) > 0
    assert np.max(np.abs(found.displacement() - expected.displacement())) < 1e-6 * size
    assert np.max(np.abs(found.energy().balance)) < 1e-6


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"waveform": SIGNAL, "periods": 3}, "periods: a Sampled has no period"),
        ({"waveform": vj.Tones([3.0])}, r"Give duration \(s\): a Tones has no end"),
        ({"waveform": SIGNAL, "frequency": 3.0}, "Give one of frequency"),
        ({"waveform": SIGNAL, "duration": 1e9}, "at most 100,000,000 fit"),
    ],
)
def test_what_cannot_be_is_refused(rig, asked, message):
    with pytest.raises(ValueError, match=message):
        vj.simulate(rig, **asked)


def test_no_phase_no_section(history):
    with pytest.raises(ValueError, match="A Sampled has no drive phase"):
        history.poincare()


def half_sine_extremes(frequency, amplitude, duration):
    """Largest and lowest acceleration of an undamped oscillator, from the closed form."""
    w, drive = 2 * np.pi * frequency, np.pi / duration
    time = np.linspace(0.0, duration, 20001)
    factor = amplitude * w**2 / (w**2 - drive**2)
    moved = factor * (np.sin(drive * time) - drive / w * np.sin(w * time))
    speed = factor * drive * (np.cos(np.pi) - np.cos(w * duration))
    after = np.hypot(moved[-1], speed / w)
    return max(moved.max(), after), max((-moved).max(), after)


def test_shock_response_spectrum_of_a_half_sine():
    pulse, frequencies = vj.model.half_sine(100.0, 11e-3), np.geomspace(5, 1500, 25)
    found = vj.history.shock_response_spectrum(pulse, frequencies, damping_ratio=0.0)
    expected = np.array([half_sine_extremes(f, 100.0, 11e-3) for f in frequencies])
    np.testing.assert_allclose(found.positive, expected[:, 0], rtol=1e-5)
    np.testing.assert_allclose(found.negative, expected[:, 1], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(found.maximax, np.max(expected, axis=1), rtol=1e-5)


def test_shock_response_spectrum_of_a_history(rig, history):
    found = vj.history.shock_response_spectrum(history, [1e4])
    # An oscillator so stiff has the acceleration itself: of the base, and of the tip on it.
    absolute = np.asarray(history.acceleration()) + ACCELERATION
    assert found.maximax[0] == pytest.approx(np.max(np.abs(absolute)), rel=0.1)
    assert found.to_xarray()["maximax"].attrs["units"] == "m/s2"
    assert found.plot().axes[0].get_xlabel() == "Natural frequency (Hz)"
    assert found.plot().axes[0].lines[0].get_marker() == "o"  # a line of one point is not seen
