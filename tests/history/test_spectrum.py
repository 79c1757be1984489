"""Spectra: what a sine, noise and a transient show in every scaling, names of lines, refusals."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import periodogram

import vibrojax as vj
from vibrojax.history.history_spectrum import folded_share
from vibrojax.history.spectrum import name_frequency, spectrum_of

RATE = 512.0
WINDOWS = ("hann", "flattop", "boxcar", "hamming", "blackmanharris")


def sine(amplitude=3.0, frequency=32.0, seconds=8.0):
    return amplitude * np.sin(2 * np.pi * frequency * np.arange(int(seconds * RATE)) / RATE + 0.4)


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("segment", [None, 2.0])
def test_a_sine_shows_its_amplitude_in_every_scaling(window, segment):
    found = {
        scaling: spectrum_of(sine(), RATE, window=window, segment=segment, scaling=scaling)
        for scaling in ("peak", "rms", "power", "density", "energy_density")
    }
    at = int(np.argmax(found["peak"].amplitude))
    value = {scaling: spectrum.amplitude[at] for scaling, spectrum in found.items()}
    length, bandwidth = segment or 8.0, found["peak"].noise_bandwidth
    assert found["peak"].frequency[at] == 32.0
    assert found["peak"].resolution == pytest.approx(1 / length)
    assert value["peak"] == pytest.approx(3.0, rel=1e-9)
    assert value["rms"] == pytest.approx(3.0 / np.sqrt(2), rel=1e-9)
    assert value["power"] == pytest.approx(4.5, rel=1e-9)
    assert value["density"] == pytest.approx(4.5 / bandwidth, rel=1e-9)
    assert value["energy_density"] == pytest.approx(4.5 / bandwidth * length, rel=1e-9)


def test_noise_bandwidths_are_those_of_the_windows():
    # Harris 1978, table 1; flattop: scipy's is the one of D'Antona and Ferrero 2006.
    for window, lines in (("boxcar", 1.0), ("hann", 1.5), ("hamming", 1.36), ("flattop", 3.77)):
        spectrum = spectrum_of(sine(), RATE, window=window)
        assert spectrum.noise_bandwidth / spectrum.resolution == pytest.approx(lines, rel=3e-3)


def test_density_integrates_to_the_mean_square():
    noise = np.random.default_rng(1).normal(size=2**14)
    spectrum = spectrum_of(noise, RATE, window="boxcar", scaling="density")
    total = np.sum(spectrum.amplitude) * spectrum.resolution
    assert total == pytest.approx(np.mean(noise**2), rel=1e-12)
    averaged = spectrum_of(noise, RATE, segment=1.0, scaling="density")
    assert np.sum(averaged.amplitude) == pytest.approx(np.mean(noise**2), rel=0.03)


def test_averages_reduce_the_variance_of_noise():
    noise = np.random.default_rng(2).normal(size=2**17)
    spread = {}
    for averages in (1, 4, 16):
        spectrum = spectrum_of(
            noise, RATE, segment=16.0, overlap=0.0, averages=averages, scaling="density"
        )
        assert spectrum.averages == averages
        inner = spectrum.amplitude[5:-5]
        spread[averages] = np.var(inner) / np.mean(inner) ** 2
        assert spread[averages] == pytest.approx(1 / averages, rel=0.1)


def test_the_analyser_of_the_forced_tests():
    """Ledezma-Ramirez et al., sec. 3.1: 30 averages of 2 s, half overlapping, span 800 Hz."""
    values = np.random.default_rng(3).normal(size=2048 * 31)
    settings = {"segment": 2.0, "averages": 30, "span": 800, "quantity": "acceleration"}
    spectrum = spectrum_of(values, 2048, **settings)
    assert (spectrum.averages, spectrum.resolution, spectrum.noise_bandwidth) == (30, 0.5, 0.75)
    assert len(spectrum.frequency) == 1601
    assert spectrum.frequency[-1] == 800.0
    with pytest.raises(ValueError, match=r"averages = 30 .* record of 31 s, got 30\.5 s.* for 29"):
        spectrum_of(values[: 2048 * 61 // 2], 2048, **settings)


def test_energy_density_of_a_decaying_sine():
    rate, decay, frequency = 16384.0, 6.0, 40.0
    time = (np.arange(int(8 * rate)) + 0.5) / rate
    turn = 2 * np.pi * frequency
    values = 2.0 * np.exp(-decay * time) * np.sin(turn * time)
    spectrum = spectrum_of(values, rate, window="boxcar", scaling="energy_density", span=200)
    w = 2 * np.pi * spectrum.frequency
    transform = 2.0 * turn / ((decay + 1j * w) ** 2 + turn**2)
    expected = 2 * np.abs(transform) ** 2  # one-sided
    np.testing.assert_allclose(spectrum.amplitude[1:], expected[1:], rtol=2e-3)
    # All of its energy, whatever the length of the record.
    energy = np.sum(values**2) / rate
    whole = spectrum_of(values, rate, window="boxcar", scaling="energy_density")
    assert np.sum(whole.amplitude) * whole.resolution == pytest.approx(energy, rel=1e-9)


def test_units_and_decibels():
    spectrum = spectrum_of(sine(9.80665), RATE, quantity="acceleration", units="g")
    assert spectrum.units == "g"
    assert np.max(spectrum.amplitude) == pytest.approx(1.0)
    assert np.max(spectrum.decibels()) == pytest.approx(0.0, abs=1e-9)
    assert np.max(spectrum.decibels(0.1)) == pytest.approx(20.0)
    power = spectrum_of(sine(9.80665), RATE, quantity="acceleration", units="g", scaling="power")
    assert power.units == "g2"
    assert np.max(power.decibels(0.1)) == pytest.approx(20.0 - 10 * np.log10(2))
    density = spectrum_of(sine(), RATE, quantity="velocity", scaling="density")
    assert density.units == "(m/s)2/Hz"
    assert spectrum_of(np.zeros(64), RATE).decibels()[0] == -np.inf
    millimetres = spectrum_of(sine(), RATE, units="mm")
    assert np.max(millimetres.amplitude) == pytest.approx(3000.0)


def test_peaks_are_refined_between_the_lines():
    signal = sine(2.0, 40.11) + sine(0.02, 90.37)
    first, second = spectrum_of(signal, RATE).peaks()
    assert first.frequency == pytest.approx(40.11, abs=0.01)
    assert first.amplitude == pytest.approx(2.0, rel=0.02)
    assert second.frequency == pytest.approx(90.37, abs=0.01)
    assert second.amplitude == pytest.approx(0.02, rel=0.02)
    assert spectrum_of(signal, RATE, scaling="power").peaks(1)[0].amplitude == pytest.approx(
        2.0, rel=0.04
    )
    exact = spectrum_of(sine(), RATE, window="boxcar").peaks()
    assert len(exact) == 1
    assert exact[0].amplitude == pytest.approx(3.0, rel=1e-9)
    assert spectrum_of(np.zeros(64), RATE).peaks() == []


MODES = (15.4, 96.6, 270.6)


@pytest.mark.parametrize(
    ("frequency", "name", "order", "mode", "sideband"),
    [
        (16.0, "drive", 1.0, 1, 0),
        (16.3, "drive", 1.0, 1, 0),
        (48.1, "3 x drive (mode 2, sideband -3)", 3.0, 2, -3),
        (96.0, "6 x drive (mode 2 - 0.6 Hz)", 6.0, 2, 0),
        (112.0, "7 x drive (mode 2, sideband +1)", 7.0, 2, 1),
        (272.1, "17 x drive (mode 3 + 1.4 Hz)", 17.0, 3, 0),
        (176.0, "11 x drive", 11.0, None, None),
        (8.0, "1/2 x drive (mode 1 - 7.4 Hz)", 0.5, 1, 0),
        (40.1, "5/2 x drive", 2.5, None, None),
        (16 * 2.4, "12/5 x drive", 2.4, None, None),
        (97.0, "mode 2", None, 2, 0),
        (113.0, "mode 2 + 1 x drive", None, 2, 1),
        (238.2, "mode 3 - 2 x drive", None, 3, -2),
        (183.0, "-", None, None, None),
    ],
)
def test_names_with_a_drive(frequency, name, order, mode, sideband):
    found = name_frequency(frequency, 1.0, 0.5, 16.0, MODES)
    assert found == (frequency, 1.0, name, order, mode, sideband)


@pytest.mark.parametrize(
    ("frequency", "resolution", "name", "mode"),
    [
        (15.6, 0.3125, "mode 1", 1),
        (30.8, 0.3125, "2 x mode 1", 1),
        (97.5, 0.3125, "mode 2", 2),
        (22.0, 0.3125, "-", None),
        (16.5, 0.3125, "-", None),
        (16.5, 1.0, "mode 1", 1),
        (93.5, 0.5, "6 x mode 1", 1),
        (94.3, 0.5, "mode 2", 2),
        (94.2, 1.0, "6 x mode 1 or mode 2", 1),
    ],
)
def test_names_without_a_drive(frequency, resolution, name, mode):
    found = name_frequency(frequency, 1.0, resolution, None, MODES)
    assert (found.name, found.mode, found.drive_order) == (name, mode, None)


def test_names_without_modes_and_equally_good_ones():
    assert name_frequency(32.0, 1.0, 0.5, 16.0).name == "2 x drive"
    assert name_frequency(33.0, 1.0, 0.5, 16.0).name == "-"
    assert name_frequency(33.0, 1.0, 0.5).name == "-"
    both = name_frequency(56.3, 1.0, 0.5, 16.0, (40.2, 72.5))
    assert both.name == "mode 1 + 1 x drive or mode 2 - 1 x drive"
    assert (both.mode, both.sideband) == (1, 1)


def test_folded_lines_are_known_by_their_acceleration():
    time = np.arange(4096) / RATE
    for frequency, expected in ((60.0, 0.0), (400.0, 1.0)):
        turn = 2 * np.pi * frequency
        displacement = np.sin(turn * time)
        share = folded_share(displacement, displacement, -(turn**2) * displacement, RATE)
        assert share == pytest.approx(expected, abs=1e-3)


@pytest.fixture(scope="module")
def driven(rig):
    # Damped enough to be periodic after 20 periods.
    return vj.simulate(
        rig(damping_ratio=0.06, gap=0.1e-3),
        frequency_ratio=1.1,
        periods=40,
        samples_per_period=256,
        gradient="forward",
    )


def test_the_whole_record_is_the_periodogram(driven):
    time, values = np.asarray(driven.time), np.asarray(driven.displacement())
    late = time >= 2.0
    spectrum = driven.spectrum(start=2, window="flattop")
    rate = 1 / (time[1] - time[0])
    frequency, power = periodogram(
        values[late][:-1], rate, "flattop", detrend=False, scaling="spectrum"
    )
    np.testing.assert_allclose(spectrum.frequency, frequency, rtol=1e-12)
    amplitude = np.sqrt(power * np.where(frequency > 0, 2.0, 1.0))
    np.testing.assert_allclose(spectrum.amplitude, amplitude, rtol=1e-9, atol=1e-18)
    assert spectrum.averages == 1
    assert spectrum.position == 1.0


def test_a_driven_rig_shows_its_harmonics(driven, rig):
    drive = 1.1 * float(vj.modes(rig().beam).frequency[0])
    spectrum = driven.spectrum("acceleration", start=1.9, segment=20 / drive, units="g")
    assert spectrum.drive_frequency == pytest.approx(drive)
    assert spectrum.natural_frequencies == pytest.approx(np.asarray(rig().modes().frequency))
    peaks = spectrum.peaks(8)
    assert peaks[0].name == "drive"
    assert peaks == sorted(peaks, key=lambda peak: -peak.amplitude)
    names = [peak.name for peak in peaks]
    assert {"2 x drive", "3 x drive"} <= set(names)
    assert any(name.startswith("8 x drive (mode 2 + 3.") for name in names)
    force = driven.spectrum("contact_force", 0.5, start=1.9)
    assert (force.units, force.position) == ("N", None)


@pytest.mark.slow
def test_a_release_shows_modes_and_no_drive(rig):
    body = vj.ImpactingBeam(rig().beam, stops=rig().stops, damping_ratio=0.005)
    free = vj.simulate(body, release=-3e-3, periods=30, samples_per_period=256)
    spectrum = free.spectrum("acceleration", scaling="energy_density")
    assert spectrum.drive_frequency is None
    names = [peak.name for peak in spectrum.peaks(20)]
    assert names[0] == "mode 1"
    assert {"2 x mode 1", "mode 2", "mode 3"} <= set(names)


def test_only_a_harmonic_that_moves_something_is_a_drive(driven):
    assert driven.spectrum().drive_frequency is not None
    chirp = eqx.tree_at(lambda h: h.motion.waveform, driven, vj.Chirp(8.0, 12.0, 0.5))
    still = eqx.tree_at(lambda h: h.motion.drive.amplitude, driven, jnp.zeros(()))
    for history in (chirp, still):
        assert history.spectrum().drive_frequency is None


def test_dataset_and_picture(driven, tmp_path):
    spectrum = driven.spectrum("acceleration", start=1.0, segment=1.0, span=400, units="g")
    dataset = spectrum.to_xarray()
    assert dataset["amplitude"].attrs == {
        "units": "g",
        "long_name": "Acceleration, peak amplitude",
    }
    assert dataset["frequency"].attrs["units"] == "Hz"
    assert dataset.attrs["window"] == "hann"
    assert dataset.attrs["averages"] == spectrum.averages
    dataset.to_netcdf(tmp_path / "spectrum.nc", engine="h5netcdf")
    figure = spectrum.plot(span=300, count=6)
    figure.savefig(tmp_path / "spectrum.png")
    (axes,) = figure.axes
    assert axes.get_xlabel() == "Frequency (Hz)"
    assert axes.get_ylabel() == "Acceleration at x/L = 1,\npeak amplitude (g)"
    assert axes.get_yscale() == "log"
    for part in ("hann", "averages of 1 s", "resolution 1 Hz"):
        assert part in axes.get_title("left")
    shown = {text.get_text() for text in axes.texts}
    assert {"mode 1", "mode 2", "mode 3", "1", "6"} <= shown
    assert not {"mode 4", "7"} & shown
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend[0] == "drive frequency, 10.131 Hz"
    assert legend[1].endswith("Hz: drive")
    silent = dataclasses.replace(spectrum, amplitude=0 * spectrum.amplitude, drive_frequency=None)
    assert not silent.plot().legends
    assert "hann" in repr(spectrum)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"quantity": "force"}, "quantity must be one of 'displacement'"),
        ({"scaling": "amplitude"}, "scaling must be one of 'peak', 'rms'"),
        ({"window": "haming"}, "window must be a name .* got 'haming'.*'hamming'"),
        ({"window": "kaiser"}, "window must be a name .* without parameters, got 'kaiser'"),
        ({"units": "mm", "quantity": "acceleration"}, "must be one of 'm/s2', 'g', got 'mm'"),
        ({"segment": 10.0}, r"segment must be above 0 and at most 3\.94\d* s.*got 10\.0.*Simulate"),
        ({"segment": 0.0}, "segment must be above 0"),
        ({"segment": 0.001}, "at least 8 samples, got 3"),
        ({"overlap": 1.0}, r"overlap must be from 0 to below 1, got 1\.0"),
        ({"overlap": -0.1}, "overlap must be"),
        ({"averages": 0}, "averages must be a whole number"),
        ({"averages": 9, "segment": 1.0}, r"averages = 9 .* record of 5\.0\d* s"),
        ({"averages": 2}, "shorter segment"),
        ({"span": 2000.0}, r"span must be above 0 and at most 1296\.\d* Hz.*sampling_rate"),
        ({"span": 0}, "span must be above 0"),
        ({"start": 3.947}, r"start = 3\.947 s leaves \d samples, 9 are needed"),
        ({"position": np.array([0.5, 1.0])}, "position must be one number"),
    ],
)
def test_refusals(driven, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        driven.spectrum(**arguments)


def test_refusals_of_results(driven):
    spectrum = driven.spectrum(span=200)
    with pytest.raises(ValueError, match="span must be above 0 and at most 19"):
        spectrum.up_to(300)
    with pytest.raises(ValueError, match="reference must be above 0"):
        spectrum.decibels(0.0)
    with pytest.raises(ValueError, match="count must be"):
        spectrum.peaks(0)
    with pytest.raises(ValueError, match="prominence must be at least 0 dB"):
        spectrum.peaks(prominence=-1.0)
    with pytest.raises(ValueError, match="count must be"):
        spectrum.plot(count=0)
    with pytest.raises(ValueError, match="rate must be above 0"):
        spectrum_of(sine(), 0.0)


def test_refusals_of_histories(driven, rig):
    diverged = eqx.tree_at(lambda h: h.status, driven, jnp.asarray(vj.Status.diverged.value))
    with pytest.raises(ValueError, match="no spectrum: its status is diverged"):
        diverged.spectrum()
    lanes = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), driven)
    with pytest.raises(ValueError, match=r"lanes of shape \(2,\)\. Take one"):
        lanes.spectrum()
    for read in (lanes.plot, lanes.displacement, lanes.to_xarray):
        with pytest.raises(ValueError, match="quantities needs one history, got lanes of shape"):
            read()
    one = jax.tree.map(lambda leaf: leaf[0], lanes)
    np.testing.assert_array_equal(one.spectrum().amplitude, driven.spectrum().amplitude)


def test_a_history_sampled_too_slowly_is_refused_where_it_folds(driven, rig):
    slow = eqx.tree_at(
        lambda h: (h.time, h.coordinates, h.rates, h.accelerations, h.contact_force),
        driven,
        replace_fn=lambda values: values[::16],
    )
    sentence = r"162\.\d* samples/s and a highest mode of 820\.\d* Hz.*samples_per_period.* 208\."
    for quantity in ("acceleration", "contact_force"):
        with pytest.raises(ValueError, match=sentence):
            slow.spectrum(quantity, start=1.0)
    # Nothing to speak of is above half the rate in the displacement.
    fast = driven.spectrum(start=1.0).up_to(80)
    kept = slow.spectrum(start=1.0).up_to(80)
    assert np.max(kept.amplitude) == pytest.approx(np.max(fast.amplitude), rel=2e-2)
