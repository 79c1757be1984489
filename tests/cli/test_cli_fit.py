import inspect
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from test_cli import RIG, run

import vibrojax as vj
from vibrojax.cli import fit as cli_fit
from vibrojax.identification.identification import Identification

DATA = Path(__file__).parents[1] / "data" / "sweeps.json"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A folder with a rig and a curve to fit it to."""
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text(RIG)
    write_curve("curve.csv")
    return tmp_path


def write_curve(name, header="ratio,peak_ratio,direction"):
    """The reference sweep of the rig with 2 % noise."""
    case = json.loads(DATA.read_text())["cases"]["C_MR0.5_mu0.5"]
    ways = (case["forward"], 1), (case["backward"], -1)
    rows = [(f, a, d) for c, d in ways for f, a in zip(c["ratio"], c["amp_ratio"], strict=True)]
    table = np.array(rows)
    table[:, 1] *= 1 + 0.02 * np.random.default_rng(0).normal(size=len(table))
    np.savetxt(name, table, delimiter=",", header=header, comments="")


def left(folder):
    return sorted(path.name for path in folder.iterdir())


class Found(Identification):
    """In the place of an identification."""

    def __init__(self):
        pass

    def save(self, path):
        files = path.with_suffix(".json"), path.with_suffix(".png")
        for file in files:
            file.write_text("made")
        return files

    def __repr__(self):
        return "Identification(2 numbers)\n  stiffness  5500"


@pytest.fixture
def asked(monkeypatch):
    """What `identify` is asked; nothing is computed."""
    calls = {}

    def remember(make, measured, guess, bounds, **settings):
        calls.update(make=make, measured=measured, guess=guess, bounds=bounds, **settings)
        return Found()

    monkeypatch.setattr("vibrojax.identification.identify.identify", remember)
    return calls


def test_defaults(folder, capsys, asked):
    assert run("fit", "curve.csv", "--rig", "rig.toml") == 0
    assert asked["guess"] == {"stiffness": 5500.0, "damping": 5e-5}
    assert asked["bounds"] == {}
    assert (asked["objective"], asked["searches"]) == ("distance", 1)
    measured = asked["measured"]
    assert (measured.quantity, measured.frequency_name) == ("peak", "frequency_ratio")
    assert measured.forward.sum() == measured.backward.sum()
    out = capsys.readouterr().out.splitlines()
    assert out[:3] == [
        "Fit of rig.toml to curve.csv",
        "  Identification(2 numbers)",
        "    stiffness  5500",
    ]
    assert out[-1] == "  written  fit.json, fit.png"
    assert left(folder) == ["curve.csv", "fit.json", "fit.png", "rig.toml"]


def test_without_a_rig_file(capsys, asked):
    assert run("fit", "curve.csv") == 0
    assert asked["guess"] == {"stiffness": 5500.0, "damping": 5e-5}
    assert "the default rig (dimensions assumed)" in capsys.readouterr().out


def test_options(folder, asked):
    write_curve("other.csv", header="f,tip,way")
    options = {
        "--fit": ["stiffness", "gap", "taper"],
        "--guess": ["stiffness=3000", "gap=5e-4"],
        "--bounds": ["stiffness=100:1e5", "taper=0.1:0.9"],
        "--objective": ["pointwise"],
        "--searches": ["4"],
        "--columns": ["amplitude=1", "direction=way", "frequency=f"],
        "--units": ["frequency=Hz", "amplitude=mm"],
        "--quantity": ["rms"],
        "--frame": ["absolute"],
        "--output": ["run.json"],
    }
    words = [word for option, values in options.items() for word in (option, *values)]
    assert run("fit", "other.csv", "--rig", "rig.toml", *words) == 0
    assert asked["guess"] == {"stiffness": 3000.0, "gap": 5e-4, "taper": 0.5}
    assert asked["bounds"] == {
        "stiffness": vj.Range(100.0, 1e5),
        "gap": vj.Range(0.0, 1e100),
        "taper": vj.Range(0.1, 0.9),
    }
    assert (asked["objective"], asked["searches"]) == ("pointwise", 4)
    measured = asked["measured"]
    assert (measured.quantity, measured.frame, measured.unit) == ("rms", "absolute", "m")
    assert measured.frequency_name == "frequency"
    assert {"run.json", "run.png"} <= set(left(folder))


def test_a_column_that_is_left_out(asked):
    columns = ("--columns", "direction=none")
    assert run("fit", "curve.csv", *columns) == 0
    assert asked["measured"].size == 94


def test_what_is_ambiguous_is_asked_about_in_options(capsys, asked):
    write_curve("forces.csv", header="ratio,peak_ratio,force (N)")
    assert run("fit", "forces.csv") == 2
    printed = capsys.readouterr().err
    for choice in ("--columns contact_force='force (N)'", "--columns contact_force=none"):
        assert choice in printed
    Path("comma.csv").write_text("ratio;peak_ratio\n0,9;1,250\n1;2,500\n1,1;1,250\n")
    assert run("fit", "comma.csv") == 0
    np.testing.assert_allclose(asked["measured"].amplitude, [1.25, 2.5, 1.25])
    Path("doubt.csv").write_text("ratio;peak_ratio\n1;1,250\n2;2,500\n3;1,250\n")
    assert run("fit", "doubt.csv") == 2
    assert "Give --decimal '.' or --decimal ','." in capsys.readouterr().err
    assert run("fit", "doubt.csv", "--decimal", ".") == 0
    np.testing.assert_allclose(asked["measured"].amplitude, [1250, 2500, 1250])
    runs = "up: ratio,up: peak_ratio,down: ratio,down: peak_ratio"
    Path("runs.csv").write_text(f"{runs}\n0.9,1,0.9,2\n1.0,3,1.0,4\n1.1,1,1.1,2\n")
    assert run("fit", "runs.csv") == 2
    assert (
        "holds 2 curves, 'runs, up', 'runs, down': say which by --run." in capsys.readouterr().err
    )
    assert run("fit", "runs.csv", "--run", "down") == 0
    np.testing.assert_allclose(asked["measured"].amplitude, [2, 4, 2])
    one = {"ratio": np.array([0.9, 1.0, 1.1]), "peak_ratio": np.array([1.0, 3.0, 1.0])}
    scipy.io.savemat("two.mat", {"bench": {"a": one, "b": one}})
    assert run("fit", "two.mat") == 2
    assert "Say which: --at 'bench.a'." in capsys.readouterr().err
    assert run("fit", "two.mat", "--at", "bench.b") == 0
    assert run("fit", str(Path.cwd())) == 2
    assert "is a folder: give the path of a file" in capsys.readouterr().err


def test_the_function_takes_what_is_fitted():
    system = vj.default_rig()
    make = cli_fit.rig_function(system, ["stiffness", "gap", "taper", "damping_ratio", "amplitude"])
    parameters = inspect.signature(make).parameters
    assert {n: p.default for n, p in parameters.items()} == {
        "stiffness": 5500.0,
        "gap": 0.4e-3,
        "taper": 0.5,
        "damping_ratio": 0.018,
        "amplitude": 0.2e-3,
    }
    assert repr(make()) == repr(system)
    made = make(stiffness=1.0, gap=2.0, taper=0.3, damping_ratio=0.4, amplitude=5.0)
    stop = made.stops[0]
    assert (stop.law.stiffness, stop.gap, made.beam.taper) == (1.0, 2.0, 0.3)
    assert (made.damping_ratio, made.drive.amplitude) == (0.4, 5.0)
    assert (stop.law.damping, made.beam.length) == (5e-5, 0.2)


def test_the_text_of_the_function(folder):
    for rig in (None, Path("rig.toml")):
        text, files = cli_fit.source_of_rig(rig, ["stiffness", "gap"])
        names = {"vibrojax": vj, "HERE": folder}
        exec(text, names)
        system = vj.default_rig() if rig is None else vj.io.read_rig(rig)[0]
        wanted = cli_fit.rig_function(system, ["stiffness", "gap"])
        assert repr(names["rig"](stiffness=3.0)) == repr(wanted(stiffness=3.0))
        assert files == ({} if rig is None else {"rig.toml": RIG})


def test_every_number_can_be_changed():
    system = vj.default_rig(position=0.6)
    known = cli_fit.rig_numbers(system)
    make = cli_fit.rig_function(system, list(known))
    for name, value in known.items():
        changed = cli_fit.rig_numbers(make(**{name: 0.9 * value}))
        assert changed == known | {name: 0.9 * value}


def test_the_other_stops_stay():
    stops = [vj.Stop(0.5, 1e-3, vj.KelvinVoigt(1e3)), vj.Stop(0.7, 2e-3, vj.KelvinVoigt(2e3))]
    rig = vj.default_rig()
    system = vj.ImpactingBeam(rig.beam, stops=stops, drive=rig.drive)
    made = cli_fit.rig_function(system, ["stiffness"])(stiffness=5.0)
    assert [stop.law.stiffness for stop in made.stops] == [5.0, 2e3]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            ["--fit", "stifness"],
            "--fit stifness: no such number of the rig. Did you mean",
        ),
        (["--fit", "gap", "gap"], "--fit must name at least one number, and each of them once"),
        (["--guess", "stiffness"], "--guess must be name=value, such as stiffness=3000, got 'st"),
        (["--guess", "stiffness=soft"], "--guess of stiffness must be a number, got 'soft'"),
        (["--guess", "gap=1e-3"], "--guess of 'gap', which is not fitted: stiffness, damping are"),
        (["--guess", "damping=1", "damping=2"], "--guess has damping twice"),
        (["--bounds", "stiffness=1000"], "--bounds must be name=low:high"),
        (["--bounds", "taper=0:1"], "--bounds of 'taper', which is not fitted"),
        (["--columns", "frequency=rpm"], "there is no column 'rpm' for frequency"),
        (["--columns", "frequency"], "--columns must be name=value, such as frequency=f_Hz"),
        (["--units", "amplitude=inch"], "Unit of amplitude must be one of"),
        (["--rig", "nothing.toml"], "Rig file 'nothing.toml' does not exist"),
        (["--output", "fit.txt"], "--output must be a name without ending"),
        (["--output", "no/fit"], "--output: the folder 'no' does not exist"),
        (["--report", "no/report.html"], "--report: the folder 'no' does not exist"),
        (["--report", "report.pdf"], "--report must end in .html or .htm, got 'report.pdf'"),
    ],
)
def test_wrong_options(folder, capsys, asked, options, sentence):
    assert run("fit", "curve.csv", *options) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("vibrojax: ")
    assert err.count("\n") == 1
    assert sentence in err
    assert asked == {}
    assert left(folder) == ["curve.csv", "rig.toml"]


def test_wrong_files(capsys, asked):
    assert run("fit", "nothing.csv") == 2
    err = capsys.readouterr().err
    assert "'nothing.csv' does not exist" in err
    assert err.count("\n") == 1
    no_stop = RIG[: RIG.index("[[stop]]")] + RIG[RIG.index("[drive]") :]
    Path("rig.toml").write_text(no_stop)
    assert run("fit", "curve.csv", "--rig", "rig.toml") == 2
    assert "--fit stiffness: the rig has no stop" in capsys.readouterr().err
    Path("rig.toml").write_text(
        RIG.replace('[drive]\nkind = "base_motion"\namplitude = 0.2e-3', "")
    )
    assert run("fit", "curve.csv", "--rig", "rig.toml") == 2
    assert "a fit needs the table [drive]" in capsys.readouterr().err
    assert asked == {}


@pytest.mark.parametrize("arguments", [[], ["c.csv", "--searches", "many"], ["c", "--fot", "a"]])
def test_tyro_refuses_with_the_same_code(capsys, asked, arguments):
    assert run("fit", *arguments) == 2
    assert capsys.readouterr().err
    assert asked == {}


def test_a_failure_while_writing_is_one_line(folder, monkeypatch, capsys, asked):
    def fail(self, path):
        raise OSError(28, "No space left on device", "fit.png")

    monkeypatch.setattr(Found, "save", fail)
    assert run("fit", "curve.csv") == 1
    assert capsys.readouterr().err == "vibrojax: No space left on device: fit.png.\n"
    assert left(folder) == ["curve.csv", "rig.toml"]


def test_help(capsys):
    assert run("fit", "--help") == 0
    text = capsys.readouterr().out
    for words in ("CURVE.csv", "--guess", "NAME=LOW:HIGH", "$ vibrojax fit curve.csv"):
        assert words in text


@pytest.mark.slow
def test_as_a_process(folder):
    command = [
        sys.executable,
        "-m",
        "vibrojax.cli.command",
        "fit",
        "curve.csv",
        "--rig",
        "rig.toml",
    ]
    options = ["--guess", "stiffness=3500", "damping=1e-4", "--output", "found"]
    options += ["--report", "report.html"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    report = json.loads(Path("found.json").read_text())
    low, high = report["parameters"]["stiffness"]["interval"]
    assert low < 5500.0 < high
    assert 0.5 < report["reduced_chi_square"] < 2.0
    assert f"stiffness  {report['parameters']['stiffness']['estimate']:.5g}" in done.stdout
    assert Path("found.png").read_bytes()[:4] == b"\x89PNG"
    page = Path("report.html").read_text("utf-8")
    assert "rig = rig_function(vibrojax.io.read_rig(" in page
    assert "It does not run as it is" not in page
