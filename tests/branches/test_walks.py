"""Walks along exact motions: through every change of contact, the same from wherever they begin."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rod import rod

import vibrojax as vj
from vibrojax.branches import contacts, shallow, side_by_side, walking, what_follows
from vibrojax.branches.comparing import COMPARED
from vibrojax.branches.continuation import Ending
from vibrojax.branches.curve_search import CurveSearch
from vibrojax.branches.exact_branches import crowded
from vibrojax.branches.neighbours import skips, turns_round
from vibrojax.branches.on_curve import Look, OnCurve, Seen, Touch
from vibrojax.branches.refining import special_points_of
from vibrojax.branches.stretch import turning_share
from vibrojax.branches.touches import touch_between
from vibrojax.branches.walking import Walk
from vibrojax.steady import paths
from vibrojax.steady.curve_programs import LEAST
from vibrojax.stepping.contact_phases import contact_phases
from vibrojax.stepping.measures import Measures

TURN = 2 * np.pi
DATA = Path(__file__).parents[1] / "data"


def special(branch, kind):
    return [p.parameter * TURN for p in branch.special_points if p.kind == kind]


def have_same_points(points, others):
    assert [point.kind for point in points] == [point.kind for point in others]
    np.testing.assert_allclose(
        [point.parameter for point in points], [point.parameter for point in others], rtol=1e-9
    )


@pytest.fixture(scope="module", autouse=True)
def _no_marches_behind_losses_of_stability():
    """What follows there is looked at by other tests; every rig's shape would compile it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(what_follows, "MOST", 0)
        yield


@pytest.fixture(scope="module")
def small_rods():
    system = rod(400.0, 3)
    ranges = (58000, 72000), (60500, 90000)
    branches = [
        vj.continue_response(system, frequency=vj.Range(low / TURN, high / TURN))
        for low, high in ranges
    ]
    fine = vj.ContinuationSettings(longest_step=0.04)
    bounds = vj.Range(58000 / TURN, 72000 / TURN)
    return [*branches, vj.continue_response(system, frequency=bounds, settings=fine)]


@pytest.mark.parametrize("kind", ["fold", "grazing", "period_doubling", "neimark_sacker"])
def test_special_points_do_not_depend_on_range_and_step(small_rods, kind):
    first, *others = small_rods
    assert first.completed
    assert all(point.refined for point in first.special_points)
    assert kind != "fold" or len(first.folds) >= 2
    for other in others:
        np.testing.assert_allclose(special(other, kind), special(first, kind), rtol=1e-9)


def test_points_keep_to_the_equations(small_rods):
    branch = small_rods[0]
    assert branch.exact_points.all()
    assert branch.residual.max() < 1e-9
    assert branch.contacts_per_period.max() > 1
    assert len(branch.contact_changes) > 0


def test_a_walk_begins_with_a_short_step(small_rods):
    """A special point may be next to where it begins."""
    start, following = small_rods[0].values[:2]
    assert 0 < following - start < 2e-3 * start


@pytest.mark.slow
def test_what_happens_next_to_a_touch_does_not_depend_on_the_step():
    """Where a contact is about to end, or has just begun, it splits into two for a little while."""
    stop = vj.Stop(position=0.61, gap=0.297e-3, law=vj.KelvinVoigt(stiffness=36.1e3, damping=23.2))
    rig = vj.ImpactingBeam(
        beam=vj.default_rig(taper=0.91, mass_ratio=8.8).beam,
        stops=(stop,),
        drive=vj.BaseMotion(amplitude=97.8e-6),
        damping_ratio=0.0554,
        num_modes=3,
    )
    branches = [
        vj.continue_response(
            rig,
            frequency_ratio=vj.Range(0.95, 1.1),
            settings=vj.ContinuationSettings(longest_step=step),
        )
        for step in (0.08, 0.05, 0.02, 0.01)
    ]
    first, *others = branches
    kinds = [point.kind for point in first.special_points]
    there = ["grazing", "contact_change", "contact_change", "fold"]
    assert kinds == [*there, *there[::-1]]
    for other in others:
        have_same_points(other.special_points, first.special_points)


@pytest.mark.slow
def test_points_are_the_same_however_many_are_solved_for_in_one_call(monkeypatch):
    """One by one in a wide program, or a stride of them as one lane alone takes."""
    calls, solved = [], side_by_side._solved

    def counted(rigs, lanes, scales, asks):
        calls.append(asks)
        return solved(rigs, lanes, scales, asks)

    monkeypatch.setattr(side_by_side, "_solved", counted)
    system, over = vj.default_rig(num_modes=1), vj.Range(0.85, 1.4)
    settings = vj.ContinuationSettings(longest_step=0.02)
    strides = vj.continue_response(system, frequency_ratio=over, settings=settings)
    number = len(calls)
    assert number < len(strides.values) / 2
    monkeypatch.setattr(side_by_side, "_width", lambda rows: side_by_side.WIDTH)
    steps = vj.continue_response(system, frequency_ratio=over, settings=settings)
    assert len(calls) - number > len(steps.values)
    np.testing.assert_allclose(strides.values, steps.values, rtol=1e-10)
    np.testing.assert_allclose(strides.peak_ratio, steps.peak_ratio, rtol=1e-9)
    assert len(strides.folds) == len(steps.folds) == 2


@pytest.mark.slow
def test_what_comes_next_is_solved_for_while_motions_are_looked_at(monkeypatch):
    """It is not asked of a program again, and the points are those found one after another."""
    begun, solving, seen = [], side_by_side.CurveRigs.solving, side_by_side._seen

    def noted(rigs, lanes, scales, asks):
        before = rigs.started
        answers = solving(rigs, lanes, scales, asks)
        begun.append(rigs.started is before)
        return answers

    monkeypatch.setattr(side_by_side.CurveRigs, "solving", noted)
    system, over = vj.default_rig(num_modes=1), vj.Range(0.85, 1.4)
    settings = vj.ContinuationSettings(longest_step=0.005)
    meanwhile = vj.continue_response(system, frequency_ratio=over, settings=settings)
    assert begun.count(True) > len(meanwhile.values) / 16 / 2
    begun.clear()
    monkeypatch.setattr(side_by_side, "_seen", lambda *given: seen(*given[:-1], None))
    afterwards = vj.continue_response(system, frequency_ratio=over, settings=settings)
    assert not any(begun)
    np.testing.assert_array_equal(meanwhile.values, afterwards.values)
    np.testing.assert_array_equal(meanwhile.peak_ratio, afterwards.peak_ratio)


@pytest.mark.slow
def test_a_doubled_branch_is_the_same_from_either_end():
    """One of its flips lies next to the touch, where motions of the single period are near."""
    rig = between_stops(
        vj.default_rig(taper=0.8933097059276558, mass_ratio=4.170735589199403).beam,
        [(0.6017825305819462, 0.0015853443270660956, 69453.88167326384, 37.956405249669004, 1)],
        0.0025831205593555835,
        0.08343615186708896,
        num_modes=1,
    )
    branch = vj.continue_response(rig, frequency_ratio=vj.Range(0.6, 2.0))
    near, far = branch.period_doublings
    assert near - branch.grazings.min() < 1e-5
    up = branch.switch(0)
    assert all(point.refined for point in up.special_points)
    assert up.status == "joined"
    assert up.values[-1] == pytest.approx(far, rel=1e-4)
    for step in (0.08, 0.03):  # with the shorter one a step lands on the single branch
        down = branch.switch(1, vj.ContinuationSettings(longest_step=step))
        assert down.status == "joined"
        assert down.values[-1] == pytest.approx(near, rel=1e-4)
        have_same_points(down.special_points, up.special_points[::-1])
        assert all(point.refined for point in down.special_points)


@pytest.mark.slow
def test_a_doubled_branch_does_not_end_where_an_impact_passes_drive_phase_0():
    """What differs between the halves of its motions turns by that impact."""
    stops = [
        (0.8405252719148035, 0.0008024610618594095, 12530.372257731948, 43.977468297163185, 1),
        (0.6076284591089487, 0.00019605902057508672, 7657147.908862883, 32.254800788587104, -1),
    ]
    rig = between_stops(
        vj.default_rig(taper=0.4538205921002112, mass_ratio=3.3640841353884374).beam,
        stops,
        0.0024273044867746054,
        0.04682420917066175,
        num_modes=1,
    )
    branch = vj.continue_response(rig, frequency_ratio=vj.Range(0.6, 2.0))
    doubled = branch.switch(2)
    assert doubled.completed
    assert len(doubled.special_points) == 11
    other = branch.switch(2, vj.ContinuationSettings(longest_step=0.04))
    have_same_points(other.special_points, doubled.special_points)
    assert all(point.refined for each in (doubled, other) for point in each.special_points)


def test_multipliers_of_what_is_no_motion_stop_no_walk():
    none = np.zeros(0)
    lost = OnCurve(
        contacts.Contacts((), 0, 0.0), none, np.ones(2), 1.0, np.ones(2), none, 0.0, np.eye(2) / 0.5
    )
    lost.find_multipliers()
    assert lost.moduli.tolist() == [2.0, 2.0]
    lost = dataclasses.replace(lost, matrix=np.full((2, 2), np.nan))
    lost.find_multipliers()
    with pytest.raises(np.linalg.LinAlgError):
        _ = lost.multipliers


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [4.0])
def test_rod_of_the_peer(ratio):
    """NLvib's harmonic balance: amplitudes within its truncation, turning points too."""
    table = np.genfromtxt(DATA / f"rod_stiffness_{ratio:g}.csv", delimiter=",", names=True)
    branch = vj.continue_response(rod(ratio, 20), frequency=vj.Range(57000 / TURN, 75000 / TURN))
    np.testing.assert_allclose(
        np.sort(branch.grazings) * TURN, [61513.782871, 63855.930823], rtol=1e-10
    )
    turning = {0.4: (63848.3, 64892.9), 4.0: (63855.86, 69450.2)}[ratio]
    np.testing.assert_allclose(np.sort(branch.folds) * TURN, turning, rtol=1e-3)
    omega, peak = table["omega"], table["A_peak"]
    away = np.min(np.abs(omega[:, None] - np.array(turning)), axis=1) > 20
    kept = np.flatnonzero(away & (omega > 57500) & (omega < 74500))[::10]
    found = branch.resample(omega[kept] / TURN)["peak_ratio"].values * 25e3
    difference = np.nanmin(np.abs(found / peak[kept, None] - 1), axis=1)
    assert np.median(difference) < {0.4: 3e-5, 4.0: 2e-4}[ratio]
    assert difference.max() < {0.4: 1e-3, 4.0: 3e-3}[ratio]


def oscillator(damping, tension):
    return vj.MatrixSystem(
        [[1.0]],
        [[0.1]],
        [[1.0]],
        response_map=[1.0],
        stops=vj.Stop(None, 1.0, vj.KelvinVoigt(50.0, damping, tension=tension)),
        stop_map=[[1.0]],
        drive=vj.PointForce(0.3),
        input_map=[1.0],
    )


def between_stops(beam, stops, base_amplitude, damping_ratio, num_modes=2):
    """A beam between stops, given by place, gap, stiffness, damping and side."""
    return vj.ImpactingBeam(
        beam=beam,
        stops=tuple(
            vj.Stop(position=x, gap=gap, law=vj.KelvinVoigt(k, c), side=side)
            for x, gap, k, c, side in stops
        ),
        drive=vj.BaseMotion(amplitude=base_amplitude),
        damping_ratio=damping_ratio,
        num_modes=num_modes,
    )


def test_a_force_that_jumps_makes_a_corner():
    bounds = vj.Range(0.8 / TURN, 1.5 / TURN)
    branch = vj.continue_response(oscillator(8.0, tension=False), frequency=bounds)
    assert branch.completed
    (corner,) = special(branch, "touch_fold")
    assert corner == pytest.approx(1.130436598485874, rel=1e-12)
    assert corner == pytest.approx(branch.grazings.max() * TURN, rel=1e-12)
    assert branch.folds.size == 2
    data = branch.to_xarray()
    assert data.sizes["fold"] == 2
    assert data["fold_refined"].values.all()


def test_stiff_stops_are_where_sweeps_settle():
    rig = vj.default_rig(stiffness=3.89e5, damping_ratio=0.06, num_modes=2, base_amplitude=1e-3)
    branch = vj.continue_response(rig, frequency_ratio=vj.Range(0.7, 1.8))
    assert branch.completed
    sweep = vj.frequency_sweep(
        rig,
        frequency_ratio=np.linspace(0.7, 1.8, 23),
        settings=vj.SweepSettings(refine_jumps=None),
        progress=False,
    )
    compared = branch.compare(sweep)
    settled = np.isfinite(compared["relative_difference"].values)
    assert settled.sum() > 20
    assert (compared["on_branch"].values == np.where(settled, 1, -1)).all()


def test_a_walk_does_not_turn_round_at_a_touch():
    """Motions before a touch and behind it are alike where a contact goes and comes again."""
    rig = vj.default_rig(
        taper=0.7342,
        mass_ratio=6.341,
        gap=1.7314e-3,
        position=0.39916,
        stiffness=1.609e5,
        damping=30.41,
        damping_ratio=0.00237,
        base_amplitude=6.765e-3,
        num_modes=2,
    )
    branch = vj.continue_response(rig, frequency_ratio=vj.Range(0.8, 0.85))
    assert branch.completed


@pytest.mark.slow
def test_touches_of_stiff_stops_where_the_curve_turns_sharply():
    """Within 1e-6 of the touch at which a contact ends, at a ratio of 1.50345."""
    beam = vj.default_rig(taper=0.2917814427493031, mass_ratio=2.5490663441435792).beam
    stops = (
        (0.25587264249069663, 1.6114530076221999e-3, 134464.30934980465, 21.088736667720916, 1),
        (0.5172418715839191, 1.8184816200270536e-3, 344195.2939165398, 7.690364390375349, -1),
        (0.7615421263512575, 0.8060172454864143e-3, 8706630.726777092, 10.580386319729145, 1),
    )
    rig = between_stops(
        beam, stops, base_amplitude=0.0013957797161279445, damping_ratio=0.04452370499804419
    )
    branch = vj.continue_response(rig, frequency_ratio=vj.Range(0.6, 1.52))
    assert branch.completed
    assert branch.contacts_per_period.max() >= 15
    assert np.max(branch.residual) < 1e-9


def special_in_steps(rig, bounds, step):
    """Where the special points of a branch followed in steps of up to this are."""
    settings = vj.ContinuationSettings(longest_step=step)
    branch = vj.continue_response(rig, frequency_ratio=bounds, settings=settings)
    return [point.parameter for point in branch.special_points]


def test_a_contact_that_comes_and_goes_within_a_step_is_seen():
    """A second contact with the far stop, at ratios of 0.76345 to 0.76356."""
    beam = vj.default_rig(taper=0.678462416607437, mass_ratio=9.415473385260913).beam
    stops = (
        (0.9105999797850765, 6.715837782082608e-4, 6634.320450423437, 8.889424134268985, 1),
        (0.26766511347987587, 9.25795635197384e-05, 186.47771453413668, 44.69499730141473, -1),
    )
    rig = between_stops(
        beam, stops, base_amplitude=0.008723440501846669, damping_ratio=0.16675051099924043
    )
    for step in (0.08, 0.02):
        found = special_in_steps(rig, vj.Range(0.74, 0.8), step)
        np.testing.assert_allclose(found, [0.7418794, 0.7634518, 0.7635637, 0.7860851], rtol=1e-7)


def test_an_approach_that_joins_the_contact_behind_it_is_seen():
    """It touches at a ratio 5e-7 before that: on either side the stop is all but left there."""
    beam = vj.default_rig(taper=0.9478825404249082, mass_ratio=0.8166459753660771).beam
    stops = (
        (0.6685547636326504, 1.3116604399422294e-3, 296.9817173951911, 24.620243285165444, 1),
        (0.5174978193866507, 5.138087605706245e-4, 3.1302546228180304, 23.144519778275363, -1),
    )
    rig = between_stops(
        beam, stops, base_amplitude=2.589802197687496e-4, damping_ratio=0.024038816553417552
    )
    for step in (0.08, 0.02):
        found = special_in_steps(rig, vj.Range(0.95, 1.0), step)
        np.testing.assert_allclose(found, [0.97760313, 0.97760363], rtol=1e-8)


def test_a_contact_that_splits_and_joins_again_behind_a_touch_is_not_jumped_over():
    """Its contacts are the same again 1.2e-3 behind the touch; however wide the range is."""
    beam = vj.default_rig(taper=0.20038074518019924, mass_ratio=9.592369958777931).beam
    stops = (
        (0.7026088021970014, 1.3467588920225216e-3, 26256.126670843212, 9.16320203638969, -1),
        (0.8584461320316132, 7.987353415110699e-06, 13554.66279999178, 15.036767732017358, 1),
    )
    rig = between_stops(
        beam, stops, base_amplitude=0.001551289220005762, damping_ratio=0.13635485654160595
    )
    for bounds in (vj.Range(1.2, 1.3), vj.Range(1.24, 1.25)):
        branch = vj.continue_response(rig, frequency_ratio=bounds)
        assert all(point.refined for point in branch.special_points)
        found = [point.parameter for point in branch.special_points]
        wanted = [1.24465491, 1.24526773, 1.2452751, 1.2453396, 1.24603307, 1.24611115]
        np.testing.assert_allclose(found, wanted, rtol=1e-8)


def test_contacts_change_right_behind_a_touch():
    """The new contact splits into two, which soon are one again."""
    rig = vj.default_rig(
        taper=0.9233067383430068,
        mass_ratio=6.399248880490002,
        gap=1.3644443874488137e-3,
        position=0.7429155375013791,
        stiffness=44790.426840630214,
        damping=31.797446095470903,
        damping_ratio=0.05982723502261731,
        base_amplitude=0.0025891871870465204,
        num_modes=2,
    )
    for step in (0.08, 0.02):
        branch = vj.continue_response(
            rig,
            frequency_ratio=vj.Range(0.65, 0.7),
            settings=vj.ContinuationSettings(longest_step=step),
        )
        points = branch.special_points
        assert [point.kind for point in points] == [
            "grazing",
            "contact_change",
            "contact_change",
            "period_doubling",
        ]
        found = [point.parameter for point in points]
        np.testing.assert_allclose(
            found, [0.69404034, 0.69416361, 0.69419055, 0.69432001], rtol=2e-8
        )
        assert all(point.refined for point in points)


def test_few_motions_are_solved_for_in_vain():
    """Steps are as long as contacts allow, and no dead end behind a touch is followed far."""
    branch = vj.continue_response(vj.default_rig(num_modes=2), frequency_ratio=vj.Range(0.85, 1.31))
    assert branch.completed
    assert branch.ticks < 1.5 * len(branch.values)


def test_a_branch_has_as_many_points_as_are_allowed():
    settings = vj.ContinuationSettings(max_points=12)
    bounds = vj.Range(0.85, 1.31)
    branch = vj.continue_response(
        vj.default_rig(num_modes=2), frequency_ratio=bounds, settings=settings
    )
    assert branch.status == "running"
    assert 10 <= len(branch.values) <= 12


def test_ways_along_frequencies_and_wider_gaps_run_the_same_programs():
    """A branch that begins in contact is reached by opening gaps, which compiles nothing more."""
    system = vj.default_rig(num_modes=1)
    path = jax.tree.map(lambda a: np.asarray(a)[None], paths.frequency_path(system, True, True))
    first, one = np.zeros(1, int), np.ones(1)
    place = paths.localise(path, first, one, True).place
    along, wider = (
        side_by_side.CurveRigs(each, 1).at(first, one) for each in (path, paths.OpenedPath(place))
    )
    assert along.kinds == wider.kinds
    assert jax.tree.structure(along) == jax.tree.structure(wider)
    # To first order is all there is: gaps change what they change linearly.
    opening = 1e-4
    (stop,) = system.stops
    opened = dataclasses.replace(stop, gap=stop.gap + opening)
    known = contact_phases(dataclasses.replace(system, stops=(opened,)).equations())
    local = jax.tree.map(lambda a: jnp.asarray(a[0]), wider.columns())
    moved = local.phases_at(jnp.asarray(opening))
    for name in ("rest", "readout_rest", "change_rest", "gap", "readout"):
        np.testing.assert_allclose(getattr(moved, name), getattr(known, name), 1e-9, 1e-12, name)


def test_a_hairpin_within_a_step_is_seen():
    """A contact lasts longer at the next motion, whose rates say that it gets shorter."""
    known = contacts.Contacts((0, 0), 0, 0.0)

    def motion(lasts, rate):
        times, along = np.array([1.0, 1.0 + lasts]), np.array([0.0, rate])
        return OnCurve(known, times, np.ones(2), 1.0, np.ones(2), along, 0.0, np.eye(2))

    last = motion(0.1, 1.0)
    assert turns_round(last, motion(0.2, -3.0))
    assert not turns_round(last, motion(0.2, -0.5))
    assert not turns_round(last, motion(0.104, -3.0))
    assert turns_round(motion(0.2, -1.0), motion(0.1, 3.0))


def test_a_part_of_the_curve_beside_the_last_motions_is_not_the_next_step():
    """On the curve itself the ways on from one motion and back from the other meet half-way."""
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    free, none = contacts.Contacts((), 0, 0.0), np.zeros(0)

    def motion(across, slope, way=0.01):
        at, along = np.array([way, across + 1.0]), np.array([np.cos(slope), np.sin(slope)])
        return OnCurve(free, none, at, 1.0, along, none, 0.0, np.eye(2), way=way)

    last = motion(0.0, 0.0, 0.0)
    bent = 0.5  # rad, over the step
    on_arc = motion(0.01 * np.tan(bent / 2), bent)
    assert search.comes_next(on_arc, last, 0.01)
    assert not search.comes_next(motion(0.008, 0.0), last, 0.01)
    assert not search.comes_next(motion(-0.004, bent), last, 0.01)


@pytest.mark.slow
def test_a_walk_keeps_to_its_own_part_where_another_one_comes_near():
    """Else it turns round there, at what looks like a fold, and goes the same way again."""
    rig = between_stops(
        vj.default_rig(taper=0.293866398532816, mass_ratio=2.52171006023559).beam,
        [(0.954970242983179, 0.00140651880992893, 310376.971940959, 0.0561080753515408, 1)],
        0.00259675071172476,
        0.00492676474500262,
    )
    branch = vj.continue_response(
        rig,
        frequency_ratio=vj.Range(0.6, 2.0),
        settings=vj.ContinuationSettings(longest_step=0.03),
    )
    assert all(point.refined for point in branch.special_points)
    folds = np.sort(branch.folds)
    assert np.diff(folds).min() > 1e-7  # none of them is passed twice


def test_the_shortest_step_is_never_too_long_by_round_off():
    """A contact may change by any share within it; by how much it is gone is known to round-off."""
    known = contacts.Contacts((0, 0), 0, 0.0)

    def motion(way):
        lasts = np.sqrt(0.1**2 - 60 * way)
        times, along = np.array([1.0, 1.0 + lasts]), np.array([0.0, -30 / lasts])
        return OnCurve(known, times, np.ones(2), 1.0, np.ones(2), along, 0.0, np.eye(2), way=way)

    last = motion(0.0)
    for way in np.nextafter(LEAST, (0.0, LEAST, 1.0)):
        assert not skips(last, motion(float(way)))
    assert skips(last, motion(1.1 * LEAST))


def test_a_march_begins_again_where_it_went_astray():
    """A release that is all but tangential is met a little late, and what follows much too late."""
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    twice = contacts.Contacts((0, 0, 0, 0), 0, 0.5)
    times = np.array([1.0, 1.2, 3.0, 3.1])
    motion = OnCurve(twice, times, np.ones(2), 1.0, np.ones(2), 0 * times, 0.0, np.eye(2))

    def begins(met, at, fits=True):
        seen = Seen(met, np.asarray(at), fits, np.ones(2), np.ones(2), None)
        assert not search.fits(motion, seen)
        steps = search.recut(motion, seen)
        try:
            return next(steps).sections[0]
        except StopIteration as end:
            return end.value

    assert begins(twice, np.add(times, [0.0, 2e-5, 1e-3, 1e-3])) == pytest.approx(2.1)
    once = contacts.Contacts((0, 0), 0, 0.5)
    assert begins(once, times[:2]) == pytest.approx(2.1)
    assert begins(once, times[2:]) == pytest.approx((3.1 - TURN + 1.0) / 2 + TURN)
    # From the last event on nothing is left to be met, and other contacts are another motion.
    assert begins(twice, np.add(times, [0.0, 0.0, 0.0, 1e-3])) is None
    assert begins(contacts.Contacts((0, 1, 1, 0), 0, 0.5), times) is None
    assert begins(twice, times + 1e-3, fits=False) is None


def test_a_contact_too_shallow_for_a_march_is_one_that_it_went_through():
    """Its depth is above zero where the march saw none, however long that lasts."""
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    twice, once = (contacts.Contacts((0, 0) * k, 0, 0.5) for k in (2, 1))
    times = np.array([1.0, 1.2, 3.0, 3.0003])
    motion = OnCurve(twice, times, np.ones(2), 1.0, np.ones(2), 0 * times, 0.0, np.eye(2))

    def fits(depth, angle):
        near = [depth], [angle]
        return search.fits(motion, Seen(once, times[:2], True, np.ones(2), np.ones(2), None, near))

    assert fits(1e-13, 3.00015)
    assert fits(1e-13, 3.00015 + TURN)
    assert not fits(-1e-13, 3.00015)
    assert not fits(1e-13, 2.9)
    assert not search.fits(motion, Seen(once, times[:2], True, np.ones(2), np.ones(2), None))


def test_stops_that_change_contact_together_may_do_so_in_either_order():
    """A march that finds one of them late has taken the other one first."""
    own = contacts.Contacts((0, 1, 0, 1), 0, 0.5)
    times, other = np.array([1.0, 1.00001, 2.0, 3.0]), own._replace(stops=(1, 0, 0, 1))
    assert contacts.same(own, times, other, np.array([1.00001, 1.0, 2.0, 3.0]), 1e-8)
    assert not contacts.same(own, times, other, times, 1e-8)
    assert not contacts.same(own, times, own._replace(stops=(1, 0, 0, 0)), times, 1.0)


def test_what_passes_zero_is_a_contact_whether_a_march_counts_it_or_not():
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    known, times = contacts.Contacts((0, 0), 0, 0.5), np.array([1.0, 1.2])
    motion = OnCurve(known, times, np.ones(2), 1.0, np.ones(2), 0 * times, 0.0, np.eye(2))

    def uncounted(height, angle):
        return [pair.middle for pair in search.uncounted(motion, seen_at(motion, height, angle))]

    assert uncounted(2e-15, 3.0) == pytest.approx([3.0])
    assert uncounted(2e-15, 0.2) == pytest.approx([0.2 + TURN])
    whole = dataclasses.replace(search, whole=2 * TURN)  # a motion of two drive periods
    assert whole.uncounted(motion, seen_at(motion, 2e-15, 3.0 + TURN))[0].middle == 3.0 + TURN
    assert not uncounted(1e-16, 3.0)  # round-off
    assert not uncounted(-2e-15, 3.0)
    assert uncounted(2e-15, 1.1)  # or leaves

    fewer = seen_at(motion, 2e-15, 1.1)._replace(contacts=known._replace(stops=()), times=times[:0])
    assert not search.uncounted(motion, fewer)  # it has that contact

    walk = Walk(search, 0.0, 2.0, 0.1, 10, points=[motion])
    for height, kept in ((-2e-15, True), (2e-15, False)):
        with pytest.raises(StopIteration) as end:
            next(walk.kept(motion, seen_at(motion, height, 3.0)))
        assert (end.value.value is not None) is kept


def test_no_touch_far_ahead_is_gone_to_from_a_motion_that_met_others():
    """There have been two changes of contact, which a shorter step will find."""
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    known, times = contacts.Contacts((0, 0), 0, 0.5), np.array([1.0, 1.2])
    closes = np.array([1.0, -1.0])
    last = OnCurve(known, times, np.ones(2), 1.0, 0 * np.ones(2), closes, 1.0, np.eye(2))
    bad = dataclasses.replace(last, times=times + 1e-2)

    def asked(seen):
        return list(touch_between(search, last, bad, seen, 0.01, 0.2, (0.0, 2.0)))[:1]

    fewer = Seen(known._replace(stops=()), times[:0], True, np.ones(2), np.ones(2), None)
    with pytest.raises(AttributeError):  # goes on with the answer to what it asks for
        asked(fewer)
    assert not asked(seen_at(last, -1.0, 3.0))


def touch_of_a_stop_near_twice(reached, shown=0.0):
    """What `touch_between` finds where a stop is touched from two parameters on, by drive phase.

    At a touch marches show contacts of so long at the other place.
    """
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    free, none = contacts.Contacts((), 0, 0.5), np.zeros(0)
    last = OnCurve(free, none, np.ones(2), 1.0, np.zeros(2), none, 1.0, np.eye(2))

    def pairs_at(parameter):
        if parameter > 1.025:  # they are one
            return [contacts.Pair(0, (0, 0), (1.8, 3.2))]
        every = {at: np.sqrt(max(parameter - begun, 0.0)) for at, begun in reached.items()}
        if shown and parameter in reached.values():
            every = {at: shown / 2 for at, begun in reached.items() if begun != parameter}
        return [contacts.Pair(0, (0, 0), (at - d, at + d)) for at, d in every.items() if d > 0]

    def solved(ask):
        parameter, times = ask.parameter, np.array(ask.times)
        along = 0 * times
        if ask.peak >= 0:  # from afar it goes to the wrong one
            at = 2.0 if parameter > 1.02 or parameter == reached[3.0] else 3.0
            parameter, times = reached[at], np.array([at])
        elif len(times):
            at = min(reached, key=lambda at: abs(at - times.mean()))
            half = ask.value / 2 if ask.by_times is not None else np.ptp(times) / 2
            parameter, times = reached[at] + half**2, np.array([at - half, at + half])
            along = np.array([-1.0, 1.0]) / (2 * half)
        state = np.ones(2)
        value = float(parameter)
        found = OnCurve(ask.contacts, times, state, value, 0 * state, along, 1.0, np.eye(2))
        return dataclasses.replace(found, error=0.0, height_along=1.0, bend=-8.0)

    def seen(motion):
        met, times = contacts.with_pairs(free, none, pairs_at(motion.parameter))
        return Seen(met, times, True, motion.state, motion.state, None)

    bad = dataclasses.replace(last, parameter=1.03)
    steps = touch_between(search, last, bad, seen(bad), 0.03, 0.03, (0.0, 2.0))
    return answered(steps, solved, seen)


def test_a_touch_behind_another_one_of_the_same_stop_gives_way_to_that():
    """It was solved for at the second place that is reached."""
    passed = touch_of_a_stop_near_twice({2.0: 1.02, 3.0: 1.01})
    assert passed.place.parameter == pytest.approx(1.01)


def test_touches_that_show_each_other_as_ahead_are_left_to_a_shorter_step():
    """Neither gives way to the other without end."""
    assert touch_of_a_stop_near_twice({2.0: 1.0105, 3.0: 1.01}, shown=0.4) is None


def test_where_a_stop_that_is_near_may_change_contact():
    """Shares of the way from the second of four points, that apart, at which it is looked."""

    def share(*places, ways=(0.01, 0.01, 0.01)):
        near = [shallow._Near(h, angle, changes, 0.5) for h, angle, changes in places]
        return shallow._share(ways, [near], TURN)

    rising = (-3e-6, 1.0, 2), (-1e-6, 1.0, 2)
    falling = rising[::-1]
    assert share(*rising, *falling) == pytest.approx(0.5)
    assert share(*falling, *rising) is None
    # In flight before it and in contact behind: contact changed between, or all but did.
    flies, touches = ((-1.1e-6, 1.0, 2), (-1e-6, 1.0, 2)), ((-1e-6, 1.0, 3), (-1e-6, 1.0, 3))
    assert share(*flies, *touches) == 0.5
    assert share(*touches, *flies[::-1]) == 0.5
    assert share(*flies, *flies) is None
    # Another flight, or elsewhere in the same one, is something else; from afar it may have moved.
    slower = (-5e-7, 1.0, 2), (-5.5e-7, 1.0, 2)
    assert share(*rising, *slower) is None
    assert share(*rising, *((h, at, changes + 2) for h, at, changes in slower)) == 0.5
    moved = [(h, at + 0.1, changes) for h, at, changes in slower]
    assert share(*rising, *moved) == 0.5
    assert share(*rising, *moved, ways=(0.08, 0.08, 0.08)) is None
    # Much nearer than its neighbours, which are something else: how that changes is not known.
    alone, others = (-1e-8, 1.0, 2), ((-1e-6, 2.0, 2), (-1e-6, 2.0, 2))
    assert share(others[0], alone, *others) == shallow.MARGIN
    assert share(*others, alone, others[0]) == 1 - shallow.MARGIN
    assert share(others[0], (-5e-7, 1.0, 2), *others) is None


MEASURED = Measures(0.0, 1e-3, -1e-3, 0.0, 0.0, 0.0, 0.0, 0.0, 0)


def as_solved(motion, nearest=((), ())):
    """What a march of a motion shows that keeps to its contacts."""
    return Seen(motion.contacts, motion.times, True, motion.state, motion.state, MEASURED, nearest)


def seen_at(motion, height, angle):
    """The same, and how near stop 0 came to another contact."""
    return as_solved(motion, ([height], [angle]))


def specials_of(walk, solved, seen=as_solved):
    """Special points of a walk, from the motions asked for and what marches of them show."""
    return answered(special_points_of(walk), solved, seen)


def answered(steps, solved, seen):
    """What steps return, from the motions that they ask for and what marches of them show."""
    answer = None
    while True:
        try:
            request = steps.send(answer)
        except StopIteration as end:
            return end.value
        looks = isinstance(request, Look)
        answer = [seen(motion) for motion in request.motions] if looks else [solved(request)]


def test_a_special_point_whose_motion_breaks_its_contacts_is_unrefined():
    """The motions on either side keep to theirs: there is more in between than was found."""
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    free, times, state = contacts.Contacts((), 0, 0.0), np.zeros(0), np.ones(2)

    def motion(rate, way):
        return OnCurve(free, times, state, 1.0, state, times, rate, np.eye(2) / 2, way=way)

    def special(met, at):
        walk = Walk(search, 0.0, 2.0, 0.1, 10, points=[motion(1.0, 0.0), motion(-1.0, 0.1)])
        fold = dataclasses.replace(motion(0.0, 0.0), error=0.0)
        seen = Seen(met, at, True, state, state, MEASURED)
        (found,) = specials_of(walk, lambda _: fold, lambda _: seen)
        return found.kind, found.refined

    assert special(free, times) == ("fold", True)
    assert special(contacts.Contacts((0, 0), 0, 0.0), np.array([1.0, 1.1])) == ("fold", False)


def doubling_between(multiplier, *, way=0.52):
    """Special point of a step of 0.52 that came from `way` behind, from a multiplier by place."""
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    free, none, state = contacts.Contacts((), 0, 0.0), np.zeros(0), np.ones(2)

    def motion(value, way=0.0):
        matrix = np.diag([multiplier(value), 0.1])
        return OnCurve(free, none, state, value, 0 * state, none, 1.0, matrix, 0.0, way=way)

    walk = Walk(search, 0.0, 2.0, 0.1, 10, points=[motion(0.0), motion(0.52, way)])
    (found,) = specials_of(walk, lambda ask: motion(float(ask.value)))
    assert found.kind == "period_doubling"
    return found.motion.parameter, found.refined


def test_a_step_is_as_long_as_its_ends_are_apart():
    """Points put in between since say otherwise of the second: a doubling lies behind that."""
    for way in (0.52, 0.4):
        value, refined = doubling_between(lambda value: -(0.5 + value), way=way)
        assert value == pytest.approx(0.5, abs=1e-10)
        assert refined


def test_where_a_number_jumps_no_special_point_is_refined():
    value, refined = doubling_between(lambda value: -0.8 if value < 0.3 else -1.2)
    assert value == pytest.approx(0.3, abs=1e-10)
    assert not refined


def test_two_folds_of_one_step_are_found():
    """The parameter has gone back at the next point, with the rate of one that rises."""
    search = CurveSearch(np.ones(2), 1e6, TURN, smooth=True, brief=1e-4)
    free, times = contacts.Contacts((), 0, 0.0), np.zeros(0)

    def motion(at, way=0.0):
        value, rate = at**3 / 3 - at**2 / 2 + 0.16 * at, (at - 0.2) * (at - 0.8)
        state, along, matrix = np.array([at, 1.0]), np.array([1.0, 0.0]), np.eye(2) / 2
        return OnCurve(free, times, state, value, along, times, rate, matrix, error=0.0, way=way)

    walk = Walk(search, -9.0, 9.0, 0.1, 10, points=[motion(0.0), motion(1.0, 1.0)])
    found = specials_of(walk, lambda ask: motion(float(ask.value / ask.by_state[0])))
    assert [special.kind for special in found] == ["fold", "fold"]
    at = [special.motion.state[0] for special in found]
    np.testing.assert_allclose(at, [0.2, 0.8], atol=1e-7)


def test_a_multiplier_that_just_passes_the_circle_between_two_points_is_seen():
    """It is looked where the cubic through four points has its turn, here far from the middle."""
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    free, times, state = contacts.Contacts((), 0, 0.0), np.zeros(0), np.ones(2)

    def motion(at):
        matrix = np.diag([-(1.0001 - 0.03 * (at - 1.8) ** 2), 0.3])
        return OnCurve(free, times, state, at, 0 * state, times, 1.0, matrix, error=0.0, way=1.0)

    walk = Walk(search, -1.0, 4.0, 0.1, 10, points=[motion(float(at)) for at in range(4)])
    found = specials_of(walk, lambda ask: motion(float(ask.value)))
    assert [special.kind for special in found] == ["period_doubling"] * 2
    at = [special.motion.parameter for special in found]
    np.testing.assert_allclose(at, 1.8 + np.array([-1, 1]) * np.sqrt(1e-4 / 0.03), atol=1e-8)


def test_a_pair_that_leaves_the_circle_and_returns_right_behind_a_touch_is_seen():
    """Multipliers change with the duration of the new contact, and are back at the next point."""
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    free, state, lasting = contacts.Contacts((), 0, 0.0), np.ones(2), 0.1
    turned = np.array([[np.cos(1), -np.sin(1)], [np.sin(1), np.cos(1)]])

    def motion(lasts):
        share = lasts / lasting
        times = np.array([2.0 - lasts / 2, 2.0 + lasts / 2])[: 2 * (lasts > 0)]
        known = free._replace(stops=(0,) * len(times))
        along = np.array([-1.0, 1.0])[: len(times)]
        matrix = turned * (0.88 + 0.668 * share - 0.6 * share**2)
        value = 1.0 + 1e-3 * share**2
        return OnCurve(
            known, times, state, value, 0 * state, along, 1.0, matrix, error=0.0, way=1e-3
        )

    ahead = dataclasses.replace(motion(0.0), parameter=0.999)
    behind = dataclasses.replace(motion(lasting), family=1)
    walk = Walk(search, 0.0, 2.0, 0.1, 10, points=[ahead, motion(0.0), behind])
    walk.seen = [as_solved(motion) for motion in walk.points]
    walk.touches = [Touch(1, True, (0, 1), 0)]
    found = specials_of(walk, lambda ask: motion(float(ask.value)))
    assert [special.kind for special in found] == ["grazing", "neimark_sacker", "neimark_sacker"]
    lasts = [np.diff(special.motion.times)[0] / lasting for special in found[1:]]
    np.testing.assert_allclose(lasts, np.sort(np.roots([0.6, -0.668, 0.12])), rtol=1e-8)


def test_where_a_number_turns_by_the_cubic_through_four_points():
    ways = 0.3, 0.5, 0.2
    at = np.cumsum([0.0, *ways]) - 0.3

    def number(at):
        return -((at - 0.1) ** 2) * (1 + at / 4)

    assert turning_share(ways, number(at).tolist()) == pytest.approx(0.2, rel=1e-12)
    assert turning_share(ways, number(at + 0.2).tolist()) is None
    assert turning_share(ways, (2.0 * at).tolist()) is None


@pytest.mark.parametrize("ways", [[0.0, 1.0], [0.0, 0.5, 1.0], [1.0, 0.0]])
def test_a_pair_may_pass_the_circle_in_the_step_of_a_doubling(ways):
    """A multiplier comes in at -1, meets another, and as a pair they go out, all in one step."""
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)
    free, times, state = contacts.Contacts((), 0, 0.0), np.zeros(0), np.ones(2)
    way = np.sign(ways[1] - ways[0])

    def motion(at):
        trace, determinant = -0.764 - 0.256 * at, -0.4286 + 1.6486 * at
        matrix = np.array([[0.0, -determinant], [1.0, trace]])
        gone = abs(at - ways[0]) / (len(ways) - 1)
        return OnCurve(free, times, state, at, 0 * state, times, way, matrix, error=0.0, way=gone)

    walk = Walk(search, -1.0, 2.0, 0.1, 10, points=[motion(at) for at in ways])
    specials = specials_of(walk, lambda ask: motion(ask.value * way))
    doubling, pair = (0.764 + 0.4286 - 1) / 1.3926, 1.4286 / 1.6486
    wanted = {"period_doubling": doubling, "neimark_sacker": pair}
    assert [special.kind for special in specials] == [*wanted][:: int(way)]  # as they are passed
    found = {special.kind: special.motion.parameter for special in specials}
    assert found == pytest.approx(wanted, abs=1e-9)


def test_a_walk_that_ends_at_as_many_contacts_as_it_has_room_for_says_so():
    search = CurveSearch(np.ones(2), 1.0, TURN, smooth=True, brief=1e-4)

    def walk(events):
        times, known = np.linspace(0.1, 6.0, events), contacts.Contacts((0,) * events, 0, 0.0)
        last = OnCurve(known, times, np.ones(2), 1.0, np.ones(2), 0 * times, 1.0, np.eye(2))
        return Walk(search, 0.0, 2.0, 0.1, 10, points=[last])

    assert "64 contacts in its period" in crowded(walk(128), Ending.stuck)
    assert crowded(walk(128), Ending.completed) == crowded(walk(126), Ending.stuck) == ""
    empty = dataclasses.replace(walk(2), points=[])
    assert crowded(empty, Ending.stuck) == ""


@pytest.mark.slow
def test_a_branch_that_comes_back_gives_way_to_the_one_from_the_high_end():
    rig = vj.default_rig(stiffness=1e6, base_amplitude=1e-3, num_modes=2)
    bounds = vj.Range(0.8, 0.9)
    branch = vj.continue_response(rig, frequency_ratio=bounds)
    assert branch.completed
    assert "Another one comes back" in branch.sentence
    assert (branch.values[0], branch.values[-1]) == (0.8, 0.9)
    assert np.max(branch.residual) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("begins", "numbers"),
    [
        ("high end", dict(stiffness=1.2e6, gap=3e-4, damping=7.0, base_amplitude=2e-3)),
        ("inside", dict(stiffness=1.4e6, gap=2e-5, damping=0.3, base_amplitude=1.9e-3)),
    ],
)
def test_where_no_motion_is_found_at_the_low_end_a_branch_begins_elsewhere(begins, numbers):
    rig = vj.default_rig(num_modes=1, damping_ratio=0.02, **numbers)
    branch = vj.continue_response(rig, frequency_ratio=vj.Range(0.6, 1.2))
    assert branch.completed
    assert f"from the {begins}" in branch.sentence
    assert (branch.values[0], branch.values[-1]) == (0.6, 1.2)
    assert np.all(np.diff(branch.arclength) > 0)
    assert np.max(branch.residual) < 1e-9


def test_a_touch_just_before_the_end_of_the_range():
    rig = vj.default_rig(num_modes=1)
    whole = vj.continue_response(rig, frequency_ratio=vj.Range(0.9, 1.3))
    touch = whole.grazings[0]
    branch = vj.continue_response(rig, frequency_ratio=vj.Range(0.9, touch * (1 + 1e-5)))
    assert branch.completed
    assert branch.grazings == pytest.approx([touch], rel=1e-12)
    assert branch.values.max() == touch * (1 + 1e-5)


def test_touches_that_cannot_be_passed_are_leapt_over(monkeypatch):
    rig, bounds = vj.default_rig(num_modes=1), vj.Range(0.9, 1.3)
    known = vj.continue_response(rig, frequency_ratio=bounds)

    def fails(*_):
        return None
        yield

    monkeypatch.setattr(walking, "touch_between", fails)
    monkeypatch.setattr(walking, "vanish", fails)
    branch = vj.continue_response(rig, frequency_ratio=bounds)
    assert branch.completed
    assert f"leapt over {known.grazings.size} times" in branch.sentence
    leaps = [p for p in branch.special_points if p.kind == "contact_change"]
    assert len(leaps) == known.grazings.size > 0
    assert not any(p.refined for p in leaps)
    np.testing.assert_allclose(sorted(p.parameter for p in leaps), np.sort(known.grazings), 1e-3)
    np.testing.assert_allclose(branch.folds, known.folds, rtol=1e-9)
    behind = [branch.values[p.after : p.after + 2].mean() for p in leaps]
    values = np.append(np.linspace(0.95, 1.25, 7), behind)
    own, other = (b.resample(values)["amplitude_ratio"].values for b in (branch, known))
    np.testing.assert_allclose(np.sort(own), np.sort(other), rtol=1e-8)


@pytest.mark.slow
def test_who_leaps_over_a_fold_and_comes_back_turns_about(monkeypatch):
    rig, bounds = vj.default_rig(num_modes=1), vj.Range(0.85, 1.45)
    known = vj.continue_response(rig, frequency_ratio=bounds)
    take, leap, about = Walk.take, Walk.leap, Walk.turn_about
    turned = []

    def take_but_the_second(walk, passed):
        if len(walk.touches) == 1 and not walk.leaps:
            return walking.SHORTEST / 2
        return (yield from take(walk, passed))

    def leap_to_the_wrong_side(walk):
        came = yield from leap(walk)
        walk.points[-1] = walk.points[-1].reversed()
        return came

    def noted(walk):
        turned.append((walk.landing, len(walk.points)))
        about(walk)

    for name, changed in dict(
        take=take_but_the_second, leap=leap_to_the_wrong_side, turn_about=noted
    ).items():
        monkeypatch.setattr(Walk, name, changed)
    branch = vj.continue_response(rig, frequency_ratio=bounds)
    ((landing, reached),) = turned
    assert reached > landing + 3
    assert branch.completed
    assert "leapt over 1 times" in branch.sentence
    np.testing.assert_allclose(branch.folds, known.folds, rtol=1e-9)
    values = np.linspace(0.95, 1.25, 7)
    own, other = (b.resample(values)["amplitude_ratio"].values for b in (branch, known))
    np.testing.assert_allclose(own, other, rtol=1e-8)


@pytest.mark.slow
def test_contacts_that_a_march_from_afar_misses_are_looked_at_from_near():
    """Of a stop of p0 = 10^8: what is off before a shallow contact grows beyond its depth."""
    law = vj.KelvinVoigt.from_restitution(0.7, stiffness=1e8, mass=1.0)
    stop = vj.Stop(None, 1.0, law)
    system = vj.model.Oscillator(1.0, 1.0, 0.1, stops=stop, drive=vj.PointForce(1.0))
    branch = vj.continue_response(system, frequency=vj.Range(0.4 / TURN, 2.2 / TURN))
    assert branch.completed
    assert all(p.refined for p in branch.special_points if p.kind == "contact_change")


def test_a_motion_that_touches_from_the_start():
    rig = vj.default_rig(stiffness=2e4, gap=1e-5, damping_ratio=0.1, num_modes=2)
    branch = vj.continue_response(rig, frequency_ratio=vj.Range(0.7, 0.9))
    assert "gaps that were opened" in branch.sentence
    assert branch.contacts_per_period.min() > 0
    sweep = vj.frequency_sweep(rig, frequency_ratio=[0.7, 0.75, 0.9], progress=False)
    assert (branch.compare(sweep)["on_branch"].values == 1).all()
    lost = {name: np.array(getattr(sweep, name)) for name in (*COMPARED, "period")}
    for values in lost.values():
        values[:, 1] = 0 if values.dtype.kind == "i" else np.nan
    found = branch.compare(dataclasses.replace(sweep, **lost))["on_branch"].values
    assert (found == [1, -1, 1]).all()


def test_comparing_refuses():
    rig = vj.default_rig(num_modes=1)
    branch = vj.continue_response(rig, frequency_ratio=vj.Range(0.7, 0.8))
    other = vj.frequency_sweep(rig, frequency=[10.0, 12.0], progress=False)
    with pytest.raises(ValueError, match="compare them along the same axis"):
        branch.compare(other)
    with pytest.raises(ValueError, match="sweep must be along frequency_ratio, as the branch is"):
        branch.plot(sweep=other)


# --------------------------------------------------------------------------- contacts


def test_a_motion_is_cut_elsewhere():
    before = contacts.Contacts((0, 1, 1, 0), 0, 0.0)
    times = np.array([1.0, 2.0, 3.0, 4.0])
    after, moved, order = contacts.at_section(before, times, 2.5, TURN)
    assert after == contacts.Contacts((1, 0, 0, 1), 3, 2.5)
    np.testing.assert_allclose(moved, [3.0, 4.0, 1.0 + TURN, 2.0 + TURN])
    again, back, _ = contacts.at_section(after, moved, TURN, TURN)
    assert again == before._replace(section=0.0)
    np.testing.assert_allclose(back, times[order][np.argsort(order)][[0, 1, 2, 3]])


def test_pairs_come_and_go():
    known = contacts.Contacts((0, 0), 0, 0.0)
    times = np.array([1.0, 2.0])
    pair = contacts.Pair(0, (0, 0), (1.4, 1.5))
    more, met = contacts.with_pairs(known, times, [pair])
    assert more.stops == (0, 0, 0, 0)
    (found,) = contacts.new_pairs(known, times, more, met)
    assert found.times == (1.4, 1.5)
    fewer, left = contacts.without(more, met, [found])
    assert fewer == known
    np.testing.assert_array_equal(left, times)
    assert contacts.same(fewer, left, known, times, 1e-4)
    assert not contacts.same(fewer, left + 1e-5, known, times, 1e-6)
    assert contacts.new_pairs(known, times, more._replace(first_phase=1), met) is None
