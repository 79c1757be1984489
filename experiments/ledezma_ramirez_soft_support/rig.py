"""The rig of the paper, what the paper prints about it, and its linear response."""

from collections.abc import Callable

import numpy as np

import vibrojax as vj

GRAVITY = 9.80665
GAP = 4e-3
STIFFNESS = 22e3
DAMPING_RATIO = 0.01
FORCE_POSITION = 0.07 / 0.40
CONTACT_DAMPING = 7.0
"""N s/m, not printed: chosen to give the printed peaks of the 10 mm release."""

RELEASES = [4e-3, 5e-3, 6e-3, 7e-3, 8e-3, 9e-3, 10e-3]
FORCES = [1.6, 3.6, 5.8, 9.8, 11.8, 15.6, 18.6, 22.5, 25.0, 28.8]
FORCE_FREQUENCY = 16.0
RECEPTANCE_FORCES = [2.0, 3.7, 6.7, 10.0, 14.7, 18.0]
"""N rms."""
PRINTED_FREQUENCIES = [15.4, 96.6, 270.6, 530.3, 876.6]
PRINTED = {
    "frequency": {"theory": 15.4, "experiment": 16.0},
    "forced_acceleration": {"theory": 52.0, "experiment": 41.0},
    "forced_force": {"theory": 10.0, "experiment": 9.4},
    "free_acceleration": {"theory": 107.0, "experiment": 95.0},
    "free_force": {"theory": 10.0, "experiment": 25.0},
}
"""Table 2: Hz, g and N."""


def beam(*point_masses: vj.PointMass) -> vj.Cantilever:
    return vj.Cantilever(
        length=0.40,
        width=0.038,
        thickness=0.003,
        youngs_modulus=70e9,
        density=2700.0,
        point_masses=point_masses,
    )


def stopped_by(
    law: vj.model.AbstractContactLaw, num_modes: int = 5, gap=GAP, **more
) -> vj.ImpactingBeam:
    """Return the rig with a support of this contact law below its tip."""
    stop = vj.Stop(position=1.0, gap=gap, law=law, side=-1)
    return vj.ImpactingBeam(beam(), stop, damping_ratio=DAMPING_RATIO, num_modes=num_modes, **more)


def released_rig(num_modes: int = 5) -> Callable[..., vj.ImpactingBeam]:
    """Return the function that makes the rig of the free releases."""

    def make(damping=CONTACT_DAMPING, gap=GAP):
        return stopped_by(vj.KelvinVoigt(STIFFNESS, damping), num_modes, gap)

    return make


def forced_rig(force, damping=CONTACT_DAMPING) -> vj.ImpactingBeam:
    """Return the rig driven by a force of this amplitude, N, at 70 mm."""
    law = vj.KelvinVoigt(STIFFNESS, damping)
    return stopped_by(law, drive=vj.PointForce(force, FORCE_POSITION))


def linear_receptance(frequency, damping_ratio: float = DAMPING_RATIO, num_modes: int = 5):
    """Return the size of tip displacement over force without a support, m/N."""
    found = vj.modes(beam(), num_modes)
    natural, mass = np.asarray(found.angular_frequency), np.asarray(found.modal_mass)
    weights = np.asarray(found.shape(1.0)) * np.asarray(found.shape(FORCE_POSITION)) / mass
    angular = 2 * np.pi * np.asarray(frequency, float)[..., None]
    bottom = natural**2 - angular**2 + 2j * damping_ratio * natural * angular
    return np.abs(np.sum(weights / bottom, axis=-1))


def frequencies() -> dict:
    """Natural frequencies, and what masses, lengths or springs would do to the first of them."""
    computed = np.asarray(vj.modes(beam(), 5).frequency)
    masses = {f"tip {grams} g": (grams, 0) for grams in (1, 2, 5)}
    masses |= {f"70 mm {grams} g": (0, grams) for grams in (20, 40)}
    masses["tip 2 g and 70 mm 30 g"] = (2, 30)
    shifted = {}
    for name, (tip, head) in masses.items():
        both = vj.PointMass(1e-3 * tip, 1.0), vj.PointMass(1e-3 * head, FORCE_POSITION)
        shifted[name] = np.asarray(vj.modes(beam(*both), 5).frequency).round(4).tolist()
    measured = PRINTED["frequency"]["experiment"]
    ratio = measured / computed[0]
    found = vj.modes(beam(), 12)
    natural, mass = np.asarray(found.angular_frequency), np.asarray(found.modal_mass)
    flexibility = np.asarray(found.shape(FORCE_POSITION)) ** 2 / mass
    spring = -1 / np.sum(flexibility / (natural**2 - (2 * np.pi * measured) ** 2))
    return {
        "computed_Hz": computed.tolist(),
        "printed_Hz": PRINTED_FREQUENCIES,
        "with_masses_Hz": shifted,
        "measured_first_Hz": measured,
        "measured_over_computed": ratio,
        "length_for_measured_m": 0.40 / np.sqrt(ratio),
        "thickness_for_measured_m": 0.003 * ratio,
        "modulus_for_measured_Pa": 70e9 * ratio**2,
        "spring_at_70_mm_for_measured_N_per_m": float(spring),
    }
