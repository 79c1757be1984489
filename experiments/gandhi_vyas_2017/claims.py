"""Every claim of the paper that the model can answer, judged by number for either formulation."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd
from paper_rig import FORMULATIONS, MASS_RATIOS, TAPERS
from table2 import Entry

PEAK_SLACK = 0.01
"""Relative change of a peak or an area that counts as none: what the frequency grid decides."""
FREQUENCY_SLACK = 0.003
"""The same for frequency ratios, absolute."""


class Verdict(NamedTuple):
    claim: str
    source: str
    formulation: str
    verdict: str
    numbers: str


class Trend(NamedTuple):
    """A claim that one column goes one way along a variable, within every group of lanes."""

    claim: str
    source: str
    study: str
    column: str
    along: str
    within: str
    sign: int


TRENDS = (
    Trend("more taper: larger peak", "4.3, 5", "fig8to10", "peak_ratio", "taper", "mass_ratio", 1),
    Trend("more taper: larger shift", "4.3, 5", "fig8to10", "shift", "taper", "mass_ratio", 1),
    Trend(
        "more taper: larger hysteresis area",
        "4.3, 5",
        "fig8to10",
        "hysteresis_area",
        "taper",
        "mass_ratio",
        1,
    ),
    Trend("more mass: smaller peak", "4.3, 5", "fig8to10", "peak_ratio", "mass_ratio", "taper", -1),
    Trend("more mass: larger shift", "4.3", "fig8to10", "shift", "mass_ratio", "taper", 1),
    Trend(
        "more mass: smaller shift (contradicts the line above)",
        "5",
        "fig8to10",
        "shift",
        "mass_ratio",
        "taper",
        -1,
    ),
    Trend(
        "more mass: smaller hysteresis area",
        "5",
        "fig8to10",
        "hysteresis_area",
        "mass_ratio",
        "taper",
        -1,
    ),
    Trend("larger gap: larger peak", "Fig. 11, 5", "gap", "peak_ratio", "gap_mm", "taper", 1),
    Trend("larger gap: smaller shift", "5", "gap", "shift", "gap_mm", "taper", -1),
    Trend(
        "stop nearer to the tip: smaller peak",
        "Fig. 12, 5",
        "position",
        "peak_ratio",
        "position",
        "taper",
        -1,
    ),
    Trend("stop nearer to the tip: larger shift", "5", "position", "shift", "position", "taper", 1),
)
LABELS = {"mass_ratio": "Mr", "taper": "taper", "gap_mm": "gap", "position": "s1"}


def follows(values: np.ndarray, sign: int, slack: float) -> bool:
    """Whether values go up (sign 1) or down (-1) as a whole, and by no step the other way."""
    ahead = sign * np.asarray(values, float)
    return bool((np.diff(ahead) > -slack).all() and ahead[-1] - ahead[0] > slack)


def _slack(column: str, values: np.ndarray) -> float:
    if column == "shift" or column.startswith("jump"):
        return FREQUENCY_SLACK
    return PEAK_SLACK * float(np.mean(np.abs(values)))


def word(good: list[bool]) -> str:
    if all(good):
        return "holds"
    return f"holds in {sum(good)} of {len(good)}" if any(good) else "does not hold"


def judge_trend(trend: Trend, table: pd.DataFrame) -> tuple[str, str]:
    """Return verdict and numbers of a trend in the rows of one study and one formulation."""
    good, numbers = [], []
    for name, group in table.groupby(trend.within):
        ordered = group.sort_values(trend.along)
        values, places = ordered[trend.column].to_numpy(), ordered[trend.along].to_numpy()
        slack = _slack(trend.column, values)
        good.append(follows(values, trend.sign, slack))
        digits = 3 if trend.column == "shift" else (2 if "area" in trend.column else 1)
        shown = [f"{v:.{digits}f}" for v in values]
        if len(values) > 5:
            against = int((trend.sign * np.diff(values) < -slack).sum())
            low, high = int(np.argmin(values)), int(np.argmax(values))
            text = (
                f"{shown[0]} to {shown[-1]}, least {shown[low]} at {places[low]:g}, most "
                f"{shown[high]} at {places[high]:g}, {against} of {len(values) - 1} steps against"
            )
        else:
            text = ", ".join(shown)
        numbers.append(f"{LABELS[trend.within]} {name:g}: {text}")
    return word(good), "; ".join(numbers)


def judge_jump(table: pd.DataFrame) -> tuple[str, str]:
    ups, downs = table["jump_up"].dropna(), table["jump_down"].dropna()
    spread = {k: v.max() - v.min() for k, v in (("up", ups), ("down", downs))}
    alike = spread["up"] < 0.05
    return (
        "holds" if alike else "does not hold",
        f"jump up {ups.min():.4f} to {ups.max():.4f} (jump down {downs.min():.4f} to "
        f"{downs.max():.4f}); it lies where the free response reaches the stop, within "
        f"{(table['jump_up'] - table['touch_frequency']).abs().max():.4f}",
    )


def judge_highest(table: pd.DataFrame) -> tuple[str, str]:
    best = table.loc[table["peak_ratio"].idxmax()]
    right = (
        best["taper"] == table["taper"].max() and best["mass_ratio"] == table["mass_ratio"].min()
    )
    corner = table[
        (table["taper"] == table["taper"].max())
        & (table["mass_ratio"] == table["mass_ratio"].min())
    ]["peak_ratio"].iloc[0]
    return (
        "holds" if right else "does not hold",
        f"largest {best['peak_ratio']:.1f} at taper {best['taper']:g}, Mr {best['mass_ratio']:g}; "
        f"at the claimed corner {corner:.1f}",
    )


def judge_contact(table: pd.DataFrame) -> tuple[str, str]:
    """Whether the way each quantity goes with taper is the same for every stiffness and damping."""
    good, numbers = [], []
    for column in ("peak_ratio", "shift", "hysteresis_area"):
        ways = {}
        for (stiffness, damping), group in table.groupby(["stiffness", "damping"]):
            values = group.sort_values("taper")[column].to_numpy()
            slack = _slack(column, values)
            up, down = follows(values, 1, slack), follows(values, -1, slack)
            ways[stiffness, damping] = "up" if up else "down" if down else "mixed"
        good.append(len(set(ways.values())) == 1)
        kinds = [f"{list(ways.values()).count(w)} {w}" for w in sorted(set(ways.values()))]
        numbers.append(f"{column.replace('_', ' ')} with taper: {', '.join(kinds)}")
    return word(good), f"{len(ways)} pairs of Ks and Cs; " + "; ".join(numbers)


def judge_modes(table: pd.DataFrame) -> tuple[str, str]:
    """Whether the answer with five modes is within 1 % (peak) and 0.003 of the largest N."""
    most = table["num_modes"].max()
    good, numbers = [], []
    for column, allowed in (("peak_ratio", 0.01), ("jump_up", 0.003), ("jump_down", 0.003)):
        wide = table.pivot(index="num_modes", columns="taper", values=column)
        reference = wide.loc[most]
        off = (wide - reference).abs()
        off = (off / reference if column == "peak_ratio" else off).max(axis=1)
        good.append(bool(off.get(5, np.nan) <= allowed))
        unit = (lambda v: f"{100 * v:.1f} %") if column == "peak_ratio" else (lambda v: f"{v:.4f}")
        shown = ", ".join(f"N {n}: {unit(v)}" for n, v in off.items() if n != most)
        numbers.append(f"{column.replace('_', ' ')} {shown}")
    return word(good), f"worst taper against N {most}: " + "; ".join(numbers)


def judge_gap_4mm(table: pd.DataFrame) -> tuple[str, str]:
    far = table.loc[table["gap_mm"].idxmax()]
    return (
        "holds" if far["contact_force"] > 0 else "does not hold",
        f"at {far['gap_mm']:g} mm contact force {far['contact_force']:g} N, no jump",
    )


Judge = Callable[[pd.DataFrame], tuple[str, str]]
OTHERS: tuple[tuple[str, str, str, Judge], ...] = (
    ("the jump up is at almost the same ratio in all cases", "4.3", "fig8to10", judge_jump),
    ("largest peak at high taper with low mass", "4.3", "fig8to10", judge_highest),
    ("Ks and Cs do not change the trends", "4.3", "contact", judge_contact),
    ("five modes are enough", "3.1", "modes", judge_modes),
    ("uniform beam, 4 mm gap: the beam hits the stop", "Fig. 7", "fig7", judge_gap_4mm),
)


def judge_table2(entries: list[Entry]) -> list[Verdict]:
    """Judge the claims about frequencies, which do not depend on the formulation."""

    def along_taper(mass_ratio, mode):
        chosen = [e for e in entries if e.mass_ratio == mass_ratio and e.mode == mode]
        return np.array([e.computed for e in sorted(chosen, key=lambda e: e.taper)])

    free = [follows(along_taper(0, k), 1, 0) for k in (1, 2, 3)]
    loaded = [
        follows(along_taper(m, k), -1 if k == 1 else 1, 0) for m in (1, 10) for k in (1, 2, 3)
    ]
    same = [abs(float(e.printed) - float(e.printed_ivm)) < 0.01 for e in entries]
    right = [e.agrees for e in entries]

    def shown(mass_ratio):
        modes = (", ".join(f"{v:.3f}" for v in along_taper(mass_ratio, k)) for k in (1, 2, 3))
        return f"Mr {mass_ratio}: " + " / ".join(modes)

    rows = (
        ("more taper, no mass: all three frequencies rise", word(free), shown(0)),
        (
            "more taper, mass ratio 1 and 10: first falls, second and third rise",
            word(loaded),
            f"{shown(1)}; {shown(10)}",
        ),
        (
            "DTM and IVM agree to two decimals",
            word(same),
            f"{sum(same)} of 27 printed pairs; {sum(right)} of 27 agree with vibrojax, the 27th is "
            "the same misprint in both columns (22.98 for 22.78)",
        ),
    )
    return [Verdict(claim, "Table 2, 4.1", "either", *rest) for claim, *rest in rows]


def judge(summary: pd.DataFrame, entries: list[Entry]) -> list[Verdict]:
    """Judge every claim whose study was run, for either formulation."""
    table = summary.assign(shift=summary["peak_frequency"] - 1, gap_mm=1e3 * summary["gap"])
    verdicts = judge_table2(entries)
    for formulation in FORMULATIONS:
        own = table[table["formulation"] == formulation]
        for trend in TRENDS:
            found = judge_trend(trend, own[own["study"] == trend.study])
            verdicts.append(Verdict(trend.claim, trend.source, formulation, *found))
        for claim, source, study, function in OTHERS:
            if study not in set(own["study"]):
                continue
            found = function(own[own["study"] == study])
            verdicts.append(Verdict(claim, source, formulation, *found))
    return verdicts


def to_markdown(verdicts: list[Verdict]) -> str:
    """Return a table of claims with one line per formulation."""
    lines = ["| claim | paper | formulation | verdict | numbers |", "|---|---|---|---|---|"]
    order = list(dict.fromkeys(v.claim for v in verdicts))
    for v in sorted(verdicts, key=lambda v: order.index(v.claim)):
        lines.append(
            f"| {v.claim} | {v.source} | {v.formulation} | **{v.verdict}** | {v.numbers} |"
        )
    tapers, masses = (", ".join(f"{x:g}" for x in xs) for xs in (TAPERS, MASS_RATIOS))
    lines += [
        "",
        f"Lists run over tapers {tapers} or mass ratios {masses}, in this order. A step against a "
        f"trend counts from {PEAK_SLACK:.0%} of a peak or an area, {FREQUENCY_SLACK} of a ratio.",
    ]
    return "\n".join(lines) + "\n"
