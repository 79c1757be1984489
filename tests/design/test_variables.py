"""What a design varies, and what it may not do: coordinates, bounds, and refusals."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.design.constraints import Constraint, named_functions
from vibrojax.design.settings import OptimiseSettings
from vibrojax.design.variables import check_bounds, check_numbers, variables_of


def test_coordinates_go_from_0_to_1_and_are_logarithmic_where_bounds_are_apart():
    held = variables_of({"gap": (1e-4, 1e-3), "taper": vj.Range(0.0, 0.8, 0.2), "mass": (1, 9)})
    assert held.logarithmic.tolist() == [True, False, False]
    assert held.given
    np.testing.assert_allclose(held.start, [10**-3.5, 0.2, 5.0])
    places = np.array([[0.0, 0.0, 0.0], [0.25, 0.5, 0.75], [1.0, 1.0, 1.0]])
    numbers = held.numbers(places)
    np.testing.assert_allclose(numbers[1], [1e-4 * 10**0.25, 0.4, 7.0])
    assert numbers[0].tolist() == [1e-4, 0.0, 1.0]  # not beyond a bound by rounding
    assert numbers[2].tolist() == [1e-3, 0.8, 9.0]
    np.testing.assert_allclose(held.places(numbers), places, atol=1e-14)
    step = 1e-6
    slope = (held.numbers(places[1] + step) - held.numbers(places[1] - step)) / (2 * step)
    np.testing.assert_allclose(held.stretch(numbers[1]), slope, rtol=1e-8)


def test_the_user_says_what_is_logarithmic():
    held = variables_of({"gap": (1e-4, 1e-3), "mass": (1.0, 9.0)}, logarithmic=["mass"])
    assert held.logarithmic.tolist() == [False, True]


@pytest.mark.parametrize(
    ("variables", "logarithmic", "words"),
    [
        ({}, None, "variables is empty"),
        ({"gap": (1e-3, 1e-4)}, None, r"variables\['gap'\] .* got the high bound first"),
        ({"gap": (1.0, 1.0)}, None, "got the same twice"),
        ({"gap": (0.0, np.inf)}, None, "two finite numbers"),
        ({"gap": (0.0, np.nan)}, None, "two finite numbers"),
        ({"gap": 1e-3}, None, r"two finite numbers, got 0.001. Give \(low, high\)"),
        ({"gap": (1, 2, 3)}, None, "two finite numbers"),
        ({"gap": (1, "2")}, None, "two finite numbers"),
        ({"gap": (0.0, 1.0)}, ["gap"], "got a low bound of 0. Raise it"),
        ({"gap": (0.0, 1.0)}, ["gab"], "Did you mean 'gap'"),
    ],
)
def test_bounds_that_are_none_are_refused(variables, logarithmic, words):
    with pytest.raises(ValueError, match=words):
        variables_of(variables, logarithmic)


@pytest.mark.parametrize(
    ("variables", "numbers", "words"),
    [
        ({"gpa": (1e-4, 1e-3)}, {}, "Unknown argument 'gpa' .* in variables. Did you mean 'gap'"),
        ({"gap": (1e-4, 1e-3)}, {"gap": 1e-3}, "gap is given twice"),
        ({"gap": (1e-4, 1e-3)}, {"taper": [0.1, 0.2]}, "taper must be one value that stays"),
        ({"gap": (1e-4, 1e-3)}, {"taper": vj.Range(0.1, 0.2)}, "What varies goes into variables"),
        ({"gap": (1e-4, 1e-3)}, {"tapper": 0.1}, "Did you mean 'taper'"),
    ],
)
def test_numbers_that_the_function_does_not_take_are_refused(variables, numbers, words):
    with pytest.raises(ValueError, match=words):
        check_numbers(vj.default_rig, variables_of(variables), numbers)


def test_rigs_are_built_at_the_bounds():
    held = variables_of({"taper": (0.0, 1.2), "gap": (1e-4, 1e-3)})
    with pytest.raises(ValueError, match=r"variables\['taper'\] .* no rig, 1.2: taper must be"):
        check_bounds(lambda place: vj.default_rig(**held.by_name(place)), held)


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ({}, "needs a bound"),
        ({"least": 2.0, "most": 1.0}, "least must be at most 1"),
        ({"most": np.nan}, "most must be a finite number"),
    ],
)
def test_constraints_that_bound_nothing_are_refused(bounds, words):
    with pytest.raises(ValueError, match=words):
        Constraint(len, **bounds)
    with pytest.raises(ValueError, match="function must be a function"):
        Constraint(3.0, most=1.0)


def test_functions_have_different_names():
    def force(response):
        return response

    bounds = [Constraint(force, most=1.0), Constraint(force, least=0.0)]
    found = named_functions({"objective": len}, [*bounds, Constraint(lambda r: r, most=1)])
    assert list(found) == ["objective", "force", "force_2", "constraint"]
    with pytest.raises(ValueError, match="'objective' is given to two functions"):
        named_functions({"objective": len}, [Constraint(force, most=1.0, name="objective")])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"starts": 0}, "starts must be a whole number"),
        ({"method": "Newton"}, "method must be one of 'SLSQP', 'trust-constr'"),
        ({"tolerance": 1.0}, "tolerance must be from"),
        ({"seed": -1}, "seed must be"),
    ],
)
def test_settings_that_cannot_work_are_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        OptimiseSettings(**wrong)
