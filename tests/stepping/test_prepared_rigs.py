"""Rigs made ready to march: what they share is computed once, and they are what each is alone."""

import jax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.ensemble.lanes import stacked
from vibrojax.stepping.prepared_rigs import MANY, _own_and_shared, rigs_of


@pytest.mark.parametrize("name", ["gap", "taper"])
def test_rigs_that_share_numbers_are_what_each_is_alone(name):
    low, high = {"gap": (1e-4, 1e-3), "taper": (0.1, 0.8)}[name]
    values = np.linspace(low, high, MANY)
    systems = [vj.default_rig(**{name: value}, num_modes=1) for value in values]
    own, shared = _own_and_shared(stacked(systems))
    assert len(jax.tree.leaves(own)) == 1
    assert all(np.ndim(leaf) == 0 for leaf in jax.tree.leaves(shared))
    rigs = rigs_of(stacked(systems))
    for k in (0, MANY - 1):
        alone = rigs_of(stacked(systems[k : k + 1]))
        for one, many in zip(jax.tree.leaves(alone), jax.tree.leaves(rigs), strict=True):
            np.testing.assert_allclose(many[k], one[0], rtol=1e-9, atol=1e-300)


def test_few_rigs_and_equal_ones_are_not_split():
    few = stacked([vj.default_rig(gap=gap, num_modes=1) for gap in (1e-4, 2e-4)])
    equal = stacked([vj.default_rig(num_modes=1)] * MANY)
    for systems in (few, equal):
        own, shared = _own_and_shared(systems)
        assert jax.tree.structure(own) == jax.tree.structure(systems)
        assert not jax.tree.leaves(shared)
