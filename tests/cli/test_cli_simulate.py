"""`vibrojax simulate`, from a record to its files, and its refusals."""

import numpy as np
import pytest
import xarray

import vibrojax as vj
from vibrojax.cli import command as cli

TIME = np.arange(201) * 1e-3
ACCELERATION = 0.5 * np.cumsum(np.random.default_rng(5).standard_normal(201))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty folder to work in, but for a record."""
    monkeypatch.chdir(tmp_path)
    columns = np.c_[TIME, ACCELERATION]
    header = "time [s],acceleration [g]"
    np.savetxt("record.csv", columns, delimiter=",", header=header, comments="")
    return tmp_path


def left(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
def test_a_record_becomes_a_motion(folder, capsys):
    assert cli.main(["simulate", "--drive", "record.csv", "--quantity", "velocity"]) == 0
    assert left(folder) == ["record.csv", "simulate.nc", "simulate.png"]
    said = capsys.readouterr().out
    assert "0 to 0.2 s, 201 samples" in said
    found = xarray.load_dataset("simulate.nc")
    np.testing.assert_allclose(found["base_acceleration"], 9.80665 * ACCELERATION, atol=1e-9)
    drive = vj.Sampled(TIME, 9.80665 * ACCELERATION)
    expected = vj.simulate(vj.default_rig(), waveform=drive, gradient="forward")
    np.testing.assert_allclose(found["tip_displacement"], expected.displacement(), atol=1e-15)
    assert found["tip_displacement"].attrs["units"] == "m"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give one of --drive RECORD.csv, --frequency and --frequency-ratio"),
        (("--drive", "record.csv", "--frequency", "9"), "give one of --drive"),
        (("--drive", "none.csv"), "none.csv"),
        (("--drive", "record.csv", "--units", "acceleration=mm"), "Unit of acceleration must be"),
        (("--drive", "record.csv", "--output", "a.txt"), "--output must end in .nc"),
    ],
)
def test_what_cannot_be_is_said_and_nothing_written(folder, capsys, arguments, message):
    assert cli.main(["simulate", *arguments]) in (1, 2)
    assert message in capsys.readouterr().err
    assert left(folder) == ["record.csv"]
