"""Forces and memories of several stops together, from depths and rates at each."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from vibrojax.model.stops import Stop

PerStop = Float[Array, "stops *lanes"]
Memories = Float[Array, "memories *lanes"]


def contact_slope(stop: Stop) -> Float[Array, "*lanes"]:
    """Stiffness of a stop not touched before, N/m: at a tenth of its gap, beyond the rounding."""
    depth = jnp.maximum(0.1 * jnp.abs(jnp.asarray(stop.gap)), 10 * jnp.asarray(stop.width))
    depth = jnp.maximum(depth, 1e-9)
    _, slope = jax.jvp(
        lambda d: stop.force(d, jnp.zeros_like(d)), (depth,), (jnp.ones_like(depth),)
    )
    return slope


def stop_forces(
    stops: tuple[Stop, ...], depth: PerStop, rate: PerStop, memory: Memories | None = None
) -> PerStop:
    """Return the rounded force of each stop, N, from depths (m), their rates and memories."""
    kept = memory_by_stop(stops, memory)
    forces = [s.force(depth[i], rate[i], kept[i]) for i, s in enumerate(stops)]
    return jnp.stack(forces) if forces else jnp.zeros_like(depth)


def forces_and_slopes(
    stops: tuple[Stop, ...], depth: PerStop, rate: PerStop, memory: Memories | None = None
) -> tuple[PerStop, PerStop, PerStop]:
    """Return the force of each stop (N), its slope in depth (N/m) and its slope in rate (N s/m)."""

    def all_stops(depth, rate):
        return stop_forces(stops, depth, rate, memory)

    one, zero = jnp.ones_like(depth), jnp.zeros_like(depth)
    force, stiffness = jax.jvp(all_stops, (depth, rate), (one, zero))
    _, damping = jax.jvp(all_stops, (depth, rate), (zero, one))
    return force, stiffness, damping


def memory_rates(
    stops: tuple[Stop, ...], depth: PerStop, rate: PerStop, memory: Memories
) -> Memories:
    """Return how fast the memories of the stops change, per s; 0 for what is behind them."""
    kept = memory_by_stop(stops, memory)
    own = [stop for stop in stops if stop.memory_size]
    rates = [
        stop.memory_rate(depth[i], rate[i], held)
        for i, (stop, held) in enumerate(zip(stops, kept, strict=True))
        if held is not None
    ]
    lanes = memory.shape[1:]
    rows = [jnp.broadcast_to(r, (s.memory_size, *lanes)) for s, r in zip(own, rates, strict=True)]
    return jnp.concatenate([*rows, jnp.zeros_like(memory[sum(map(len, rows)) :])])


def touching_stops(
    stops: tuple[Stop, ...], depth: PerStop, force: PerStop
) -> Bool[Array, "stops *lanes"]:
    """Return which stops are touched, from depths (m) and forces (N).

    The surface of a stop with memory may not be back yet where the body comes again.
    """
    lagging = np.array([stop.memory_size > 0 for stop in stops], bool)
    return (depth > 0) & (~lagging.reshape((-1,) + (1,) * (depth.ndim - 1)) | (force > 0))


def memory_by_stop(
    stops: tuple[Stop, ...], memory: Memories | None
) -> list[Float[Array, "*memories_and_lanes"] | None]:
    """Return the memory of every stop, one number or several, None for those without."""
    found, at = [], 0
    for stop in stops:
        held = (
            None if memory is None or not stop.memory_size else memory[at : at + stop.memory_size]
        )
        found.append(held[0] if held is not None and stop.memory_size == 1 else held)
        at += stop.memory_size
    return found
