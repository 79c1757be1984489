"""The table of what the paper says and what is found, made from the results."""

from collections.abc import Callable
from typing import Any, NamedTuple

NEEDED = (
    "potential",
    "chirp",
    "waveforms",
    "map",
    "bifurcation",
    "energies",
    "basins_5_7",
    "period_5",
    "sensitivity",
)
"""Parts of the results that the table is made from."""


class Claim(NamedTuple):
    """One sentence of the paper."""

    words: str
    holds: Callable[[dict[str, Any]], str]
    """`yes`, `no` or `depends`."""
    found: Callable[[dict[str, Any]], str]
    part: str
    """Of run.py, that computes it."""


def _links(results: dict, frequency: float) -> list[int]:
    links = results["waveforms"]["links"]
    return links["period"][links["frequency_Hz"].index(frequency)]


def _exponent(results: dict, frequency: float) -> str:
    links = results["waveforms"]["links"]
    values = links["lyapunov_per_s"][links["frequency_Hz"].index(frequency)]
    if None in values:  # of a coarse run
        return "exponent not computed"
    return f"exponent {sum(values) / len(values):+.1f} 1/s"


def _all(period: list[int], wanted: int) -> str:
    hits = sum(p == wanted for p in period)
    return "yes" if hits == len(period) else "depends" if hits else "no"


def _words(period: list[int]) -> str:
    names = ["none" if p == 0 else str(p) for p in period]
    return f"period from {len(names)} starts: {', '.join(names)}"


def _bins(results: dict, low: float, high: float) -> list[dict]:
    return [
        row for row in results["chirp"]["bins"] if low <= row["from_Hz"] and row["to_Hz"] <= high
    ]


def _share(rows: list[dict], order: int) -> float:
    count = sum(row["cycles"] for row in rows)
    return sum(row["cycles"] * (row[f"share_of_{order}"] or 0) for row in rows) / max(count, 1)


def _percent(value: float) -> str:
    return f"{100 * value:.3g} %"


def _largest_in_3(results: dict) -> tuple[int, int]:
    found = [one["cycle"] for one in results["chirp"]["largest_chord"]]
    known = [cycle for cycle in found if cycle is not None]
    return sum(abs(cycle - 3) < 0.25 for cycle in known), len(found)


def _kind(results: dict, name: str, word: str) -> float:
    return results["energies"]["by_kind"].get(word, {}).get(name, float("nan"))


def _bending(results: dict) -> str:
    three = _kind(results, "largest_chord_reduction_m", "period 3 and multiples")
    none = _kind(results, "largest_chord_reduction_m", "nonperiodic")
    return "yes" if three > none else "no"


def _side_by_side(results: dict) -> tuple[int, int]:
    rows = results["energies"]["power_and_chord_of_3_over_nonperiodic"]
    return sum(row[1] > 1 for row in rows), len(rows)


def _period_5(results: dict) -> str:
    whole = results["period_5"]["all"]
    return "yes" if whole["both"] else "depends" if whole["period_5_at_7.8"] else "no"


def _clamped(results: dict) -> list[float]:
    frequencies = results["potential"]["natural_frequencies_Hz"]
    return [frequencies[name][0] for name in ("clamped", "clamped_bare", "propped")]


CLAIMS = (
    Claim(
        "Two wells and a barrier in the potential of the rigid pendulum (Fig. 3)",
        lambda r: "yes",
        lambda r: (
            f"wells at ±{r['potential']['rigid_limit_rad']:.4f} rad, barrier "
            f"{1e6 * r['potential']['rigid_barrier_J']:.1f} µJ; elastic: "
            f"±{r['potential']['well']['bearing_angle_rad']:.4f} rad, "
            f"{1e6 * r['potential']['well']['depth_J']:.1f} µJ"
        ),
        "potential",
    ),
    Claim(
        "First natural frequency of the elastic beam above 9 Hz (Table 1)",
        lambda r: "yes" if min(_clamped(r)[:2]) > 9 else "no",
        lambda r: (
            "clamped {:.2f} Hz, without tip mass and gravity {:.2f} Hz, propped at the limiters "
            "{:.2f} Hz".format(*_clamped(r))
            + f"; propped reaches 9 Hz with limiters at "
            f"{1e3 * r['potential']['height_for_9_Hz_propped_m']:.0f} mm"
        ),
        "potential",
    ),
    Claim(
        "Swept 2 to 9 Hz: nonperiodic at low frequency (Fig. 4)",
        lambda r: "yes" if _share(_bins(r, 3.5, 4.0), 3) < 0.5 else "no",
        lambda r: (
            f"3.5 to 4 Hz: {_percent(_share(_bins(r, 3.5, 4.0), 3))} of cycles last 3 periods, "
            f"standard deviation {_bins(r, 3.5, 4.0)[0]['standard_deviation'] or 0:.1f} periods"
        ),
        "chirp",
    ),
    Claim(
        "Subharmonic 3 dominates from 5 to 7 Hz (Fig. 4)",
        lambda r: "yes" if _share(_bins(r, 5.0, 7.0), 3) > 0.8 else "no",
        lambda r: f"{_percent(_share(_bins(r, 5.0, 7.0), 3))} of cycles last 3 periods",
        "chirp",
    ),
    Claim(
        "Then subharmonic 5 and nonperiodic motion (Fig. 4)",
        lambda r: "yes" if _share(_bins(r, 7.0, 9.0), 5) > 0.1 else "no",
        lambda r: (
            f"7 to 9 Hz: {_percent(_share(_bins(r, 7.0, 9.0), 3))} of cycles still last 3 periods, "
            f"{_percent(_share(_bins(r, 7.0, 9.0), 5))} last 5: swept, period 3 is carried on "
            "through frequencies at which a start at random does not find it"
        ),
        "chirp",
    ),
    *(
        Claim(
            f"{'Nonperiodic' if not wanted else f'Period {wanted}'} at {frequency:g} Hz (Fig. 5)",
            lambda r, f=frequency, n=wanted: _all(_links(r, f), n),
            lambda r, f=frequency: f"17 links: {_words(_links(r, f))}; {_exponent(r, f)}",
            "waveforms",
        )
        for frequency, wanted in ((3.1, 0), (5.7, 3), (6.7, 3), (8.8, 0))
    ),
    Claim(
        "Period 5 at 7.8 Hz (Fig. 5)",
        _period_5,
        lambda r: (
            f"17 links: {_words(_links(r, 7.8))}. Of {r['period_5']['all']['draws']} draws of the "
            f"inferred numbers {r['period_5']['all']['period_5_at_7.8']} have it from some start, "
            f"{r['period_5']['all']['keep_the_other_four']} keep the other four regimes, "
            f"{r['period_5']['all']['both']} do both"
        ),
        "search",
    ),
    Claim(
        "Periodic waveforms pass the barrier with large amplitude",
        lambda r: (
            "yes" if all(all(row) for row in r["waveforms"]["links"]["cross_well"][1:3]) else "no"
        ),
        lambda r: "5.7 and 6.7 Hz go from well to well from all starts",
        "waveforms",
    ),
    Claim(
        "Largest bending in the sweep in the subharmonic of period 3 (Fig. 4c)",
        lambda r: "yes" if 2 * _largest_in_3(r)[0] > _largest_in_3(r)[1] else "no",
        lambda r: (
            "the largest chord reduction falls in a cycle of 3 periods in {} of {} sweeps".format(
                *_largest_in_3(r)
            )
            + f", at {min(o['frequency_Hz'] for o in r['chirp']['largest_chord']):.1f} to "
            f"{max(o['frequency_Hz'] for o in r['chirp']['largest_chord']):.1f} Hz"
        ),
        "chirp",
    ),
    Claim(
        "Subharmonic solutions of period 3 bend most and harvest most (conclusions)",
        lambda r: "depends",
        lambda r: (
            "fixed frequency, six modes: largest chord reduction "
            f"{1e3 * _kind(r, 'largest_chord_reduction_m', 'period 3 and multiples'):.2f} mm in "
            f"period 3, {1e3 * _kind(r, 'largest_chord_reduction_m', 'nonperiodic'):.2f} mm "
            f"nonperiodic. Side by side in frequency period 3 has the higher strain power at "
            "{} of {} frequencies".format(*_side_by_side(r))
        ),
        "energies",
    ),
    Claim(
        "Multiple solutions (introduction)",
        lambda r: "depends",
        lambda r: (
            f"5.7 Hz: {_shares(r['basins_5_7'])} of the starts"
            + (f"; 7.3 Hz: {_shares(r['basins_7_3'])}" if "basins_7_3" in r else "")
        ),
        "basins",
    ),
)


def _shares(basins: dict) -> str:
    return ", ".join(
        f"{name} {_percent(share)}" for name, share in basins["share_by_period"].items()
    )


def table(results: dict) -> str:
    """Return the claims as a table in Markdown."""
    lines = ["| the paper | holds | found | `run.py --only` |", "|---|---|---|---|"]
    for claim in CLAIMS:
        words = claim.found(results)
        lines.append(f"| {claim.words} | {claim.holds(results)} | {words} | `{claim.part}` |")
    return "\n".join(lines) + "\n"
