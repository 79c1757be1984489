import jax.numpy as jnp
import numpy as np
import pytest
from analytic import Analytic

from vibrojax.design.robust import Robust, RobustEvaluator, Tolerance

TOLERANCES = {"gap": Tolerance(0.2), "stiffness": Tolerance(0.3, relative=True)}
FUNCTIONS = {
    "force": lambda x: jnp.exp(0.3 * x[0]) * x[1] ** 1.5 + x[2] * x[0] ** 2,
    "width": lambda x: x[0] * x[1] - 0.5 * x[1] ** 2 + jnp.sin(x[2]),
}
NAMES = ("gap", "stiffness", "mass")
PLACES = np.array([[1.0, 2.0, 0.3], [0.4, 1.1, -0.7]])
UP_AND_DOWN = (1, -1)


def judged(robust, names=NAMES, held=None, worse=UP_AND_DOWN, **inner):
    evaluator = Analytic(NAMES, inner.pop("functions", FUNCTIONS), **inner)
    return RobustEvaluator(evaluator, names, robust, worse, held)


@pytest.mark.parametrize(
    "robust",
    [
        Robust(TOLERANCES),
        Robust(TOLERANCES, "mean"),
        Robust(TOLERANCES, "quantile"),
        Robust(TOLERANCES, "quantile", quantile=0.37, rigs=7, seed=2),
    ],
)
def test_slopes_are_those_of_finite_differences(robust):
    evaluator = judged(robust)
    found = evaluator.evaluate(PLACES)
    assert len(evaluator.inner.batches) == 1
    step = 1e-6
    moved = [p + way * step * row for p in PLACES for row in np.eye(3) for way in (1, -1)]
    values = np.array([one.values for one in evaluator.evaluate(np.array(moved), slopes=False)])
    values = values.reshape(2, 3, 2, 2)
    wanted = (values[:, :, 0] - values[:, :, 1]).transpose(0, 2, 1) / (2 * step)
    for one, slopes in zip(found, wanted, strict=True):
        assert one.slopes == pytest.approx(slopes, rel=1e-6, abs=1e-7)
        assert one.note == ""


def test_the_worst_is_at_the_corner_where_functions_are_monotonic():
    (one,) = judged(Robust(TOLERANCES)).evaluate(PLACES[:1])
    assert one.values[0] == pytest.approx(FUNCTIONS["force"](np.array([1.2, 2.6, 0.3])))
    corners = [(gap, stiffness, 0.3) for gap in (0.8, 1.2) for stiffness in (1.4, 2.6)]
    assert one.values[1] == pytest.approx(min(FUNCTIONS["width"](np.array(c)) for c in corners))


def test_mean_and_quantile_of_a_linear_function():
    functions = {"line": lambda x: 3.0 * x[0] + x[1]}
    gap = {"gap": Tolerance(0.5)}
    mean = judged(Robust(gap, "mean"), functions=functions, worse=[1])
    (one,) = mean.evaluate(PLACES[:1])
    assert one.values == pytest.approx(5.0, rel=1e-14)
    assert one.slopes[0] == pytest.approx([3.0, 1.0, 0.0])
    for worse in (1, -1):
        robust = Robust(gap, "quantile", quantile=0.9, rigs=512)
        (one,) = judged(robust, functions=functions, worse=[worse]).evaluate(PLACES[:1])
        assert one.values == pytest.approx(5.0 + worse * 0.8 * 1.5, abs=0.01)


def test_quantile_is_that_of_numpy():
    robust = Robust(TOLERANCES, "quantile", quantile=0.8, rigs=10)
    evaluator = judged(robust)
    (one,) = evaluator.evaluate(PLACES[:1])
    rigs = PLACES[0] + np.pad(robust.nodes() * [0.2, 0.6], ((0, 0), (0, 1)))
    values = np.array([[f(rig) for f in FUNCTIONS.values()] for rig in rigs])
    wanted = [np.quantile(values[:, 0], 0.8), np.quantile(values[:, 1], 0.2)]
    assert one.values == pytest.approx(wanted)


def test_a_number_held_fixed_may_have_a_tolerance():
    robust = Robust(TOLERANCES)
    whole = judged(robust).evaluate(PLACES)
    part = judged(robust, ["mass", "gap"], {"stiffness": 2.0}).evaluate(PLACES[:1, [2, 0]])
    assert part[0].values == pytest.approx(whole[0].values)
    assert part[0].slopes == pytest.approx(whole[0].slopes[:, [2, 0]])


def test_of_many_corners_the_worst_of_first_order_is_tried():
    names = [f"n{k}" for k in range(6)]
    slopes = np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0])
    functions = {"up": lambda x: slopes @ x, "down": lambda x: jnp.sinh(slopes @ x)}
    inner = Analytic(names, functions)
    robust = Robust(dict.fromkeys(names, Tolerance(0.1)))
    evaluator = RobustEvaluator(inner, names, robust, UP_AND_DOWN)
    found = evaluator.evaluate(np.stack([np.zeros(6), np.ones(6)]))
    assert inner.batches[0] == 2  # as designed, then the others
    assert len(inner.batches) == 2
    assert found[0].values == pytest.approx([2.1, -np.sinh(2.1)])
    assert found[1].values == pytest.approx([-0.9, -np.sinh(5.1)])
    assert found[1].slopes[1] == pytest.approx(np.cosh(5.1) * slopes)


def test_a_rig_without_a_value_makes_the_statistic_none():
    def lost(place):
        return "It never touches." if place[0] > 1.19 else ""

    first, second = judged(Robust(TOLERANCES), lost=lost).evaluate(PLACES)
    assert np.isnan(first.values).all()
    assert np.isnan(first.slopes).all()
    assert first.note == (
        "Of 21 rigs within the tolerances that with gap = 1.2, stiffness = 1.4 has no force: It "
        "never touches."
    )
    assert np.isfinite(second.values).all()


def test_where_rigs_are_equally_bad_the_first_counts():
    functions = {"valley": lambda x: x[0] ** 2}
    evaluator = judged(Robust({"gap": Tolerance(1.0)}), functions=functions, worse=[1])
    (one,) = evaluator.evaluate(np.zeros((1, 3)))
    assert one.values == pytest.approx(1.0)
    assert one.slopes[0] == pytest.approx([-2.0, 0.0, 0.0])
    assert evaluator.evaluate(np.empty((0, 3))) == []


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: Tolerance(0.0), "width must be above 0"),
        (lambda: Tolerance(20.0, relative=True), "width must be below 1, a share.*For 20 % give"),
        (lambda: Tolerance("5 %"), "width must be a number, got '5 %'"),
        (lambda: Robust({}), "tolerances is empty"),
        (lambda: Robust({"gap": 0.1}), r"tolerances\['gap'\] must be a Tolerance, got 0.1"),
        (lambda: Robust(TOLERANCES, "median"), "statistic must be one of 'worst', 'mean', 'quant"),
        (lambda: Robust(TOLERANCES, quantile=90), "quantile must be above 0 and below 1, got 90"),
        (lambda: Robust(TOLERANCES, rigs=1), "rigs must be a whole number of at least 2"),
        (lambda: judged(Robust({"gpa": Tolerance(0.1)})), "Unknown number 'gpa' in tolerances"),
        (lambda: judged(Robust(TOLERANCES), ["gap", "mass"]), "stiffness has a tolerance but no v"),
        (lambda: judged(Robust(TOLERANCES), worse=[1, 0]), "worse must be 1 or -1 for each of 2"),
    ],
)
def test_wrong_calls(made, said):
    with pytest.raises(ValueError, match=said):
        made()
