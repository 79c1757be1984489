"""The same batch of impacting beams integrated by other tools, each with its best settings.

The standard problem: the default rig with 5 modes, lanes over frequency ratio 0.95 to 1.25 (to the
first natural frequency), 20 drive periods from rest at drive phase zero, one core. The answer is
the tip displacement at the end of each period. The error is the maximum over lanes and periods of
|tip - tip_exact| / (max |tip_exact| over that lane's period ends), against exact event-driven
propagation.

Every peer is `run(problem, drive_frequencies, periods, accuracy) -> Run`, drive frequencies in
rad/s, `accuracy` its relative and absolute tolerance on a state scaled to order one.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import importlib.util
import math
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import exact_propagation as exact
import numpy as np
from exact_propagation import Problem


class Run(NamedTuple):
    """Tip displacement (lanes, periods) in m, and wall seconds of the run and of compiling."""

    tip: np.ndarray
    seconds: float
    compile_seconds: float


def standard_frequencies(problem: Problem, lanes: int) -> np.ndarray:
    """Drive frequencies (rad/s) of the standard problem."""
    return np.linspace(0.95, 1.25, lanes) * problem.angular_frequency[0]


def exact_tip(problem: Problem, drive_frequencies: np.ndarray, periods: int) -> np.ndarray:
    """Exact tip displacement (lanes, periods) at period ends, cached in the temporary folder."""
    digest = hashlib.sha256(Path(exact.__file__).read_bytes())
    for value in (*_numbers(problem), drive_frequencies, periods):
        digest.update(np.asarray(value, float).tobytes())
    folder = Path(tempfile.gettempdir()) / "vibrojax-benchmarks"
    path = folder / f"exact-{digest.hexdigest()[:24]}.npz"
    if path.exists():
        with np.load(path) as stored:
            return stored["tip"]
    tip = np.array([exact.tip_at_period_ends(problem, f, periods) for f in drive_frequencies])
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(path, tip=tip)
    return tip


def tip_error(
    problem: Problem, drive_frequencies: np.ndarray, tip: np.ndarray, judged_lanes: int = 64
) -> float:
    """Largest error over lanes and period ends, relative to each lane's largest exact value.

    Of more than `judged_lanes` lanes only every k-th is judged.
    """
    every = slice(None, None, max(1, len(drive_frequencies) // judged_lanes))
    truth = exact_tip(problem, np.asarray(drive_frequencies)[every], tip.shape[1])
    largest = np.abs(truth).max(axis=1, keepdims=True)
    return float(np.max(np.abs(tip[every] - truth) / largest))


def _numbers(problem: Problem) -> list:
    return [getattr(problem, name) for name in problem.__dataclass_fields__]


class _Scaled:
    """The model in x = (sqrt(m) w q, sqrt(m) q') / (10 sqrt(m_1) w_1 sigma), of order one.

    x' = A x + drive Omega^2 sin(Omega t) - push (Ks d + Cs d') with d = depth . x - gap.
    """

    def __init__(self, problem: Problem):
        if not problem.tension:
            raise ValueError("the peers integrate the contact law that may pull")
        n, w = problem.num_modes, np.asarray(problem.angular_frequency)
        root = np.sqrt(problem.modal_mass)
        unit = 10.0 * root[0] * w[0] * problem.base_amplitude
        shape = problem.side * np.asarray(problem.shape_at_stop) / root
        zeros = np.zeros(n)
        self.w, self.twice_decay = w, 2.0 * np.broadcast_to(problem.damping_ratio, (n,)) * w
        self.matrix = np.block(
            [[np.zeros((n, n)), np.diag(w)], [-np.diag(w), -np.diag(self.twice_decay)]]
        )
        forcing = root * problem.participation * problem.base_amplitude / unit
        self.drive = np.concatenate([zeros, forcing])
        self.push = np.concatenate([zeros, shape])
        self.depth, self.rate = np.concatenate([shape / w, zeros]), np.concatenate([zeros, shape])
        self.gap = problem.gap / unit
        self.stiffness, self.damping = problem.stiffness, problem.damping
        self.tip = np.concatenate([np.asarray(problem.shape_at_tip) / root / w, zeros]) * unit
        force_row = self.stiffness * self.depth + self.damping * self.rate
        self.contact_matrix = self.matrix - np.outer(self.push, force_row)
        self.contact_constant = self.push * self.stiffness * self.gap


def run_scipy(
    problem: Problem,
    drive_frequencies: np.ndarray,
    periods: int,
    accuracy: float,
    method: str = "RK45",
    steps_per_period: float = 200.0,
) -> Run:
    """`scipy.integrate.solve_ivp` phase by phase, with terminal events, one lane after another.

    The step is bounded by the period / `steps_per_period`: solve_ivp looks for events by the signs
    at its step ends, so a graze shorter than a step is missed and its lane lost. DOP853 is faster
    (1.5 times) and far more precise lane by lane, with steps so long that it misses more of them.
    """
    from scipy.integrate import solve_ivp

    model = _Scaled(problem)
    tip = np.empty((len(drive_frequencies), periods))
    implicit = method in ("Radau", "BDF", "LSODA")

    def phase(matrix, constant, direction, drive):
        forcing = model.drive * drive**2

        def field(t, x):
            return matrix @ x + (forcing * math.sin(drive * t) + constant)

        def crossing(t, x):
            return model.depth @ x - model.gap

        crossing.terminal, crossing.direction = True, direction
        return field, crossing, ({"jac": lambda t, x: matrix} if implicit else {})

    began = time.perf_counter()
    for lane, drive in enumerate(drive_frequencies):
        free = phase(model.matrix, 0.0, 1.0, drive)
        touching = phase(model.contact_matrix, model.contact_constant, -1.0, drive)
        ends = np.arange(1, periods + 1) * (2.0 * np.pi / drive)
        t, x, contact, filled = 0.0, np.zeros(len(model.drive)), False, 0
        while filled < periods:
            field, crossing, options = touching if contact else free
            answer = solve_ivp(
                field,
                (t, ends[-1]),
                x,
                method=method,
                t_eval=ends[filled:],
                events=crossing,
                rtol=accuracy,
                atol=accuracy,
                max_step=ends[0] / steps_per_period,
                **options,
            )
            got = len(answer.t)
            if got:
                tip[lane, filled : filled + got] = model.tip @ answer.y
            filled += got
            if answer.status != 1:
                break
            t, x, contact = answer.t_events[0][0], answer.y_events[0][0], not contact
        if filled < periods:
            tip[lane, filled:] = np.nan
    return Run(tip, time.perf_counter() - began, 0.0)


@functools.cache
def _heyoka_integrator(problem: Problem, accuracy: float, batch: int):
    """A batch integrator with the contact switched by a terminal event, and its compile time."""
    import heyoka as hy

    model, n = _Scaled(problem), problem.num_modes
    u = [hy.expression(f"u{i}") for i in range(n)]
    v = [hy.expression(f"v{i}") for i in range(n)]
    in_contact, drive = hy.par[0], hy.par[1]
    depth = hy.sum([float(model.depth[i]) * u[i] for i in range(n)]) - model.gap
    rate = hy.sum([float(model.rate[n + i]) * v[i] for i in range(n)])
    force = in_contact * (model.stiffness * depth + model.damping * rate)
    base = drive * drive * hy.sin(drive * hy.time)
    system = [(u[i], float(model.w[i]) * v[i]) for i in range(n)]
    for i in range(n):
        linear = -float(model.w[i]) * u[i] - float(model.twice_decay[i]) * v[i]
        forced = float(model.drive[n + i]) * base - float(model.push[n + i]) * force
        system.append((v[i], linear + forced))

    class Switch:
        def __call__(self, integrator, sign, lane):
            integrator.pars[0, lane] = 1.0 if sign > 0 else 0.0
            return True

    began = time.perf_counter()
    integrator = hy.taylor_adaptive_batch(
        system,
        np.zeros((2 * n, batch)),
        tol=accuracy,
        pars=np.ones((2, batch)),
        # The default cooldown grows with the tolerance and swallows events: errors of order one.
        t_events=[hy.t_event_batch(depth, callback=Switch(), cooldown=1e-9)],
    )
    return integrator, time.perf_counter() - began


def run_heyoka(
    problem: Problem,
    drive_frequencies: np.ndarray,
    periods: int,
    accuracy: float,
    batch: int | None = None,
) -> Run:
    """heyoka's Taylor integrator in batch mode, contacts by terminal events."""
    import heyoka as hy

    batch = batch or hy.recommended_simd_size()
    integrator, compile_seconds = _heyoka_integrator(problem, accuracy, batch)
    weights = _Scaled(problem).tip
    lanes = len(drive_frequencies)
    padded = np.resize(drive_frequencies, -(-lanes // batch) * batch).reshape(-1, batch)
    tips = []
    began = time.perf_counter()
    for drives in padded:
        integrator.set_time(0.0)
        integrator.state[:] = 0.0
        integrator.pars[0], integrator.pars[1] = 0.0, drives
        integrator.reset_cooldowns()
        ends = np.outer(np.arange(periods + 1), 2.0 * np.pi / drives)
        _, states = integrator.propagate_grid(ends)
        tips.append(np.einsum("pib,i->bp", states[1:], weights))
    seconds = time.perf_counter() - began
    return Run(np.concatenate(tips)[:lanes], seconds, compile_seconds)


def vector_field(problem: Problem):
    """Rate of the scaled state over a drive period, of (time in periods, state, drive in rad/s).

    Also the row that reads the tip. The contact is a plain kinked force.
    """
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    model, n = _Scaled(problem), problem.num_modes
    # One matrix product gives A x, the penetration and its rate.
    rows = jnp.asarray(np.vstack([model.matrix, model.depth, model.rate]).T)
    forcing, push = jnp.asarray(model.drive), jnp.asarray(model.push)

    def field(t, x, drive):
        products = x @ rows
        depth, rate = products[2 * n] - model.gap, products[2 * n + 1]
        force = jnp.where(depth > 0.0, model.stiffness * depth + model.damping * rate, 0.0)
        base = drive**2 * jnp.sin(2.0 * jnp.pi * t)
        return (2.0 * jnp.pi / drive) * (products[: 2 * n] + forcing * base - push * force)

    return field, jnp.asarray(model.tip)


@functools.cache
def diffrax_program(problem: Problem, periods: int, solver: str, steps_per_period: float):
    """Tips at all period ends, of drive frequencies and a tolerance."""
    import diffrax
    import jax
    import jax.numpy as jnp

    field, tip = vector_field(problem)
    ends = jnp.arange(1.0, periods + 1.0)

    def lane(drive, accuracy):
        answer = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            getattr(diffrax, solver)(),
            0.0,
            float(periods),
            1e-3,
            jnp.zeros_like(tip),
            args=drive,
            saveat=diffrax.SaveAt(ts=ends, fn=lambda t, x, args: x @ tip),
            stepsize_controller=diffrax.PIDController(
                rtol=accuracy, atol=accuracy, dtmax=1.0 / steps_per_period
            ),
            adjoint=diffrax.ForwardMode(),
            max_steps=None,
            throw=False,
        )
        return answer.ys

    return jax.jit(jax.vmap(lane, in_axes=(0, None)))


def run_diffrax(
    problem: Problem,
    drive_frequencies: np.ndarray,
    periods: int,
    accuracy: float,
    solver: str = "Tsit5",
    steps_per_period: float = 50.0,
    chunk: int = 64,
) -> Run:
    """diffrax under `vmap`, `chunk` lanes at a time, in float64; the contact a plain kinked force.

    The step is bounded by the period / `steps_per_period`, else loose tolerances skip contacts.
    """
    program = diffrax_program(problem, periods, solver, steps_per_period)
    lanes = len(drive_frequencies)
    chunk = min(chunk, lanes)
    padded = np.resize(drive_frequencies, -(-lanes // chunk) * chunk).reshape(-1, chunk)
    began = time.perf_counter()
    compiled = program.lower(padded[0], accuracy).compile()
    compile_seconds = time.perf_counter() - began
    began = time.perf_counter()
    tips = [np.asarray(compiled(drives, accuracy)) for drives in padded]
    seconds = time.perf_counter() - began
    return Run(np.concatenate(tips)[:lanes], seconds, compile_seconds)


def _installed(*modules: str) -> bool:
    return all(importlib.util.find_spec(module) is not None for module in modules)


def available() -> dict:
    """The peers that can run here, by name."""
    found = {
        "scipy RK45": run_scipy,
        "scipy DOP853": functools.partial(run_scipy, method="DOP853", steps_per_period=100.0),
    }
    if _installed("heyoka"):
        found["heyoka"] = run_heyoka
    if _installed("diffrax", "jax"):
        found["diffrax Tsit5"] = run_diffrax
        found["diffrax Dopri8"] = functools.partial(run_diffrax, solver="Dopri8")
    return found


# Tolerances that span errors of about 1e-2 to 1e-7.
ACCURACIES = {
    "scipy RK45": (1e-4, 1e-6),
    "scipy DOP853": (1e-3, 1e-5),
    "heyoka": (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9),
    "diffrax Tsit5": (1e-3, 3e-5, 1e-6, 1e-7, 1e-9),
    "diffrax Dopri8": (1e-3, 1e-6, 1e-8, 1e-9),
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Lane-periods per second against error.")
    parser.add_argument("--lanes", type=int, default=64)
    parser.add_argument("--scipy-lanes", type=int, default=64, help="fewer miss fewer grazes")
    parser.add_argument("--periods", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=3, help="the fastest one counts")
    parser.add_argument("--rigs", nargs="*", default=["default"], choices=list(exact.rigs()))
    options = parser.parse_args()
    for rig in options.rigs:
        problem = exact.rigs()[rig]
        print(f"{rig}: tolerance, largest error, lane-periods/s, compile s")
        for name, run in available().items():
            slow = name.startswith("scipy")
            lanes = options.scipy_lanes if slow else options.lanes
            drives = standard_frequencies(problem, lanes)
            for accuracy in ACCURACIES[name]:
                repeats = 1 if slow else options.repeats
                runs = [run(problem, drives, options.periods, accuracy) for _ in range(repeats)]
                rate = lanes * options.periods / min(r.seconds for r in runs)
                error = tip_error(problem, drives, runs[0].tip)
                compiling = max(r.compile_seconds for r in runs)
                print(f"  {name:15s} {accuracy:.0e} {error:9.1e} {rate:9.0f} {compiling:5.1f}")


if __name__ == "__main__":
    main()
