import io
import sys

import jax
import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

import vibrojax as vj
from vibrojax.plot.style import show_zero
from vibrojax.sweep.frequency_response import CURVES

FREQUENCIES = np.linspace(0.8, 1.4, 61)
JUMPS = 1.0963, 1.2267  # up (backward), down (forward)


def response(axes=None, axis="frequency_ratio", directions=("forward", "backward"), **changed):
    """A hysteretic curve without a sweep."""
    shape = tuple(len(v) for v in (axes or {}).values())
    low = 1.0 / np.abs(1.0 - FREQUENCIES**2 + 0.05)
    high = 5.0 + 20.0 * (FREQUENCIES - 0.8)
    up, down = JUMPS
    curves = {
        "forward": np.where(down > FREQUENCIES, high, low),
        "backward": np.where(up > FREQUENCIES, high, low),
    }
    scale = np.linspace(1.0, 2.0, int(np.prod(shape))).reshape(shape)
    amplitude = scale[..., None, None] * np.stack([curves[d] for d in directions])
    whole = np.ones(amplitude.shape, int)
    unit = 10.0 if axis == "frequency" else 1.0
    fields = dict.fromkeys(CURVES, amplitude) | {
        "period": whole,
        "status": 0 * whole,
        "periods_marched": 50 * whole,
        "steps": 4000 * whole,
    }
    lanes = np.ones(shape)
    fields |= {
        "axis": axis,
        "frequencies": FREQUENCIES * unit,
        "directions": directions,
        "axes": {k: np.asarray(v, float) for k, v in (axes or {}).items()},
        "ratio_units": "1",
        "natural_frequency": 10.0 * lanes,
        "jump_up": up * unit * lanes,
        "jump_down": down * unit * lanes,
        "jump_up_bracket": np.stack([up * unit * lanes] * 2, axis=-1),
        "jump_down_bracket": np.stack([down * unit * lanes] * 2, axis=-1),
        "attributes": {},
    }
    return vj.sweep.FrequencyResponse(**(fields | changed))


def texts(figure):
    axes = figure.axes[0]
    return [t.get_text() for t in axes.texts if t.get_text()]


def legend(figure):
    return [t.get_text() for t in figure.legends[0].get_texts()]


def png(figure):
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


def width_of(data):
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(data[16:20])


def test_both_directions_with_their_jumps():
    figure = response().plot()
    assert texts(figure) == ["jump up 1.0963", "jump down 1.2267"]
    assert legend(figure) == ["forward sweep", "backward sweep"]
    assert figure.axes[0].get_xlabel() == "Drive frequency over first natural frequency"
    markers = {line.get_marker() for line in figure.axes[0].lines}
    assert {">", "<"} <= markers
    assert width_of(png(figure)) == 1500


def test_in_hertz():
    figure = response(axis="frequency").plot("contact_force")
    assert texts(figure) == ["jump up 10.963 Hz", "jump down 12.267 Hz"]
    assert figure.axes[0].get_xlabel() == "Drive frequency (Hz)"
    assert figure.axes[0].get_ylabel() == "Largest contact force (N)"


def test_receptances_have_their_unit():
    assert "(m/N)" in response(ratio_units="m/N").plot().axes[0].get_ylabel()


def test_no_text_is_small_or_outside_the_picture():
    figure = response(axes={"gap": [1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4]}).plot()
    png(figure)
    drawn = [t for t in figure.findobj(matplotlib.text.Text) if t.get_text() and t.get_visible()]
    assert min(t.get_fontsize() for t in drawn) >= 10
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.width
    # The legend is below the axis label.
    assert box.y1 <= figure.axes[0].xaxis.label.get_window_extent().y0


@pytest.mark.parametrize("place", [0.82, 0.9, 1.1, 1.3, 1.38])
@pytest.mark.parametrize("apart", [0.002, 0.02, 0.1])
def test_jump_labels_neither_collide_nor_leave_the_axes(place, apart):
    figure = response(jump_up=np.array(place), jump_down=np.array(min(place + apart, 1.39))).plot()
    png(figure)
    boxes = [t.get_window_extent() for t in figure.axes[0].texts if t.get_text()]
    assert not boxes[0].overlaps(boxes[1])
    frame = figure.axes[0].get_window_extent()
    assert all(b.x0 >= frame.x0 and b.x1 <= frame.x1 for b in boxes)


def test_line_is_broken_at_a_jump():
    figure = response().plot(direction="forward")
    (line,) = [x for x in figure.axes[0].lines if len(x.get_xdata()) == len(FREQUENCIES) + 1]
    x, y = line.get_data()
    (gap,) = np.flatnonzero(np.isnan(y))
    assert x[gap - 1] < JUMPS[1] <= x[gap + 1]
    assert legend(figure) == ["forward sweep"]
    assert texts(figure) == ["jump down 1.2267"]


def test_unsettled_points_are_hollow_and_counted():
    status = np.zeros((2, len(FREQUENCIES)), int)
    status[0, 3:6], status[1, 10] = vj.Status.aperiodic.value, vj.Status.diverged.value
    figure = response(status=status).plot()
    assert legend(figure)[2:] == ["no period found (3 points)", "diverged (1 point)"]
    hollow = [x for x in figure.axes[0].lines if x.get_markerfacecolor() == "white"]
    assert sum(len(x.get_xdata()) for x in hollow) == 3


def test_nothing_jumps_and_everything_diverged():
    nan = np.full((2, len(FREQUENCIES)), np.nan)
    gone = np.full(nan.shape, vj.Status.diverged.value)
    none = np.array(np.nan)
    figure = response(amplitude_ratio=nan, status=gone, jump_up=none, jump_down=none).plot()
    assert texts(figure) == []
    assert width_of(png(figure)) == 1500


def test_one_axis_is_lines_of_colours():
    many = response(axes={"gap": [1e-4, 3e-4]})
    assert legend(many.plot())[:2] == ["gap = 0.0001 m", "gap = 0.0003 m"]
    one = many.plot(gap=2.7e-4)
    assert one.axes[0].get_title("left") == "gap = 0.0003 m"
    assert legend(one) == ["forward sweep", "backward sweep"]


def test_many_lines_have_a_colour_bar():
    figure = response(axes={"gap": np.linspace(1e-4, 1e-3, 12)}).plot()
    assert figure.axes[1].get_ylabel() == "Gap (m)"
    assert not any("gap" in text for text in legend(figure))


def test_axes_that_are_left_are_named():
    both = response(axes={"gap": [1e-4, 3e-4], "taper": [0.0, 0.5, 0.6]})
    with pytest.raises(ValueError, match="2 axes are left, gap and taper"):
        both.plot()
    figure = both.plot(taper=0.52)
    assert figure.axes[0].get_title("left") == "taper = 0.5"
    assert legend(figure)[:2] == ["gap = 0.0001 m", "gap = 0.0003 m"]


@pytest.mark.parametrize("variable", CURVES)
def test_every_variable(variable):
    assert width_of(png(response().plot(variable))) == 1500


@pytest.mark.parametrize(
    ("arguments", "selection", "sentence"),
    [
        (["amplitude"], {}, "Unknown variable 'amplitude'. Did you mean 'amplitude_ratio'"),
        (["jump_up"], {}, "Unknown variable 'jump_up'"),
        ([], {"gpa": 1.0}, "Unknown axis 'gpa'. Did you mean 'gap'"),
        ([], {"gap": "wide"}, "gap must be one number, got 'wide'"),
        ([], {"gap": [1e-4]}, "gap must be one number"),
        ([], {"gap": float("nan")}, "gap must be finite"),
        ([], {"direction": "up"}, "direction must be one of those swept, forward, backward"),
    ],
)
def test_refusals(arguments, selection, sentence):
    with pytest.raises(ValueError, match=sentence):
        response(axes={"gap": [1e-4, 3e-4]}).plot(*arguments, **selection)


def test_shows_itself_in_a_notebook_without_pyplot():
    data, metadata = response().plot()._repr_png_()
    assert width_of(data) == 1500
    assert metadata == {"width": 750}
    assert "matplotlib.pyplot" not in sys.modules


def test_a_curve_that_hardly_varies_has_room_above_it():
    """The axis begins at zero, so that a margin of its own range is none."""
    figure = Figure()
    axes = figure.subplots()
    axes.plot([1.0, 2.0], [0.3212, 0.3213])
    show_zero(axes)
    assert axes.get_ylim() == pytest.approx((0.0, 1.05 * 0.3213))


def test_modes():
    modes = vj.default_rig().modes()
    figure = modes.plot()
    assert legend(figure)[0] == "mode 1: 9.2103 Hz"
    shapes = [x for x in figure.axes[0].lines if len(x.get_xdata()) > 2]
    assert [np.abs(x.get_ydata()).max() for x in shapes] == [1.0] * 5
    batch = jax.tree.map(lambda a: a[None], modes)
    with pytest.raises(ValueError, match="batch of beams"):
        batch.plot()


def test_periods_have_whole_numbers_beside_them():
    axes = response().plot("period").axes[0]
    assert axes.get_ylim()[0] < 0 < axes.get_ylim()[1]
    ticks = axes.get_yticks()
    np.testing.assert_array_equal(ticks, np.round(ticks))
