"""Coexisting motions: found from many starts, and their branches."""

import numpy as np
import pytest

import vibrojax as vj


def test_refusals(rig):
    with pytest.raises(ValueError, match="one of the two"):
        vj.coexisting_responses(rig())
    with pytest.raises(ValueError, match="starts must be"):
        vj.coexisting_responses(rig(), frequency_ratio=1.1, starts=0)
    with pytest.raises(ValueError, match="size must be"):
        vj.coexisting_responses(rig(), frequency_ratio=1.1, size=-1.0)
    with pytest.raises(ValueError, match="Unknown argument"):
        vj.coexisting_responses(rig(), frequency_ratio=1.1, gap=1e-3)


@pytest.mark.slow
def test_both_motions_of_the_hysteresis_are_found_and_lie_on_one_branch(rig, small_branch):
    found = vj.coexisting_responses(rig(num_modes=1), frequency_ratio=1.15, starts=24)
    here = small_branch.resample([1.15])
    stable = np.asarray(here.amplitude_ratio)[np.asarray(here.stable) == 1]
    assert len(found.motions) == 2
    np.testing.assert_allclose(
        sorted(m.amplitude_ratio for m in found.motions), sorted(stable), rtol=1e-4
    )
    reached = np.concatenate([m.starts for m in found.motions])
    assert sorted([*reached, *found.aperiodic, *found.diverged]) == list(range(24))
    assert np.all(found.start_states[0] == 0)  # rest is among the starts
    again = vj.coexisting_responses(rig(num_modes=1), frequency_ratio=1.15, starts=24)
    assert [len(m.starts) for m in again.motions] == [len(m.starts) for m in found.motions]
    branches = found.branches((0.85, 1.4))
    assert len(branches) == 1  # the second motion lies on the branch of the first
    np.testing.assert_allclose(sorted(branches[0].folds), sorted(small_branch.folds), atol=1e-6)
    assert "from" in repr(found)
