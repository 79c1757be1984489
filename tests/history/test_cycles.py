"""Cycles of constructed motions under a chirp, their statistics, and pictures of them."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.history.cycles import HYSTERESIS

CHIRP = vj.Chirp(2.0, 6.0, 8.0)
END = 7.95


@pytest.fixture(scope="module")
def oscillator():
    return vj.MatrixSystem(
        [[1.0]],
        [[0.2]],
        [[4.0]],
        drive=vj.PointForce(1.0),
        input_map=[1.0],
        response_map=[1.0],
    )


@pytest.fixture(scope="module")
def made(oscillator):
    """Build a history from functions of time: q and q'."""

    def history(move, rate, samples=4001, status=vj.Status.completed):
        run = vj.motion(oscillator, waveform=CHIRP)
        time = jnp.linspace(0.0, END, samples)
        q, v = move(time)[:, None], rate(time)[:, None]
        none = jnp.zeros((samples, 0))
        a = jnp.zeros_like(q)
        return vj.history.History(
            oscillator, run, time, q, v, a, none, none, jnp.asarray(status.value)
        )

    return history


def turns(order, size=1.0, mean=0.0):
    """A motion of one cycle in `order` drive periods, and its rate."""

    def move(time):
        return mean + size * jnp.sin(CHIRP.phase(time)[0] / order)

    def rate(time):
        phase, angular, _ = CHIRP.phase(time)
        return size * jnp.cos(phase / order) * angular / order

    return move, rate


@pytest.mark.parametrize("order", [1, 2, 3])
def test_cycles_of_a_locked_chirp_have_whole_numbers_of_drive_periods(made, order):
    cycles = made(*turns(order, 0.3)).cycles()
    drive_cycles = float(CHIRP.phase(jnp.asarray(END))[0]) / (2 * np.pi)
    # The motion starts at an up-crossing, before which nothing was below: it does not count.
    assert len(cycles) == int(drive_cycles / order) - 1
    np.testing.assert_allclose(cycles.drive_periods, order, atol=2e-6)
    phase = np.asarray(CHIRP.phase(jnp.asarray(cycles.start))[0])
    np.testing.assert_allclose(phase, 2 * np.pi * order * np.arange(1, len(cycles) + 1), rtol=1e-6)
    np.testing.assert_allclose(cycles.start[1:], (cycles.start + cycles.length)[:-1], rtol=1e-12)
    np.testing.assert_allclose(
        cycles.drive_frequency, 2.0 + 0.5 * (cycles.start + cycles.length / 2), rtol=1e-12
    )
    np.testing.assert_allclose(cycles.peak_to_peak, 0.6, rtol=1e-3)
    # Potential energy of 4 N/m at 0.3 m.
    np.testing.assert_allclose(cycles.largest["strain_energy"], 0.18, rtol=1e-3)
    assert cycles.threshold[0] == pytest.approx(HYSTERESIS * 0.3 / np.sqrt(2), rel=0.05)


def test_hysteresis_passes_over_small_crossings(made):
    slow, slow_rate = turns(3)
    fast, fast_rate = turns(0.25, 0.1)

    def move(time):
        return slow(time) + fast(time)

    def rate(time):
        return slow_rate(time) + fast_rate(time)

    history = made(move, rate)
    rough = history.cycles(threshold=0.0)
    calm = history.cycles(threshold=0.3)
    assert len(rough) > len(calm)
    # The small wave moves a crossing by at most asin(0.1) of the slow phase.
    np.testing.assert_allclose(calm.drive_periods, 3.0, atol=2 * 3 * 0.11 / (2 * np.pi))
    # A quantity that never comes below the threshold has no cycles.
    assert len(history.cycles(threshold=1.5)) == 0


def test_level_and_position_of_cycles(made):
    history = made(*turns(2, 0.1, mean=5.0))
    assert len(history.cycles(threshold=0.05)) == 0
    cycles = history.cycles(level=5.0)
    np.testing.assert_allclose(cycles.drive_periods, 2.0, atol=2e-6)
    assert cycles.level == 5.0


def test_statistics_by_frequency(made):
    third, fifth = made(*turns(3)).cycles(), made(*turns(5)).cycles()
    pooled = vj.history.Cycles.pooled([third, fifth])
    assert len(pooled) == len(third) + len(fifth)
    np.testing.assert_array_equal(np.unique(pooled.history), [1, 2])
    edges = [2.0, 4.0, 6.0, 7.0]
    table = pooled.statistics(edges, share_of={3: 0.25, 5: 0.05})
    counts = [
        [np.sum((c.drive_frequency >= a) & (c.drive_frequency < b)) for c in (third, fifth)]
        for a, b in itertools.pairwise(edges)
    ]
    np.testing.assert_array_equal(table["count"], np.sum(counts, axis=1))
    for k in range(2):
        of_three, of_five = counts[k]
        share = of_three / (of_three + of_five)
        assert float(table["share_of_3"][k]) == pytest.approx(share)
        assert float(table["share_of_5"][k]) == pytest.approx(1 - share)
        assert float(table["mean"][k]) == pytest.approx(3 * share + 5 * (1 - share), rel=1e-5)
        spread = 2 * np.sqrt(share * (1 - share))
        assert float(table["standard_deviation"][k]) == pytest.approx(spread, rel=1e-4)
    assert np.isnan(table["median"][2])
    np.testing.assert_allclose(table["frequency"], [3.0, 5.0, 6.5])
    for name in (*table.data_vars, *table.coords):
        assert {"units", "long_name"} <= set(table[name].attrs)
    with pytest.raises(ValueError, match="edges must be at least two increasing"):
        pooled.statistics([3.0, 2.0])
    with pytest.raises(ValueError, match="share_of"):
        pooled.statistics(edges, share_of={3: -1.0})


def test_dataset_and_pictures(made, tmp_path):
    history = made(*turns(3))
    cycles = history.cycles()
    data = cycles.to_xarray()
    assert data["drive_periods"].dims == ("cycle",)
    assert data["largest_strain_energy"].attrs["units"] == "J"
    assert data.attrs["quantity"] == "displacement"
    for name in data.data_vars:
        assert {"units", "long_name"} <= set(data[name].attrs)
    figure = cycles.plot()
    assert "drive periods" in figure.axes[0].get_ylabel()
    assert "Hz" in figure.axes[0].get_xlabel()
    figure.savefig(tmp_path / "cycles.png")
    figure = history.plot_chirp("displacement", "velocity", "strain_power")
    labels = [panel.get_ylabel() for panel in figure.axes]
    assert ["N" in labels[0], "m/s" in labels[2], "W" in labels[3], "Hz" in labels[4]] == [True] * 4
    assert figure.axes[-1].get_xlabel() == "Time (s)"
    figure.savefig(tmp_path / "chirp.png")
    assert "median 3 drive periods" in repr(cycles)


def test_refusals(made):
    history = made(*turns(3))
    with pytest.raises(ValueError, match=r"quantity must be one of .*strain_energy"):
        history.cycles("bearing_angle")
    with pytest.raises(ValueError, match="threshold must be at least 0 m"):
        history.cycles(threshold=-1.0)
    with pytest.raises(ValueError, match="level must be a finite number"):
        history.cycles(level=np.nan)
    with pytest.raises(ValueError, match="status is diverged"):
        made(*turns(3), status=vj.Status.diverged).cycles()
    with pytest.raises(ValueError, match="list of at least one Cycles"):
        vj.history.Cycles.pooled([])
    with pytest.raises(ValueError, match="different quantity"):
        vj.history.Cycles.pooled([history.cycles(), history.cycles("velocity")])
    with pytest.raises(ValueError, match="quantity must be one of"):
        history.plot_chirp("speed")


def test_diverged_histories_are_left_out_and_counted(made):
    parts = [made(*turns(3)), made(*turns(5), status=vj.Status.diverged), made(*turns(2))]
    lanes = jax.tree.map(lambda *a: jnp.stack(a), *parts)
    found = vj.history.Histories({"start": np.arange(1, 4)}, lanes).cycles()
    np.testing.assert_array_equal(np.unique(found.history), [1, 3])
    assert found.left_out == 1
    np.testing.assert_allclose(found.drive_periods[found.history == 3], 2.0, atol=2e-6)
    assert "1 more diverged" in repr(found)


@pytest.mark.slow
def test_chirp_of_the_elastic_pendulum_locks_at_three_drive_periods():
    """From about 5.5 Hz on, as Litak et al., fig. 4; counts and bending of a reference in numpy."""
    draw = np.random.default_rng(1)
    starts = [(a * np.ones(17), b * np.ones(17)) for a, b in draw.uniform(-0.12, 0.12, (6, 2))]
    found = vj.simulate(
        vj.default_pendulum(),
        waveform=vj.Chirp(2.0, 9.0, 15.0),
        duration=15.0,
        samples=3750,
        initial_states=starts,
        stepper=vj.LinearlyImplicit(longest_step=4e-4),
    )
    cycles = found.cycles("bearing_angle", threshold=0.3 * 0.006 / 0.04)
    table = cycles.statistics(np.arange(5.5, 8.6, 0.5), share_of={3: 0.25})
    reference = np.array([23, 24, 32, 28, 36, 36]) / 12
    np.testing.assert_allclose(table["count"] / len(starts), reference, atol=0.6)
    np.testing.assert_allclose(table["median"], 3.0, atol=0.03)
    assert (table["share_of_3"] > 0.85).all()
    # Largest chord reductions of the bins from 7 to 8 and from 8 to 9 Hz, m.
    most = np.asarray(table["largest_chord_reduction"])
    np.testing.assert_allclose([max(most[3:5]), most[5]], [2.35e-4, 3.03e-4], rtol=0.15)
