"""Table 2 of the paper beside vibrojax: frequency parameters beta^2, printed by truncation."""

import csv
from decimal import ROUND_DOWN, Decimal
from pathlib import Path
from typing import NamedTuple

from paper_rig import beam

import vibrojax as vj

# (taper, mass ratio): printed DTM and IVM values of modes 1 to 3.
PRINTED = {
    (0.3, 0): (("3.91", "22.98", "62.43"), ("3.91", "22.98", "62.43")),
    (0.5, 0): (("4.315", "23.51", "63.19"), ("4.315", "23.51", "63.19")),
    (0.7, 0): (("4.931", "24.68", "64.52"), ("4.931", "24.68", "64.52")),
    (0.3, 1): (("1.533", "16.43", "50.99"), ("1.533", "16.43", "50.99")),
    (0.5, 1): (("1.51", "16.58", "51.10"), ("1.511", "16.58", "51.10")),
    (0.7, 1): (("1.479", "16.76", "51.24"), ("1.479", "16.76", "51.24")),
    (0.3, 10): (("0.52", "15.84", "50.36"), ("0.52", "15.84", "50.36")),
    (0.5, 10): (("0.505", "16.10", "50.61"), ("0.505", "16.10", "50.61")),
    (0.7, 10): (("0.486", "16.39", "50.90"), ("0.486", "16.39", "50.90")),
}


class Entry(NamedTuple):
    taper: float
    mass_ratio: float
    mode: int
    printed: str
    printed_ivm: str
    computed: float
    agrees: bool


def agrees_by_truncation(computed: float, printed: str) -> bool:
    """Whether cutting off the computed digits, without rounding, gives the printed number."""
    shown = Decimal(printed)
    return Decimal(float(computed)).quantize(shown, rounding=ROUND_DOWN) == shown


def compare() -> list[Entry]:
    """Compute all 27 entries and judge each against its printed digits."""
    entries = []
    for (taper, mass_ratio), (dtm, ivm) in PRINTED.items():
        squares = vj.modes(beam(taper, float(mass_ratio)), num_modes=3).beta ** 2
        for i, value in enumerate(map(float, squares)):
            good = agrees_by_truncation(value, dtm[i])
            entries.append(Entry(taper, mass_ratio, i + 1, dtm[i], ivm[i], value, good))
    return entries


def write(entries: list[Entry], folder: Path) -> None:
    """Write table2.csv and table2.md."""
    with open(folder / "table2.csv", "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(Entry._fields)
        out.writerows(e._replace(computed=round(e.computed, 8)) for e in entries)
    lines = [
        "| taper | mass ratio | mode | printed (DTM) | printed (IVM) | vibrojax | agrees |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {e.taper} | {e.mass_ratio} | {e.mode} | {e.printed} | {e.printed_ivm} "
            f"| {e.computed:.6f} | {'yes' if e.agrees else '**no**'} |"
            for e in entries
        ),
        "",
        f"{sum(e.agrees for e in entries)} of {len(entries)} agree by truncation.",
    ]
    (folder / "table2.md").write_text("\n".join(lines) + "\n")
