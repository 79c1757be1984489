"""The pendulum of Litak et al., its starts and how it is stepped."""

import numpy as np

import vibrojax as vj

FREQUENCIES = (3.1, 5.7, 6.7, 7.8, 8.8)
"""Hz, of the paper's fig. 5."""
PRINTED = {3.1: 0, 5.7: 3, 6.7: 3, 7.8: 5, 8.8: 0}
"""Period numbers that the paper gives them; 0 for nonperiodic."""
INFERRED = {
    "limiter_height": (0.04, "m"),
    "base_amplitude": (6.33e-3, "m"),
    "joint_damping_time": (2.91e-4, "s"),
    "bearing_damping": (1.44e-3, "N m s/rad"),
}
"""What the paper does not print."""
MODES = 6
LINKS = 17
STEPS = 1000
"""Steps per drive period."""
COARSER = vj.LinearlyImplicit(steps_per_period=600)
"""For thousands of lanes."""
METHOD = vj.LinearlyImplicit(steps_per_period=STEPS)
MARCHED = vj.RegimeSettings(transient=110, samples_per_period=16, spectrum=False, stepper=METHOD)
"""As the reference: strobed after 110 periods, 2 %, up to period 20."""


def modal(**numbers) -> vj.LinearisedPendulum:
    """Make the model of six modes, with numbers changed by name."""
    return vj.default_pendulum(**numbers).linearised(MODES)


def tilted(angle: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Angles (rad) and rates (rad/s) of the straight pendulum."""
    return angle * np.ones(LINKS), rate * np.ones(LINKS)


def tilts(count: int, seed: int = 0) -> list[tuple[float, float]]:
    """Draw angles within the limiters (rad) and rates (rad/s) to start from."""
    draw = np.random.default_rng(seed)
    return list(zip(draw.uniform(-0.14, 0.14, count), draw.uniform(-3.0, 3.0, count), strict=True))


def full_starts(count: int, seed: int = 0) -> np.ndarray:
    """Return states of the 17 links, shape (count, 34)."""
    return np.array([np.concatenate(tilted(*tilt)) for tilt in tilts(count, seed)])


def modal_starts(count: int, seed: int = 0) -> np.ndarray:
    """Return the same states in the modes of the pendulum with the inferred numbers."""
    straight = np.asarray(modal().modal_coordinates(np.ones(LINKS)))
    return np.array([np.concatenate([a * straight, w * straight]) for a, w in tilts(count, seed)])
