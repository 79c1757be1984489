"""The page that reports a fit: what is on it, and that its script finds the same numbers."""

import base64
import dataclasses
import io
import re
import runpy
import zipfile
from html.parser import HTMLParser

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.identification.coordinates import coordinate_of
from vibrojax.identification.fit import Alternative
from vibrojax.identification.fitted_data import fitted_data
from vibrojax.identification.identification import Identification
from vibrojax.identification.problem import Problem
from vibrojax.identification.report import report_page
from vibrojax.identification.run_again import run_again
from vibrojax.identification.trial_rigs import Curve

NASTY = 'a <script>alert("&")</script>'
BEAM = vj.default_rig().beam


def rig(stiffness=5500.0, gap=0.4e-3, damping=0.5):
    stop = vj.Stop(0.5, gap, vj.KelvinVoigt(stiffness, damping))
    return vj.ImpactingBeam(BEAM, stop, vj.BaseMotion(2e-4), 0.018, num_modes=1)


def curve():
    frequency = np.linspace(0.9, 1.3, 9)
    return vj.io.MeasuredCurve(
        frequency,
        "frequency_ratio",
        amplitude=1 + frequency / 3,
        amplitude_deviation=np.full(9, 0.01),
        direction=1,
        parameters={"damping": 0.5},
        label=NASTY,
        notes=("The column was <tip>.",),
    )


def record():
    time = np.arange(1, 9) / 300
    drive = vj.Sampled(np.linspace(0, 0.1, 6), np.arange(6) / 7)
    motion = np.where(np.arange(8) == 3, np.nan, np.sin(time / 3))
    return vj.io.MeasuredHistory(time, motion, waveform=drive, label="record")


def fitted(make=rig, **changed):
    """A fit of two measurements, with a private number, that nobody made."""
    measured = curve(), record()
    gap = coordinate_of("gap", 4e-4, vj.Range(1e-4, 1e-3))
    own = [gap._replace(label=m.label) for m in measured]
    problem = Problem.__new__(Problem)
    problem.make, problem.coordinates = make, (coordinate_of("stiffness", 4e3), *own)
    problem.objective, problem.held = "distance", {}
    problem.unknowns = [{"stiffness": 0, "gap": 1}, {"stiffness": 0, "gap": 2}]
    along = Curve(curve().frequency, np.ones((9, 1)), np.ones((9, 1)), np.arange(9) < 8)
    drawn = (
        fitted_data(measured[0], np.linspace(-1, 2.5, 9), along),
        fitted_data(measured[1], np.linspace(-1, 1, 7)),
    )
    names = problem.names
    estimate = dict(zip(names, (5402.1256, 3.9e-4, 5.1e-4), strict=True))
    fields = {
        "estimate": estimate,
        "interval": {name: (0.9 * v, 1.1 * v) for name, v in estimate.items()},
        "identifiability": {name: f"verdict of {name}" for name in names},
        "identifiable": dict.fromkeys(names, True),
        "standard_deviation": {name: 0.05 * v for name, v in estimate.items()},
        "covariance": np.eye(3),
        "correlation": np.eye(3) + 0.123 * (1 - np.eye(3)),
        "chi_square": 19.8,
        "degrees_of_freedom": 14,
        "confidence": 0.9,
        "measured": measured,
        "predictions": drawn,
        "alternatives": (Alternative({name: 7.5 for name in names}, 88.5),),
        "warnings": ("Not to be <believed>.", "Nor this."),
        "notes": ("It was assumed.",),
        "evaluations": 8,
        "problem": problem,
        "repetition": 0,
        "frequency_scale": 1e-3,
        "point": np.zeros(3),
        "call": {"guess": {"stiffness": 4e3, "gap": 4e-4}, "bounds": None, "private": ("gap",)},
    }
    return Identification(**(fields | changed))


class Reader(HTMLParser):
    """The text of a page, its tags, and the addresses in it."""

    def __init__(self, page):
        super().__init__()
        self.text, self.tags, self.addresses = "", [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ("href", "src")]

    def handle_data(self, data):
        self.text += data


def unpacked(page, folder):
    """Unpack what the page holds to run the fit again."""
    archive = re.search(r'data:application/zip;base64,([^"]+)', page)
    assert archive is not None
    zipfile.ZipFile(io.BytesIO(base64.b64decode(archive[1]))).extractall(folder)
    return {path.name: path.read_text() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text("an older one")
    fitted().report(path)
    return path.read_text("utf-8")


def test_everything_of_the_fit_is_on_the_page(page):
    text, fit = Reader(page).text, fitted()
    for words in (
        *fit.warnings,
        *fit.notes,
        *fit.names,
        *fit.identifiability.values(),
        *("5402.13", "4861.9 to 5942.3", "90 % interval", "N/m", "0.0001 to 0.001"),
        *("Reduced chi-square 1.414", "14 degrees of freedom", "0.123", "88.5"),
        *(repr(m) for m in fit.measured),
        *("All standard deviations were given", "Standard deviations are assumed: displacement"),
        *(repr(fit.system(k)) for k in range(2)),
        *("2 of 9 beyond 2", "vibrojax", "numpy", "Python", "UTC"),
        "def rig(stiffness=5500.0, gap=0.4e-3, damping=0.5):",
    ):
        assert words in text, words
    assert "It does not run as it is" not in text


def test_the_page_stands_alone_and_what_users_write_is_text(page):
    read = Reader(page)
    assert NASTY in read.text
    assert not {"script", "link", "iframe", "believed", "tip"} & set(read.tags)
    assert all(address.startswith("data:") for address in read.addresses)
    assert "http" not in re.sub(r"base64,[^\"]+", "", page)
    assert read.tags.count("img") == 2


def test_the_script_reads_the_measurements_to_the_last_digit(page, tmp_path, monkeypatch):
    files = unpacked(page, tmp_path)
    assert set(files) == {
        "run_again.py",
        "measurement_1.csv",
        "measurement_2.csv",
        "measurement_2_waveform.csv",
    }
    asked = {}
    monkeypatch.setattr(vj, "identify", lambda *data, **how: asked.update(data=data, **how))
    made = runpy.run_path(str(tmp_path / "run_again.py"))
    assert made["rig"](3.0).stops[0].law.stiffness == 3.0
    for wanted, found in zip(fitted().measured, asked["data"][1], strict=True):
        for field in dataclasses.fields(wanted):
            one, other = (getattr(m, field.name) for m in (wanted, found))
            if isinstance(one, vj.Sampled):
                assert np.array_equal(one.time, other.time)
                assert np.array_equal(one.values, other.values)
            elif isinstance(one, np.ndarray):
                assert np.array_equal(one, other, equal_nan=True), field.name
            else:
                assert one == other, field.name
    assert asked["guess"] == {"stiffness": 4e3, "gap": 4e-4}
    assert asked["private"] == ("gap",)
    assert "bounds" not in asked


def test_no_digit_is_lost_to_how_numpy_prints(tmp_path):
    with np.printoptions(legacy="1.13"):
        files = run_again(fitted()).files
    table = np.genfromtxt(files["measurement_1.csv"].splitlines(), delimiter=",", names=True)
    assert table["amplitude"].tolist() == curve().amplitude.tolist()


def test_what_the_script_lacks_is_said():
    text = Reader(report_page(fit := fitted(lambda **n: rig(**n)), run_again(fit))).text
    assert "It does not run as it is; put in its place what is missing." in text
    assert "The function of the rig, a lambda, has no text of its own." in text
    other = fitted(call={"search": len})
    assert run_again(other).missing == (
        "search, a builtin_function_or_method, cannot be written as text.",
    )


def test_a_source_that_is_given_is_tried(tmp_path):
    fit = fitted(lambda **numbers: rig(**numbers))
    source = "import vibrojax as vj\ndef rig(stiffness, gap, damping):\n"
    source += "    return vj.default_rig({}stiffness=stiffness)"
    for wrong, words in (
        ("rig = 1 +", "it does not run, SyntaxError"),
        ("x = 1", "it defines no rig"),
        (source.format(""), "it makes another rig than the one fitted"),
    ):
        with pytest.raises(ValueError, match=f"source must make .*{words}"):
            fit.report(tmp_path / "report.html", source=wrong)
    assert not any(tmp_path.iterdir())
    right = source.format("num_modes=1, gap=gap, damping=damping, ")
    fit.report(tmp_path / "report.html", source=right)
    assert "It does not run" not in (tmp_path / "report.html").read_text()


def test_paths_that_are_not_of_a_page(tmp_path):
    (tmp_path / "folder.html").mkdir()
    for wrong, words in (
        (tmp_path / "report.pdf", "path must end in .html, got "),
        (tmp_path / "report", "path must end in .html, got "),
        (tmp_path / "none" / "report.html", "The folder of path .* does not exist: make it first"),
        (tmp_path / "folder.html", "is a folder"),
        ("", "path must be the path of a file, got ''"),
    ):
        with pytest.raises(ValueError, match=words):
            fitted().report(wrong)
