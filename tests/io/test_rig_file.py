import math
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax._tools.files import read_bytes

EXAMPLE = Path(__file__).parents[2] / "examples" / "uniform_beam.toml"

THREE = "{{start = 1e-4, end = 1e-3, points = {}}}"
DEFAULT = """
[beam]
length = 0.2
width = 0.025
thickness = 1e-3
youngs_modulus = 130e9
density = 8250
taper = 0.5
mass_ratio = 0.5
[[stop]]
position = 0.5
gap = 0.4e-3
stiffness = 5500
damping = 5e-5
[drive]
kind = "base_motion"
amplitude = 0.2e-3
[model]
damping_ratio = 0.018
[sweep]
frequency_ratio = [0.9, 1.2, 4]
"""


def write(folder, text, name="rig.toml"):
    path = folder / name
    path.write_text(text)
    return path


def same(a, b):
    return jax.tree.structure(a) == jax.tree.structure(b) and all(
        x == y for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    )


def test_default_rig_from_a_file(tmp_path, rig):
    system, settings = vj.io.read_rig(write(tmp_path, DEFAULT))
    assert same(system, vj.default_rig())
    assert same(system, rig())
    assert settings.keys() == {"frequency_ratio", "settings"}
    assert settings["settings"] == vj.SweepSettings()
    np.testing.assert_allclose(settings["frequency_ratio"], [0.9, 1.0, 1.1, 1.2])


def test_default_rig_takes_every_number_by_name():
    changed = vj.default_rig(gap=1e-3, base_amplitude=1e-4, density=2700.0, num_modes=3)
    assert changed.stops[0].gap == 1e-3
    assert changed.drive.amplitude == 1e-4
    assert (changed.beam.density, changed.num_modes) == (2700.0, 3)
    with pytest.raises(ValueError, match="taper must be at least 0 and below 1"):
        vj.default_rig(taper=1.5)


def test_example_has_every_part():
    system, settings = vj.io.read_rig(EXAMPLE)
    assert [stop.side for stop in system.stops] == [1, -1]
    assert [stop.gap for stop in system.stops] == [0.5e-3, 0.7e-3]
    assert not any(stop.law.tension for stop in system.stops)
    assert (system.beam.taper, system.num_modes) == (0.0, 5)
    assert (len(settings["frequency"]), settings["settings"].direction) == (97, "both")


def test_example_names_every_key():
    from vibrojax.io.rig_file_keys import KEYS, LAWS

    text = EXAMPLE.read_text()
    laws = {f"law {name}": keys for name, (_, keys) in LAWS.items()}
    for table, keys in (KEYS | laws).items():
        assert f"[{table}]" in text or table.startswith("law ")
        for name in set(keys) - {"point_masses"}:
            assert any(
                line.removeprefix("# ").startswith(f"{name} = ") for line in text.split("\n")
            ), name


@pytest.mark.parametrize(
    ("numbers", "law"),
    [
        ('law = "hertz"\nstiffness = 3e5', vj.Hertz(3e5)),
        ('law = "hertz"\nstiffness = 3e5\nexponent = 2', vj.Hertz(3e5, 2.0)),
        (
            'law = "hunt_crossley"\nstiffness = 3e5\ndissipation = 0.2',
            vj.HuntCrossley(3e5, 0.2),
        ),
        (
            'law = "standard_linear_solid"\nstiffness = 3e3\nmaxwell_stiffness = 1e3\n'
            "relaxation_time = 1e-3",
            vj.StandardLinearSolid(3e3, 1e3, 1e-3),
        ),
    ],
)
def test_contact_laws_by_name(tmp_path, numbers, law):
    start = DEFAULT.index("[[stop]]")
    end = DEFAULT.index("[drive]")
    stop = f"[[stop]]\nposition = 0.5\ngap = 1e-3\n{numbers}\n"
    system, _ = vj.io.read_rig(write(tmp_path, DEFAULT[:start] + stop + DEFAULT[end:]))
    assert same(system.stops[0].law, law)
    wrong = stop + "damping = 1.0\n"
    with pytest.raises(ValueError, match=r"unknown key 'damping' in \[\[stop\]\]"):
        vj.io.read_rig(write(tmp_path, DEFAULT[:start] + wrong + DEFAULT[end:]))
    unknown = stop.replace(numbers, 'law = "rubber"\nstiffness = 1.0')
    with pytest.raises(ValueError, match=r"\[\[stop\]\] law must be one of 'kelvin_voigt'"):
        vj.io.read_rig(write(tmp_path, DEFAULT[:start] + unknown + DEFAULT[end:]))


def test_point_masses(tmp_path):
    masses = "[[beam.point_masses]]\nmass = 2e-3\n[[beam.point_masses]]\nmass = 0\nposition = 0.2\n"
    system, _ = vj.io.read_rig(write(tmp_path, DEFAULT.replace("[[stop]]", masses + "[[stop]]", 1)))
    first, second = system.beam.point_masses
    assert (first.mass, first.position, second.position) == (2e-3, 1.0, 0.2)
    wrong = masses.replace("2e-3", "-1")
    with pytest.raises(ValueError, match=r"\[\[beam.point_masses\]\] mass must be at least 0"):
        vj.io.read_rig(write(tmp_path, DEFAULT.replace("[[stop]]", wrong + "[[stop]]", 1)))
    with pytest.raises(ValueError, match=r"point_masses must be one or more tables"):
        vj.io.read_rig(write(tmp_path, DEFAULT.replace("[beam]", "[beam]\npoint_masses = 3", 1)))


def test_point_force_and_no_stop(tmp_path):
    text = DEFAULT.replace('"base_motion"', '"point_force"\nposition = 0.35')
    text = text[: text.index("[[stop]]")] + text[text.index("[drive]") :]
    system, _ = vj.io.read_rig(write(tmp_path, text))
    assert isinstance(system.drive, vj.PointForce)
    assert (system.drive.position, system.stops) == (0.35, ())


def test_settings_go_into_a_sweep(tmp_path):
    more = 'direction = "both"\nrefine_jumps = false\nmax_period = 8\nmax_periods = 50\n'
    system, settings = vj.io.read_rig(write(tmp_path, DEFAULT + more))
    assert settings["settings"].refine_jumps is None
    response = vj.frequency_sweep(replace(system, num_modes=1), **settings)
    assert response.amplitude_ratio.shape == (2, 4)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("length = 0.2", "lenght = 0.2", r"unknown key 'lenght' in \[beam\]. Did you mean 'leng"),
        ("length = 0.2", "", r"\[beam\] lacks the key 'length'"),
        ("length = 0.2", "length = 0.0", r"\[beam\] length must be above 0 m, got 0.0"),
        ("length = 0.2", 'length = "0.2"', r"\[beam\] length must be a number, got '0.2'"),
        ("length = 0.2", "length = true", r"\[beam\] length must be a number, got true"),
        ("length = 0.2", "length = nan", r"\[beam\] length must be above 0 m, got nan"),
        ("taper = 0.5", "taper = 1.0", r"\[beam\] taper must be at least 0 and below 1, got 1.0"),
        ("density = 8250", "density = -1", r"\[beam\] density must be above 0"),
        ("130e9", "0", r"\[beam\] youngs_modulus must be above 0 Pa"),
        ("thickness = 1e-3", "thickness = 0", r"\[beam\] thickness must be above 0 m"),
        ("gap = 0.4e-3", "gap = inf", r"\[\[stop\]\] gap must be a finite length"),
        ("stiffness = 5500", "stiffness = -1", r"\[\[stop\]\] stiffness must be at least 0"),
        ("damping = 5e-5", "damping = -1", r"\[\[stop\]\] damping must be at least 0"),
        ("position = 0.5", "position = 0", r"\[\[stop\]\] position must be above 0"),
        ("damping = 5e-5", "side = 2", r"\[\[stop\]\] side must be one of 1, -1, got 2"),
        ("damping = 5e-5", "tension = 0", r"\[\[stop\]\] tension must be true or false, got 0"),
        ("[[stop]]", "[[stops]]", "unknown table 'stops'. Did you mean 'stop'"),
        ("[beam]", "beam = 3\n[rest]", "unknown table 'rest'"),
        ("[beam]", "gap = 3\n[beam]", "unknown key outside the tables, 'gap'"),
        ("[beam]", "[[beam]]", r"beam must be a table that begins with \[beam\]"),
        ("[model]\ndamping_ratio = 0.018", "", r"the table \[model\] is missing"),
        ('"base_motion"', '"shaker"', r"\[drive\] kind must be one of 'base_motion', 'point_f"),
        ("amplitude = 0.2e-3", "amplitude = 1\nposition = 1", "the base moves as a whole"),
        ("0.018", "0.018\nnum_modes = 0", r"\[model\] num_modes must be a whole number of at l"),
        ("0.018", "0.018\nnum_modes = 2.5", r"\[model\] num_modes must be a whole number, got"),
        ("0.018", '0.018\nformulation = "x"', r"\[model\] formulation must be one of"),
        ("[0.9, 1.2, 4]", "[0.9, 1.2]", r"\[sweep\] frequency_ratio must be three numbers"),
        ("[0.9, 1.2, 4]", "[]", r"\[sweep\] frequency_ratio must be three numbers"),
        ("[0.9, 1.2, 4]", "[1.2, 0.9, 4]", r"\[sweep\] frequency_ratio must start below its end"),
        ("[0.9, 1.2, 4]", "[0.9, inf, 4]", r"\[sweep\] frequency_ratio must be finite"),
        ("[0.9, 1.2, 4]", "[0.9, nan, 4]", r"\[sweep\] frequency_ratio must be finite"),
        ("[0.9, 1.2, 4]", "[0.0, 1.2, 4]", r"Start of \[sweep\] frequency_ratio must be above 0"),
        ("[0.9, 1.2, 4]", "[0.9, 1.2, 4.5]", r"Points of \[sweep\] frequency_ratio must be a wh"),
        ("[0.9, 1.2, 4]", "[0.9, 1.2, 4]\nfrequency = [1, 2, 3]", "give one of the two"),
        ("[0.9, 1.2, 4]", '[0.9, 1.2, 4]\ndirection = "up"', r"\[sweep\] direction must be one"),
        ("[0.9, 1.2, 4]", "[0.9, 1.2, 4]\ntolerance = 0", r"\[sweep\] tolerance must be"),
        ("[beam]", "[beam", "is not TOML: .*line 2"),
        (
            "4]",
            "1_000_000_000_000]",
            "Points of .sweep. frequency_ratio must be a whole number of at most 1,000,000, got",
        ),
        ("0.018", "0.018\nnum_modes = 1_000_000_000_000", "num_modes must be at most 1,000, got 1"),
        ("4]", "4]\nmax_period = 10_000_000", r"\[sweep\] max_period must be at most 1,000,000"),
        (
            "4]",
            f"4]\n[map.axes]\ngap = {THREE.format(10**12)}",
            "of .map.axes. gap must be a whole number of at most 1,000,000, got",
        ),
        (
            "4]",
            f"4]\n[[map.zipped]]\ngap = {THREE.format(10**12)}",
            "number of at most 1,000,000, got",
        ),
        ("length = 0.2", f"length = {'[' * 1000}{']' * 1000}", "is nested too deeply"),
        ("length = 0.2", f"length = {'{a=' * 1000}1{'}' * 1000}", "is nested too deeply"),
        ("length = 0.2", f"length = {'[' * 90}{']' * 90}", r"length must be a number, got \[\[\["),
        ("length = 0.2", f"length = 1{'0' * 400}", r"\[beam\] length must be a number, got 100"),
        ("length = 0.2", f"length = {'9' * 5000}", "is not TOML: Exceeds the limit"),
        ("length = 0.2", "length = 2026-01-01", "length must be a number, got 2026-01-01"),
        ("[0.9, 1.2, 4]", f"[0.9, {10**30}, 4]\ntolerance = 0", r"\[sweep\] tolerance must be"),
    ],
)
def test_wrong_files(tmp_path, old, new, sentence):
    assert old in DEFAULT
    path = write(tmp_path, DEFAULT.replace(old, new, 1))
    with pytest.raises(ValueError, match=sentence) as caught:
        vj.io.read_rig(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_second_stop_is_named(tmp_path):
    stop = "[[stop]]\nposition = 0.5\ngap = inf\nstiffness = 1\n"
    with pytest.raises(ValueError, match=r"\[\[stop\]\] 2: gap must be a finite length"):
        vj.io.read_rig(write(tmp_path, DEFAULT.replace("[drive]", stop + "[drive]")))


def test_no_such_file(tmp_path):
    with pytest.raises(ValueError, match=r"nothing\.toml' does not exist"):
        vj.io.read_rig(tmp_path / "nothing.toml")
    with pytest.raises(ValueError, match="is a folder"):
        vj.io.read_rig(tmp_path)


@pytest.mark.parametrize("path", [None, 3, b"rig.toml", ["rig.toml"], "", "x\0"])
def test_what_is_no_path(path):
    with pytest.raises(ValueError, match="Rig file must be the path of a file, got"):
        read_bytes("Rig file", path)


def test_a_file_with_a_byte_order_mark_and_one_too_large(tmp_path):
    system, _ = vj.io.read_rig(write(tmp_path, "\ufeff" + DEFAULT))
    assert same(system, vj.default_rig())
    with pytest.raises(ValueError, match=r"is too large: 11 MB, at most 10 MB\."):
        vj.io.read_rig(write(tmp_path, "#" * 11_000_000))


def test_not_text(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(ValueError, match="is not TOML"):
        vj.io.read_rig(path)


def test_without_a_drive_there_are_still_modes(tmp_path):
    text = DEFAULT[: DEFAULT.index("[drive]")] + DEFAULT[DEFAULT.index("[model]") :]
    system, _ = vj.io.read_rig(write(tmp_path, text))
    assert isinstance(system.drive, vj.NoDrive)
    assert math.isclose(system.modes().frequency[0], 9.210324, rel_tol=1e-6)
