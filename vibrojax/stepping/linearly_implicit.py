"""`LinearlyImplicit`: stepping for systems whose mass depends on the configuration."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from vibrojax._tools.checks import check_count, check_positive, concrete
from vibrojax._tools.compiled import compiled
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.stop_forces import touching_stops
from vibrojax.model.systems import AbstractSystem, Motion, as_arrays, equations_of
from vibrojax.stepping.linearly_implicit_step import (
    StepMatrix,
    linear_matrices,
    step_matrix,
    take_step,
)
from vibrojax.stepping.measures import Measures, Segment, no_measures
from vibrojax.stepping.stepper import AbstractMarch, AbstractStepper, check_settings, motion_of

lax = jax.lax

STEPS = 2000
"""Steps per drive period at a tolerance of 1e-4."""
RINGING = 100.0
"""Damping rate times step beyond which a damped mode alternates from step to step for long."""


@validated
class LinearlyImplicit(AbstractStepper):
    """Stiffness and damping implicit, mass at the middle of the step, contact in closed form.

    For every system: one linear solve a step, by refining the constant matrix of the position of
    rest, so that the stiffest link does not limit the step. Second order between impacts, first
    order at them. See `linearly_implicit_step`.

    Raises `ValueError` for a tolerance outside (0, 0.1], fewer than 4 steps per period, a step
    that is not above 0, both of these at once, no refinement, and, when used, for a step too long
    for the damping of the system or stops with an internal state.
    """

    tolerance: float = eqx.field(default=1e-4)
    """Error to expect relative to the response, from which the steps are chosen."""
    steps_per_period: int | None = eqx.field(static=True, default=None)
    """Steps per drive period, instead of those chosen from the tolerance and the damping."""
    longest_step: float | None = eqx.field(static=True, default=None, metadata={"units": "s"})
    """Longest step, s, instead; as many equal ones are taken as fill a drive period."""
    refinements: int = eqx.field(static=True, default=2)
    """Corrections of the solve for the change of the mass; more for links that fold sharply."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        check_settings(self.tolerance, self.steps_per_period)
        check_count("refinements", self.refinements)
        if self.longest_step is not None:
            check_positive("longest_step", self.longest_step, "s")
            if self.steps_per_period is not None:
                raise ValueError("Give steps_per_period or longest_step (s), not both.")

    def prepare(self, equations: AbstractEquations, drive: AbstractDrive) -> "ImplicitMarch":
        """Linearise about rest; the matrix of the solve depends on the drive frequency too."""
        return ImplicitMarch(
            equations=equations,
            drive=drive,
            matrices=linear_matrices(_without_memory(equations)),
            fastest=fastest_damping(equations),
            tolerance=jnp.asarray(self.tolerance),
            steps_per_period=self.steps_per_period,
            longest_step=self.longest_step,
            refinements=self.refinements,
        )

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> StepMatrix:
        """Invert the matrix of the solve for the step, for diffrax."""
        equations = _without_memory(motion_of(args).equations)
        return step_matrix(linear_matrices(equations), jnp.asarray(t1 - t0))

    def advance(
        self,
        motion: Motion,
        start: Float[Array, ""],
        duration: Float[Array, ""],
        state: Float[Array, " states"],
        solver_state: Any,
    ) -> Float[Array, " states"]:
        """Take one step of the length given to `init`."""
        drive_input = motion.drive.input(motion.waveform, start + duration / 2)
        return take_step(
            motion.equations, solver_state, state, duration, drive_input, self.refinements
        )

    def steps(self, motion: Motion) -> int:
        """As many as the tolerance and the damping, or the settings, ask for.

        Raises `ValueError` for a step that is too long for the damping, or a `longest_step` (s) at
        a frequency that JAX is tracing.
        """
        with jax.ensure_compile_time_eval():  # a known frequency stays known inside of jit
            period = concrete(2 * jnp.pi / motion.clock)
        fastest = concrete(_fastest_damping(_without_memory(motion.equations)))
        if self.steps_per_period is not None:
            if period is not None and fastest is not None:
                self.check_ringing(float(period) / self.steps_per_period, float(fastest))
            return self.steps_per_period
        if self.longest_step is not None:
            if fastest is not None:
                self.check_ringing(self.longest_step, float(fastest))
            if period is None:
                raise ValueError(
                    "The number of steps of longest_step depends on a frequency that JAX is "
                    "tracing: give LinearlyImplicit(steps_per_period=...)."
                )
            return math.ceil(float(period) / self.longest_step - 1e-9)
        if period is None or fastest is None:
            return math.ceil(STEPS * (1e-4 / self.tolerance) ** 0.5)
        return int(chosen_steps(period, fastest, np.asarray(self.tolerance), np))

    def check_system(self, system: AbstractSystem, lowest: tuple[str, float] | None = None) -> None:
        """Refuse, with a `ValueError`, a system that these settings cannot step.

        `lowest` is the lowest frequency of a study and its name, where that is known. Raises
        `ValueError` when a step is too long for the damping of the `system`.
        """
        count, step = self.steps_per_period, self.longest_step
        if step is None and (count is None or lowest is None):
            return
        equations = _without_memory(equations_of(as_arrays(system)))
        fastest = concrete(_fastest_damping(equations))
        if count is not None and lowest is not None:
            name, value = lowest
            unit = concrete(equations.drive_unit(name == "frequency_ratio"))
            step = None if unit is None else 2 * np.pi / (float(unit) * value) / count
        if step is not None and fastest is not None:
            self.check_ringing(step, float(fastest))

    def check_ringing(self, step: float, fastest: float) -> None:
        """Refuse, with a `ValueError`, a `step` (s) too long for the `fastest` damping (1/s)."""
        if step * fastest > RINGING * (1 + 1e-9):
            name = "longest_step" if self.longest_step is not None else "steps_per_period"
            raise ValueError(
                f"{name} makes steps of {step:.3g} s, which must be at most "
                f"{RINGING / fastest:.3g} s for this damping: its fastest mode decays at "
                f"{fastest:.3g} 1/s and would alternate from step to step in place of decaying. "
                "Take shorter steps, or fewer links."
            )


def _without_memory(equations: AbstractEquations) -> AbstractEquations:
    if equations.memory_size:
        laws = (f"a {type(s.law).__name__}" for s in equations.stops if s.memory_size)
        raise ValueError(
            "LinearlyImplicit takes systems and contact laws without internal states, but "
            f"{next(laws, 'this system')} has one. Use ExactContact() where the stops are linear, "
            "else continue_response, or simulate(..., stepper=diffrax.Kvaerno5())."
        )
    return equations


def fastest_damping(equations: AbstractEquations) -> Float[Array, ""]:
    """Rate of decay of the most damped motion about rest, elasticity left out, 1/s."""
    mass, damping, _ = linear_matrices(equations)
    lower = jnp.linalg.cholesky(mass)
    half = jax.scipy.linalg.solve_triangular(lower, (damping + damping.T) / 2, lower=True)
    whole = jax.scipy.linalg.solve_triangular(lower, half.T, lower=True)
    return lax.stop_gradient(jnp.max(jnp.linalg.eigvalsh((whole + whole.T) / 2)))


_fastest_damping = compiled(fastest_damping)


def chosen_steps(period: Any, fastest: Any, tolerance: Any, xp: Any = jnp) -> Any:
    """Steps per drive period (s) for a tolerance, and for the damping (1/s) not to ring."""
    wanted = STEPS * (1e-4 / tolerance) ** 0.5
    return xp.ceil(xp.maximum(wanted, period * fastest / RINGING)).astype(int)


class ImplicitMarch(AbstractMarch):
    """`LinearlyImplicit` made ready; its arrays may carry lanes as trailing axes, all or none."""

    equations: AbstractEquations
    drive: AbstractDrive
    matrices: tuple[Float[Array, "..."], ...]
    """M at rest, C and K."""
    fastest: Float[Array, "*lanes"]
    tolerance: Float[Array, "*lanes"]
    steps_per_period: int | None = eqx.field(static=True)
    longest_step: float | None = eqx.field(static=True)
    refinements: int = eqx.field(static=True)

    def __call__(
        self,
        state: Float[Array, "states *lanes"],
        angular_frequency: Float[Array, "*lanes"],
        periods: Int[Array, "*lanes"],
        observe: bool,
    ) -> tuple[Float[Array, "states *lanes"], Int[Array, "*lanes"], Measures | None]:
        """March every lane in its own number of equal steps a period."""
        frequency = jnp.asarray(angular_frequency)
        periods = jnp.broadcast_to(jnp.asarray(periods, jnp.int32), frequency.shape)
        if not frequency.ndim:
            found = _march(self, None, state[None], frequency[None], periods[None], observe)
            return jax.tree.map(lambda a: a[0], found)
        state = jnp.broadcast_to(state, (state.shape[0], *frequency.shape)).T
        if jnp.ndim(self.fastest):
            # Lanes first, the links as rows: small products of matrices run fastest so.
            own = jax.tree.map(lambda a: jnp.moveaxis(a, -1, 0), self)
            end, steps, measures = _march(own, 0, state, frequency, periods, observe)
        else:
            end, steps, measures = _march(self, None, state, frequency, periods, observe)
        return end.T, steps, measures

    def check_steps(
        self, rig: Int[np.ndarray, " lanes"], angular_frequency: Float[np.ndarray, " lanes"]
    ) -> None:
        """Refuse, with a `ValueError`, steps that were asked for and ring somewhere."""
        if self.steps_per_period is None:
            return
        step = 2 * np.pi / np.asarray(angular_frequency) / self.steps_per_period
        fastest = np.asarray(self.fastest)[rig]
        if len(step):
            worst = np.argmax(step * fastest)
            LinearlyImplicit(steps_per_period=self.steps_per_period).check_ringing(
                float(step[worst]), float(fastest[worst])
            )

    def steps_for(self, angular_frequency: Float[Array, ""]) -> Int[Array, ""]:
        """Steps of one lane in a drive period."""
        period = 2 * jnp.pi / angular_frequency
        if self.steps_per_period is not None:
            return jnp.asarray(self.steps_per_period)
        if self.longest_step is not None:
            return jnp.ceil(period / self.longest_step - 1e-9).astype(int)
        return chosen_steps(period, self.fastest, self.tolerance)

    def energy_weight(self) -> Float[Array, "states *lanes"]:
        """Return roots of the diagonals of stiffness and mass: about the root of the energy."""
        mass, _, stiffness = self.matrices
        across = jnp.diagonal(mass)  # (lanes..., n)
        along = jnp.abs(jnp.diagonal(stiffness))
        diagonals = jnp.concatenate([along, across], axis=-1)
        return jnp.sqrt(jnp.moveaxis(diagonals, -1, 0))


def _march(march, axis, state, frequency, periods, observe):
    """March lanes, all arrays with the lanes first; those of `march` where `axis` is 0."""
    count = jax.vmap(ImplicitMarch.steps_for, (axis, 0))(march, frequency)
    step = 2 * jnp.pi / frequency / count
    table = jax.vmap(step_matrix, (axis, 0))(march.matrices, step)
    zero = jnp.zeros_like(frequency)
    amplitude = march.drive.complex_amplitude(frequency, zero)
    turn = 2 * jnp.pi / count
    back, ahead, spin = (jnp.exp(half * 1j * turn) for half in (-0.5, 0.5, 1.0))
    refinements = march.refinements

    def advance(equations, table, state, step, drive_input):
        return take_step(equations, table, state, step, drive_input, refinements)

    one = jax.vmap(advance, (axis, 0, 0, 0, 0))
    read = jax.vmap(_read, (axis, 0))
    total = count * periods

    def step_lanes(carry):
        k, state, wave, reading, measures = carry
        live = k < total
        # A rotating phasor, set right at every period: no sine in the loop.
        wave = jnp.where(k % count == 0, ahead, wave)
        new = one(march.equations, table, state, step, (amplitude * wave).imag)
        new = jnp.where(live[:, None], new, state)
        if measures is not None:
            (y0, v0, f0, t0), after = reading, read(march.equations, new)
            y1, v1, f1, t1 = after
            start, end = (jnp.stack([a.imag, a.real]) for a in (wave * back, wave * ahead))
            part = Segment(
                step,
                (start, end),
                frequency,
                (y0, y1),
                (v0, v1),
                jnp.max(jnp.maximum(f0, f1), axis=1, initial=0.0),
                jnp.any(t0, axis=1),
                jnp.sum(~t0 & t1, axis=1, dtype=jnp.int32),
            )
            measures, reading = measures.add(part, live), after
        return k + live, new, wave * spin, reading, measures

    first = no_measures(zero) if observe else None
    reading = read(march.equations, state) if observe else None
    begin = jnp.zeros(frequency.shape, count.dtype), state, spin * 0, reading, first
    k, end, _, _, measures = lax.while_loop(lambda c: jnp.any(c[0] < total), step_lanes, begin)
    return end, k.astype(jnp.int32), measures


def _read(equations, state):
    """Response, its rate, force and touch of every stop."""
    n = equations.size
    q, rate = state[:n], state[n : 2 * n]
    response, speed = jax.jvp(equations.response, (q,), (rate,))
    if not equations.stops:
        return response, speed, jnp.zeros(0), jnp.zeros(0, bool)
    force = equations.contact_forces(q, rate)
    touching = touching_stops(equations.stops, equations.penetration(q), force)
    return response, speed, force, touching
