"""Numbers that go along one axis together, in every study over lists: as in maps."""

import inspect
import io
from dataclasses import replace

import numpy as np
import pytest
import xarray

import vibrojax as vj
from vibrojax.branches.along import along_of
from vibrojax.results.axes import axis_scale, coordinates_of, example, pick, together

TAPERS, GAPS = [0.0, 0.5, 0.8, 0.3], [3e-4, 4e-4, 3e-4, 5e-4]
GRID = [0.9, 1.0, 1.1]
SWEPT = vj.SweepSettings(direction="forward", refine_jumps=None)
SETTINGS = {"frequency_ratio": GRID, "settings": SWEPT}
GROUP = vj.zipped(taper=TAPERS, gap=GAPS)


def build(taper=0.5, gap=4e-4, stiffness=5500.0, material="soft", num_modes=1):
    return vj.default_rig(
        taper=taper,
        gap=gap,
        stiffness=stiffness if material == "soft" else 2 * stiffness,
        num_modes=num_modes,
    )


@pytest.fixture(scope="module")
def zipped():
    return vj.frequency_sweep(build, GROUP, **SETTINGS)


def drawn(figure):
    figure.savefig(io.BytesIO())
    return figure


def test_a_sweep_of_a_group_is_the_diagonal_of_the_crossed_one(zipped):
    crossed = vj.frequency_sweep(build, taper=TAPERS[:2], gap=GAPS[:2], **SETTINGS)
    assert zipped.amplitude_ratio.shape == (4, 1, 3)
    for name in ("amplitude_ratio", "contact_force", "period"):
        wanted = getattr(crossed, name)[[0, 1], [0, 1]]
        np.testing.assert_allclose(getattr(zipped, name)[:2], wanted, rtol=1e-9)
    assert repr(zipped).startswith("FrequencyResponse(taper_gap: 4, direction: 1,")


def test_its_dataset_has_the_coordinates_of_both(zipped, tmp_path):
    zipped.save(tmp_path / "curves.nc")
    with xarray.open_dataset(tmp_path / "curves.nc", engine="h5netcdf") as dataset:
        assert dataset.amplitude_ratio.dims == ("taper_gap", "direction", "frequency_ratio")
        assert dataset.jump_up.dims == ("taper_gap",)
        assert dataset.taper.dims == dataset.gap.dims == ("taper_gap",)
        np.testing.assert_array_equal(dataset.taper, TAPERS)
        np.testing.assert_array_equal(dataset.gap, GAPS)
        assert dataset.gap.attrs["units"] == "m"


@pytest.mark.slow  # to compile
def test_it_is_the_map_of_the_group(zipped):
    maps = vj.parameter_map(
        build, GROUP, frequency_ratio=GRID, response=vj.SweepSettings("forward"), progress=False
    )
    dataset = zipped.to_xarray()
    assert set(maps.coords) == set(dataset.coords)
    assert maps.amplitude_ratio.dims == dataset.amplitude_ratio.dims
    np.testing.assert_allclose(maps.amplitude_ratio, dataset.amplitude_ratio, rtol=1e-3)


def test_its_picture_takes_either_name(zipped):
    figure = drawn(zipped.plot())
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words[0] == "taper = 0, gap = 0.0003 m"
    for selection in ({"taper": 0.79}, {"taper_gap": 0.8}):
        title = drawn(zipped.plot(**selection)).axes[0].get_title(loc="left")
        assert title == "taper = 0.8, gap = 0.0003 m"
    with pytest.raises(ValueError, match="taper and gap go together along taper_gap"):
        zipped.plot(taper=0.5, gap=4e-4)
    with pytest.raises(ValueError, match=r"Unknown axis 'tapper'. Did you mean 'taper'"):
        zipped.plot(tapper=0.5)


def test_a_keyword_names_the_axis_and_text_may_go_along():
    design = vj.zipped(material=["soft", "hard"], gap=[3e-4, 4e-4])
    found = vj.frequency_sweep(build, taper=TAPERS[:2], design=design, **SETTINGS)
    assert found.amplitude_ratio.shape == (2, 2, 1, 3)
    dataset = found.to_xarray()
    assert dataset.amplitude_ratio.dims[:2] == ("taper", "design")
    assert dataset.material.values.tolist() == ["soft", "hard"]
    figure = drawn(found.plot(taper=0.0))
    assert figure.legends[0].get_texts()[1].get_text() == "material = hard, gap = 0.0004 m"
    with pytest.raises(ValueError, match="material must be one of 'soft', 'hard', got 'wood'"):
        found.plot(taper=0.0, material="wood")


@pytest.mark.slow  # to compile
def test_histories_of_a_group():
    found = vj.simulate(build, GROUP, frequency=9.0, periods=1, samples_per_period=48)
    assert (found.shape, len(found)) == ((4,), 4)
    one = found.at(taper=0.8)
    assert float(one.system.beam.taper) == 0.8
    assert float(one.system.stops[0].gap) == 3e-4
    dataset = found.to_xarray()
    assert dataset.tip_displacement.dims == ("taper_gap", "time")
    assert dataset.gap.dims == ("taper_gap",)
    words = [text.get_text() for text in drawn(found.plot()).legends[0].get_texts()]
    assert words[2] == "taper = 0.8, gap = 0.0003 m"
    with pytest.raises(ValueError, match="Give a value of taper_gap too, such as taper=0"):
        found.at()


@pytest.mark.slow  # to compile
def test_branches_of_a_group():
    group = vj.zipped(taper=[0.0, 0.5], gap=[3e-4, 4e-4])
    found = vj.continue_response(build, group, frequency_ratio=vj.Range(0.95, 1.05))
    assert found.shape == (2,)
    assert found.sel(taper=0.5).labels == {"taper": 0.5, "gap": 4e-4}
    dataset = found.to_xarray()
    assert dataset.status.dims == dataset.gap.dims == ("taper_gap",)
    drawn(found.plot())
    stiffness = np.array([4e3, 5e3])
    many = [replace(b, labels=b.labels | {"stiffness": k}) for b in found for k in stiffness]
    crossed = vj.branches.Branches(found.axes | {"stiffness": stiffness}, tuple(many)).to_xarray()
    assert crossed.status.dims == ("taper_gap", "stiffness")
    assert crossed.gap.dims == ("taper_gap",)
    picked = crossed.isel(taper_gap=1, stiffness=0).amplitude_ratio.dropna("point")
    np.testing.assert_array_equal(picked, found[1].amplitude_ratio)


def test_branches_along_another_number_take_groups():
    group = vj.zipped(taper=[0.0, 0.5], gap=[3e-4, 4e-4])
    along = along_of(build, 1.05, None, {"stiffness": vj.Range(5e3, 6e3), "num_modes": 1}, (group,))
    assert along.labels == [{"taper": 0.0, "gap": 3e-4}, {"taper": 0.5, "gap": 4e-4}]
    (stop,) = along.paths(exact=True).system.stops
    np.testing.assert_array_equal(stop.gap, [3e-4, 4e-4])
    texts = vj.zipped(material=["soft", "hard"], gap=[3e-4, 4e-4])
    with pytest.raises(ValueError, match="material_gap must be numbers, got texts"):
        along_of(build, vj.Range(0.9, 1.1), None, {}, (texts,))
    twice = vj.zipped(gap=[1.0], stiffness=[1.0])
    with pytest.raises(ValueError, match="stiffness is given twice"):
        along_of(build, 1.0, None, {"stiffness": vj.Range(1, 2)}, (twice,))


@pytest.mark.slow  # to compile
def test_regimes_and_diagrams_of_a_group():
    few = vj.RegimeSettings(
        transient=20,
        periods=40,
        max_period=4,
        samples_per_period=32,
        lyapunov=False,
        spectrum=False,
    )
    found = vj.regimes(build, GROUP, frequency_ratio=GRID, settings=few)
    assert found.to_xarray().period.dims == ("taper_gap", "frequency_ratio")
    drawn(found.plot())
    drawn(found.poincare(taper=0.5))
    title = drawn(found.plot(taper=0.5)).axes[0].get_title(loc="left")
    assert title == "taper = 0.5, gap = 0.0004 m"
    diagram = vj.bifurcation_diagram(
        build,
        GROUP,
        frequency_ratio=GRID,
        settings=few,
    )
    assert diagram.to_xarray().period.dims == ("taper_gap", "direction", "frequency_ratio")
    drawn(diagram.plot(taper=0.8))
    with pytest.raises(ValueError, match="such as taper=0"):
        diagram.plot()
    with pytest.raises(ValueError, match="along must name one list of numbers, got 'taper_gap'"):
        vj.bifurcation_diagram(build, GROUP, frequency_ratio=1.0)


@pytest.mark.slow  # to compile
def test_basins_of_a_group():
    found = vj.basins(
        build,
        GROUP,
        start=lambda x, speed: ([x], [speed]),
        x=[-1e-3, 0.0, 1e-3],
        speed=[0.0, 0.1],
        frequency_ratio=1.0,
    )
    assert found.attractor.shape == (4, 3, 2)
    assert found.to_xarray().attractor.dims == ("taper_gap", "x", "speed")
    title = drawn(found.plot(taper=0.5)).axes[0].get_title(loc="left")
    assert title == "taper = 0.5, gap = 0.0004 m"


@pytest.mark.parametrize(
    ("groups", "axes", "sentence"),
    [
        ((GROUP,), {"gap": [1e-4]}, "gap is given twice"),
        ((vj.zipped(taper=[0.1], gab=[1e-4]),), {}, "Unknown argument 'gab' of the rig"),
        ((vj.zipped(taper=[-0.1], gap=[1e-4]),), {}, "taper must be"),
        (((0.9, 1.0),), {}, r"must be vj.zipped\(...\), got \(0.9, 1.0\)"),
    ],
)
@pytest.mark.parametrize("study", [vj.frequency_sweep, vj.regimes, vj.bifurcation_diagram])
def test_wrong_groups_are_refused_before_anything_runs(study, groups, axes, sentence):
    study = inspect.unwrap(study)  # without the check of types
    with pytest.raises(ValueError, match=sentence):
        study(build, *groups, frequency_ratio=GRID, **axes)


def test_a_group_without_numbers_is_refused_where_it_is_made():
    with pytest.raises(ValueError, match="gap must be finite, got nan"):
        vj.zipped(taper=[0.1], gap=[np.nan])


def test_a_made_system_takes_no_group():
    with pytest.raises(ValueError, match="pass a function that makes the rig"):
        vj.frequency_sweep(build(), GROUP, frequency_ratio=GRID)


def test_how_a_group_is_drawn():
    axes = {"design": together({"kind": np.array(["a", "b"]), "gap": np.array([2.0, 2.0])})}
    scale = axis_scale(axes, "design")
    assert not scale.is_scale  # texts, and a number that repeats: one after the other
    np.testing.assert_array_equal(scale.places, [0.0, 1.0])
    assert scale.labels == ["kind = a, gap = 2 m", "kind = b, gap = 2 m"]
    assert example(axes, "design") == "kind='a'"
    assert pick(axes, {"design": "b"}) == ((1,), [])
    assert coordinates_of(axes)["gap"][0] == ("design",)
    scale = axis_scale({"gap": np.array([1.0, 2.0])}, "gap")
    assert (scale.number, scale.partners, scale.is_scale) == ("gap", "", True)
