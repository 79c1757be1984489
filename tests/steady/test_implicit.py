"""Derivatives of a solution as programs of their own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax._tools.compiled import compiled
from vibrojax.steady.implicit import with_columns


def test_the_program_of_a_derivative_gives_the_value_too():
    @compiled
    def cube(x, factor):
        return {"value": factor * x**3, "count": jnp.asarray(3)}

    def value(x):
        found = with_columns(cube, x, jnp.asarray(2.0))
        assert found["count"] == 3
        return found["value"]

    x = jnp.asarray(1.5)
    found, slope = jax.value_and_grad(value)(x)
    np.testing.assert_allclose([found, slope], [2 * 1.5**3, 6 * 1.5**2], rtol=1e-15)
    assert jax.jvp(value, (x,), (1.0,))[1] == slope
    assert not cube.programs  # nothing was compiled for the value alone
    assert value(x) == found
    assert len(cube.programs) == 1


def test_derivatives_of_derivatives_that_would_be_wrong_are_refused():
    def value(x, first_only):
        return with_columns(compiled(lambda x: x**2), x, first_only=first_only)

    x = jnp.asarray(1.5)
    assert jax.grad(value)(x, "It has none.") == 3.0
    assert jax.hessian(value)(x, "") == 2.0
    for twice in (jax.hessian(value), jax.grad(jax.grad(value))):
        with pytest.raises(ValueError, match="It has none"):
            twice(x, "It has none.")
