"""Shooting: Newton's method on the period map of any system under any stepper."""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix
from jaxtyping import Array, Float

from vibrojax._tools.compiled import compiled
from vibrojax._tools.eigenvalues import eigenvalues
from vibrojax.model.drives import AbstractDrive, Harmonic
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.stop_forces import touching_stops
from vibrojax.model.systems import AbstractSystem, Motion, equation_kinds
from vibrojax.steady.implicit import frozen, with_columns
from vibrojax.steady.methods import Shooting
from vibrojax.steady.periodic_result import Sampled, numbers_of
from vibrojax.stepping.choice import choose_stepper
from vibrojax.stepping.cubic import cubic_maximum, largest

SETTLING = 200
"""Drive periods marched from rest for a first guess."""


class _Place(NamedTuple):
    """Equations of any kind, drive and drive frequency."""

    equations: AbstractEquations
    drive: AbstractDrive
    angular_frequency: Float[Array, ""]


def shoot(
    system: AbstractSystem,
    value: Float[Array, ""],
    is_ratio: bool,
    period: int,
    state: Float[Array, " states"] | None,
    method: Shooting,
    exact: bool,
) -> dict[str, Array]:
    """Solve for the motion that returns after `period` drive periods; see `periodic_response`."""
    stepper = method.stepper
    if stepper is None:
        equations = equation_kinds(system)
        if equations.stops or equations.linear_between_contacts is not None:
            stepper = choose_stepper(system, None, 1e-6 if exact else 1e-4, None)
        else:
            stepper = diffrax.Tsit5()  # nothing is stiff or sharp for all that is known
    return with_columns(_shoot, (system, value), is_ratio, period, state, method, stepper)


@compiled
def _shoot(numbers, is_ratio, period, state, method, stepper):
    system, value = numbers

    def place_of(system, value) -> _Place:
        equations = system.equations()
        return _Place(equations, system.drive, value * equations.drive_unit(is_ratio))

    shapes = eqx.filter_eval_shape(system.equations)
    n, extent = shapes.size, shapes.state_size

    # States are in units of the first one's size, q' over the drive frequency: comparable.
    def passed(numbers, x, periods, keep):
        place = place_of(*numbers)
        frequency = place.angular_frequency
        motion = Motion(place.equations, place.drive, Harmonic(frequency / (2 * jnp.pi)))
        steps = method.steps_per_period * periods
        step = 2 * jnp.pi / frequency / method.steps_per_period
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(motion.vector_field),
            stepper,
            t0=0.0,
            t1=steps * step,
            dt0=step,
            y0=x,
            args=motion,
            saveat=diffrax.SaveAt(steps=True, t0=True) if keep else diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.ConstantStepSize(),
            adjoint=diffrax.ForwardMode(),
            max_steps=steps + 2,
            throw=False,
        )
        states = jnp.asarray(solution.ys)
        return states[: steps + 1] if keep else states[0]

    still = frozen((system, value))
    if state is None:
        start = jax.lax.fori_loop(
            0, SETTLING // period, lambda _, x: passed(still, x, period, False), jnp.zeros(extent)
        )
    else:
        start = frozen(state)
    rate = place_of(*still).angular_frequency
    size = jnp.max(jnp.abs(start[:n]) + jnp.abs(start[n : 2 * n]) / rate)
    size = jnp.where(size > 0, size, 1.0)
    # Memories of stops are lengths, as q.
    unit = size * jnp.ones(extent).at[n : 2 * n].set(rate)

    def returned(x, given):
        numbers, unit = given
        return passed(numbers, x * unit, period, False) / unit - x

    found = optimistix.root_find(
        returned,
        optimistix.Newton(rtol=1e-9, atol=1e-9),
        start / unit,
        (numbers, unit),
        max_steps=method.max_steps,
        throw=False,
    )
    x = found.value
    states = passed(numbers, x * unit, period, True)
    place = place_of(*numbers)
    # Under differentiation only the solution matters, not the map's own Jacobian.
    still_x, held = jax.lax.stop_gradient(x), (still, unit)
    matrix = jax.jacfwd(lambda x: returned(x, held))(still_x)
    residual = jnp.max(jnp.abs(returned(still_x, held)))
    multipliers = eigenvalues(jax.lax.stop_gradient(matrix) + jnp.eye(extent))
    return numbers_of(
        place,
        _read(place, states, method.steps_per_period, period),
        period=period,
        strobes=jax.lax.stop_gradient(states[: -1 : method.steps_per_period]),
        guess=state,
        multipliers=jax.lax.stop_gradient(multipliers),
        residual=jax.lax.stop_gradient(residual),
        converged=residual < 1e-6,
    )


def _read(place: _Place, states: Any, steps_per_period: int, period: int) -> Sampled:
    """Read amplitudes and forces off the states at the ends of all steps."""
    equations = place.equations
    step = 2 * jnp.pi / place.angular_frequency / steps_per_period

    def at(state):
        q, v, memory = equations.split(state)
        response, rate = jax.jvp(equations.response, (q,), (v,))
        forces = equations.contact_forces(q, v, memory)
        touching = touching_stops(equations.stops, equations.penetration(q), forces)
        return response, rate, forces, touching

    response, rate, forces, touching = jax.vmap(at)(states)
    top = cubic_maximum(response[:-1], rate[:-1] * step, response[1:], rate[1:] * step)
    low = cubic_maximum(-response[:-1], -rate[:-1] * step, -response[1:], -rate[1:] * step)
    y = response[:-1]
    angle = 2 * jnp.pi * jnp.arange(y.size) / steps_per_period
    touching = touching[:-1]
    entered = touching & ~jnp.roll(touching, 1, axis=0)
    return Sampled(
        highest=largest(top),
        lowest=-largest(low),
        mean_square=jnp.mean(y**2),
        first_harmonic=2 * jnp.hypot(jnp.mean(y * jnp.sin(angle)), jnp.mean(y * jnp.cos(angle))),
        contact_force=largest(jnp.append(forces, 0.0)),
        contact_fraction=jnp.mean(jnp.any(touching, axis=1).astype(float)),
        contacts=jnp.sum(entered).astype(float),
        initial_state=states[0],
    )
