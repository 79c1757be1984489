"""Refusals of frequencies and drives fit the study that is called."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax._tools.checks import check_frequencies
from vibrojax.ensemble.frequencies import check_drive

STILL = vj.default_rig(base_amplitude=0.0)
AT, FALLING = {"frequency_ratio": [1.0, 1.1]}, {"frequency_ratio": [1.1, 1.0]}
STUDIES = {
    "regimes": vj.regimes,
    "map of periodic responses": lambda rig, **at: vj.parameter_map(
        lambda: rig, response=vj.PeriodicSettings(), **at
    ),
    "continue_response": lambda rig, **at: vj.continue_response(
        rig, frequency_ratio=vj.Range(*at["frequency_ratio"])
    ),
}


@pytest.mark.parametrize("study", STUDIES)
def test_only_sweeps_speak_of_sweeps_without_a_drive(study):
    with pytest.raises(ValueError, match=r"^This study needs a drive with an amplitude above 0"):
        STUDIES[study](STILL, **AT)
    with pytest.raises(ValueError, match=r"^A frequency sweep needs a drive with an amplitude"):
        vj.frequency_sweep(STILL, **AT)
    with pytest.raises(ValueError, match=r"^This study needs a drive"):
        check_drive(STILL)


@pytest.mark.parametrize(
    "study", [vj.frequency_sweep, vj.regimes, vj.single_contact_response], ids=lambda f: f.__name__
)
def test_frequencies_that_fall(study):
    said = r"^frequency_ratio must increase .*, got 1.1 then 1.0 at index 1. Sort it; (?!.*sweep)"
    with pytest.raises(ValueError, match=said):
        study(vj.default_rig(), **FALLING)
    with pytest.raises(ValueError, match=r"at index 1. Sort it\.$"):
        vj.Tones([2.0, 1.0])


@pytest.mark.parametrize("values", [[], [None]])
@pytest.mark.parametrize("unit", ["(ratio)", "Hz"])
def test_units_stand_in_one_pair_of_brackets(values, unit):
    with pytest.raises(ValueError, match=r"^place (is empty|must be a sequence)") as refused:
        check_frequencies("place", values, unit)
    bare = unit.strip("()")
    assert f" ({bare})" in str(refused.value)
    with pytest.raises(ValueError, match=r"^place must be above 0 .*, got -1.0 at index 0") as low:
        check_frequencies("place", np.array([-1.0]), unit)
    assert f" {unit}," in str(low.value)
