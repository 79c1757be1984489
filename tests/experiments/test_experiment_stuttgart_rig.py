"""The pair of beams of Stuttgart: its natural frequencies, its page, and the reader of records."""

import functools
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

FOLDER = Path(__file__).parents[2] / "experiments" / "stuttgart_rig"


@pytest.fixture(scope="module")
def part():
    """A module of the experiment by name."""

    @functools.cache
    def load(name):
        spec = importlib.util.spec_from_file_location(f"stuttgart_{name}", FOLDER / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


def off(found, measured):
    return 100 * (np.array(found) / measured - 1)


def test_nine_natural_frequencies(part):
    rig = part("rig")
    left, right = rig.left_beam(), rig.right_beam()
    assert rig.MEASURED["left"] == [30.95, 199.04, 556.82, 1085.93]
    assert rig.MEASURED["right"] == [28.2, 205.54, 277.74, 594.98, 1168.62]
    found = off(left.frequencies(4), rig.MEASURED["left"])
    assert found == pytest.approx([-0.02, 1.52, 0.69, 0.42], abs=0.01)
    found = off(right.frequencies(5), rig.MEASURED["right"])
    assert found == pytest.approx([0.71, 1.62, -1.40, -1.04, -3.79], abs=0.01)


def test_elements_are_fine_enough_and_those_of_a_uniform_beam(part, monkeypatch):
    rig = part("rig")
    coarse = rig.right_beam().frequencies(5)
    bare = [rig.Section(0.0, rig.LENGTH, rig.rigidity(rig.HEIGHT), rig.PER_LENGTH)]
    mesh = rig.Mesh()
    node, *_ = mesh.add(bare, rig.CAP_NUT)
    uniform = rig.Body(mesh.elements(), node, node).frequencies(3)
    stiff = np.sqrt(rig.rigidity(rig.HEIGHT) / rig.PER_LENGTH) / rig.LENGTH**2 / (2 * np.pi)
    assert uniform / stiff == pytest.approx([3.516015, 22.034492, 61.697214], rel=1e-6)
    monkeypatch.setattr(rig, "LONGEST", rig.LONGEST / 2)
    assert rig.right_beam().frequencies(5) == pytest.approx(coarse, rel=3e-7)


def test_the_stop_is_as_stiff_as_the_table_says(part):
    rig = part("rig")
    tip = 3 * rig.SOURCE.mini * rig.rigidity(rig.MINI_HEIGHT, rig.PLATE_WIDTH) / rig.MINI_LENGTH**3
    assert tip == pytest.approx(rig.NUMBERS["mini-beam static tip stiffness"], rel=3e-3)


def test_the_pair_meets_at_the_gap(part):
    rig = part("rig")
    pair = rig.pair(gap=3e-4)
    assert pair.between[0].gap == 3e-4
    for body, lowest in ((pair.first, 28.4014), (pair.second, 30.9444)):
        modes = np.sqrt(np.diag(body.stiffness)) / (2 * np.pi)
        assert modes[0] == pytest.approx(lowest, abs=1e-3)
    # What is touched moves by its own static flexibility: the mini-beam's, and its beam's below it.
    soft = np.sum(pair.first_map[0] ** 2 / np.diag(pair.first.stiffness))
    rig_beam = rig.right_beam()
    row = rig_beam.elements.row(node=rig_beam.touch, dof=3)
    assert soft == pytest.approx(row @ spsolve(rig_beam.elements.stiffness, row), rel=1e-6)


def test_the_page_has_the_results():
    page = (FOLDER / "README.md").read_text()
    content = json.loads((FOLDER / "results.json").read_text())
    table = content["frequencies_Hz"]
    for side, measured in table["measured"].items():
        for k, value in enumerate(measured):
            cells = [f"{value:g}", f"{table['source'][side][k]:.2f}"]
            for name in ("source", "source_wide", "drawn", "fitted", "point_masses"):
                found = table[name][side][k]
                cells.append(f"{100 * (found / value - 1):+.1f}" if found else "")
            assert f"| {' | '.join(cells)} |" in page
    for name, factor in content["fitted_factors"].items():
        assert f"{name} {factor:.3f}" in page
    for row in json.loads((FOLDER / "pair.json").read_text()):
        assert f"{row['touch_frequency_ratio']:.3f} of the first" in page
        height, place = row["largest_amplitude_over_gap"], row["its_frequency_ratio"]
        assert f"{height:.1f} gaps at {place:.3f}" in page


TIME = np.arange(0, 30, 1 / 300)
NAME = "FRC_SteppedFrequency_0_0305ms2_1"


def written(folder, run=NAME, steps="frequency_steps", ending="", separator=",", level=0.0305):
    """Records of three holds as the source reads them; returns what is in them."""
    folder.mkdir(exist_ok=True)
    asked = np.array([28.0, 28.5, 29.0])
    begins = np.array([0.5, 10.5, 20.5])
    hertz = np.interp(TIME, np.ravel([begins, begins + 9], "F"), np.repeat(asked, 2))
    turned = 2 * np.pi * np.cumsum(hertz) / 300
    base = level / (2 * np.pi * hertz) * np.cos(turned)
    amplitude, phase = 1e-4 * hertz / 28, -1.0
    # The displacement leads by `phase`; the velocity of the base is that of its displacement.
    response = 2 * np.pi * hertz * amplitude * np.cos(turned + phase) + 1e-3 * np.cos(3 * turned)
    signals = np.stack([TIME, 0 * TIME, base, response, hertz], axis=1)
    np.savetxt(folder / f"{run}_dspace{ending}", signals, delimiter=separator)
    at = np.ravel([begins, begins + 9], "F")
    table = np.stack([at, np.repeat(asked, 2)], axis=1)
    np.savetxt(folder / f"{run}_{steps}{ending}", table, delimiter=separator)
    return asked, 1e-4 * asked / 28, phase


@pytest.mark.parametrize(("ending", "separator"), [("", ","), (".txt", "\t"), (".csv", ";")])
def test_a_run_is_read(part, tmp_path, ending, separator):
    asked, amplitude, phase = written(tmp_path, ending=ending, separator=separator)
    curve, acceleration = part("records").read_run(tmp_path, NAME, frame="relative")
    assert curve.frequency == pytest.approx(asked, rel=1e-6)
    assert curve.amplitude == pytest.approx(amplitude, rel=1e-4)
    assert curve.phase == pytest.approx(np.full(3, phase), abs=1e-4)
    assert acceleration == pytest.approx(np.full(3, 0.0305), rel=1e-4)
    assert curve.forward.all()
    assert (curve.unit, curve.quantity, curve.frame) == ("m", "first_harmonic", "relative")


def test_points_off_their_level_are_left_out_and_said(part, tmp_path):
    records = part("records")
    written(tmp_path, level=0.0300)
    curve, _ = records.read_run(tmp_path, NAME, frame="absolute")
    assert curve.size == 3
    written(tmp_path, level=0.0296)
    with pytest.raises(ValueError, match=r"the base is nowhere within 2.5 % of 0.0305 m/s2"):
        records.read_run(tmp_path, NAME, frame="absolute")


def test_backbones_have_no_level_and_no_direction(part, tmp_path):
    name = "Backbone_SteppedResponseAmplitude_3"
    written(tmp_path, name, "amplitude_steps", level=0.01)
    curve, acceleration = part("records").read_run(tmp_path, name, frame="relative")
    assert acceleration == pytest.approx(np.full(3, 0.01), rel=1e-4)
    assert not curve.direction.any()


def test_points_of_the_scanning_vibrometer(part, tmp_path):
    records = part("records")
    name = "Backbone_SteppedResponseAmplitude_1"
    for point, padded in ((3, "_3"), (17, "17")):
        np.savetxt(tmp_path / f"{name}_MPV_Point_{padded}", [[0.0, point], [0.1, 2.0]])
        _, velocity = records.read_point(tmp_path, name, point)
        assert velocity[0] == point
    with pytest.raises(ValueError, match="point must be from 1 to 17, got 18"):
        records.read_point(tmp_path, name, 18)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0 1 2 3\n1 2 3 4\n", "must have at least 5 columns, got 4"),
        ("words only\n", "no line that begins with a number"),
        ("0;1,5;2;3;4\n", "line 1: commas in numbers are not known here"),
        ("t a b c d\n0 1 2 3 x\n", "is not a table of numbers"),
        ("0 1 2 3 4\n1 2 3\n", "is not a table of numbers"),
        ("0 1 2 3 4\n1 2 nan 4 5\n", "line 2: a number is not finite"),
        ("t\n1 1 2 3 4\n0 2 3 4 5\n", "line 3: its time, the first column, must rise"),
        ("", "no line that begins with a number"),
    ],
)
def test_records_that_are_not_as_known_are_refused(part, tmp_path, text, words):
    written(tmp_path)
    (tmp_path / f"{NAME}_dspace").write_text(text)
    with pytest.raises(ValueError, match=f"{NAME}_dspace.*{words}"):
        part("records").read_run(tmp_path, NAME, frame="relative")


def test_files_that_are_missing_or_there_twice(part, tmp_path):
    read = part("records").read_run
    with pytest.raises(ValueError, match=r"must have one file .*_dspace, got no file of it"):
        read(tmp_path, NAME, frame="relative")
    written(tmp_path)
    written(tmp_path, ending=".txt")
    with pytest.raises(ValueError, match="got 2 files of it"):
        read(tmp_path, NAME, frame="relative")
    with pytest.raises(ValueError, match="run must be as FRC_SteppedFrequency_0_0305ms2_1"):
        read(tmp_path, "Ringdown_1", frame="relative")


def test_holds_that_are_too_short(part, tmp_path):
    written(tmp_path)
    with pytest.raises(ValueError, match="nothing is held for more than 70 periods"):
        part("records").read_run(tmp_path, NAME, frame="relative", nominal_frequency=5.0)
