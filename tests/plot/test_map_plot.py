import inspect
import io

import matplotlib
import numpy as np
import pytest
import xarray

from vibrojax.plot.map_plot import plot_map
from vibrojax.plot.map_summary import plot_map_summary

GAP = np.array([2e-4, 3e-4, 5e-4, 8e-4])
TAPER = np.array([0.0, 0.25, 0.5])
STIFFNESS = np.array([100.0, 1000.0, 10000.0, 100000.0])
FREQUENCY = np.linspace(0.8, 1.4, 31)
LANES = "settled aperiodic lost failed missing"
AMPLITUDE = "Half peak-to-peak displacement of the tip over drive"
RATIO = "Drive frequency over first natural frequency"


def named(name, units="1", **more):
    return {"long_name": name, "units": units} | more


def jumps():
    """Frequencies over gap and taper, without jumps at the largest gap."""
    down = np.broadcast_to(1.25 - 200 * GAP[:, None] - 0.05 * TAPER, (4, 3)).copy()
    up = down - 0.1
    down[-1] = up[-1] = np.nan
    return up, down


def make_map(**coordinates):
    """A map over gap and taper of hysteretic curves, or over others of the same lengths."""
    up, down = jumps()
    low, high = 1 / (0.3 + np.abs(1.05 - FREQUENCY**2)), 5 + 20 * (FREQUENCY - 0.8)
    below = [
        np.where(np.nan_to_num(j, nan=1.0)[..., None] > FREQUENCY, high, low) for j in (down, up)
    ]
    amplitude = np.stack(below, axis=-2)
    whole = np.ones(amplitude.shape, int)
    outer = ("gap", "taper")
    curve = (*outer, "direction", "frequency_ratio")
    flags = {"flag_values": [0, 1, 2, 3, 4], "flag_meanings": LANES}
    data = {
        "amplitude_ratio": (curve, amplitude, named(AMPLITUDE)),
        "contact_force": (curve, amplitude / 10, named("Largest contact force", "N")),
        "period": (curve, whole, named("Period of the motion")),
        "status": (curve, 0 * whole, named("How the lane ended")),
        "jump_up": (outer, up, named("Frequency at which the response jumps up")),
        "jump_down": (outer, down, named("Frequency at which the response jumps down")),
        "peak_amplitude_ratio": (outer, amplitude.max((-1, -2)), named("Peak amplitude ratio")),
        "peak_frequency": (outer, np.nan_to_num(down, nan=1.0), named("Peak frequency")),
        "largest_contact_force": (outer, amplitude.max((-1, -2)) / 10, named("Force", "N")),
        "hysteresis_width": (outer, np.nan_to_num(down - up), named("Hysteresis width")),
        "d_peak_d_gap": (outer, 1e4 * (GAP[:, None] - 4e-4) + TAPER, named("Gradient", "1/m")),
        "lane_status": (outer, np.zeros((4, 3), int), named("How the lane ended", **flags)),
        "lane_steps": (outer, np.full((4, 3), 1000), named("Cost")),
    }
    axes = {
        "gap": ("gap", GAP, named("Gap", "m")),
        "taper": TAPER,
        "direction": ["forward", "backward"],
        "frequency_ratio": ("frequency_ratio", FREQUENCY, named(RATIO)),
    }
    attributes = {"title": "a map of nothing", "rig": "Rig(\n  length=0.2,\n  width=0.1)"}
    return xarray.Dataset(data, axes | coordinates, attrs=attributes)


def over_stiffness():
    """The same map at every stiffness, stiffer ones higher."""
    one = make_map()
    parts = []
    for number in range(len(STIFFNESS)):
        part = one.copy(deep=True)
        part["peak_amplitude_ratio"] = one["peak_amplitude_ratio"] * (1 + number)
        parts.append(part)
    along = xarray.DataArray(STIFFNESS, dims="stiffness", attrs={"units": "N/m"})
    joined = xarray.concat(parts, xarray.Variable("stiffness", STIFFNESS, along.attrs))
    return joined.transpose("gap", "taper", "stiffness", ...)


def panels(figure):
    return [a for a in figure.axes if a.get_visible() and a.get_label() != "<colorbar>"]


def bar(figure):
    (axes,) = [a for a in figure.axes if a.get_label() == "<colorbar>"]
    return axes


def titles(figure):
    return [a.get_title() for a in panels(figure)]


def legend(figure):
    return [t.get_text() for t in figure.legends[0].get_texts()] if figure.legends else []


def mesh(axes):
    (found,) = [c for c in axes.collections if isinstance(c, matplotlib.collections.QuadMesh)]
    return found


def jump_lines(axes):
    return {line.get_gid(): line.get_xydata() for line in axes.lines if line.get_gid()}


def borders(axes):
    found = [c for c in axes.collections if isinstance(c, matplotlib.collections.LineCollection)]
    return np.concatenate([np.array(c.get_segments()) for c in found]) if found else np.empty(0)


def letters(axes):
    return {t.get_text() for t in axes.texts}


def page(figure):
    """Draw it, as nothing is drawn before."""
    figure.savefig(io.BytesIO(), format="png")
    return figure


def test_a_measure_over_its_two_parameters():
    figure = plot_map(make_map())
    (axes,) = panels(figure)
    assert axes.get_xlabel() == "Taper"
    assert axes.get_ylabel() == "Gap (m)"
    assert bar(figure).get_ylabel() == "Peak amplitude ratio"
    expected = make_map()["peak_amplitude_ratio"].values
    np.testing.assert_allclose(mesh(axes).get_array(), expected)


def test_cells_are_to_scale():
    figure = plot_map(make_map())
    corners = mesh(panels(figure)[0]).get_coordinates()
    middles = (GAP[1:] + GAP[:-1]) / 2
    np.testing.assert_allclose(corners[1:-1, 0, 1], middles)
    assert corners[0, 0, 1] == pytest.approx(1.5e-4)
    assert corners[-1, 0, 1] == pytest.approx(9.5e-4)


def test_values_that_grow_by_a_factor_have_a_logarithmic_axis():
    figure = plot_map(over_stiffness(), x="stiffness", taper=0.0)
    (axes,) = panels(figure)
    assert axes.get_xscale() == "log"
    assert axes.get_yscale() == "linear"
    assert axes.get_xlabel() == "Stiffness (N/m)"
    corners = mesh(axes).get_coordinates()[0, :, 0]
    np.testing.assert_allclose(corners, 10 ** np.arange(1.5, 6.0))


def test_unsorted_values_are_sorted_with_their_cells():
    turned = make_map().isel(gap=[2, 0, 3, 1])
    figure = plot_map(turned)
    expected = make_map()["peak_amplitude_ratio"].values
    np.testing.assert_allclose(mesh(panels(figure)[0]).get_array(), expected)


def test_curves_have_a_panel_for_each_direction():
    figure = plot_map(make_map(), "amplitude_ratio", taper=0.25)
    assert titles(figure) == ["forward sweep \u2192", "\u2190 backward sweep"]
    for axes in panels(figure):
        assert axes.get_xlabel().replace("\n", " ") == RATIO
    assert panels(figure)[0].get_ylabel() == "Gap (m)"
    assert bar(figure).get_ylabel().replace("\n", " ") == AMPLITUDE
    assert figure.get_suptitle() == "taper = 0.25"
    array = make_map()["amplitude_ratio"].sel(taper=0.25)
    for number, axes in enumerate(panels(figure)):
        np.testing.assert_allclose(mesh(axes).get_array(), array[:, number])


def test_jumps_are_lines_at_their_frequencies():
    figure = plot_map(make_map(), "amplitude_ratio", taper=0.5, direction="backward")
    (axes,) = panels(figure)
    up, down = jumps()
    lines = jump_lines(axes)
    np.testing.assert_allclose(lines["jump_up"][:, 0], up[:, 2])
    np.testing.assert_allclose(lines["jump_down"][:, 0], down[:, 2])
    np.testing.assert_allclose(lines["jump_up"][:, 1], GAP)
    assert {"jump up", "jump down"} <= set(legend(figure))
    styles = {line.get_gid(): line for line in axes.lines if line.get_gid()}
    assert styles["jump_up"].get_color() != styles["jump_down"].get_color()
    assert styles["jump_up"].get_marker() != styles["jump_down"].get_marker()


def test_jumps_follow_when_the_frequency_is_upright():
    figure = plot_map(
        make_map(), "amplitude_ratio", y="frequency_ratio", taper=0.0, direction="forward"
    )
    line = jump_lines(panels(figure)[0])["jump_down"]
    np.testing.assert_allclose(line[:, 0], GAP)
    np.testing.assert_allclose(line[:, 1], jumps()[1][:, 0])


def test_a_jump_without_neighbours_has_its_marker():
    lonely = make_map()
    lonely["jump_up"][:] = np.nan
    lonely["jump_up"][2, 0] = 1.1
    figure = plot_map(lonely, "amplitude_ratio", taper=0.0, direction="forward")
    (line,) = [x for x in panels(figure)[0].lines if x.get_gid() == "jump_up"]
    assert 2 in line.get_markevery()


def test_edges_between_periods_are_drawn_and_named():
    doubled = make_map()
    doubled["period"][..., 10:20] = 2
    figure = plot_map(doubled, "contact_force", taper=0.0, direction="forward")
    (axes,) = panels(figure)
    where = np.unique(borders(axes)[:, :, 0])
    np.testing.assert_allclose(where, [FREQUENCY[9:11].mean(), FREQUENCY[19:21].mean()])
    assert {"P1", "P2"} == letters(axes)
    assert "change of motion (Pn: period n)" in legend(figure)


def test_aperiodic_and_unstable_motion_is_marked():
    changed = make_map()
    changed["status"][:2, :, :, 25:] = 1
    changed["period"][:2, :, :, 25:] = 0
    changed["stable"] = xarray.ones_like(changed["amplitude_ratio"])
    changed["stable"][..., :10] = 0.0
    figure = plot_map(changed, "amplitude_ratio", taper=0.0, direction="forward")
    assert "aperiodic" in legend(figure)
    assert "change of motion (Pn: period n, U: unstable)" in legend(figure)
    assert "U" in letters(panels(figure)[0])
    marks = [x.get_xydata() for x in panels(figure)[0].lines if len(x.get_xdata()) == 12]
    np.testing.assert_allclose(np.unique(marks[0][:, 0]), FREQUENCY[25:])


def test_one_kind_of_motion_has_no_edges():
    figure = plot_map(make_map(), "amplitude_ratio", taper=0.0, direction="forward")
    assert not borders(panels(figure)[0]).size
    assert legend(figure) == ["jump up", "jump down"]


def test_edge_of_hysteresis_over_two_parameters():
    figure = plot_map(make_map())
    (axes,) = panels(figure)
    assert np.unique(borders(axes)[:, :, 1]) == pytest.approx(GAP[2:].mean())
    assert letters(axes) == {"H"}
    assert legend(figure) == ["edge of hysteresis (H: jumps)"]


def test_lanes_that_did_not_settle_are_marked():
    changed = make_map()
    changed["lane_status"][0, 1] = 1
    figure = plot_map(changed, "largest_contact_force")
    assert "some points aperiodic" in legend(figure)
    marks = [line.get_xydata().tolist() for line in panels(figure)[0].lines]
    assert [[TAPER[1], GAP[0]]] in marks


def test_cells_without_a_value_are_hatched_and_explained():
    holes = make_map()
    holes["peak_amplitude_ratio"][1, 1] = holes["peak_amplitude_ratio"][2, 2] = np.nan
    holes["lane_status"][1, 1], holes["lane_status"][2, 2] = 3, 4
    figure = plot_map(holes)
    (axes,) = panels(figure)
    assert axes.patch.get_hatch()
    assert "no value (failed: 1 lane, missing: 1 lane)" in legend(figure)
    assert np.ma.getmaskarray(mesh(axes).get_array()).sum() == 2
    assert not any("no value" in text for text in legend(plot_map(make_map())))


def test_whole_numbers_of_lost_lanes_are_no_value():
    lost = make_map()
    lost["period"][0, 0, 0, 10:], lost["period"][2, 1] = 2, 0
    lost["lane_status"][2, 1] = 4
    figure = plot_map(lost, "period", frequency_ratio=1.2, direction="forward")
    (axes,) = panels(figure)
    masked = np.ma.getmaskarray(mesh(axes).get_array())
    assert np.argwhere(masked).tolist() == [[2, 1]]
    assert "no value (missing: 1 lane)" in legend(figure)
    assert [t.get_text() for t in bar(figure).get_yticklabels()] == ["1", "2"]
    assert bar(figure).get_ylabel() == "Period of the motion"


def test_a_map_of_which_nothing_is_there_yet():
    empty = make_map()
    for name, array in empty.data_vars.items():
        if array.dtype.kind == "f":
            empty[name] = array.where(False)
    empty["lane_status"][:] = 4
    assert "no value (missing: 12 lanes)" in legend(page(plot_map(empty)))
    assert "12 missing (100.0 %)" in page(plot_map_summary(empty)).get_suptitle()
    page(plot_map(empty, "amplitude_ratio"))
    page(plot_map(empty, taper=0.0))


def test_axes_in_hertz():
    hertz = make_map().rename(frequency_ratio="frequency")
    hertz["frequency"].attrs.update(units="Hz", long_name="Drive frequency")
    for name in ("jump_up", "jump_down"):
        hertz[name].attrs["units"] = "Hz"
    figure = plot_map(hertz, "amplitude_ratio", taper=0.0, direction="forward")
    assert panels(figure)[0].get_xlabel() == "Drive frequency (Hz)"
    assert set(jump_lines(panels(figure)[0])) == {"jump_up", "jump_down"}
    figure = plot_map(hertz, "amplitude_ratio", taper=0.0, gap=2e-4)
    assert "jump down 1.21 Hz" in legend(figure)


def test_cells_without_a_jump_say_so():
    lost = make_map()
    lost["jump_up"][0], lost["jump_down"][0], lost["lane_status"][0] = np.nan, np.nan, 4
    figure = plot_map(lost, "jump_up")
    assert "no jump, or missing: 3 lanes" in legend(figure)
    # The edge is that of the lanes that do not jump, not of those that are missing.
    assert np.unique(borders(panels(figure)[0])[:, :, 1]) == pytest.approx(GAP[2:].mean())


def test_flags_have_their_names_on_the_bar():
    changed = make_map()
    changed["lane_status"][0, 1], changed["lane_status"][3, 2] = 1, 4
    figure = plot_map(changed, "lane_status")
    assert [t.get_text() for t in bar(figure).get_yticklabels()] == [
        "settled",
        "aperiodic",
        "missing",
    ]


def test_gradients_are_centred_at_zero():
    drawn = mesh(panels(plot_map(make_map(), "d_peak_d_gap"))[0])
    assert drawn.norm.vmin == -drawn.norm.vmax


def test_two_more_axes_are_rows_and_columns():
    figure = plot_map(make_map(), "amplitude_ratio")
    assert len(panels(figure)) == 6
    assert titles(figure)[:2] == [
        "taper = 0, forward sweep \u2192",
        "taper = 0, \u2190 backward sweep",
    ]
    assert titles(figure)[-1].startswith("taper = 0.5")
    limits = {mesh(axes).norm.vmax for axes in panels(figure)}
    assert len(limits) == 1
    page(figure)


def test_many_rows_are_put_beside_each_other():
    ten = make_map().isel(taper=[0] * 10).assign_coords(taper=np.arange(10) / 10)
    figure = plot_map(ten, "amplitude_ratio")
    rows, columns = panels(figure)[0].get_subplotspec().get_gridspec().get_geometry()
    assert (rows, columns) == (5, 4)
    assert titles(figure)[2] == "taper = 0.1\nforward sweep \u2192"
    page(figure)


def test_every_column_has_its_axis_named_at_its_end():
    five = make_map().isel(taper=[0] * 5).assign_coords(taper=np.arange(5) / 10)
    figure = page(plot_map(five, "contact_force", direction="forward"))
    assert len(panels(figure)) == 5
    named_there = [a for a in panels(figure) if "natural" in a.get_xlabel() + "".join(letters(a))]
    assert [a.get_title() for a in named_there] == ["taper = 0.2", "taper = 0.3", "taper = 0.4"]


def test_one_more_axis_is_a_grid_of_panels_with_units():
    figure = plot_map(over_stiffness())
    assert titles(figure) == [f"stiffness = {v} N/m" for v in ("100", "1000", "10000", "100000")]


def test_selection_takes_the_nearest_value_and_says_which():
    figure = plot_map(over_stiffness(), stiffness=900.0)
    assert figure.get_suptitle() == "stiffness = 1000 N/m"
    expected = make_map()["peak_amplitude_ratio"].values * 2
    np.testing.assert_allclose(mesh(panels(figure)[0]).get_array(), expected)


def test_a_frequency_can_be_selected():
    figure = plot_map(make_map(), "amplitude_ratio", frequency_ratio=1.1, direction="forward")
    (axes,) = panels(figure)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Taper", "Gap (m)")
    assert figure.get_suptitle() == "frequency_ratio = 1.1, forward sweep \u2192"


def test_maps_at_a_single_frequency():
    single = make_map().sel(frequency_ratio=1.1, method="nearest").drop_vars("peak_amplitude_ratio")
    figure = plot_map(single)
    assert titles(figure) == ["forward sweep \u2192", "\u2190 backward sweep"]
    assert figure.get_suptitle() == "frequency_ratio = 1.1"


def test_one_axis_left_is_a_line():
    figure = plot_map(make_map(), taper=0.5)
    (axes,) = figure.axes
    expected = make_map()["peak_amplitude_ratio"].sel(taper=0.5)
    np.testing.assert_allclose(axes.lines[0].get_xydata(), np.stack([GAP, expected], axis=1))
    assert axes.get_xlabel() == "Gap (m)"
    assert axes.get_ylabel() == "Peak amplitude ratio"
    assert figure.get_suptitle() == "taper = 0.5"


def test_lines_of_both_directions_differ_in_more_than_colour():
    changed = make_map()
    changed["status"][1, 1, 0, 4:6] = 1
    figure = plot_map(changed, "contact_force", taper=0.25, gap=3e-4)
    (axes,) = figure.axes
    forward, backward = [x for x in axes.lines if len(x.get_xdata()) == 31][:2]
    assert forward.get_linestyle() != backward.get_linestyle()
    assert forward.get_marker() != backward.get_marker()
    texts = ["forward sweep", "aperiodic", "backward sweep", "jump up 1.0775", "jump down 1.1775"]
    assert legend(figure) == texts
    assert axes.get_ylabel() == "Largest contact force (N)"
    page(figure)


def test_lines_leave_out_and_mark_what_is_missing():
    holes = make_map()
    holes["peak_amplitude_ratio"][1, 0] = np.nan
    figure = plot_map(holes, taper=0.0)
    assert "no value (1)" in legend(figure)
    cross = [x for x in figure.axes[0].lines if x.get_marker() == "x"]
    np.testing.assert_allclose(cross[0].get_xdata(), GAP[1])


def continued():
    """Branches: a second response at some frequencies, none for the third place."""
    several = make_map().rename(direction="crossing").drop_vars(["crossing", "lane_status"])
    several = several.pad(crossing=(0, 1)).assign_coords(crossing=[0, 1, 2])
    several["stable"] = xarray.ones_like(several["amplitude_ratio"])
    several["stable"][:, :, 1] = 0.0
    return several


def test_crossings_without_any_response_have_no_panel():
    figure = plot_map(continued(), "amplitude_ratio", taper=0.0)
    assert titles(figure) == ["crossing = 0", "crossing = 1"]


def test_crossings_along_a_line_are_points_and_hollow_where_unstable():
    figure = plot_map(continued(), "amplitude_ratio", taper=0.0, gap=2e-4)
    assert figure.axes[0].lines[0].get_linestyle() == "None"
    assert legend(figure)[:2] == ["responses, up to 2 at one frequency", "unstable"]


def test_axes_of_names_are_labelled_with_them():
    both = make_map().isel(taper=[0, 1]).assign_coords(taper=["consistent", "as_printed"])
    both = both.rename(taper="formulation")
    figure = plot_map(both)
    (axes,) = panels(figure)
    assert [t.get_text() for t in axes.get_xticklabels()] == ["consistent", "as_printed"]
    assert axes.get_xlabel() == "Formulation"
    assert plot_map(both, formulation="as_printed").get_suptitle() == "formulation = as_printed"
    with pytest.raises(
        ValueError, match="must be one of 'consistent', 'as_printed', got 'printed'"
    ):
        plot_map(both, formulation="printed")


def zipped():
    """Gap and stiffness along one dimension that has no coordinate of its own."""
    both = make_map().drop_vars("gap").rename_dims(gap="gap_stiffness")
    stiffness = ("gap_stiffness", STIFFNESS[::-1], named("Stiffness", "N/m"))
    return both.assign_coords(gap=("gap_stiffness", GAP, named("Gap", "m")), stiffness=stiffness)


def test_zipped_axes_take_either_name():
    (axes,) = panels(plot_map(zipped()))
    assert axes.get_ylabel() == "Gap (m), with stiffness"
    (axes,) = panels(plot_map(zipped(), y="stiffness"))
    assert axes.get_ylabel() == "Stiffness (N/m), with gap"
    expected = make_map()["peak_amplitude_ratio"].values[::-1]
    np.testing.assert_allclose(mesh(axes).get_array(), expected)
    assert plot_map(zipped(), gap=5e-4).get_suptitle() == "gap = 0.0005 m, stiffness = 1000 N/m"


def test_a_dimension_without_coordinates_is_counted():
    (axes,) = panels(plot_map(make_map().drop_vars("taper")))
    assert axes.get_xlabel() == "Taper"
    np.testing.assert_allclose(mesh(axes).get_coordinates()[0, :, 0], [-0.5, 0.5, 1.5, 2.5])


def test_repeated_values_are_drawn_one_by_one():
    figure = plot_map(make_map(taper=[0.0, 0.5, 0.5]))
    assert [t.get_text() for t in panels(figure)[0].get_xticklabels()] == ["0", "0.5", "0.5"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"variable": "peak_amplitude"}, "Unknown variable 'peak_amplitude'. Did you mean 'peak_a"),
        ({"x": "tapper"}, "Unknown axis 'tapper' of peak_amplitude_ratio. Did you mean 'taper'"),
        ({"x": "gap", "y": "gap"}, "x and y must be two axes, got 'gap' and 'gap'"),
        ({"gap": np.nan}, "gap must be finite, got nan"),
        ({"gap": "small"}, "gap must be one number, got 'small'"),
        ({"gap": [1e-4, 2e-4]}, "gap must be one number"),
        ({"gapp": 1.0}, "Unknown axis 'gapp'"),
        ({"direction": "forward"}, "peak_amplitude_ratio does not depend on direction"),
        (
            {"variable": "amplitude_ratio", "direction": "up"},
            "one of 'forward', 'backward', got 'up'",
        ),
        ({"x": "gap", "gap": 1e-4}, "is an axis of the picture and gap a selection along it"),
        ({"gap": 1e-4, "taper": 0.0}, "has a single value there"),
    ],
)
def test_refusals_say_what_is_allowed(arguments, message):
    with pytest.raises(ValueError, match=message):
        plot_map(make_map(), **arguments)


def test_zipped_refusals():
    with pytest.raises(ValueError, match="which lie along gap_stiffness"):
        plot_map(zipped(), x="gap", y="stiffness")
    with pytest.raises(ValueError, match="gap and stiffness go together along gap_stiffness"):
        plot_map(zipped(), gap=1e-4, stiffness=100.0)


def test_too_many_axes_or_panels_are_refused_with_a_way_out():
    message = r"3 axes are left over, taper \(3 values\) and stiffness .* stiffness=100\)"
    many = over_stiffness()
    with pytest.raises(ValueError, match=message):
        plot_map(many, "amplitude_ratio")
    long = many.isel(stiffness=[0] * 30).assign_coords(stiffness=np.arange(30.0))
    with pytest.raises(ValueError, match="30 panels would be left over, stiffness"):
        plot_map(long)


@pytest.mark.parametrize("draw", [plot_map, plot_map_summary])
def test_what_is_not_a_map_is_refused(draw):
    with pytest.raises(ValueError, match="none of its variables holds numbers over an axis"):
        draw(xarray.Dataset({"mass": 1.0}))
    unchecked = inspect.unwrap(draw)  # the tests' own check of types would come first
    with pytest.raises(ValueError, match=r"must be an xarray.Dataset.*got ndarray"):
        unchecked(np.zeros(3))


def outside(figure):
    """Texts that leave the picture, but for ticks, which matplotlib keeps beyond the axes."""
    page(figure)
    ticks = {t for a in figure.axes for t in (*a.get_xticklabels(), *a.get_yticklabels())}
    texts = [t for t in figure.findobj(matplotlib.text.Text) if t.get_text() and t not in ticks]
    boxes = [(t.get_text(), t.get_window_extent()) for t in texts if t.get_visible()]
    width, height = figure.bbox.width, figure.bbox.height
    return [t for t, b in boxes if b.x0 < 0 or b.y0 < 0 or b.x1 > width or b.y1 > height]


@pytest.mark.parametrize(
    "draw",
    [
        lambda: plot_map(make_map()),
        lambda: plot_map(make_map(), "amplitude_ratio"),
        lambda: plot_map(over_stiffness()),
        lambda: plot_map_summary(make_map()),
        lambda: plot_map_summary(over_stiffness()),
    ],
)
def test_text_is_legible_and_inside_the_picture(draw):
    figure = draw()
    assert outside(figure) == []
    texts = [t for t in figure.findobj(matplotlib.text.Text) if t.get_text()]
    assert min(t.get_fontsize() for t in texts) >= 10


def test_summary_has_the_maps_the_effects_and_the_tally():
    changed = over_stiffness()
    changed["lane_status"][0, 0, 0], changed["lane_status"][1, 0, 0] = 1, 4
    figure = plot_map_summary(changed)
    heading = figure.get_suptitle()
    assert heading.splitlines()[0] == "a map of nothing"
    assert "48 systems: 4 gap × 3 taper × 4 stiffness" in heading
    assert "frequency ratio 0.8 to 1.4 in 31 points" in heading
    assert "46 settled (95.8 %), 1 aperiodic (2.1 %), 1 missing (2.1 %)" in heading
    assert "cost 48,000 steps" in heading
    assert "rig: Rig(length=0.2, width=0.1)" in heading
    maps = [
        a.get_title(loc="left") for a in panels(figure) if a.collections and a.get_title(loc="left")
    ]
    assert maps == [
        f"{name}\nat taper = 0.25"
        for name in ("Peak amplitude ratio", "Peak frequency", "Force (N)", "Hysteresis width")
    ]
    (tally,) = [a for a in panels(figure) if a.patches]
    assert [p.get_width() for p in tally.patches] == [46, 1, 1]
    assert "46 (95.8 %)" in letters(tally)


def test_summary_has_no_cost_that_was_not_counted():
    changed = over_stiffness()
    changed["lane_steps"][:] = -1
    assert "cost" not in plot_map_summary(changed).get_suptitle()


def test_summary_draws_the_effect_of_each_parameter():
    dataset = over_stiffness()
    figure = plot_map_summary(dataset)
    effects = {a.get_xlabel(): a for a in panels(figure) if "median" in a.get_ylabel()}
    (axes,) = effects.values()
    peak = dataset["peak_amplitude_ratio"]
    expected = peak.median(["gap", "taper"])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), expected)
    assert axes.get_xlabel().replace("\n", " ") == "Stiffness ($10^{3}$ N/m)"
    band = axes.collections[0].get_paths()[0].vertices
    assert band[:, 1].max() == pytest.approx(np.nanpercentile(peak.isel(stiffness=-1), 90))


def test_summary_of_one_parameter_draws_lines():
    figure = plot_map_summary(make_map().isel(taper=0))
    labels = [a.get_ylabel() for a in panels(figure) if a.lines]
    assert labels == ["Peak amplitude ratio", "Peak frequency", "Force (N)", "Hysteresis width"]


def test_summary_needs_a_measure():
    curves = make_map()[["amplitude_ratio", "status"]]
    with pytest.raises(ValueError, match="no measure over a parameter"):
        plot_map_summary(curves)
