import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray

import vibrojax as vj
from vibrojax.cli import command as cli
from vibrojax.cli import files, options

EXAMPLE = str(Path(__file__).parents[2] / "examples" / "uniform_beam.toml")

RIG = """
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
frequency = [8.0, 12.0, 6]
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def left(folder):
    return sorted(path.name for path in folder.iterdir())


def run(*arguments):
    """Exit code of the command line."""
    try:
        return cli.main(list(arguments))
    except SystemExit as leaving:
        return leaving.code


@pytest.fixture
def no_sweep(monkeypatch):
    """Fail a test that gets as far as computing."""

    def refuse(*_, **__):
        raise AssertionError("a sweep was started")

    monkeypatch.setattr("vibrojax.sweep.frequency_sweep.frequency_sweep", refuse)


def test_sweep_of_the_default_rig(folder, capsys):
    assert run("sweep", "--frequency-ratio", "1.0", "1.3", "7") == 0
    table = capsys.readouterr().out
    assert "Frequency sweep of the default rig" in table
    for row in ("first natural frequency", "9.2103", "jump up", "jump down", "hysteresis area"):
        assert row in table
    assert "14 settled, 0 aperiodic, 0 diverged" in table
    assert left(folder) == ["sweep.nc", "sweep.png"]
    with xarray.open_dataset("sweep.nc") as data:
        assert data.amplitude_ratio.shape == (2, 7)
        assert float(data.jump_down) == pytest.approx(1.2267, rel=1e-3)
        assert f"{float(data.jump_down):.5f}" in table


def test_sweep_of_a_file_in_hertz(folder, capsys):
    Path("rig.toml").write_text(RIG)
    where = ("--output", "a.nc", "--picture", "none", "--tolerance", "1e-3")
    assert run("sweep", "rig.toml", "--quiet", *where) == 0
    assert capsys.readouterr().out == ""
    assert left(folder) == ["a.nc", "rig.toml"]
    with xarray.open_dataset("a.nc") as data:
        np.testing.assert_allclose(data.frequency, np.linspace(8, 12, 6))


def test_options_come_before_the_file(monkeypatch):
    asked = {}

    def remember(_, **settings):
        asked.update(settings)
        raise KeyboardInterrupt

    monkeypatch.setattr("vibrojax.sweep.frequency_sweep.frequency_sweep", remember)
    Path("rig.toml").write_text(RIG + 'tolerance = 1e-5\ndirection = "both"\n')
    options = ("--frequency-ratio", "1", "2", "3", "--direction", "forward")
    run("sweep", "rig.toml", *options, "--steps-per-period", "99", "--quiet")
    np.testing.assert_allclose(asked.pop("frequency_ratio"), [1.0, 1.5, 2.0])
    wanted = vj.SweepSettings(direction="forward", tolerance=1e-5, steps_per_period=99)
    assert repr(asked.pop("settings")) == repr(wanted)
    assert asked == {"progress": False}


def test_the_default_is_121_points(monkeypatch):
    asked = {}

    def remember(_, **settings):
        asked.update(settings)
        raise KeyboardInterrupt

    monkeypatch.setattr("vibrojax.sweep.frequency_sweep.frequency_sweep", remember)
    run("sweep")
    np.testing.assert_allclose(asked["frequency_ratio"], np.linspace(0.8, 1.4, 121))


def test_interrupt_is_quiet(folder, monkeypatch, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("vibrojax.sweep.frequency_sweep.frequency_sweep", interrupt)
    assert run("sweep") == 130
    assert capsys.readouterr() == ("", "\n")
    assert left(folder) == []


def test_a_failure_while_writing_leaves_nothing(folder, monkeypatch, capsys):
    def fail(*_, **__):
        raise OSError(28, "No space left on device", "sweep.png")

    monkeypatch.setattr("vibrojax.plot.frequency_response.plot_frequency_response", fail)
    Path("sweep.nc").write_text("older")
    assert run("sweep", "--frequency-ratio", "1.0", "1.3", "7") == 1
    assert capsys.readouterr().err == "vibrojax: No space left on device: sweep.png.\n"
    assert left(folder) == ["sweep.nc"]
    assert Path("sweep.nc").read_text() == "older"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--frequency-ratio", "1.4", "0.8", "5"], "--frequency-ratio must start below its end"),
        (["--frequency-ratio", "0", "1", "5"], "Start of --frequency-ratio must be above 0"),
        (["--frequency-ratio", "nan", "1", "5"], "--frequency-ratio must be finite"),
        (["--frequency", "8", "inf", "5"], "--frequency must be finite"),
        (["--frequency", "8", "9", "0"], "Points of --frequency must be a whole number of at"),
        (["--frequency-ratio", "1", "2", "3", "--frequency", "1", "2", "3"], "one of the two"),
        (["--output", "sweep.txt"], "--output must end in .nc, got 'sweep.txt'"),
        (["--picture", "sweep.gif"], "--picture must end in .png, .svg or .pdf"),
        (["--output", "no/sweep.nc"], "--output: the folder 'no' does not exist"),
        (["--picture", "no/sweep.png"], "--picture: the folder 'no' does not exist"),
        (["nothing.toml"], "Rig file 'nothing.toml' does not exist"),
    ],
)
@pytest.mark.usefixtures("no_sweep")
def test_wrong_options(folder, capsys, options, sentence):
    assert run("sweep", *options) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("vibrojax: ")
    assert err.count("\n") == 1
    assert sentence in err
    assert left(folder) == []


@pytest.mark.parametrize("options", [["--tolerance", "0"], ["--steps-per-period", "1"]])
def test_wrong_settings(folder, capsys, options):
    assert run("sweep", *options) == 2
    err = capsys.readouterr().err
    assert options[0].strip("-").replace("-", "_") in err
    assert err.count("\n") == 1
    assert left(folder) == []


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("taper = 0.5", "taper = 1.0", "[beam] taper must be at least 0 and below 1"),
        ("taper = 0.5", "taper = -0.1", "[beam] taper must be at least 0 and below 1"),
        ("length = 0.2", "length = 0", "[beam] length must be above 0 m"),
        ("density = 8250", "density = 0", "[beam] density must be above 0"),
        ("130e9", "-1", "[beam] youngs_modulus must be above 0 Pa"),
        ("thickness = 1e-3", "thickness = 0", "[beam] thickness must be above 0 m"),
        ("gap = 0.4e-3", "gap = inf", "[[stop]] gap must be a finite length in m"),
        ("stiffness = 5500", "stiffness = -1", "[[stop]] stiffness must be at least 0"),
        ("damping = 5e-5", "damping = -1", "[[stop]] damping must be at least 0"),
        ("position = 0.5", "position = 1.1", "[[stop]] position must be above 0 (root)"),
        ("0.018", "0.018\nnum_modes = 0", "[model] num_modes must be a whole number of at"),
        ("[8.0, 12.0, 6]", "[]", "[sweep] frequency must be three numbers"),
        ("[8.0, 12.0, 6]", "[nan, 12.0, 6]", "[sweep] frequency must be finite"),
        ("[8.0, 12.0, 6]", "[12.0, 8.0, 6]", "[sweep] frequency must start below its end"),
        ("gap =", "gpa =", "unknown key 'gpa' in [[stop]]. Did you mean 'gap'"),
        ("[beam]", "beam:", "is not TOML"),
        ('[drive]\nkind = "base_motion"\namplitude = 0.2e-3', "", "a sweep needs the table [dri"),
    ],
)
@pytest.mark.usefixtures("no_sweep")
def test_wrong_rig_files(folder, capsys, old, new, sentence):
    assert old in RIG
    Path("rig.toml").write_text(RIG.replace(old, new))
    assert run("sweep", "rig.toml") == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("vibrojax: Rig file 'rig.toml'")
    assert err.count("\n") == 1
    assert sentence in err
    assert left(folder) == ["rig.toml"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["swep"],
        ["sweep", "--bogus"],
        ["sweep", "--direction", "up"],
        ["sweep", "--frequency-ratio", "0.8", "1.4"],
        ["sweep", "--tolerance", "small"],
        ["sweep", "--frequency", "8", "9", "2.5"],
    ],
)
@pytest.mark.usefixtures("no_sweep")
def test_tyro_refuses_with_the_same_code(folder, capsys, arguments):
    assert run(*arguments) == 2
    assert capsys.readouterr().err
    assert left(folder) == []


def test_modes(folder, capsys):
    assert run("modes", "--output", "m.csv", "--picture", "m.png") == 0
    table = capsys.readouterr().out
    assert "frequency, Hz" in table
    assert "9.21032" in table
    assert left(folder) == ["m.csv", "m.png"]
    rows = np.genfromtxt("m.csv", delimiter=",", names=True)
    assert rows.dtype.names == ("mode", "frequency_hz", "beta", "modal_mass_kg", "participation")
    assert len(rows) == 5
    assert rows["beta"][0] == pytest.approx(1.421282, rel=1e-6)


def test_modes_writes_nothing_unless_asked(folder, capsys):
    assert run("modes", "--num-modes", "1") == 0
    assert len(capsys.readouterr().out.splitlines()) == 3
    assert left(folder) == []


def test_modes_refuses(folder, capsys):
    assert run("modes", "--num-modes", "0") == 2
    assert "num_modes must be a whole number of at least 1" in capsys.readouterr().err
    assert run("modes", EXAMPLE, "--output", "m.txt") == 2
    assert left(folder) == []


@pytest.mark.parametrize("arguments", [[], ["--help"], ["sweep", "--help"], ["modes", "--help"]])
def test_help(capsys, arguments):
    assert run(*arguments) == 0
    text = capsys.readouterr().out
    assert "usage: vibrojax" in text
    assert "$ vibrojax " in text
    if arguments[:1] == ["sweep"]:
        for option in ("--frequency-ratio", "--steps-per-period", "RIG.toml", "0.8 1.4 121"):
            assert option in text


def test_version(capsys):
    assert run("--version") == 0
    assert capsys.readouterr().out.startswith("vibrojax 0.")


def test_help_itself_imports_nothing_heavy():
    # The module alone: `import vibrojax`, which comes before it, imports jax.
    code = (
        "import importlib.util as u, sys\n"
        f"spec = u.spec_from_file_location('cli', {options.__file__!r})\n"
        "cli = sys.modules['cli'] = u.module_from_spec(spec); spec.loader.exec_module(cli)\n"
        "try: cli.parsed(['sweep', '--help'])\n"
        "except SystemExit as leaving: assert leaving.code == 0\n"
        "heavy = {'jax', 'numpy', 'matplotlib', 'xarray'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.slow
def test_as_a_process(folder):
    command = [sys.executable, "-m", "vibrojax.cli.command", "sweep", EXAMPLE]
    options = ["--frequency", "14", "21", "5", "--output", "u.nc", "--picture", "u.svg"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=True)
    assert "uniform_beam.toml" in done.stdout
    assert done.stderr == ""
    assert left(folder) == ["u.nc", "u.svg"]
    wrong = subprocess.run([*command, "--output", "u.txt"], capture_output=True, text=True)
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr == "vibrojax: --output must end in .nc, got 'u.txt'.\n"


def test_compiling_side_by_side_is_counted_once(monkeypatch):
    seconds = files.watch_compilation()
    for now, duration in ((10.0, 2.0), (11.0, 2.0), (20.0, 1.0)):  # from 8, 9 and 19 on
        monkeypatch.setattr(files.time, "perf_counter", lambda now=now: now)
        jax.monitoring.record_event_duration_secs("x/backend_compile_duration", duration)
    monkeypatch.undo()
    assert seconds() == pytest.approx(4.0)
