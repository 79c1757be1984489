"""Maps without their engine: what the arguments mean, and how lanes are cut into chunks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vibrojax as vj
from vibrojax.ensemble.arguments import arguments_of
from vibrojax.maps.chunks import cut, spread_out
from vibrojax.maps.rig_maker import RigMaker


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(1, 7), min_size=0, max_size=4),
    st.integers(1, 60),
    st.lists(st.booleans(), min_size=4, max_size=4),
)
def test_chunks_cover_every_lane_once(shape, lanes, single):
    shape = tuple(shape)
    chunks = cut(shape, tuple(single[: len(shape)]), lanes)
    counted = np.zeros(shape, int)
    grid = np.arange(counted.size).reshape(shape)
    assert chunks.lanes_per_block <= lanes
    for number in range(chunks.number):
        block = chunks.at(number)
        counted[block.region] += 1
        assert all(len(i) == b for i, b in zip(block.indices, chunks.block, strict=True))
        computed = grid[np.ix_(*block.indices)].ravel()[block.inside]
        np.testing.assert_array_equal(computed, grid[block.region].ravel())
        assert block.lanes == computed.size
    assert (counted == 1).all()
    for k, alone in enumerate(single[: len(shape)]):
        assert not alone or chunks.block[k] == 1


def test_chunks_waste_little_at_the_edges():
    chunks = cut((3, 101), (False, False), 64)
    computed = chunks.number * chunks.lanes_per_block
    assert chunks.block == (1, 51)
    assert computed <= 1.02 * 3 * 101
    assert cut((10, 20), (False, False), 8).block == (1, 5)  # 7 would compute a lane twice


def test_a_few_lanes_are_spread_over_the_whole_grid():
    rows = np.array(spread_out((10, 20, 5), 24))
    assert len(rows) >= 20
    for k, size in enumerate((10, 20, 5)):
        assert np.ptp(rows[:, k]) > 0.7 * (size - 1)
    assert spread_out((2, 3), 24) == [(i, j) for i in range(2) for j in range(3)]


def rig(taper=0.0, gap=4e-4, kind="consistent", num_modes=1):
    return vj.default_rig(taper=taper, gap=gap, formulation=kind, num_modes=num_modes)


def test_axes_in_the_order_of_the_call():
    named = arguments_of(rig, (vj.zipped(taper=[0.0, 0.5], gap=[1e-4, 2e-4]),), {"num_modes": 2})
    assert [d.name for d in named.dimensions] == ["taper_gap"]
    assert named.fixed == {"num_modes": 2}
    assert named.at((1,)) == {"taper": 0.5, "gap": 2e-4, "num_modes": 2}
    named = arguments_of(rig, (), {"gap": [1e-4], "design": vj.zipped(kind=["a"], taper=[0.1])})
    assert [d.name for d in named.dimensions] == ["gap", "design"]
    assert named.lanes == 1


@pytest.mark.parametrize(
    ("groups", "keywords", "sentence"),
    [
        ((), {"gab": [1.0]}, "Unknown argument 'gab' of the rig. Did you mean 'gap'?"),
        ((), {"gap": []}, "gap is an empty axis: give at least one value"),
        ((), {"gap": [1e-4, np.nan]}, "gap must be finite, got nan"),
        ((), {"gap": [1e-4, 2e-4, 1e-4]}, "gap has the value 0.0001 twice"),
        ((), {"gap": [[1e-4]]}, "gap must be one value, or a list of numbers or of texts, got"),
        ((), {"gap": [None]}, "gap must be one value, or a list of numbers or of texts"),
        (([1.0],), {}, "Positional arguments after the function must be vj.zipped"),
    ],
)
def test_wrong_axes_are_refused(groups, keywords, sentence):
    with pytest.raises(ValueError, match=sentence.replace("(", r"\(")):
        arguments_of(rig, groups, keywords)


def test_an_argument_given_twice_is_refused():
    group = vj.zipped(taper=[0.0, 0.5], gap=[1e-4, 2e-4])
    with pytest.raises(ValueError, match="gap is given twice"):
        arguments_of(rig, (group,), {"gap": [1e-4]})
    with pytest.raises(ValueError, match="equal lengths: taper has 2, gap has 1"):
        vj.zipped(taper=[0.0, 0.5], gap=[1e-4])
    with pytest.raises(ValueError, match="at least two"):
        vj.zipped(taper=[0.0, 0.5])
    with pytest.raises(ValueError, match="'direction' is taken"):
        arguments_of(rig, (), {"direction": group})


def systems_of(make, **axes):
    maker = RigMaker(make, arguments_of(make, (), axes))
    index = tuple(np.arange(d.size) for d in maker.arguments.dimensions)
    return maker, index


def test_rigs_of_a_block_are_those_of_single_calls():
    maker, index = systems_of(rig, taper=[0.0, 0.5], gap=[1e-4, 2e-4, 3e-4])
    assert maker.traced
    rigs = maker.rigs(index)
    for lane, (i, j) in enumerate(np.ndindex(2, 3)):
        one = maker.sample((i, j)).equations()
        np.testing.assert_allclose(
            rigs.equations.angular_frequency[lane], one.angular_frequency, rtol=1e-12
        )
        np.testing.assert_allclose(rigs.equations.stop_map[lane], one.stop_map, rtol=1e-11)
        assert rigs.equations.stops[0].gap[lane] == one.stops[0].gap


def test_a_function_that_jax_cannot_trace_is_called_for_every_lane():
    def plain(gap):
        return rig(gap=float(gap), taper=0.0 if gap < 2e-4 else 0.5)

    maker, index = systems_of(plain, gap=[1e-4, 3e-4])
    assert not maker.traced
    tapers = maker.systems(index).beam.taper
    np.testing.assert_array_equal(tapers, [0.0, 0.5])


def test_numbers_that_decide_the_structure_are_an_axis_too():
    maker, _ = systems_of(rig, num_modes=[1, 2], gap=[1e-4, 2e-4])
    assert maker.static == (True, False)
    one = maker.systems((np.array([1]), np.arange(2)))
    assert one.num_modes == 2
    np.testing.assert_array_equal(one.stops[0].gap, [1e-4, 2e-4])
    # Whole numbers that only are numbers stay traced.
    maker, _ = systems_of(lambda stiffness: vj.default_rig(stiffness=stiffness), stiffness=[1, 2])
    assert maker.traced
    assert maker.static == (False,)


def test_every_value_of_every_axis_is_built_before_anything_runs():
    maker, _ = systems_of(rig, taper=[0.0, 1.5], gap=[1e-4])
    with pytest.raises(ValueError, match=r"taper must be .*got 1.5"):
        maker.check()
    maker, _ = systems_of(lambda gap: gap, gap=[1e-4])
    with pytest.raises(ValueError, match="must return a system"):
        maker.check()


def test_a_rig_that_holds_other_numbers_is_another_rig(tmp_path, monkeypatch):
    # Its arrays print alike, and nothing in the call distinguishes them.
    monkeypatch.setattr("vibrojax.maps.parameter_map._run", lambda *_: None)

    def call(mass, factor):
        def oscillator(gap):
            stop = vj.Stop(None, gap, vj.KelvinVoigt(50.0, 0.1))
            return vj.MatrixSystem(
                [[mass]],
                [[0.1]],
                [[1.0]],
                response_map=[1.0],
                stops=stop,
                stop_map=[[1.0]],
                drive=vj.BaseMotion(1.0),
                input_map=[1.0],
            )

        return vj.parameter_map(
            oscillator,
            gap=[1.0, 2.0],
            frequency_ratio=[0.9, 1.0],
            measures={"scaled": lambda curve: factor * curve["peak_ratio"].max()},
            store=tmp_path / "map.zarr",
        )

    call(1.0, 1.0)
    call(1.0, 1.0)
    with pytest.raises(ValueError, match=r"other settings\. first rig"):
        call(4.0, 1.0)
    with pytest.raises(ValueError, match=r"other settings\. measures: scaled"):
        call(1.0, 2.0)
