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


def main(rows: int) -> None:
    vj.io.read_measured_curve({"f [Hz]": [8.0, 9.0], "tip [mm]": [1.0, 2.0]})  # imports
    print(f"| {rows:,} rows of two columns | seconds | of the processor |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        for name, text in tables(rows).items():
            path.write_text(text, encoding="utf-16" if "UTF-16" in name else "utf-8")
            report(f"curve: {name}", lambda: vj.io.read_measured_curve(path))
        path.write_text(tables(rows)["commas"].replace("f [Hz]", "t [s]"))
        report("history: commas", lambda: vj.io.read_measured_history(path, frequency=10.0))


def report(name: str, read) -> None:
    wall, processor = time.perf_counter(), time.process_time()
    read()
    print(
        f"| {name} | {time.perf_counter() - wall:.2f} | {time.process_time() - processor:.2f} |",
        flush=True,
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
