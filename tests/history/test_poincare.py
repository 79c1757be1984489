"""Poincaré sections of constructed motions, and the quantities of a system that is not linear."""

import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.history.poincare import rate_name

FREQUENCY = 3.0


def history_of(equations, system, waveform, q, v, a, time):
    drive = vj.PointForce(1.0)
    run = vj.model.Motion(equations, drive, waveform)
    none = jnp.zeros((len(time), 0))
    status = jnp.asarray(vj.Status.completed.value)
    return vj.history.History(system, run, time, q, v, a, none, none, status)


@pytest.fixture(scope="module")
def oscillator():
    return vj.MatrixSystem(
        [[1.0]], [[0.2]], [[4.0]], drive=vj.PointForce(1.0), input_map=[1.0], response_map=[1.0]
    )


def sine(system, order, waveform, end=4.0, samples=2001):
    """A motion of one cycle in `order` drive periods."""
    time = jnp.linspace(0.0, end, samples)
    phase, rate, second = (part[:, None] for part in waveform.phase(time))
    s, c, w = jnp.sin(phase / order), jnp.cos(phase / order), rate / order
    moved = s, c * w, -s * w**2 + c * second / order
    return history_of(system.equations(), system, waveform, *moved, time)


@pytest.mark.parametrize("waveform", [vj.Harmonic(FREQUENCY), vj.Chirp(2.0, 5.0, 4.0)])
@pytest.mark.parametrize("phase", [0.0, 1.3])
def test_strobes_lie_at_the_drive_phase(oscillator, waveform, phase):
    history = sine(oscillator, 2, waveform)
    section = history.poincare(phase=phase)
    at, rate, _ = waveform.phase(jnp.asarray(section.time))
    away = (np.asarray(at) - phase + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(away, 0.0, atol=1e-9)
    turned = float(waveform.phase(jnp.asarray(4.0))[0])
    assert len(section) == int((turned - phase) / (2 * np.pi) + 1e-9) + 1
    np.testing.assert_allclose(section.values["displacement"], np.sin(at / 2), atol=1e-8)
    np.testing.assert_allclose(
        section.values["velocity"], np.cos(at / 2) * rate / 2, atol=1e-6 * float(np.max(rate))
    )
    np.testing.assert_allclose(section.drive_phase, phase)


def test_crossings_of_a_level(oscillator):
    history = sine(oscillator, 2, vj.Harmonic(FREQUENCY))
    angle = np.arcsin(0.5)
    for direction, at in (
        ("upwards", [angle]),
        ("downwards", [np.pi - angle]),
        ("both", [angle, np.pi - angle]),
    ):
        section = history.poincare("displacement", 0.5, direction, start=1.0)
        turns = np.add.outer(2 * np.pi * np.arange(7), at).ravel() / (np.pi * FREQUENCY)
        expected = turns[(turns >= 1.0) & (turns <= 4.0)]
        np.testing.assert_allclose(section.time, expected, atol=1e-8)
        np.testing.assert_allclose(section.values["displacement"], 0.5, atol=1e-9)
    # Strain energy of the spring of 4 N/m; where it passes 1 J, displacement is +-1/sqrt(2).
    section = history.poincare("strain_energy", 1.0, "upwards")
    np.testing.assert_allclose(np.abs(section.values["displacement"]), np.sqrt(0.5), atol=1e-6)
    assert (section.values["strain_power"] > 0).all()


def test_a_crossing_at_a_sample_counts_once(oscillator):
    history = sine(oscillator, 1, vj.Harmonic(1.0), end=4.0, samples=401)
    assert len(history.poincare("displacement", 0.0, "downwards")) == 4


def test_dataset_and_picture(oscillator, tmp_path):
    section = sine(oscillator, 2, vj.Harmonic(FREQUENCY)).poincare()
    data = section.to_xarray()
    assert data["velocity"].attrs["units"] == "m/s"
    assert data["strain_power"].attrs["units"] == "W"
    assert data["drive_phase"].attrs["units"] == "rad"
    figure = section.plot()
    assert figure.axes[0].get_xlabel() == "Displacement (m)"
    assert figure.axes[0].get_ylabel() == "Velocity (m/s)"
    figure.savefig(tmp_path / "section.png")
    with pytest.raises(ValueError, match="Unknown variable 'speed'"):
        section.plot("speed")
    assert "13 points" in repr(section)


def test_refusals(oscillator):
    history = sine(oscillator, 2, vj.Harmonic(FREQUENCY))
    with pytest.raises(ValueError, match="quantity must be one of"):
        history.poincare("contact_force", 1.0)
    with pytest.raises(ValueError, match="direction must be one of 'upwards'"):
        history.poincare("displacement", 0.0, "up")
    with pytest.raises(ValueError, match="start must be at most 4 s"):
        history.poincare(start=5.0)
    free = vj.MatrixSystem([[1.0]], [[0.2]], [[4.0]], response_map=[1.0])
    with pytest.raises(ValueError, match="Nothing drives this system"):
        sine(free, 2, vj.Harmonic(FREQUENCY)).poincare()


class Swing(vj.model.AbstractEquations):
    """A mass on a rigid rod of 0.5 m: its coordinate is an angle, its place is not linear in it."""

    stops: tuple[vj.Stop, ...] = ()

    @property
    def size(self):
        return 1

    @property
    def coordinate_units(self):
        return "rad"

    def mass(self, q):
        return jnp.ones((1, 1))

    def linear_force(self, q, rate):
        return 2.0 * q

    def smooth_force(self, q, rate):
        return jnp.zeros_like(q)

    def input(self, q):
        return jnp.ones(1)

    def penetration(self, q):
        return jnp.zeros(0)

    def response(self, q):
        return 0.5 * jnp.sin(q[0])

    def observables(self, q):
        seen = {"displacement": self.response(q), "strain_energy": self.strain_energy(q)}
        return seen | {"bearing_angle": q[0], "chord_reduction": 0.5 * (1 - jnp.cos(q[0]))}


@pytest.fixture(scope="module")
def swing(oscillator):
    """q = 0.4 sin(2 pi 3 t), of equations that are not linear."""
    time = jnp.linspace(0.0, 4.0, 2049)
    w = 2 * np.pi * FREQUENCY
    q, v, a = (x[:, None] for x in (jnp.sin(w * time), w * jnp.cos(w * time), 0.0 * time))
    moved = 0.4 * q, 0.4 * v, a - 0.4 * w**2 * q
    return history_of(Swing(), oscillator, vj.Harmonic(FREQUENCY), *moved, time)


def test_quantities_of_what_is_not_linear(swing):
    angle = 0.4 * np.sin(2 * np.pi * FREQUENCY * np.asarray(swing.time))
    np.testing.assert_allclose(swing.displacement(), 0.5 * np.sin(angle), atol=1e-14)
    np.testing.assert_allclose(swing.quantity("bearing_angle"), angle, atol=1e-14)
    np.testing.assert_allclose(
        swing.quantity("chord_reduction"), 0.5 * (1 - np.cos(angle)), atol=1e-14
    )
    np.testing.assert_allclose(swing.quantity("strain_energy"), angle**2, atol=1e-14)
    interval = float(swing.time[1])
    for value, rate in (
        (swing.displacement(), swing.velocity()),
        (swing.velocity(), swing.acceleration()),
        (swing.quantity("strain_energy"), swing.quantity("strain_power")),
    ):
        slope = np.gradient(np.asarray(value), interval)[2:-2]
        np.testing.assert_allclose(slope, rate[2:-2], atol=2e-3 * float(jnp.max(jnp.abs(rate))))


def test_dataset_spectrum_and_picture_of_what_is_not_linear(swing, tmp_path):
    data = swing.to_xarray()
    assert data["coordinates"].dims == ("time", "coordinate")
    assert data["coordinates"].attrs["units"] == "rad"
    assert data["accelerations"].attrs["units"] == "rad/s2"
    units = {"displacement": "m", "bearing_angle": "rad", "chord_reduction": "m"}
    units |= {"strain_energy": "J", "strain_power": "W"}
    assert {name: data[name].attrs["units"] for name in units} == units
    spectrum = swing.spectrum("bearing_angle", window="flattop")
    at = int(np.argmax(spectrum.amplitude))
    assert spectrum.frequency[at] == pytest.approx(FREQUENCY)
    assert spectrum.amplitude[at] == pytest.approx(0.4, rel=1e-3)
    assert spectrum.to_xarray()["amplitude"].attrs["units"] == "rad"
    assert "rad" in spectrum.plot(span=20.0).axes[0].get_ylabel()
    assert swing.spectrum("chord_reduction", units="mm").units == "mm"
    with pytest.raises(
        ValueError, match="Unit of bearing_angle must be one of 'rad', 'deg', got 'm'"
    ):
        swing.spectrum("bearing_angle", units="m")
    figure = swing.plot("bearing_angle")
    assert "(rad)" in figure.axes[0].get_ylabel()
    figure.savefig(tmp_path / "angle.png")
    assert swing.poincare("bearing_angle", 0.0).values[rate_name("bearing_angle")][0] > 0


def test_what_needs_a_linear_body_says_so(swing):
    for read in (swing.contacts, swing.peak, swing.energy):
        with pytest.raises(ValueError, match="linear but for their stops"):
            read()
    with pytest.raises(ValueError, match="Only the history of a beam"):
        swing.displacement(0.5)
    with pytest.raises(ValueError, match="give no position"):
        swing.quantity("bearing_angle", 0.5)
