"""The whole study of Gandhi and Vyas (2017) as one call: taper, mass ratio, gap and stop position.

python experiments/parametric_study/study.py                        in this process
python experiments/parametric_study/study.py --workers 2            on two cores
python experiments/parametric_study/study.py --quick                coarse, to see that it runs

Whole curves stay in the Zarr store of `--store`; the same command again continues what was
interrupted, or only reads it and draws anew.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import curve_numbers
import numpy as np
import pictures
import trends
import workers
import xarray

import vibrojax as vj

HERE = Path(__file__).parent
AXES = {
    "taper": [0.0, 0.25, 0.5, 0.75],
    "mass_ratio": [0.5, 1.0, 5.0],
    "gap": [0.2e-3, 0.4e-3, 0.6e-3, 0.8e-3, 1.2e-3, 1.6e-3],
    "position": [0.3, 0.4, 0.5, 0.6, 0.8, 1.0],
}
# Fine where most rigs jump; only stops near the tip bring peaks beyond 1.3, up to 1.8.
RATIOS = np.round(np.r_[np.arange(0.925, 1.3, 0.0125), np.arange(1.3, 1.84 + 1e-9, 0.02)], 4)
QUICK_AXES = {name: values[1:5:2] for name, values in AXES.items()} | {"mass_ratio": [0.5, 5.0]}
QUICK_RATIOS = np.round(np.linspace(0.95, 1.52, 20), 4)
MEASURES = [
    "peak_amplitude_ratio",
    "peak_frequency",
    "largest_contact_force",
    "jump_up",
    "jump_down",
    "hysteresis_width",
    "hysteresis_area",
    "aperiodic_fraction",
    curve_numbers.settled_peak_ratio,
    curve_numbers.settled_shift,
    curve_numbers.peak_ratio_area,
]


def make_map(store: Path, quick: bool, client: Any) -> xarray.Dataset:
    """The study: one call."""
    return vj.parameter_map(
        vj.default_rig,
        **(QUICK_AXES if quick else AXES),
        frequency_ratio=QUICK_RATIOS if quick else RATIOS,
        response=vj.SweepSettings(max_periods=200),
        measures=MEASURES,
        keep_curves=True,
        chunk_lanes=None if quick else 108,  # a taper each: what an interruption costs
        store=store,
        client=client,
    )


def lanes_there(store: Path) -> int:
    """Lanes that a store has already."""
    if not store.exists():
        return 0
    with xarray.open_zarr(store, consolidated=False, chunks=None) as found:
        flags = found["lane_status"].attrs
        names = dict(zip(flags["flag_meanings"].split(), flags["flag_values"], strict=True))
        return int((~found["lane_status"].isin([names["failed"], names["missing"]])).sum())


def summarise(dataset: xarray.Dataset) -> dict[str, Any]:
    """The study in numbers: aperiodic motion above all, and where it is."""
    aperiodic = dataset["status"] == vj.Status.aperiodic.value
    touches = dataset["largest_contact_force"] > 0
    said: dict[str, Any] = {
        "lanes": int(dataset["lane_status"].size),
        "points": int(aperiodic.size),
        "lanes_that_touch": int(touches.sum()),
        "lanes_with_hysteresis": int((dataset["hysteresis_width"] > 0).sum()),
        "lanes_with_aperiodic_points": int(aperiodic.any(("direction", "frequency_ratio")).sum()),
        "aperiodic_points": int(aperiodic.sum()),
        "diverged_points": int((dataset["status"] == vj.Status.diverged.value).sum()),
        "steps": int(dataset["lane_steps"].sum()),
    }
    for name in ("taper", "mass_ratio", "gap", "position", "direction"):
        others = [d for d in aperiodic.dims if d != name]
        share = aperiodic.mean(others).values
        keys = [str(v) if name == "direction" else f"{v:g}" for v in dataset[name].values]
        said[f"aperiodic_share_by_{name}"] = dict(
            zip(keys, [round(float(s), 4) for s in share], strict=True)
        )
    return said


def write_measures(dataset: xarray.Dataset, path: Path) -> None:
    """One row per lane, rounded."""
    curves = [n for n in dataset.data_vars if "frequency_ratio" in dataset[n].dims]
    table = dataset.drop_vars(curves).drop_dims(["frequency_ratio", "direction"], errors="ignore")
    rows = table.to_dataframe().reset_index()
    rows["gap"] = rows["gap"].round(7)
    numbers = [n for n in rows.columns if n != "gap" and rows[n].dtype.kind == "f"]
    rows[numbers] = rows[numbers].round(5)
    rows.to_csv(path, index=False)


def run(output: Path, store: Path, quick: bool = False, count: int = 1) -> dict[str, Any]:
    """Make the map, or what is missing of it, and write `results/` and `pictures/`."""
    results, drawn = output / "results", output / "pictures"
    for place in (results, drawn, store.parent):
        place.mkdir(parents=True, exist_ok=True)
    already = lanes_there(store)
    started = time.perf_counter()
    with workers.local_client(count) as client:
        dataset = make_map(store, quick, client)
        seconds = time.perf_counter() - started
        cost = workers.taken(client)
    dataset = dataset.load()
    said = summarise(dataset)
    computed = said["lanes"] - already
    print(f"{computed} of {said['lanes']} lanes computed in {seconds:.1f} s", flush=True)
    if computed:
        share = said["points"] * computed / said["lanes"]
        said["run"] = {
            "vibrojax": vj.__version__,
            "quick": quick,
            "lanes_computed": computed,
            "workers": count,
            "seconds": round(seconds, 1),
            "points_per_second": round(share / seconds, 1),
            "store_megabytes": round(size_of(store) / 1e6, 2),
            **cost,
        }
        (results / "run.json").write_text(json.dumps(said, indent=1) + "\n")
    conclude(dataset, output)
    return said


def conclude(dataset: xarray.Dataset, output: Path) -> None:
    """Write the measures and the trends, and draw."""
    results = output / "results"
    write_measures(dataset, results / "measures.csv")
    counts = trends.count_all(dataset)
    (results / "trends.md").write_text(trends.to_markdown(counts, dataset))
    pictures.draw_all(dataset, counts, output / "pictures")
    for c in counts:
        print(f"{100 * c.share:3.0f} % of {c.pairs:4d} steps: {c.claim}")


def size_of(folder: Path) -> int:
    """Bytes of all files under a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="2 values of each axis, 20 ratios")
    parser.add_argument("--store", type=Path, help="Zarr store of the curves (default: work/ here)")
    parser.add_argument("--workers", type=int, default=1, help="processes, one core each")
    parser.add_argument(
        "--output", type=Path, help="folder to write into (default: here; --quick: quick/ here)"
    )
    parser.add_argument("--pictures", action="store_true", help="only draw what the store has")
    given = parser.parse_args()
    output = given.output or (HERE / "quick" if given.quick else HERE)
    store = given.store or (output / "work" / "study.zarr")
    if given.pictures:
        conclude(xarray.open_zarr(store, consolidated=False, chunks=None).load(), output)
    else:
        run(output, store, given.quick, given.workers)


if __name__ == "__main__":
    main()
