"""The same batch problem as `peers.py`, by vibrojax: bare loop, inside diffrax, splitting."""

import time
from functools import lru_cache

import diffrax
import equinox as eqx
import exact_propagation as exact
import jax
import jax.numpy as jnp
import numpy as np
from peers import Run

import vibrojax as vj
from vibrojax.stepping.contact_phases import contact_phases

STEPS_IN_DIFFRAX = 2
"""Steps of diffrax's loop per drive period for `ExactContact`, which any length suits."""


def equations(problem: exact.Problem) -> vj.model.LinearEquations:
    """The problem's equations of motion."""
    shape = jnp.asarray(problem.shape_at_stop * problem.side)
    mass = jnp.asarray(problem.modal_mass)
    law = vj.KelvinVoigt(problem.stiffness, problem.damping)
    w = jnp.asarray(problem.angular_frequency)
    return vj.model.LinearEquations(
        stops=(vj.Stop(1.0, problem.gap, law, smoothing=0.0),),
        angular_frequency=w,
        damping_ratio=jnp.broadcast_to(jnp.asarray(problem.damping_ratio), w.shape),
        input_map=jnp.asarray(problem.participation),
        stop_map=shape[None],
        force_map=(shape / mass)[:, None],
        response_map=jnp.asarray(problem.shape_at_tip),
        modal_mass=mass,
    )


def _timed(program, arguments, repeats: int = 1) -> tuple[np.ndarray, float, float]:
    start = time.perf_counter()
    compiled = jax.jit(program).lower(*arguments).compile()
    compile_seconds = time.perf_counter() - start
    result = jax.block_until_ready(compiled(*arguments))
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = jax.block_until_ready(compiled(*arguments))
        seconds.append(time.perf_counter() - start)
    return np.asarray(result), min(seconds), compile_seconds


@lru_cache
def _phases(problem: exact.Problem):
    return jax.jit(contact_phases)(equations(problem))


def march(problem: exact.Problem, method: vj.stepping.AbstractStepper):
    """The march of the problem, of (state, drive frequency, periods, whether to measure)."""
    drive = vj.BaseMotion(problem.base_amplitude)
    return eqx.filter_jit(method.prepare)(equations(problem), drive)


def run_bare(problem, frequencies, periods, accuracy, method=vj.ExactContact, repeats=3) -> Run:
    """The bare loop: tips of every period end from one run, the time from another in one go."""
    ready = march(problem, method(accuracy))
    omega = jnp.asarray(frequencies)
    tip = jnp.asarray(problem.shape_at_tip)
    start = jnp.zeros((2 * tip.size, omega.size))
    one = jnp.ones(omega.size, jnp.int32)

    def all_at_once(start, omega):
        return tip @ ready(start, omega, periods * one, False)[0][: tip.size]

    def period_by_period(start, omega):
        def period(state, _):
            state = ready(state, omega, one, False)[0]
            return state, tip @ state[: tip.size]

        return jax.lax.scan(period, start, None, length=periods)[1].T

    _, seconds, compile_seconds = _timed(all_at_once, (start, omega), repeats)
    tips = np.asarray(jax.jit(period_by_period)(start, omega))
    return Run(tips, seconds, compile_seconds)


def run_splitting(problem, frequencies, periods, accuracy, repeats=3) -> Run:
    """Exponential splitting in the bare loop."""
    return run_bare(problem, frequencies, periods, accuracy, vj.ExponentialSplitting, repeats)


def run_in_diffrax(problem, frequencies, periods, accuracy, repeats=3) -> Run:
    """`ExactContact` as a solver of `diffrax.diffeqsolve`, under vmap."""
    model, phases = equations(problem), _phases(problem)
    drive = vj.BaseMotion(jnp.asarray(problem.base_amplitude))
    solver = vj.ExactContact(accuracy)

    def lane(omega):
        motion = vj.model.Motion(model, drive, vj.Harmonic(omega / (2 * jnp.pi)), phases)
        period = 2 * jnp.pi / omega
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(motion.vector_field),
            solver,
            0.0,
            periods * period,
            period / STEPS_IN_DIFFRAX,
            jnp.zeros(2 * model.size),
            args=motion,
            saveat=diffrax.SaveAt(ts=period * jnp.arange(1, periods + 1)),
            stepsize_controller=diffrax.ConstantStepSize(),
            adjoint=diffrax.ForwardMode(),
            max_steps=periods * STEPS_IN_DIFFRAX + 16,
        )
        return solution.ys[:, : model.size] @ model.response_map

    tips, seconds, compile_seconds = _timed(jax.vmap(lane), (jnp.asarray(frequencies),), repeats)
    return Run(tips, seconds, compile_seconds)


RUNS = {
    "vibrojax ExactContact, bare loop": run_bare,
    "vibrojax ExactContact in diffrax": run_in_diffrax,
    "vibrojax ExponentialSplitting": run_splitting,
}
ACCURACIES = {
    "vibrojax ExactContact, bare loop": (1e-3, 1e-4, 1e-6, 1e-8),
    "vibrojax ExactContact in diffrax": (1e-3, 1e-6),
    "vibrojax ExponentialSplitting": (1e-3, 1e-5),
}
