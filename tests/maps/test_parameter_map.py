"""Maps: equal to single calls whatever the chunks, described, made again from their file."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import vibrojax as vj
from vibrojax.sweep import swept_lanes

GRID = np.array([1.02, 1.1, 1.18, 1.5])
GAPS, TAPERS = [3e-4, 4e-4, 6e-4], [0.0, 0.5]
SWEEP = vj.SweepSettings(tolerance=1e-6, refine_jumps=1e-3, max_periods=300)


def rig(taper=0.5, gap=4e-4, stiffness=5500.0, formulation="consistent", num_modes=1):
    return vj.default_rig(
        taper=taper,
        gap=gap,
        stiffness=stiffness,
        formulation=formulation,
        num_modes=num_modes,
    )


@pytest.fixture(scope="module")
def crossed():
    return vj.parameter_map(rig, frequency_ratio=GRID, taper=TAPERS, gap=GAPS, response=SWEEP)


def assert_same(one, other, rtol=1e-7):
    """All variables but the cost, which depends on rounding."""
    for name in one.data_vars:
        if not name.endswith("steps"):
            np.testing.assert_allclose(
                one[name], other[name].transpose(*one[name].dims), rtol, 1e-9, err_msg=name
            )


def test_every_lane_is_what_a_single_call_gives(crossed):
    assert crossed.amplitude_ratio.dims == ("taper", "gap", "direction", "frequency_ratio")
    for taper in TAPERS:
        for gap in GAPS[:2]:
            one = vj.frequency_sweep(
                rig(taper, gap),
                frequency_ratio=GRID,
                settings=vj.SweepSettings(tolerance=1e-6, refine_jumps=1e-3, max_periods=300),
            )
            lane = crossed.sel(taper=taper, gap=gap)
            single = one.to_xarray()
            shared = [n for n in single.data_vars if n in lane and n != "steps"]
            assert len(shared) > 14
            for name in shared:
                np.testing.assert_allclose(lane[name], single[name], 1e-7, 1e-9, err_msg=name)
            assert float(lane.hysteresis_area) == pytest.approx(one.hysteresis_area, rel=1e-7)
            assert float(lane.hysteresis_width) == pytest.approx(one.hysteresis_width)
            assert float(lane.largest_contact_force) == np.nanmax(lane.contact_force)
    assert float(crossed.jump_down.sel(taper=0.5, gap=4e-4)) > 1.1


def test_jumps_are_looked_for_where_a_measure_may_read_them(crossed, monkeypatch):
    looked, refine = [], swept_lanes.refine
    monkeypatch.setattr(swept_lanes, "refine", lambda *a: (looked.append(a), refine(*a)))
    settings = {"frequency_ratio": GRID, "taper": TAPERS, "gap": GAPS, "response": SWEEP}
    found = vj.parameter_map(
        rig, measures=["peak_amplitude_ratio", "hysteresis_area"], keep_curves=True, **settings
    )
    assert not looked
    assert_same(found, crossed)
    for measure in ("jump_up", {"own": lambda curve: curve["jump_up"]}):
        found = vj.parameter_map(rig, measures=measure, **settings)
        np.testing.assert_allclose(found[next(iter(found))], crossed.jump_up, rtol=1e-7)
        assert looked
        looked.clear()


def test_chunks_and_order_of_axes_change_nothing(crossed, tmp_path):
    stored = vj.parameter_map(
        rig,
        frequency_ratio=GRID,
        gap=GAPS,
        taper=TAPERS,
        response=SWEEP,
        store=tmp_path / "map.zarr",
        chunk_lanes=2,
    )
    assert stored.amplitude_ratio.dims[:2] == ("gap", "taper")
    assert json.loads(stored.attrs["block"]) == [1, 2]
    assert_same(crossed, stored)
    opened = xarray.open_zarr(tmp_path / "map.zarr")
    assert_same(stored, opened, 0)


def test_zipped_axes_are_the_diagonal(crossed):
    group = vj.zipped(taper=[0.0, 0.5], gap=[3e-4, 6e-4])
    found = vj.parameter_map(rig, group, frequency_ratio=GRID, response=SWEEP)
    assert found.amplitude_ratio.dims == ("taper_gap", "direction", "frequency_ratio")
    np.testing.assert_array_equal(found.taper, [0.0, 0.5])
    assert found.gap.dims == ("taper_gap",)
    for k, (taper, gap) in enumerate([(0.0, 3e-4), (0.5, 6e-4)]):
        assert_same(found.isel(taper_gap=k), crossed.sel(taper=taper, gap=gap))
    named = vj.parameter_map(rig, design=group, frequency_ratio=GRID, response=SWEEP)
    assert_same(found.rename(taper_gap="design"), named, 0)


def test_the_dataset_says_what_it_is(crossed):
    for name, variable in crossed.data_vars.items():
        assert variable.attrs["long_name"], name
        assert variable.attrs["units"], name
    assert crossed.direction.attrs == {"units": "1", "long_name": "Direction of the sweep"}
    assert crossed.gap.attrs == {"units": "m", "long_name": "Gap"}
    assert crossed.largest_contact_force.attrs["units"] == "N"
    assert crossed.lane_status.attrs["flag_meanings"].split() == [
        "settled",
        "aperiodic",
        "lost",
        "failed",
        "missing",
    ]
    assert (crossed.lane_status == 0).all()
    assert (crossed.lane_steps == crossed.steps.sum(["direction", "frequency_ratio"])).all()
    assert "6 lanes" in crossed.attrs["summary"]


def test_a_map_is_made_again_from_its_attributes_alone(crossed):
    names = vars(vj) | {"vj": vj}
    exec(crossed.attrs["rig_source"], names)
    again = eval(crossed.attrs["call"], names)
    assert_same(crossed, again, 0)
    system = eval(crossed.attrs["rig"], names)
    assert system == rig(TAPERS[0], GAPS[0])
    assert crossed.attrs["jax_version"] == jax.__version__


@pytest.mark.slow
def test_one_frequency_is_no_axis():
    found = vj.parameter_map(
        rig, frequency_ratio=1.1, gap=GAPS, taper=0.5, response=vj.SweepSettings("forward")
    )
    assert found.amplitude_ratio.dims == ("gap", "direction")
    assert float(found.frequency_ratio) == 1.1
    assert found.frequency_ratio.dims == ()
    one = vj.frequency_sweep(
        rig(0.5, GAPS[1]), frequency_ratio=[1.1], settings=vj.SweepSettings(direction="forward")
    )
    assert float(found.amplitude_ratio[1, 0]) == pytest.approx(one.amplitude_ratio[0, 0])
    assert "frequency_ratio" in found.coords


def test_measures_of_ones_own():
    def reach(curve):
        return curve["peak_ratio"][0].max() * curve["natural_frequency"]

    settings = {"frequency_ratio": GRID, "gap": GAPS[:2], "response": SWEEP}
    found = vj.parameter_map(rig, measures=["peak_amplitude_ratio", reach], **settings)
    assert set(found.data_vars) == {"peak_amplitude_ratio", "reach", "lane_steps", "lane_status"}
    kept = vj.parameter_map(
        rig, measures={"first": lambda c: c["frequency_ratio"][0]}, keep_curves=True, **settings
    )
    np.testing.assert_array_equal(kept["first"], [GRID[0]] * 2)
    wanted = kept.peak_ratio.sel(direction="forward").max("frequency_ratio")
    np.testing.assert_allclose(found.reach, wanted * rig().modes().frequency[0], rtol=1e-12)


@pytest.mark.slow
def test_texts_and_structure_as_axes():
    found = vj.parameter_map(
        rig,
        frequency_ratio=1.1,
        gap=GAPS[:2],
        formulation=["consistent", "as_printed"],
        num_modes=[1, 2],
        response=vj.SweepSettings("forward"),
        measures="peak_amplitude_ratio",
    )
    assert found.peak_amplitude_ratio.dims == ("gap", "formulation", "num_modes")
    assert len(np.unique(found.peak_amplitude_ratio.isel(gap=1))) == 4
    for kind, count in (("consistent", 1), ("as_printed", 2)):
        one = vj.frequency_sweep(
            rig(gap=GAPS[1], formulation=kind, num_modes=count),
            frequency_ratio=[1.1],
            settings=vj.SweepSettings(direction="forward"),
        )
        lane = found.sel(formulation=kind, num_modes=count).isel(gap=1)
        assert float(lane.peak_amplitude_ratio) == pytest.approx(one.peak_amplitude_ratio, rel=1e-6)


def test_a_lane_that_is_no_rig_is_flagged_and_leaves_its_neighbours(crossed):
    def fragile(gap, taper=0.5):
        lost = (jnp.abs(gap - GAPS[1]) < 1e-9) & (taper > 0)
        return rig(taper=taper, gap=gap, stiffness=jnp.where(lost, jnp.nan, 5500.0))

    # Each value of each axis is fine with the first of the other: only the combination is not.
    found = vj.parameter_map(fragile, frequency_ratio=GRID, taper=TAPERS, gap=GAPS, response=SWEEP)
    lost = np.zeros((2, 3), bool)
    lost[1, 1] = True
    np.testing.assert_array_equal(found.lane_status == 2, lost)
    assert np.isnan(found.peak_amplitude_ratio[1, 1])
    for name in ("amplitude_ratio", "contact_force", "peak_amplitude_ratio"):
        np.testing.assert_allclose(
            found[name].values[~lost], crossed[name].values[~lost], rtol=1e-7, err_msg=name
        )


def test_new_numbers_do_not_compile_again(crossed):
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, _, **__: compiled.append(event) if "backend_compile" in event else None
    )
    vj.parameter_map(
        rig,
        frequency_ratio=GRID + 0.01,
        taper=[0.1, 0.4],
        gap=[3.1e-4, 4.2e-4, 5e-4],
        response=vj.SweepSettings(tolerance=1e-5, refine_jumps=1e-3, max_periods=200),
    )
    assert not compiled


@pytest.mark.slow
def test_dry_run_says_what_it_takes_and_makes_nothing(tmp_path):
    plan = vj.parameter_map(
        rig,
        frequency_ratio=GRID,
        taper=np.linspace(0, 0.8, 40),
        gap=np.linspace(2e-4, 1e-3, 50),
        response=SWEEP,
        store=tmp_path / "map.zarr",
        chunk_lanes=5,
        dry_run=True,
    )
    assert isinstance(plan, vj.maps.MapPlan)
    assert (plan.lanes, plan.points) == (2000, 16000)
    assert (plan.chunks, plan.lanes_per_chunk) == (400, 5)
    assert plan.seconds > plan.lane_seconds * 2000 > 0
    assert "2,000 lanes" in repr(plan)
    assert not (tmp_path / "map.zarr").exists()


@pytest.mark.slow
def test_memory_bounds_the_chunks():
    def planned(memory):
        return vj.parameter_map(
            rig,
            frequency_ratio=1.1,
            gap=np.linspace(2e-4, 1e-3, 5000),
            response=vj.SweepSettings("forward"),
            memory=memory,
            dry_run=True,
        )

    small, large = planned(4e5), planned(1e9)
    assert small.lanes_per_chunk < 0.2 * large.lanes_per_chunk
    assert small.memory_bytes <= 1e6


def test_quiet_where_there_is_no_terminal(capfd):
    vj.parameter_map(rig, frequency_ratio=GRID, gap=GAPS, taper=TAPERS, response=SWEEP)
    assert capfd.readouterr().err == ""
    vj.parameter_map(
        rig, frequency_ratio=GRID, gap=GAPS, taper=TAPERS, response=SWEEP, progress=True
    )
    shown = capfd.readouterr().err
    assert "lane" in shown
    assert "100%" in shown


REFUSALS = [
    ({"gap": [3e-4], "frequency": [9.0]}, "frequency_ratio or frequency, one of the two"),
    ({"gab": [3e-4]}, "Unknown argument 'gab' of the rig. Did you mean 'gap'"),
    ({"taper": [-0.1]}, "taper must be at least 0 and below 1"),
    ({"gap": []}, "gap is an empty axis"),
    ({"gap": [3e-4], "response": "swep"}, "response must be one of 'sweep', 'periodic'"),
    ({"gap": [3e-4], "measures": ["peak"]}, "Unknown measure 'peak'"),
    ({"gap": [3e-4], "measures": ["fold"]}, "'fold' for this response"),
    ({"gap": [3e-4], "measures": [3.0]}, "a text or a function, got 3.0"),
    ({"gap": [3e-4], "measures": ["jump_up", "jump_up"]}, "asked for twice"),
    ({"gap": [3e-4], "measures": [lambda curve: 1.0]}, "needs one: measures="),
    ({"gap": [3e-4], "gradients": ["gab"]}, "gradients: unknown argument 'gab'"),
    ({"gap": [3e-4], "gradients": ["formulation"]}, "gradients: formulation must be a number"),
    ({"gap": [3e-4], "chunk_lanes": 0}, "chunk_lanes must be a whole number of at least 1"),
    ({"gap": [3e-4], "memory": 0.0}, "memory must be above 0 bytes"),
    ({"gap": [3e-4], "client": object()}, "client= needs store="),
    ({"gap": [3e-4], "measures": {"gap": lambda curve: 1.0}}, "would be an axis and a result"),
    (
        {"gap": [3e-4], "measures": "hysteresis_area", "response": vj.SweepSettings("forward")},
        "'hysteresis_area' for this response",
    ),
]


@pytest.mark.parametrize(("arguments", "sentence"), REFUSALS)
def test_wrong_input_is_refused_before_anything_is_computed(monkeypatch, arguments, sentence):
    def computed(*_, **__):
        raise AssertionError("something was computed")

    monkeypatch.setattr("vibrojax.maps.rig_maker.RigMaker.rigs", computed)
    with pytest.raises(ValueError, match=sentence):
        vj.parameter_map(rig, frequency_ratio=GRID, **arguments)


def test_a_measure_that_returns_a_curve_is_said():
    with pytest.warns(UserWarning, match="'whole' must return one number for a curve"):
        found = vj.parameter_map(
            rig,
            frequency_ratio=GRID,
            gap=GAPS[:2],
            response=SWEEP,
            measures={"whole": lambda curve: curve["amplitude_ratio"]},
        )
    assert (found.lane_status == 3).all()
