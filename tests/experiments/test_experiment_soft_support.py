"""The soft support of Ledezma-Ramirez et al.: a coarse run, the kept results, and its README."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "experiments" / "ledezma_ramirez_soft_support"
PICTURES = ("free_releases", "forced_runs", "spectra", "receptance", "energy_flow")


def assert_claims(results):
    """What the README says and any run must give, a coarse one too."""
    frequencies = results["frequencies"]
    assert np.round(frequencies["computed_Hz"], 1).tolist() == frequencies["printed_Hz"]
    for shifted in frequencies["with_masses_Hz"].values():
        assert shifted[0] < frequencies["computed_Hz"][0] < frequencies["measured_first_Hz"]

    rows = results["releases"]
    assert [row["contacts"] > 0 for row in rows] == [False] + 6 * [True]
    assert rows[-1]["peak_acceleration_g"] == pytest.approx(107, rel=0.03)
    assert rows[-1]["peak_force_N"] == pytest.approx(10, rel=0.03)
    assert np.all(np.diff([row["peak_force_N"] for row in rows]) > 0)

    laws = results["against_modes"]
    jumping = next(name for name in laws if name.startswith("Kelvin-Voigt, c1 = 7"))
    assert laws[jumping]["first_contact_g"][-1] > 1.2 * laws[jumping]["first_contact_g"][0]

    for level in results["forced"]["amplitude"]:
        if level["contacts_per_period"] > 0.5 and level["period"] == 1:
            assert level["power_in_multiples"] > 0.98

    # The stronger the force, the lower the receptance.
    peaks = [row["from_rest"]["peak_mm_per_N"] for row in results["receptance"]]
    assert np.all(np.diff([results["linear"]["peak_mm_per_N"], *peaks]) < 0)
    for reading in ("amplitude", "rms"):
        two = results["linear"][f"2_N_as_{reading}"]
        assert two["tip_at_resonance_mm"] > 4 > two["tip_at_frequency_mm"]["17"]

    for energy in (*results["energy_released"].values(), results["energy_forced"]):
        assert energy["balance"] < 1e-6
    lost = results["energy_released"]
    assert lost["with"]["decay_s"]["0.1"] < 0.5 * lost["without"]["decay_s"]["0.1"]


def test_kept_results():
    results = json.loads((FOLDER / "results.json").read_text())
    assert not results["about"]["quick"]
    assert_claims(results)
    laws = results["against_modes"]
    spread = {
        name: np.ptp(rows["analyser_g"][2:]) / rows["analyser_g"][-1] for name, rows in laws.items()
    }
    assert max(spread.values()) < 0.03


def test_the_readme_quotes_the_kept_results():
    results = json.loads((FOLDER / "results.json").read_text())
    text = (FOLDER / "README.md").read_text()
    for row in results["releases"]:
        cells = [
            f"{1e3 * row['release_m']:.0f}",
            f"{row['peak_acceleration_g']:.1f}",
            f"{row['peak_force_N']:.2f}",
            f"{row['contacts']}",
        ]
        assert "| " + " | ".join(cells) + " |" in text
    for row in results["receptance"]:
        rest = row["from_rest"]
        cells = [f"{row['force_rms_N']:g}", f"{rest['peak_mm_per_N']:.2f}", f"{rest['at_Hz']:.0f}"]
        assert "| " + " | ".join(cells) + " |" in text


@pytest.mark.slow
@pytest.mark.long
def test_quick_run(tmp_path):
    # In a process of its own: other experiments have modules of the same names.
    command = [sys.executable, str(FOLDER / "run.py"), "--quick", "--output", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, timeout=600)
    assert_claims(json.loads((tmp_path / "results.json").read_text()))
    for name in (*PICTURES, "peak_acceleration"):
        assert (tmp_path / f"{name}.png").stat().st_size > 20_000
