"""The static potential, fig. 3: of the rigid pendulum, and of the elastic one on a limiter."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import root

import vibrojax as vj


def run(count: int = 401) -> dict:
    """Return both potentials against the bearing angle, and the well of the elastic pendulum."""
    equations = vj.default_pendulum().equations()
    weight = float(equations.gravity * jnp.sum(equations.moment))

    @jax.jit
    def energy(q):
        """Energy without motion, J, with that of the limiters; 0 when upright."""
        depth = jnp.maximum(equations.penetration(q), 0.0)
        stiffness = jnp.array([stop.law.stiffness for stop in equations.stops])
        lifted = equations.gravity * (equations.moment @ (1 - jnp.cos(q)))
        return equations.strain_energy(q) - lifted + jnp.sum(stiffness * depth**2) / 2

    pull, bend = jax.jit(jax.grad(energy)), jax.jit(jax.hessian(energy))
    near = np.linspace(0.1465, 0.1495, 31)
    angle = np.union1d(np.linspace(-0.16, 0.16, count), np.concatenate([-near, near]))
    straight = np.ones(equations.size)
    rigid = np.array([float(energy(a * straight)) for a in angle])
    # The limiters let the straight pendulum turn up to this angle.
    limit = float(np.arctan(equations.stops[0].gap / equations.limiter_height))

    def bent(first: float, guess: np.ndarray) -> np.ndarray:
        """Angles at rest with the bearing held at one."""

        def whole(rest):
            return np.concatenate([[first], rest])

        found = root(
            lambda rest: np.asarray(pull(whole(rest)))[1:],
            guess,
            jac=lambda rest: np.asarray(bend(whole(rest)))[1:, 1:],
            tol=1e-14,
        )
        return whole(found.x)

    held = [bent(a, a * straight[1:]) for a in angle]
    elastic = np.array([float(energy(q)) for q in held])
    well = root(pull, 0.15 * straight, jac=bend, tol=1e-15)
    rest = well.x
    depth = float(equations.penetration(rest)[0])
    frequencies = {
        support: np.asarray(vj.default_pendulum().natural_frequencies(support))[:2].tolist()
        for support in ("hinged", "propped", "clamped")
    }
    heights = np.linspace(0.03, 0.06, 31)
    propped = [
        float(vj.default_pendulum(limiter_height=h).natural_frequencies("propped")[0])
        for h in heights
    ]
    bare = vj.default_pendulum(tip_mass=0.0, gravity=0.0).natural_frequencies("clamped")
    return {
        "bearing_angle_rad": angle.tolist(),
        "rigid_normalised": (rigid / weight).tolist(),
        "elastic_normalised": (elastic / weight).tolist(),
        "weight_J": weight,
        "rigid_limit_rad": limit,
        "rigid_barrier_J": float(weight * (1 - np.cos(limit))),
        "well": {
            "bearing_angle_rad": float(rest[0]),
            "tip_angle_rad": float(rest[-1]),
            "contact_force_N": 1e4 * depth,
            "depth_J": -float(energy(rest)),
            "residual_Nm": float(np.abs(pull(rest)).max()),
            "chord_reduction_m": float(equations.observables(jnp.asarray(rest))["chord_reduction"]),
        },
        "natural_frequencies_Hz": frequencies | {"clamped_bare": bare[:2].tolist()},
        "height_for_9_Hz_propped_m": float(np.interp(9.0, propped, heights)),
    }
