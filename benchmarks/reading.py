"""How long reading a table of measurements takes: python benchmarks/reading.py [rows]."""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import vibrojax as vj


def tables(rows: int) -> dict[str, str]:
    """Text of one table in several forms: frequency, amplitude, direction where named so."""
    frequency = np.linspace(8, 12, rows)
    amplitude = 1 + np.random.default_rng(0).random(rows)
    pairs = list(zip(frequency.tolist(), amplitude.tolist(), strict=True))
    lines = [f"{f:.7f},{a:.9f}" for f, a in pairs]
    plain = "\n".join(["f [Hz],tip [mm]", *lines])
    bad = [f"{f:.7f},oops" for f, _ in pairs[::10]]
    spoiled = [bad[k // 10] if k % 10 == 0 else line for k, line in enumerate(lines)]
    return {
        "commas": plain,
        "semicolons, decimal commas": plain.replace(",", ";").replace(".", ","),
        "tabs, UTF-16": plain.replace(",", "\t"),
        "spaces": plain.replace("f [Hz],tip [mm]", "f[Hz],tip[mm]").replace(",", "  "),
        "quotes, decimal commas": "\n".join(
            '"' + line.replace(",", '","').replace(".", ",") + '"' for line in plain.split("\n")
        ),
        "directions": "\n".join(["f [Hz],tip [mm],sweep", *(f"{line},up" for line in lines)]),
        "every tenth row unusable": "\n".join(["f [Hz],tip [mm]", *spoiled]),
    }


def histories(rows: int) -> dict[str, np.ndarray]:
    """Columns of a history: time in s, motion in mm, force of one contact in two."""
    time_s = 1e-4 * np.arange(rows)
    tip_mm = np.sin(60 * time_s) + 0.01 * np.random.default_rng(0).standard_normal(rows)
    return {"time_s": time_s, "tip_mm": tip_mm, "contact_force_N": np.maximum(tip_mm, 0)}


def write_histories(folder: Path, rows: int) -> list[Path]:
    """Write one history in several formats."""
    import h5py
    import pandas
    import pyuff
    import scipy.io
    from nptdms import ChannelObject, TdmsWriter

    columns = histories(rows)
    paths = [folder / f"history.{ending}" for ending in ("mat", "h5", "tdms", "uff")]
    scipy.io.savemat(paths[0], {"bench": {"run1": columns}})
    with h5py.File(paths[1], "w") as file:
        for name, values in columns.items():
            file[f"bench/run1/{name}"] = values
    with TdmsWriter(paths[2]) as writer:
        writer.write_segment([ChannelObject("run1", n, v) for n, v in columns.items()])
    common = dict(
        type=58, func_type=1, rsp_node=1, rsp_dir=3, ref_node=1, ref_dir=3, binary=1,
        abscissa_spacing=1, abscissa_spec_data_type=17, abscissa_axis_units_lab="s",
        orddenom_spec_data_type=0, z_axis_spec_data_type=0, x=columns["time_s"],
    )  # fmt: skip
    units = {"tip_mm": (8, "mm"), "contact_force_N": (13, "N")}
    pyuff.UFF(str(paths[3])).write_sets(
        [
            common
            | dict(ordinate_spec_data_type=kind, ordinate_axis_units_lab=unit, data=columns[name])
            for name, (kind, unit) in units.items()
        ],
        "add",
    )
    runs = {f"Run 1: {name}": values for name, values in columns.items()}
    frame = pandas.DataFrame(runs | {n.replace("1", "2", 1): v for n, v in runs.items()})
    frame.loc[np.arange(rows) % 4 > 0, ["Run 1: tip_mm", "Run 2: tip_mm"]] = np.nan
    frame.to_csv(folder / "two runs, gaps.csv", index=False, float_format="%.7g")
    paths.append(folder / "two runs, gaps.csv")
    if rows <= 100_000:  # writing a workbook takes minutes
        pandas.DataFrame(columns).to_excel(folder / "history.xlsx", index=False)
        paths.append(folder / "history.xlsx")
    return paths


def reduced(path: Path) -> None:
    """Read a history, or two, and estimate the noise of the channels."""
    read = vj.io.read_measured_history(path, frequency=10.0)
    for history in read if isinstance(read, list) else [read]:
        history.noise()


def main(rows: int) -> None:
    vj.io.read_measured_curve({"f [Hz]": [8.0, 9.0], "tip [mm]": [1.0, 2.0]})  # imports
    print(f"| {rows:,} rows of two columns | seconds | of the processor |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        for name, text in tables(rows).items():
            path.write_text(text, encoding="utf-16" if "UTF-16" in name else "utf-8")
            report(f"curve: {name}", lambda: vj.io.read_measured_curve(path))
        path.write_text(tables(rows)["commas"].replace("f [Hz]", "t [s]"))
        report("history: commas", lambda: reduced(path))
        for other in write_histories(Path(folder), rows):
            report(f"history and its noise: {other.name}", lambda other=other: reduced(other))


def report(name: str, read) -> None:
    wall, processor = time.perf_counter(), time.process_time()
    read()
    print(
        f"| {name} | {time.perf_counter() - wall:.2f} | {time.process_time() - processor:.2f} |",
        flush=True,
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
