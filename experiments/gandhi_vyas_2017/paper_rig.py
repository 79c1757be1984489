"""The rig of Gandhi and Vyas (2017), dimensions assumed: the paper's Table 1 is missing."""

import jax.numpy as jnp
import numpy as np

import vibrojax as vj

FORMULATIONS = ("consistent", "as_printed")
TAPERS = (0.0, 0.25, 0.5, 0.75)
MASS_RATIOS = (0.5, 1.0, 5.0)
SIGMA = 0.2e-3
GAP = 0.4e-3
POSITION = 0.5
STIFFNESS = 5500.0
DAMPING = 5e-5
DAMPING_RATIO = 0.018


def beam(taper: float, mass_ratio: float) -> vj.Cantilever:
    return vj.Cantilever(
        length=0.2,
        width=0.025,
        thickness=1e-3,
        youngs_modulus=130e9,
        density=8250.0,
        taper=taper,
        mass_ratio=mass_ratio,
    )


def rig_of(formulation: str, num_modes: int = 5):
    """Return the function from named numbers to a rig that `frequency_sweep` takes."""

    def rig(
        taper=0.5,
        mass_ratio=0.5,
        gap=GAP,
        position=POSITION,
        stiffness=STIFFNESS,
        damping=DAMPING,
    ):
        return vj.ImpactingBeam(
            beam(taper, mass_ratio),
            stops=vj.Stop(position=position, gap=gap, law=vj.KelvinVoigt(stiffness, damping)),
            drive=vj.BaseMotion(amplitude=SIGMA),
            damping_ratio=DAMPING_RATIO,
            num_modes=num_modes,
            formulation=formulation,
        )

    return rig


def stop_amplitude(formulation: str, ratios: np.ndarray, **numbers: float) -> np.ndarray:
    """Amplitude of the beam at the stop's place (m) as long as it does not touch: closed form."""
    equations = rig_of(formulation)(**numbers).equations()
    free = np.asarray(equations.angular_frequency)
    drive = np.asarray(equations.input_map) * np.asarray(equations.stop_map)[0] * SIGMA
    omega = np.asarray(ratios)[:, None] * free[0]
    receptance = 1 / (free**2 - omega**2 + 2j * DAMPING_RATIO * free * omega)
    return np.abs((drive * omega**2 * receptance).sum(axis=1))


def touch_frequency(formulation: str, **numbers: float) -> float:
    """Highest frequency ratio at which the free response reaches the gap; NaN if it never does.

    Coming down in frequency, the response has to jump up there.
    """
    ratios = np.linspace(0.5, 2.0, 30001)
    reached = stop_amplitude(formulation, ratios, **numbers) >= numbers.get("gap", GAP)
    return float(ratios[np.flatnonzero(reached)[-1]]) if reached.any() else float("nan")


def mode_shapes(taper: float, mass_ratio: float, points: int = 201):
    """Five mode shapes scaled to a largest value of 1, and beta^2."""
    found = vj.modes(beam(taper, mass_ratio), num_modes=5)
    s = jnp.linspace(0, 1, points)
    shapes = np.asarray(found.shape(s))
    return np.asarray(s), shapes / np.abs(shapes).max(axis=0), np.asarray(found.beta) ** 2
