"""Reproduce Litak et al.: an inverted elastic pendulum between two limiters, shaken at its hinge.

python experiments/litak_pendulum/run.py             the whole
python experiments/litak_pendulum/run.py --coarse    few points, to see that it runs, into coarse/
python experiments/litak_pendulum/run.py --only chirp waveforms     these parts anew
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib

sys.path.insert(0, str(Path(__file__).parents[1]))
import basin_maps
import chirp
import claims
import maps
import numpy as np
import pictures
import potential
import search
import waveforms
from common import write_json

import vibrojax as vj

matplotlib.use("Agg")
HERE = Path(__file__).parent
REFERENCE = HERE / "reference.json"
"""Of another program with the same equations: its chirps and its well."""
DRAWS = 512
"""Of the numbers that are not printed, in the search for period 5."""
COEXISTING = 7.3
"""Hz, where a period-3 motion and one without a period are both reached."""


def rounded(value):
    """Return numbers with 6 digits, which is more than they are good for."""
    if isinstance(value, dict):
        return {str(key): rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(one) for one in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return value


def _potential(folder: Path, coarse: bool) -> dict:
    found = potential.run(81 if coarse else 401)
    pictures.draw_potential(found, folder / "potential.png")
    return {"potential": found}


def _chirp(folder: Path, coarse: bool) -> dict:
    histories, found = chirp.run(2 if coarse else 12)
    reference = json.loads(REFERENCE.read_text())["sweep_2_9Hz_15s"]
    pictures.draw_chirp(histories[0], folder / "chirp.png")
    pictures.draw_cycles(found, None if coarse else reference, folder / "cycles.png")
    return {"chirp": found}


def _waveforms(folder: Path, coarse: bool) -> dict:
    histories, found = waveforms.run(*((1, 60, False) if coarse else (3, 120)))
    pictures.draw_waveforms(histories, found, folder / "waveforms.png")
    return {"waveforms": found}


def _map(folder: Path, coarse: bool) -> dict:
    _, found = maps.regime_map(*((8, 2, 40) if coarse else (57, 11, 40)))
    pictures.draw_map(found, folder / "regime_map.png")
    return {"map": found}


def _bifurcation(folder: Path, coarse: bool) -> dict:
    diagram, found = maps.bifurcation(*((4, 10, 40) if coarse else (57, 40, 40)))
    pictures.draw_bifurcation(diagram, folder / "bifurcation.png")
    return {"bifurcation": found}


def _energies(folder: Path, coarse: bool) -> dict:
    found = maps.energies(*((8, 2, 40) if coarse else (57, 8, 40)))
    pictures.draw_energies(found, folder / "energies.png")
    return {"energies": found}


def _basins(folder: Path, coarse: bool) -> dict:
    results = {}
    for name, frequency, count in (("basins_5_7", 5.7, 100), ("basins_7_3", COEXISTING, 50)):
        found, numbers = basin_maps.run(frequency, 8 if coarse else count, 60 if coarse else 150)
        pictures.draw_basins(found, folder / f"{name}.png")
        results[name] = numbers
        if coarse:
            break
    return results


def _search(folder: Path, coarse: bool) -> dict:
    changes = (0.1,) if coarse else (0.05, 0.1, 0.2)
    found = {
        "period_5": search.period_5(*((16, 0) if coarse else (DRAWS, 4))),
        "sensitivity": search.sensitivity(changes, 1 if coarse else 4),
    }
    pictures.draw_search(found["period_5"], found["sensitivity"], folder / "search.png")
    return found


def _agreement(folder: Path, coarse: bool) -> dict:
    return {} if coarse else {"agreement": search.agreement(16, 1, 40)}


PARTS: dict[str, Callable[[Path, bool], dict]] = {
    "potential": _potential,
    "chirp": _chirp,
    "waveforms": _waveforms,
    "map": _map,
    "bifurcation": _bifurcation,
    "energies": _energies,
    "basins": _basins,
    "search": _search,
    "agreement": _agreement,
}


def reproduce(folder: Path, coarse: bool = False, only: list[str] | None = None) -> dict:
    """Run the parts, write results.json, the table of claims and the pictures into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / "results.json"
    results = json.loads(kept.read_text()) if only and kept.exists() else {}
    about = results.pop("about", {"parts": {}})
    for name in only or PARTS:
        begun, worked = time.perf_counter(), time.process_time()
        results |= rounded(PARTS[name](folder, coarse))
        took = time.perf_counter() - begun, time.process_time() - worked
        about["parts"][name] = dict(zip(("seconds", "processor_s"), rounded(took), strict=True))
        print(f"{name}: {took[0]:.1f} s, {took[1]:.1f} s of processor time", flush=True)
        about |= {"vibrojax": vj.__version__, "coarse": coarse}
        for total in ("seconds", "processor_s"):
            about[total] = rounded(sum(part[total] for part in about["parts"].values()))
        write_json(kept, {"about": about} | results)
    if set(claims.NEEDED) <= set(results):
        (folder / "claims.md").write_text(claims.table(results))
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--coarse", action="store_true", help="few points and draws")
    parser.add_argument("--only", nargs="+", choices=list(PARTS), help="run these parts anew")
    parser.add_argument(
        "--output", type=Path, help="folder to write into (default: results/; --coarse: coarse/)"
    )
    given = parser.parse_args()
    folder = given.output or HERE / ("coarse" if given.coarse else "results")
    reproduce(folder, given.coarse, given.only)


if __name__ == "__main__":
    main()
