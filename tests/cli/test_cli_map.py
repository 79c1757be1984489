import inspect
import json
from pathlib import Path

import numpy as np
import pytest
import xarray
from test_cli import RIG, left, run

import vibrojax as vj
from vibrojax.cli import map as cli_map
from vibrojax.io.rig_file import read_map

EXAMPLE = Path(__file__).parents[2] / "examples" / "map.toml"
MAP = """
[map]
response = "sweep"
frequency_ratio = [0.9, 1.4, 6]
direction = "forward"
measures = ["peak_amplitude_ratio", "jump_up"]
keep_curves = true
gradients = ["damping"]
[map.axes]
gap = { start = 1e-4, end = 1e-2, points = 3, spacing = "log" }
mass_ratio = [0, 0.5]
[[map.zipped]]
taper = [0.0, 0.5]
width = { start = 0.02, end = 0.03, points = 2 }
"""
NO_STOP = RIG[: RIG.index("[[stop]]")] + RIG[RIG.index("[drive]") :]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A folder with rig files."""
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text(RIG)
    Path("map.toml").write_text(RIG + MAP)
    return tmp_path


def made_map(gap=(1e-4, 2e-4, 3e-4, 4e-4), failed=0):
    """In the place of a map."""
    count = len(gap)
    peak = np.linspace(3.0, 5.0, count)
    status = np.zeros(count, np.int8)
    jump = np.full(count, np.nan)
    if failed:
        peak[-failed:], status[-failed:] = np.nan, 3
    words = "settled aperiodic diverged failed missing"
    return xarray.Dataset(
        {
            "peak_amplitude_ratio": ("gap", peak, {"units": "1"}),
            "largest_contact_force": ("gap", np.ones(count), {"units": "N"}),
            "jump_up": ("gap", jump, {"units": "1"}),
            "lane_steps": ("gap", np.full(count, 100)),
            "lane_status": (
                "gap",
                status,
                {"flag_values": list(range(5)), "flag_meanings": words},
            ),
        },
        {"gap": ("gap", list(gap), {"units": "m", "long_name": "Gap"})},
        {
            "block": json.dumps([2]),
            "summary": "1 of 2 chunks failed twice. Chunk 1 at gap[2:4]: ValueError: no. The same "
            "call with the same store again computes only what is missing.",
        },
    )


@pytest.fixture
def asked(monkeypatch):
    """What `parameter_map` is asked; nothing is computed."""
    calls = {"answer": made_map()}

    def remember(make, *groups, **settings):
        calls.update(make=make, groups=groups, settings=settings)
        if isinstance(calls["answer"], BaseException):
            raise calls["answer"]
        return calls["answer"]

    monkeypatch.setattr("vibrojax.maps.parameter_map.parameter_map", remember)
    return calls


def settings_for(asked, *words):
    """The settings that the command asks for, without its pictures."""
    assert run("map", *words, "--picture", "none", "--summary", "none", "--quiet") == 0
    return asked["settings"]


def test_axes_of_the_command_line(asked):
    axes = ["--axis", "gap=0.2e-3:1e-3:5", "taper=0,0.25,0.5", "--axis", "stiffness=1e3:1e5:3:log"]
    settings = settings_for(asked, *axes, "--frequency-ratio", "0.9", "1.4", "6")
    np.testing.assert_allclose(settings["gap"], np.linspace(0.2e-3, 1e-3, 5))
    assert settings["taper"] == [0.0, 0.25, 0.5]
    np.testing.assert_allclose(settings["stiffness"], [1e3, 1e4, 1e5])
    np.testing.assert_allclose(settings["frequency_ratio"], np.linspace(0.9, 1.4, 6))
    assert repr(settings["response"]) == repr(vj.SweepSettings())
    assert (settings["measures"], settings["keep_curves"], settings["gradients"]) == (None,) * 2 + (
        (),
    )
    assert (settings["store"], settings["chunk_lanes"]) == (Path("map.zarr"), None)
    assert settings["progress"] is False
    made = asked["make"](gap=1e-3, taper=0.1, stiffness=5.0)
    stop = made.stops[0]
    assert (stop.gap, made.beam.taper, stop.law.stiffness) == (1e-3, 0.1, 5.0)


def test_every_option(asked):
    settings = settings_for(
        asked,
        *("rig.toml", "--axis", "gap=4e-4", "--zipped", "taper=0,0.5", "width=0.02:0.03:2"),
        *("--zipped", "length=0.1,0.2", "density=8e3,9e3", "--frequency", "9.5"),
        *("--response", "periodic", "--tolerance", "1e-6", "--measures", "natural_frequency"),
        *("--keep-curves", "--gradients", "gap", "damping", "--store", "none"),
        *("--chunk-lanes", "8"),
    )
    assert settings["gap"] == [4e-4]
    first, second = asked["groups"]
    assert first.values == {"taper": [0.0, 0.5], "width": [0.02, 0.03]}
    assert second.values == {"length": [0.1, 0.2], "density": [8e3, 9e3]}
    assert settings["frequency"] == 9.5
    assert "frequency_ratio" not in settings
    assert repr(settings["response"]) == repr(vj.PeriodicSettings(tolerance=1e-6))
    assert (settings["measures"], settings["keep_curves"]) == (["natural_frequency"], True)
    assert (settings["store"], settings["chunk_lanes"]) == (None, 8)
    assert settings["gradients"] == ("gap", "damping")
    parameters = inspect.signature(asked["make"]).parameters
    assert parameters["damping"].default == 5e-5


def test_the_table_of_a_file(asked):
    settings = settings_for(asked, "map.toml")
    np.testing.assert_allclose(settings["gap"], [1e-4, 1e-3, 1e-2])
    assert settings["mass_ratio"] == [0.0, 0.5]
    (group,) = asked["groups"]
    assert group.values == {"taper": [0.0, 0.5], "width": [0.02, 0.03]}
    np.testing.assert_allclose(settings["frequency_ratio"], np.linspace(0.9, 1.4, 6))
    assert settings["response"].direction == "forward"
    assert settings["measures"] == ["peak_amplitude_ratio", "jump_up"]
    assert (settings["keep_curves"], settings["gradients"]) == (True, ("damping",))


def test_options_override_the_file(asked):
    axes = ["--axis", "gap=1e-3,2e-3", "--zipped", "mass_ratio=0,1", "position=0.4,0.6"]
    more = ["--direction", "both", "--measures", "jump_down", "--no-curves", "--frequency", "9"]
    settings = settings_for(asked, "map.toml", *axes, *more, "--gradients", "gap")
    assert settings["gap"] == [1e-3, 2e-3]
    assert "mass_ratio" not in settings
    assert [list(group.values) for group in asked["groups"]] == [
        ["taper", "width"],
        ["mass_ratio", "position"],
    ]
    assert settings["frequency"] == 9.0
    assert settings["response"].direction == "both"
    assert (settings["measures"], settings["keep_curves"]) == (["jump_down"], False)
    assert settings["gradients"] == ("gap",)
    settings = settings_for(asked, "map.toml", "--axis", "taper=0.1", "width=0.02")
    assert (asked["groups"], settings["taper"], settings["width"]) == ((), [0.1], [0.02])


def test_settings_of_the_sweep_hold_for_maps(asked):
    text = RIG + "tolerance = 1e-5\nmax_period = 4\nrefine_jumps = false\n"
    Path("rig.toml").write_text(text)
    settings = settings_for(asked, "rig.toml", "--axis", "gap=1e-3,2e-3")
    np.testing.assert_allclose(settings["frequency"], np.linspace(8, 12, 6))
    wanted = vj.SweepSettings(tolerance=1e-5, max_period=4, refine_jumps=None)
    assert repr(settings["response"]) == repr(wanted)
    settings = settings_for(
        asked, "rig.toml", "--axis", "gap=1e-3,2e-3", "--response", "continuation"
    )
    assert repr(settings["response"]) == repr(vj.ContinuationSettings())
    assert len(settings_for(asked, "--axis", "gap=1e-3")["frequency_ratio"]) == 61


def test_table_and_pictures(folder, capsys, asked):
    assert run("map", "--axis", "gap=1e-4:4e-4:4", "--frequency", "9", "10", "3") == 0
    out, err = capsys.readouterr()
    assert err == ""
    for line in (
        "Map of the default rig (dimensions assumed)\n",
        "gap                       0.0001, 0.0002, 0.0003, 0.0004 m\n",
        "frequency                 9, 9.5, 10 Hz\n",
        "lanes, 4                  4 settled, 0 aperiodic, 0 diverged, 0 failed; each by its worst",
        "points, 24                in chunks, 2 of up to 2 lanes\n",
        "peak_amplitude_ratio          4      3  gap 0.0001        5  gap 0.0004\n",
        "largest_contact_force, N      4      1  everywhere\n",
        "jump_up                       0   none\n",
        "written                   map.zarr, map.png, map_summary.png\n",
    ):
        assert line in out
    assert left(folder) == ["map.png", "map.toml", "map_summary.png", "rig.toml"]


def test_a_single_lane_is_not_drawn(folder, capsys, asked):
    asked["answer"] = made_map(gap=(1e-4,))
    assert run("map", "--axis", "gap=1e-4", "--summary", "none") == 0
    out = capsys.readouterr().out
    assert "not drawn                 map.png: a single lane makes no map" in out
    assert left(folder) == ["map.toml", "rig.toml"]


def test_what_has_too_many_axes_is_not_drawn(folder, capsys, asked, monkeypatch):
    def refuse(*_, **__):
        raise ValueError("3 axes are left over.")

    monkeypatch.setattr("vibrojax.plot.map_plot.plot_map", refuse)
    assert run("map", "--axis", "gap=1e-4:4e-4:4") == 0
    assert "not drawn                 map.png: 3 axes are left over." in capsys.readouterr().out
    assert left(folder) == ["map.toml", "map_summary.png", "rig.toml"]


@pytest.mark.parametrize("failed", [2, 4])
def test_failed_chunks(capsys, asked, failed):
    asked["answer"] = made_map(failed=failed)
    assert run("map", "--axis", "gap=1e-4:4e-4:4") == 1
    out, err = capsys.readouterr()
    assert f"{failed} failed; each by its worst point" in out
    assert err == (
        "vibrojax: 1 of 2 chunks failed twice. Chunk 1 at gap[2:4]: ValueError: no. The same "
        "command again computes only what is missing.\n"
    )


def test_interrupted(capsys, asked):
    asked["answer"] = KeyboardInterrupt()
    assert run("map", "--axis", "gap=1e-4,2e-4") == 130
    assert capsys.readouterr() == ("", "\n")
    Path("map.zarr").mkdir()
    assert run("map", "--axis", "gap=1e-4,2e-4") == 130
    assert capsys.readouterr().err == (
        "\nvibrojax: interrupted. Whole chunks are in map.zarr: the same command continues.\n"
    )


def test_a_full_disk(capsys, asked):
    asked["answer"] = vj.maps.StoreFull(28, "The disk of the store is full")
    assert run("map", "--axis", "gap=1e-4,2e-4") == 1
    assert capsys.readouterr().err == (
        "vibrojax: the disk is full. Whole chunks stay: make room, and the same command "
        "continues: map.zarr.\n"
    )
    asked["answer"] = PermissionError(13, "Permission denied")
    assert run("map", "--axis", "gap=1e-4,2e-4") == 1
    assert capsys.readouterr().err == "vibrojax: Permission denied.\n"


def test_dry_run(folder, capsys, asked):
    asked["answer"] = "Map of 4 lanes, 24 points"
    assert run("map", "--axis", "gap=1e-4:4e-4:4", "--dry-run") == 0
    assert asked["settings"]["dry_run"] is True
    assert capsys.readouterr().out.startswith("Map of 4 lanes, 24 points\n")
    assert left(folder) == ["map.toml", "rig.toml"]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ([], "a map needs an axis: give --axis, such as gap=0.2e-3:1e-3:20"),
        (["--axis"], "a map needs an axis"),
        (["--axis", "gap"], "--axis must be NAME=LOW:HIGH:COUNT[:log] or NAME=VALUE,VALUE"),
        (["--axis", "gap=1:2"], "--axis must be NAME=LOW:HIGH:COUNT[:log]"),
        (["--axis", "gap=1e-3", "rig.toml"], "got 'rig.toml'. The rig file comes first."),
        (["--axis", "gap=wide"], "--axis gap must be a number, got 'wide'"),
        (["--axis", "gap=1,,2"], "--axis gap must be a number, got ''"),
        (["--axis", "gap=2:1:3"], "--axis gap must start below its end, got start 2.0 and end 1"),
        (["--axis", "gap=1:inf:3"], "--axis gap must be finite"),
        (["--axis", "gap=1:2:3.5"], "Points of --axis gap must be a whole number of at least 2"),
        (["--axis", "gap=1:2:1"], "Points of --axis gap must be a whole number of at least 2"),
        (["--axis", "gap=1:2:3:cubic"], "Spacing of --axis gap must be one of 'linear', 'log'"),
        (["--axis", "gap=0:2:3:log"], "Start of --axis gap must be above 0 with log spacing"),
        (["--axis", "gpa=1,2"], "--axis gpa (or [map] in the rig file): no such number of the"),
        (["--axis", "gap=1", "--gradients", "rho"], "--gradients rho (or [map]"),
        (["--axis", "gap=1", "--axis", "gap=2"], "gap is given twice"),
        (["--axis", "gap=1", "--zipped", "gap=2", "taper=0"], "gap is given twice"),
        (["--zipped", "gap=1,2"], "--zipped or [[map.zipped]]: zipped needs at least two"),
        (["--zipped", "gap=1,2", "taper=0,0.2,0.3"], "gap has 2, taper has 3"),
        (["--frequency", "8", "9"], "--frequency must be START END POINTS, or one value, got 2"),
        (["--frequency", "8", "9", "2.5"], "Points of --frequency must be a whole number"),
        (["--frequency-ratio", "0"], "--frequency-ratio must be above 0 (ratio), got 0.0"),
        (["--frequency-ratio", "1.4", "1", "5"], "--frequency-ratio must start below its end"),
        (["--frequency", "9", "--frequency-ratio", "1"], "one of the two"),
        (["--keep-curves", "--no-curves"], "give --keep-curves or --no-curves, one of the two"),
        (["--response", "periodic", "--direction", "both"], "--direction is for --response sweep"),
        (["--response", "periodic", "--tolerance", "1"], "tolerance must be above 0, up to 0.1"),
        (["--picture", "map.gif"], "--picture must end in .png, .svg or .pdf"),
        (["--summary", "no/map.png"], "--summary: the folder 'no' does not exist"),
        (["--store", "no/map.zarr"], "--store: the folder 'no' does not exist"),
        (["--store", "rig.toml"], "store: 'rig.toml' is there already and is not a store of a map"),
    ],
)
def test_wrong_options(folder, capsys, asked, options, sentence):
    if options and not {"--axis", "--zipped"} & set(options):
        options = ["--axis", "gap=1e-3,2e-3", *options]
    assert run("map", *options) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("vibrojax: ")
    assert err.count("\n") == 1
    assert sentence in err
    assert "settings" not in asked
    assert left(folder) == ["map.toml", "rig.toml"]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("measures =", "measure =", "unknown key 'measure' in [map]. Did you mean 'measures'"),
        ('measures = ["peak', 'measures = [3, "peak', "[map] measures must be a list of texts"),
        ('"sweep"', '"swept"', "[map] response must be one of 'sweep', 'periodic'"),
        ('"sweep"', '"periodic"', "[map] direction is for response = 'sweep'"),
        ('"forward"', '"up"', "[map] direction must be one of"),
        ("[0.9, 1.4, 6]", "[0.9, 1.4]", "[map] frequency_ratio must be three numbers"),
        ("[0.9, 1.4, 6]", "-1", "[map] frequency_ratio must be above 0 (ratio), got -1"),
        ("[0.9, 1.4, 6]", "1\nfrequency = 2", "[map] has frequency and frequency_ratio"),
        ("[0, 0.5]", "[]", "[map.axes] mass_ratio must be a list of numbers, or {start = ..."),
        ("[0, 0.5]", "0.5", "[map.axes] mass_ratio must be a list of numbers, or {start = ..."),
        ("[0, 0.5]", "[0, true]", "Every value of [map.axes] mass_ratio must be a number, got t"),
        ("points = 3", "count = 3", "unknown key 'count' in [map.axes] gap. Known: start"),
        (", points = 3", "", "[map.axes] gap lacks the key 'points'"),
        ("points = 3", 'points = "3"', "Points of [map.axes] gap must be a whole number"),
        ("end = 1e-2", "end = true", "[map.axes] gap end must be a number, got true"),
        ('"log"', "3", "Spacing of [map.axes] gap must be one of 'linear', 'log', got 3"),
        ("[[map.zipped]]", "[map.zipped]", "[map] zipped must be one or more tables [[map.zip"),
        ("[map.axes]", "[map.axs]", "unknown key 'axs' in [map]. Did you mean 'axes'"),
    ],
)
def test_wrong_tables(capsys, asked, old, new, sentence):
    assert old in MAP
    Path("map.toml").write_text(RIG + MAP.replace(old, new))
    assert run("map", "map.toml") == 2
    err = capsys.readouterr().err
    assert err.startswith("vibrojax: Rig file 'map.toml': ")
    assert sentence in err
    assert "settings" not in asked


def test_what_the_rig_has_not(capsys, asked):
    Path("rig.toml").write_text(NO_STOP)
    assert run("map", "rig.toml", "--axis", "gap=1,2") == 2
    assert "the rig has no stop. Give it a table [[stop]]" in capsys.readouterr().err
    Path("rig.toml").write_text(
        RIG.replace('[drive]\nkind = "base_motion"\namplitude = 0.2e-3', "")
    )
    assert run("map", "rig.toml", "--axis", "gap=1,2") == 2
    assert "a map needs the table [drive]" in capsys.readouterr().err
    assert run("map", "map.toml", "--axis", "width=0.01,0.02") == 2
    err = capsys.readouterr().err
    assert "The rig file has taper and width in one [[map.zipped]]: with another width, say" in err
    assert "settings" not in asked


def test_what_the_map_itself_refuses_is_one_line(folder, capsys):
    for words, sentence in (
        (["--axis", "position=-1e-3,1e-3"], "position must be"),
        (["--axis", "gap=1e-3,1e-3"], "gap has the value 0.001 twice"),
        (["--axis", "gap=1e-3,2e-3", "--measures", "jump"], "Unknown measure 'jump'"),
        (
            ["--axis", "gap=1:2:1000000000000"],
            "gap must be a whole number of at most 1,000,000, got",
        ),
        (["--axis", "gap=1:2:1000000", "width=1:2:1000000"], "must be at most 1,000,000,000, got"),
    ):
        assert run("map", *words) == 2
        err = capsys.readouterr().err
        assert sentence in err
        assert err.count("\n") == 1
    assert left(folder) == ["map.toml", "rig.toml"]


@pytest.mark.parametrize("words", [["--respons", "x"], ["--response", "swept"], ["--tolerance"]])
def test_tyro_refuses_with_the_same_code(capsys, asked, words):
    assert run("map", *words) == 2
    assert capsys.readouterr().err
    assert "settings" not in asked


def test_help(capsys):
    assert run("map", "--help") == 0
    text = capsys.readouterr().out
    for words in ("NAME=LOW:HIGH:COUNT[:log]", "--zipped", "$ vibrojax map rig.toml", "Exit code"):
        assert words in text


def test_a_rig_file_may_carry_a_map(folder):
    system, settings = vj.io.read_rig("map.toml")
    assert repr(system) == repr(vj.io.read_rig("rig.toml")[0])
    assert settings.keys() == {"frequency", "settings"}
    assert read_map("rig.toml") == {}
    with pytest.raises(ValueError, match=r"^Rig file 'no.toml' does not exist"):
        read_map("no.toml")


def test_example_names_every_key(asked):
    from vibrojax.io.rig_file_keys import MAP_KEYS, SPACED_KEYS

    text = EXAMPLE.read_text()
    lines = [line.removeprefix("# ") for line in text.split("\n")]
    for name in MAP_KEYS:
        if name not in ("axes", "zipped"):
            assert any(line.startswith(f"{name} = ") for line in lines), name
    for word in (*(f"{name} = " for name in SPACED_KEYS), "[map.axes]", "[[map.zipped]]"):
        assert word in text
    settings = settings_for(asked, str(EXAMPLE))
    assert len(settings["gap"]) == 9
    assert settings["keep_curves"] is False
    taper, width = (np.array(values) for values in asked["groups"][0].values.values())
    np.testing.assert_allclose(width * (1 - taper / 2), width[0], rtol=1e-7)


@pytest.mark.slow
def test_a_real_map(folder, capsys):
    text = RIG.replace("0.018", "0.018\nnum_modes = 1")
    Path("rig.toml").write_text(text[: text.index("[sweep]")])
    command = ["rig.toml", "--axis", "gap=0.3e-3,0.4e-3", "--frequency-ratio", "0.9", "1.2", "4"]
    assert run("map", *command, "--chunk-lanes", "1") == 0
    out, err = capsys.readouterr()
    assert "Map of rig.toml\n" in out
    assert "lanes, 2                  2 settled" in out
    assert "points, 16                in chunks, 2 of up to 1 lanes\n" in out
    assert err.count("\n") <= 1 or "map: 100%" in err  # the progress bar
    made = ["map.png", "map.toml", "map.zarr", "map_summary.png", "rig.toml"]
    assert left(folder) == made
    with xarray.open_zarr("map.zarr") as first:
        peak = first["peak_amplitude_ratio"].values
        assert first["amplitude_ratio"].dims == ("gap", "direction", "frequency_ratio")
        assert f"{peak.max():.5g}" in out
    assert run("map", *command, "--quiet", "--store", "none") == 0
    assert capsys.readouterr().out == ""
    # One of its chunks is taken away: the same command computes only that.
    stored = sorted(Path("map.zarr/lane_status/c").iterdir())
    assert len(stored) == 2
    stored[1].unlink()
    with pytest.warns(UserWarning, match=r"damaged: chunk 1 at gap\[1:2\]: lane_status"):
        assert run("map", *command) == 0
    assert "1 were in the store, 1 computed now" in capsys.readouterr().out
    assert run("map", *command) == 0
    assert "2 were in the store, nothing was left to compute" in capsys.readouterr().out
    with xarray.open_zarr("map.zarr") as again:
        np.testing.assert_array_equal(again["peak_amplitude_ratio"], peak)
    assert run("map", *command, "--tolerance", "1e-5") == 2
    assert "was made with other settings. response" in capsys.readouterr().err
    assert run("map", *command, "--dry-run", "--store", "other.zarr") == 0
    assert "Map of 2 lanes, 16 points" in capsys.readouterr().out
    assert left(folder) == made


def test_an_axis_that_is_read():
    assert cli_map.read_axis("--axis", "gap=-1:1:3") == ("gap", [-1.0, 0.0, 1.0])
