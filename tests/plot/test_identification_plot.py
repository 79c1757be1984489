import sys

import numpy as np
import pytest

from vibrojax.identification.fitted_data import fitted_data
from vibrojax.identification.identification import Identification
from vibrojax.identification.profile import Profile
from vibrojax.identification.trial_rigs import Curve
from vibrojax.measured.curve import MeasuredCurve
from vibrojax.measured.history import MeasuredHistory
from vibrojax.plot.identification import plot_profiles

# A curve that leans to the right: up to 1.2, back to 1.1, and on.
CURVE = np.r_[np.linspace(0.9, 1.2, 31), np.linspace(1.19, 1.1, 10), np.linspace(1.11, 1.3, 20)]
HEIGHT = np.r_[np.linspace(2.0, 20.0, 31), np.linspace(19.0, 6.0, 10), np.linspace(5.5, 3.0, 20)]


def prediction(measured, forces=False, unit=1.0, points=61):
    channels = np.stack([HEIGHT, HEIGHT / 2], axis=1)[:points, : 1 + forces]
    continues = np.arange(points) < points - 1
    made = Curve(CURVE[:points] * unit, channels, channels, continues)
    return fitted_data(measured, np.linspace(-2.5, 2.5, measured.size), made)


def curve(**changed):
    frequency = np.r_[np.linspace(0.92, 1.28, 10), np.linspace(1.28, 0.92, 10)]
    fields = {
        "frequency": frequency,
        "frequency_name": "frequency_ratio",
        "amplitude": np.interp(frequency, np.sort(CURVE), HEIGHT[np.argsort(CURVE)]),
        "direction": np.repeat([1, -1], 10),
    }
    return MeasuredCurve(**(fields | changed))


def fitted(measured=None, predictions=None, **changed):
    """An identification that nobody made."""
    measured = (curve(),) if measured is None else measured
    bound = "not identifiable: the data only bound it, at most 0.62 (95 %)"
    fields = {
        "estimate": {"stiffness": 5402.0, "damping": 0.2},
        "interval": {"stiffness": (5192.0, 5620.0), "damping": (0.0, 0.62)},
        "identifiability": {"stiffness": "identifiable", "damping": bound},
        "identifiable": {"stiffness": True, "damping": False},
        "standard_deviation": {"stiffness": 105.0, "damping": 0.2},
        "covariance": np.eye(2),
        "correlation": np.eye(2),
        "chi_square": 19.8,
        "degrees_of_freedom": 18,
        "confidence": 0.95,
        "measured": measured,
        "predictions": predictions or tuple(prediction(m) for m in measured),
        "alternatives": (),
        "warnings": (),
        "notes": (),
        "evaluations": 8,
        "problem": None,
        "repetition": 0,
        "frequency_scale": 1e-3,
        "point": np.zeros(2),
        "call": {},
    }
    return Identification(**(fields | changed))


def profile(name="stiffness", values=None, **changed):
    values = np.linspace(5100.0, 5700.0, 9) if values is None else values
    fields = {
        "values": values,
        "rise": np.linspace(-2.5, 2.5, len(values)) ** 2,
        "others": {},
        "threshold": 3.84,
        "interval": (float(values[1]), float(values[-2])),
        "confidence": 0.95,
        "estimate": float(values[len(values) // 2]),
    }
    return Profile(name=name, **(fields | changed))


def texts(axes):
    return [t.get_text() for t in axes.texts]


def legend(figure):
    return [t.get_text() for t in figure.legends[0].get_texts()]


def lines(axes, style):
    return [line for line in axes.lines if line.get_linestyle() == style and len(line.get_xdata())]


def test_a_curve():
    figure = fitted().plot()
    top, residuals, below = figure.axes
    assert (
        top.get_ylabel() == "Displacement, amplitude\n(max\u00a0−\u00a0min)/2 over drive amplitude"
    )
    assert residuals.get_xlabel() == "Drive frequency over first natural frequency"
    assert legend(figure) == [
        "measured, forward sweep",
        "measured, backward sweep",
        "fitted",
        "fitted, between folds",
        "fold of the fitted curve",
        "±2 standard deviations",
    ]
    assert texts(top) == ["backward fold 1.1", "forward fold 1.2"]
    written = texts(below)
    for words in ("stiffness", "5402", "5192 to 5620", "identifiable", "0 to 0.62"):
        assert words in written
    assert written[-1] == "reduced chi-square 1.100 (18 degrees of freedom), 20 points"
    figure.savefig("/dev/null", format="png")


def test_the_curve_is_whole_and_dashed_between_its_folds():
    axes = fitted().plot().axes[0]
    solid = [line for line in lines(axes, "-") if len(line.get_xdata()) > 5]
    (back,) = [line for line in lines(axes, "--") if len(line.get_xdata()) > 5]
    assert [len(line.get_xdata()) for line in solid] == [31, 21]
    assert back.get_xdata()[0] == pytest.approx(1.2)
    assert back.get_xdata()[-1] == pytest.approx(1.1)
    folds = [k for k in axes.lines if k.get_marker() == "o" and len(k.get_xdata())]
    assert [line.get_xydata()[0].tolist() for line in folds] == [
        [pytest.approx(1.2), 20.0],
        [pytest.approx(1.1), 6.0],
    ]


def test_a_break_is_not_bridged():
    made = prediction(curve())
    made["curve_continues"][20] = 0
    axes = fitted(predictions=(made,)).plot().axes[0]
    solid = [line for line in lines(axes, "-") if len(line.get_xdata()) > 5]
    assert [len(line.get_xdata()) for line in solid] == [21, 10, 21]


def test_directions_have_their_own_markers():
    measured = curve(direction=np.r_[np.zeros(5, int), np.ones(5, int), -np.ones(10, int)])
    figure = fitted((measured,)).plot()
    for axes in figure.axes[:2]:
        counts = {k.get_marker(): len(k.get_xdata()) for k in axes.lines if len(k.get_xdata()) > 2}
        assert (counts[">"], counts["<"], counts["o"]) == (5, 10, 5)
    assert "measured, unknown direction" in legend(figure)


def test_units_and_contact_force():
    measured = curve(
        frequency=9.0 * curve().frequency,
        frequency_name="frequency",
        quantity="rms",
        signal="acceleration",
        is_ratio=False,
        frame="absolute",
        contact_force=np.linspace(0.0, 5.0, 20),
        parameters={"gap": 4e-4},
        label="run 3",
    )
    figure = fitted((measured,), (prediction(measured, True, 9.0),)).plot()
    top, force, residuals, _ = figure.axes
    assert top.get_ylabel().replace("\n", " ") == "Absolute acceleration, root mean square (m/s2)"
    assert force.get_ylabel() == "Largest contact force (N)"
    assert residuals.get_xlabel() == "Drive frequency (Hz)"
    assert "forward fold 10.8 Hz" in texts(top)
    assert top.get_title(loc="left") == "run 3, gap = 0.0004 m"


def test_force_alone():
    measured = curve(amplitude=None, contact_force=np.linspace(0.0, 5.0, 20))
    figure = fitted((measured,)).plot()
    assert figure.axes[0].get_ylabel() == "Largest contact force (N)"
    assert len(figure.axes) == 3


def test_warnings_are_their_first_sentences():
    many = ("The sweep jumped early: 3 points at 1.2. Its place says nothing.", "b.", "c.", "d.")
    written = texts(fitted(warnings=many).plot().axes[-1])
    assert "Warning: The sweep jumped early: 3 points at 1.2." in written
    assert written[-1] == "and 1 more warning: print the fit to read them."


def test_a_long_sentence_stays_in_the_picture():
    long = "not identifiable: " + "the data know it only with others, " * 8
    fit = fitted(identifiability={"stiffness": long, "damping": "identifiable"})
    figure = fit.plot()
    figure.canvas.draw()
    for text in figure.axes[-1].texts:
        box = text.get_window_extent()
        assert box.x1 < figure.bbox.x1
        assert box.y0 > 0


def test_a_curve_that_was_lost():
    figure = fitted(predictions=(prediction(curve(), points=0),)).plot()
    assert "fitted" not in legend(figure)
    figure.canvas.draw()


def test_a_history_among_others():
    time = np.linspace(0.0, 1.0, 50)
    history = MeasuredHistory(
        time=time,
        displacement=np.sin(time),
        contact_force=np.cos(time),
        frequency=9.0,
        window=(0.5, 1.0),
    )
    count = history.windowed().size
    residual = np.r_[np.full(count, 1.0), np.full(count, -1.0)]
    fit = fitted((curve(), history), (prediction(curve()), fitted_data(history, residual)))
    figure = fit.plot(1)
    first, below, second, last, _ = figure.axes
    assert first.get_title(loc="left") == "measurement 2 of 2"
    assert first.get_ylabel() == "Displacement\n(m)"
    assert second.get_ylabel() == "Contact force\n(N)"
    assert last.get_xlabel() == "Time (s)"
    assert set(below.lines[0].get_ydata()) == {1.0}
    assert set(last.lines[0].get_ydata()) == {-1.0}
    assert last.lines[0].get_xdata()[0] >= 0.5
    # A residual is measured less fitted, over the deviation.
    inside = time >= 0.5
    for axes, signal, r in ((first, np.sin(time), 1.0), (second, np.cos(time), -1.0)):
        measured, fitted_line = (line.get_ydata() for line in axes.lines)
        deviation = history.noise().deviation["displacement" if r > 0 else "contact_force"]
        assert measured == pytest.approx(signal[inside])
        assert measured - fitted_line == pytest.approx(np.full(count, r * deviation))


@pytest.mark.parametrize("measurement", [1, -1])
def test_no_such_measurement(measurement):
    with pytest.raises(ValueError, match="measurement must be"):
        fitted().plot(measurement)


def test_a_profile():
    figure = profile().plot()
    (axes,) = figure.axes
    assert axes.get_xlabel() == "stiffness (SI)"
    assert axes.get_xscale() == "linear"
    assert axes.get_title(loc="left") == "5400  (5175 to 5625)"
    assert legend(figure) == [
        "others refitted",
        "95 % threshold, 3.84",
        "95 % interval",
        "estimate",
    ]
    curve = axes.lines[0].get_xydata()
    assert curve[:, 1].min() == pytest.approx(0.0, abs=1e-3)
    assert curve[0].tolist() == [5100.0, 6.25]


def test_a_profile_over_decades():
    axes = profile("damping", np.geomspace(1e-5, 1.0, 9)).plot().axes[0]
    assert axes.get_xscale() == "log"
    low, high = axes.get_ylim()
    assert low < 0.0 < 6.25 < high


def test_a_profile_that_reaches_zero_is_linear():
    assert profile("damping", np.linspace(0, 1, 9)).plot().axes[0].get_xscale() == "linear"


def test_profiles_share_their_height():
    steep = profile("gap", rise=np.linspace(-4.0, 4.0, 9) ** 2)
    many = [profile(), steep, profile("damping"), profile("taper"), profile("e")]
    figure = plot_profiles([one.to_xarray() for one in many])
    shown = [axes for axes in figure.axes if axes.axison]
    assert [axes.get_xlabel()[:-5] for axes in shown] == [
        "stiffness",
        "gap",
        "damping",
        "taper",
        "e",
    ]
    assert len({axes.get_ylim() for axes in shown}) == 1
    assert shown[0].get_ylim()[1] > 16
    figure.canvas.draw()
    with pytest.raises(ValueError, match="at least one profile"):
        plot_profiles([])


def test_pictures_need_no_pyplot():
    fitted().plot()
    assert "matplotlib.pyplot" not in sys.modules
