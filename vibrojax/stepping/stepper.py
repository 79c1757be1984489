"""How a sweep steps its lanes: one interface, several methods."""

import math
from abc import abstractmethod
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from vibrojax._tools.checks import check_count, check_range, concrete
from vibrojax._tools.compiled import compiled
from vibrojax._tools.described import described
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import AbstractEquations, LinearEquations
from vibrojax.model.systems import Motion
from vibrojax.stepping import exact_contact, splitting
from vibrojax.stepping.contact_phases import ContactPhases, contact_phases, phases_of
from vibrojax.stepping.cubic import cubic_between
from vibrojax.stepping.forcing import Forcing, forcing, longest_step
from vibrojax.stepping.gauge import Ruler
from vibrojax.stepping.measures import Measures
from vibrojax.stepping.runs import AbstractRun, EqualRun
from vibrojax.stepping.splitting_step import step_from

States = Float[Array, "states *lanes"]
Lanes = Float[Array, "*lanes"]
State = Float[Array, " states"]
Scalar = Float[Array, ""]
Counts = Int[Array, "*lanes"]


MEASURED = 2e-4
"""Error of the cells in which a motion is measured, over the tolerance."""


class AbstractMarch(eqx.Module):
    """A stepper made ready for its lanes."""

    @abstractmethod
    def __call__(
        self, state: States, angular_frequency: Lanes, periods: Counts, observe: bool
    ) -> tuple[States, Counts, Measures | None]:
        """Advance each lane from drive phase 0 by its number of drive periods.

        Returns the states, the steps taken, and the measures if `observe`. A lane that cannot go
        on has a state that is not finite.
        """

    def run_at(self, angular_frequency: Lanes) -> AbstractRun:
        """Make lanes at their drive frequencies ready to go on from period to period."""
        return EqualRun(self, angular_frequency)

    @abstractmethod
    def energy_weight(self) -> States:
        """Return weights that make (q, q') comparable: norms of weighted states are energies."""

    def check_steps(
        self, rig: Int[np.ndarray, " lanes"], angular_frequency: Float[np.ndarray, " lanes"]
    ) -> None:
        """Refuse, with a `ValueError`, steps that do not suit some lanes, before any march.

        `rig[k]` is the rig of lane k along the trailing axis of the arrays, which are concrete.
        """


class StateInterpolation(diffrax.AbstractLocalInterpolation):
    """Between two steps: the cubic through (q, q') at both ends, and its derivative.

    Memories of stops, behind them in the state, run straight.
    """

    # The base class has them as class variables, as all of diffrax's interpolations override.
    t0: Scalar  # pyright: ignore
    t1: Scalar  # pyright: ignore
    y0: State
    y1: State
    memory0: Float[Array, " memories"] | None = None
    memory1: Float[Array, " memories"] | None = None

    def evaluate(
        self, t0: Float[ArrayLike, ""], t1: Float[ArrayLike, ""] | None = None, left: bool = True
    ) -> State:
        """Return the state at t0, or the increment from t0 to t1."""
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        h = self.t1 - self.t0
        safe = jnp.where(h > 0, h, 1.0)
        u = (t0 - self.t0) / safe
        (q0, v0), (q1, v1) = jnp.split(self.y0, 2), jnp.split(self.y1, 2)
        cubic = cubic_between(q0, safe * v0, q1, safe * v1)
        q, v = cubic.at(u), cubic.slope_at(u) / safe
        if self.memory0 is None or self.memory1 is None:
            return jnp.concatenate([q, v])
        return jnp.concatenate([q, v, self.memory0 + u * (self.memory1 - self.memory0)])


class AbstractStepper(diffrax.AbstractSolver[Any]):
    """How the motion is stepped; a setting, apart from the system.

    Every stepper is a diffrax solver too: pass a `Motion` as `args` and
    `ODETerm(motion.vector_field)` as the terms, at constant steps.
    """

    term_structure: ClassVar[Any] = diffrax.AbstractTerm
    """The terms that diffrax has to give: one, of the vector field."""
    interpolation_cls: ClassVar[Any] = StateInterpolation
    """How diffrax reads between steps."""

    @abstractmethod
    def prepare(self, equations: AbstractEquations, drive: AbstractDrive) -> AbstractMarch:
        """Compute what does not depend on the drive frequency, for one lane.

        `equations` are those of one system (for lanes of several: `jax.vmap(..., out_axes=-1)`),
        `drive` drives it. Raises `ValueError` for equations that the stepper cannot step.
        """

    @abstractmethod
    def steps(self, motion: Motion) -> int:
        """Return how many equal steps to take in a drive period, for diffrax.

        `motion` holds equations, drive and waveform. Raises `ValueError` when the number depends on
        values that JAX is tracing.
        """

    @abstractmethod
    def advance(
        self, motion: Motion, start: Scalar, duration: Scalar, state: State, solver_state: Any
    ) -> State:
        """Return the state after a step.

        `motion` holds equations, drive and waveform; the step begins at `start` and takes
        `duration` (s); `solver_state` is what `init` returned.
        """

    def order(self, terms: Any) -> int:
        """Order of convergence with smooth forces."""
        return 2

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """Vector field, for diffrax."""
        return terms.vf(t0, y0, args)

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Any, None, dict[str, Any], Any, Any]:
        """Take one step, for diffrax."""
        state = self.advance(args, jnp.asarray(t0), jnp.asarray(t1 - t0), y0, solver_state)
        whole = jnp.all(jnp.isfinite(state))
        result = diffrax.RESULTS.where(
            whole,
            diffrax.RESULTS.successful,
            diffrax.RESULTS.nonlinear_divergence,  # pyright: ignore[reportArgumentType]
        )
        n = 2 * args.equations.size
        ends = {"y0": y0[:n], "y1": state[:n]}
        if args.equations.memory_size:  # arrays without elements upset XLA in diffrax's loop
            ends |= {"memory0": y0[n:], "memory1": state[n:]}
        return state, None, ends, solver_state, result

    def __repr__(self) -> str:
        return described(self)


def motion_of(args: object) -> Motion:
    """Return the `args` of a diffrax solver; raises `ValueError` where they are no motion."""
    if not isinstance(args, Motion):
        raise ValueError(
            "This solver needs args=motion, a Motion as made by vibrojax.motion(system, ...), "
            f"got {args!r}."
        )
    return args


class ExactMarch(AbstractMarch):
    """`ExactContact` made ready: the phases of every rig are known."""

    phases: ContactPhases
    drive: AbstractDrive
    tolerance: Lanes
    steps_per_period: int | None = eqx.field(static=True)
    max_rounds: int = eqx.field(static=True)

    def __call__(
        self, state: States, angular_frequency: Lanes, periods: Counts, observe: bool
    ) -> tuple[States, Counts, Measures | None]:
        """March with exact propagators; see `exact_contact.march`."""
        force, ruler, rounds = self.force_at(angular_frequency), None, self.max_rounds
        if observe:
            ruler = self._ruler(2 * jnp.pi / angular_frequency)
        return exact_contact.march(self.phases, force, state, periods, ruler=ruler, rounds=rounds)

    def _ruler(self, period: Lanes) -> Ruler:
        """How finely motions are measured."""
        if self.steps_per_period is None:
            return Ruler(MEASURED * self.tolerance, jnp.full_like(period, jnp.inf))
        return Ruler(jnp.full_like(period, jnp.inf), period / self.steps_per_period)

    def run_at(self, angular_frequency: Lanes) -> exact_contact.ExactRun:
        """Make lanes at their drive frequencies ready to go on from period to period."""
        force = self.force_at(angular_frequency)
        return exact_contact.ExactRun(self.phases, force, self.max_rounds)

    def force_at(self, angular_frequency: Lanes) -> Forcing:
        """Tabulate what the drive does."""
        zero = jnp.zeros_like(angular_frequency)
        amplitude = self.drive.complex_amplitude(angular_frequency, zero)
        return forcing(self.phases, amplitude, angular_frequency, zero)

    def energy_weight(self) -> States:
        """Return weights that make (q, q') comparable."""
        return self.phases.weight


@validated
class ExactContact(AbstractStepper):
    """Exact propagators in flight and in contact, from one change of contact to the next.

    For linear stops (KelvinVoigt, with or without tension, any smoothing left out); up to four of
    them. Between changes of contact every depth is bounded, so none is missed however short, unless
    it is less deep than 1e-9 of the gap; what is left is round-off, and the cost is that of the
    contacts, whatever their stiffness. Raises `ValueError` for a tolerance outside (0, 0.1],
    fewer than 4 steps per period or counts below 1.
    """

    tolerance: float = eqx.field(default=1e-4)
    """Error to expect of extremes relative to the response: chooses how finely they are read. The
    motion itself is exact."""
    steps_per_period: int | None = eqx.field(static=True, default=None)
    """Steps per drive period to read in, instead of those chosen from contact and tolerance."""
    max_attempts: int | None = eqx.field(static=True, default=None)
    """Within diffrax: most rounds per step, kept for reverse mode to differentiate; None takes as
    many as needed, for forward mode and plain values."""
    max_rounds: int = eqx.field(static=True, default=exact_contact.ROUNDS)
    """Rounds in a drive period, several for a contact, before a lane of a sweep, map or regime is
    given up, with the status `gave_up`."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        check_settings(self.tolerance, self.steps_per_period)
        if self.max_attempts is not None:
            check_count("max_attempts", self.max_attempts)
        check_count("max_rounds", self.max_rounds)

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> ContactPhases | None:
        """Compute the phases once, for diffrax, unless `motion` has."""
        run = motion_of(args)
        if run.prepared is not None:
            return None
        return contact_phases(_linear(run.equations, "ExactContact"))

    def advance(
        self, motion: Motion, start: Scalar, duration: Scalar, state: State, solver_state: Any
    ) -> State:
        """Advance with exact propagators, landing on every crossing in between."""
        # As `args` the phases stay shared by the lanes of a vmap; as solver state they would not.
        phases = solver_state if motion.prepared is None else motion.prepared
        return exact_contact.step_from(phases, motion, state, start, duration, self.max_attempts)

    def steps(self, motion: Motion) -> int:
        """As many as the march would take; 64 when that depends on numbers that JAX is tracing."""
        if self.steps_per_period is not None:
            return self.steps_per_period
        phases = motion.prepared
        if phases is None:
            phases = phases_of(_linear(motion.equations, "ExactContact"))
        steps = concrete(_exact_steps(phases, motion.clock, jnp.asarray(self.tolerance)))
        return 64 if steps is None else max(32, math.ceil(float(steps)))

    def prepare(self, equations: AbstractEquations, drive: AbstractDrive) -> ExactMarch:
        """Compute the phases of flight and contact."""
        phases = contact_phases(_linear(equations, "ExactContact"))
        tolerance = jnp.asarray(self.tolerance)
        return ExactMarch(phases, drive, tolerance, self.steps_per_period, self.max_rounds)


class SplittingMarch(AbstractMarch):
    """`ExponentialSplitting` made ready."""

    equations: LinearEquations
    drive: AbstractDrive
    tolerance: Lanes
    steps_per_period: int | None = eqx.field(static=True)

    def __call__(
        self, state: States, angular_frequency: Lanes, periods: Counts, observe: bool
    ) -> tuple[States, Counts, Measures | None]:
        """March with kicks of contact; see `splitting.march`."""
        if self.steps_per_period is None:
            steps = splitting.steps_for(self.equations, angular_frequency, self.tolerance)
        else:
            steps = jnp.asarray(self.steps_per_period, jnp.int32)
        zero = jnp.zeros_like(angular_frequency)
        amplitude = self.drive.complex_amplitude(angular_frequency, zero)
        return splitting.march(
            self.equations, amplitude, angular_frequency, state, periods, steps, observe=observe
        )

    def energy_weight(self) -> States:
        """Return weights that make (q, q') comparable."""
        return self.equations.energy_weight


@validated
class ExponentialSplitting(AbstractStepper):
    """Exact modes and kicks of contact with a force-gradient correction, at equal steps.

    For every contact law and any number of stops; the corner of the force is rounded over
    `Stop.width`. Raises `ValueError` for a tolerance outside (0, 0.1] or fewer than 4 steps, and,
    when used, for damping that couples the modes.
    """

    tolerance: float = eqx.field(default=1e-4)
    """Error to expect relative to the response, from which the steps are chosen."""
    steps_per_period: int | None = eqx.field(static=True, default=None)
    """Steps per drive period, instead of those chosen from the contact and the tolerance."""

    def __check_init__(self) -> None:
        """Refuse settings that cannot work."""
        check_settings(self.tolerance, self.steps_per_period)

    def prepare(self, equations: AbstractEquations, drive: AbstractDrive) -> SplittingMarch:
        """Keep the equations: there is nothing to compute before the frequency is known."""
        linear = _uncoupled(equations)
        return SplittingMarch(linear, drive, jnp.asarray(self.tolerance), self.steps_per_period)

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> None:
        """Keep nothing between steps, for diffrax."""
        _uncoupled(motion_of(args).equations)

    def advance(
        self, motion: Motion, start: Scalar, duration: Scalar, state: State, solver_state: Any
    ) -> State:
        """Drift, kick, drift."""
        return step_from(motion, state, start, duration)

    def steps(self, motion: Motion) -> int:
        """As many as the contact and the tolerance, or `steps_per_period`, ask for."""
        if self.steps_per_period is not None:
            return self.steps_per_period
        linear = _uncoupled(motion.equations)
        steps = concrete(splitting.steps_of(linear, motion.clock, jnp.asarray(self.tolerance)))
        if steps is None:
            raise ValueError(
                "The number of steps depends on values that JAX is tracing: give the solver, as "
                "ExponentialSplitting(steps_per_period=...)."
            )
        return int(steps)


@compiled
def _exact_steps(phases, rate, tolerance):
    step = longest_step(phases, rate, tolerance)
    return 2 * jnp.pi / rate / step


def _linear(equations: AbstractEquations, stepper: str) -> LinearEquations:
    linear = equations.linear_between_contacts
    if linear is None:
        raise ValueError(f"{stepper} needs a system that is linear but for its stops.")
    return linear


def _uncoupled(equations: AbstractEquations) -> LinearEquations:
    linear = _linear(equations, "ExponentialSplitting")
    splitting.check_uncoupled(linear)
    return linear


def with_traced_numbers(stepper: AbstractStepper) -> AbstractStepper:
    """Return the stepper with its numbers as arrays: a new tolerance does not compile again."""
    return jax.tree.map(lambda x: jnp.asarray(x) if isinstance(x, float) else x, stepper)


def check_settings(tolerance: float, steps_per_period: int | None) -> None:
    """Refuse a tolerance or a number of steps that cannot work, with a `ValueError`."""
    check_range(
        "tolerance", tolerance, 0.0, 0.1, include_low=False, allowed="above 0 and at most 0.1"
    )
    if steps_per_period is not None:
        check_count("steps_per_period", steps_per_period, least=4)
