"""The pendulum of Litak et al.: a coarse run, the kept results, and its README."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "experiments" / "litak_pendulum"
PICTURES = (
    "potential",
    "chirp",
    "cycles",
    "waveforms",
    "regime_map",
    "bifurcation",
    "energies",
    "basins_5_7",
    "search",
)


@pytest.fixture(scope="module")
def kept():
    return json.loads((FOLDER / "results" / "results.json").read_text())


def claims():
    """The module that makes the table; other experiments have one of the same name."""
    spec = importlib.util.spec_from_file_location("litak_claims", FOLDER / "claims.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def assert_claims(results):
    """What the README says and any run must give, a coarse one too."""
    reference = json.loads((FOLDER / "reference.json").read_text())["static_well"]
    well = results["potential"]["well"]
    assert well["bearing_angle_rad"] == pytest.approx(reference["bearing_angle"], rel=1e-5)
    assert well["contact_force_N"] == pytest.approx(reference["contact_force"], rel=1e-5)
    assert well["depth_J"] == pytest.approx(reference["depth_J"], rel=1e-5)
    rigid = np.array(results["potential"]["rigid_normalised"])
    assert rigid.max() < 0.4
    assert rigid.min() < -0.01

    locked = [row for row in results["chirp"]["bins"] if 5.5 <= row["from_Hz"] < 7.0]
    assert all(row["median"] == pytest.approx(3, abs=0.05) for row in locked)

    links = results["waveforms"]["links"]
    for frequency, period in zip(links["frequency_Hz"], links["period"], strict=True):
        assert set(period) == ({3} if frequency in (5.7, 6.7) else {0})

    assert results["basins_5_7"]["diverged_share"] == 0
    shares = [one["share"] for one in results["basins_5_7"]["attractors"]]
    assert sum(shares) == pytest.approx(1, abs=1e-4)


def test_kept_results(kept):
    assert not kept["about"]["coarse"]
    assert_claims(kept)
    chirp = kept["chirp"]
    reference = json.loads((FOLDER / "reference.json").read_text())["sweep_2_9Hz_15s"]["table"]
    for row, other in zip(chirp["bins"], reference.values(), strict=True):
        if row["from_Hz"] >= 5.0:  # before, both are a few cycles of a chaotic motion
            assert row["median"] == pytest.approx(other["median"], abs=0.05)
            assert row["share_of_3"] == pytest.approx(other["frac3"], abs=0.2)
    exponents = np.array(kept["waveforms"]["links"]["lyapunov_per_s"])
    assert np.all(exponents[[0, 3, 4]] > 2)
    assert np.all(exponents[[1, 2]] < 1)


def test_the_readme_has_the_table_of_the_kept_results(kept):
    table = claims().table(kept)
    assert table in (FOLDER / "README.md").read_text()
    assert table == (FOLDER / "results" / "claims.md").read_text()
    assert "nan" not in table
    assert "None" not in table


def test_pictures_are_kept_and_small():
    readme = (FOLDER / "README.md").read_text()
    for name in PICTURES:
        picture = FOLDER / "results" / f"{name}.png"
        assert 10_000 < picture.stat().st_size < 300_000
        assert f"results/{name}.png" in readme


@pytest.mark.slow
@pytest.mark.long
def test_a_coarse_run(tmp_path):
    command = [sys.executable, str(FOLDER / "run.py"), "--coarse", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert_claims(json.loads((tmp_path / "results.json").read_text()))
    assert all((tmp_path / f"{name}.png").exists() for name in PICTURES)
    assert (tmp_path / "claims.md").exists()
