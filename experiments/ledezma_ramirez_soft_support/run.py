"""Reproduce Ledezma-Ramirez, Rustighi and Tapia Gonzalez: a cantilever on a soft support.

python experiments/ledezma_ramirez_soft_support/run.py            the whole
python experiments/ledezma_ramirez_soft_support/run.py --quick    coarse, to see that it runs
"""

import argparse
import sys
import time
from pathlib import Path

import matplotlib

sys.path.insert(0, str(Path(__file__).parents[1]))
import forced
import free
import numpy as np
import pictures
import receptance
import rig
from common import write_json

import vibrojax as vj

matplotlib.use("Agg")
HERE = Path(__file__).parent
DAMPINGS = [0.0, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0]
"""Contact dampings at 12 N, N s/m."""


def rounded(value):
    """Return numbers with 8 digits, which is more than they are good for."""
    if isinstance(value, dict):
        return {str(key): rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(one) for one in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.8g}") if np.isfinite(value) else None
    return value


def reproduce(folder: Path, quick: bool = False) -> dict:
    """Run everything and write results.json and the pictures into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    started, parts = time.perf_counter(), {}
    begun = started

    def done(name: str) -> None:
        nonlocal begun
        now = time.perf_counter()
        parts[name], begun = round(now - begun, 1), now
        print(f"{name}: {parts[name]} s", flush=True)

    results: dict = {"frequencies": rig.frequencies()}
    done("frequencies")
    released, energies = free.releases()
    results["releases"] = free.table_of_releases(released)
    results["energy_released"] = free.table_of_energies(energies)
    done("releases")
    dampings = [4.0, 7.0, 10.0] if quick else [*np.arange(0.0, 12.1, 0.5).tolist(), 6.85]
    damped = free.against_damping(sorted(dampings))
    results["against_damping"] = damped | {"within_3_percent": free.range_of_damping(damped)}
    done("contact damping")
    results["rubber"] = (
        {} if quick else free.rubber_laws(results["releases"][-1]["energy_lost_J"][0])
    )
    counts = [5, 8] if quick else [3, 5, 8, 12, 20]
    results["against_modes"] = free.against_modes(counts, results["rubber"])
    done("contact laws and number of modes")
    readings = {"amplitude": 1.0} if quick else forced.READINGS
    runs, took = forced.run(6 if quick else 30, readings)
    results["forced"] = {reading: forced.table(found) for reading, found in runs.items()}
    middle = runs["amplitude"][rig.FORCES.index(11.8)].history
    driven = middle.energy()
    results["energy_forced"] = forced.table_of_energy(driven)
    done("ten forces")
    if not quick:
        results["twelve_newtons"] = forced.twelve_newtons(DAMPINGS)
        done("12 N")
    forces = [2.0, 10.0] if quick else rig.RECEPTANCE_FORCES
    frequency = np.linspace(10.0, 25.0, 16 if quick else 76)
    curve = receptance.sweep(forces, frequency, 25 if quick else 300)
    done("sweeps")
    rest = receptance.from_rest(forces)
    results["receptance"] = receptance.table(curve, rest, forces)
    results["linear"] = receptance.linear_table()
    done("from rest")
    pictures.draw_releases(released, results["releases"], folder / "free_releases.png")
    pictures.draw_forced(runs, results["forced"], folder / "forced_runs.png")
    pictures.draw_spectra(runs["amplitude"], results["forced"], folder / "spectra.png")
    pictures.draw_receptance(curve, rest, forces, folder / "receptance.png")
    pictures.draw_energy(energies, driven, folder / "energy_flow.png")
    pictures.draw_peaks(results, folder / "peak_acceleration.png")
    done("pictures")
    total = time.perf_counter() - started
    about = {"vibrojax": vj.__version__, "quick": quick, "seconds": round(total, 1)}
    about |= {"processor_s": round(time.process_time(), 1), "parts_s": parts, "ten_forces_s": took}
    results = rounded({"about": about} | results)
    write_json(folder / "results.json", results)
    print(f"written to {folder} in {total:.1f} s")
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few values and records, no rubber")
    parser.add_argument(
        "--output", type=Path, help="folder to write into (default: here; --quick: quick/ here)"
    )
    given = parser.parse_args()
    reproduce(given.output or (HERE / "quick" if given.quick else HERE), given.quick)


if __name__ == "__main__":
    main()
