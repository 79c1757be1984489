"""The loop that reverse mode replays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.stepping.replay import replayed_while


def power(factor, start, most=50):
    """Multiply until above 10; the exponent depends on the numbers."""
    factor = jnp.asarray(factor)

    def body(carry, tick):
        value, count = carry
        return value * factor + 0.0 * tick, count + 1

    return replayed_while(lambda c: c[0] < 10.0, body, (jnp.asarray(start), jnp.int32(0)), most)


@pytest.mark.parametrize(("factor", "count"), [(2.0, 4), (1.1, 25), (20.0, 1)])
def test_the_way_back_goes_through_the_rounds_made(factor, count):
    value, made = power(factor, 1.0)
    assert int(made) == count
    assert value == pytest.approx(factor**count)
    slopes = jax.grad(lambda f, s: power(f, s)[0], argnums=(0, 1))(factor, 1.0)
    assert slopes == pytest.approx((count * factor ** (count - 1), factor**count))


def test_lanes_of_a_vmap_have_rounds_of_their_own():
    factors = jnp.array([2.0, 1.1, 20.0])
    slopes = jax.vmap(jax.grad(lambda f: power(f, 1.0)[0]))(factors)
    np.testing.assert_allclose(slopes, [4 * 2.0**3, 25 * 1.1**24, 1.0], rtol=1e-12)


def test_the_rounds_allowed_are_the_limit():
    assert float(power(1.1, 1.0, most=3)[0]) == pytest.approx(1.1**3)
