"""Do the paper's trends hold over the whole grid? Counted over pairs of neighbours in it."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray

PAPER = Path(__file__).parents[1] / "gandhi_vyas_2017" / "results" / "claims.csv"
SLACK = {"settled_shift": 0.003}
"""Change of a frequency ratio that counts as none, as in the judgement of single figures."""
RELATIVE_SLACK = 0.01
"""The same of a peak or an area, over the mean of the two."""
ALIKE = 0.05
"""Spread of the jumps up that counts as one place, as in the judgement of single figures."""


class Claim(NamedTuple):
    """A measure is said to go one way along an axis."""

    claim: str
    source: str
    measure: str
    along: str
    sign: int


CLAIMS = (
    Claim("more taper: larger peak", "4.3, 5", "settled_peak_ratio", "taper", 1),
    Claim("more taper: larger shift", "4.3, 5", "settled_shift", "taper", 1),
    Claim("more taper: larger hysteresis area", "4.3, 5", "peak_ratio_area", "taper", 1),
    Claim("more mass: smaller peak", "4.3, 5", "settled_peak_ratio", "mass_ratio", -1),
    Claim("more mass: larger shift", "4.3", "settled_shift", "mass_ratio", 1),
    Claim(
        "more mass: smaller shift (contradicts the line above)",
        "5",
        "settled_shift",
        "mass_ratio",
        -1,
    ),
    Claim("more mass: smaller hysteresis area", "5", "peak_ratio_area", "mass_ratio", -1),
    Claim("larger gap: larger peak", "Fig. 11, 5", "settled_peak_ratio", "gap", 1),
    Claim("larger gap: smaller shift", "5", "settled_shift", "gap", -1),
    Claim("larger gap: smaller hysteresis area", "not claimed", "peak_ratio_area", "gap", -1),
    Claim(
        "stop nearer to the tip: smaller peak", "Fig. 12, 5", "settled_peak_ratio", "position", -1
    ),
    Claim("stop nearer to the tip: larger shift", "5", "settled_shift", "position", 1),
    Claim(
        "stop nearer to the tip: larger hysteresis area",
        "not claimed",
        "peak_ratio_area",
        "position",
        1,
    ),
)


class Count(NamedTuple):
    """Pairs of neighbours along an axis, both of which touch the stop."""

    claim: str
    source: str
    pairs: int
    with_it: int
    level: int
    against: int
    lines: int
    whole_lines: int
    """Of the lines along the axis (all else fixed), those without a step against and with one
    along."""
    calm_pairs: int
    calm_with_it: int
    """The same where neither rig has a point without a period."""

    @property
    def share(self) -> float:
        return self.with_it / self.pairs if self.pairs else float("nan")


def count(claim: Claim, dataset: xarray.Dataset) -> Count:
    """Count the steps along, level and against; a lane that never touches makes no pair."""
    touches = dataset["largest_contact_force"] > 0
    values = dataset[claim.measure].where(touches).transpose(..., claim.along).values
    before, after = values[..., :-1], values[..., 1:]
    slack = SLACK.get(claim.measure, RELATIVE_SLACK * (np.abs(before) + np.abs(after)) / 2)
    ahead = claim.sign * (after - before)
    there = np.isfinite(ahead)
    along, against = there & (ahead > slack), there & (ahead < -slack)
    calm = (dataset["aperiodic_fraction"] == 0).transpose(..., claim.along).values
    calm = there & calm[..., :-1] & calm[..., 1:]
    has_pairs = there.any(axis=-1)
    whole = along.any(axis=-1) & ~against.any(axis=-1)
    return Count(
        claim.claim,
        claim.source,
        int(there.sum()),
        int(along.sum()),
        int((there & ~along & ~against).sum()),
        int(against.sum()),
        int(has_pairs.sum()),
        int(whole.sum()),
        int(calm.sum()),
        int((calm & along).sum()),
    )


def count_all(dataset: xarray.Dataset) -> list[Count]:
    return [count(claim, dataset) for claim in CLAIMS]


def _paper_verdicts() -> dict[str, str]:
    table = pd.read_csv(PAPER)
    table = table[table["formulation"] == "consistent"]
    return dict(zip(table["claim"], table["verdict"], strict=True))


def _corner(dataset: xarray.Dataset) -> tuple[int, int]:
    """Return at how many gaps and positions the largest peak is at high taper and low mass."""
    rigs = {"rig": ("taper", "mass_ratio")}
    peaks = dataset["settled_peak_ratio"].stack(rigs)
    touched = (dataset["largest_contact_force"] > 0).stack(rigs).all("rig").values
    where = peaks.argmax("rig").values[touched]
    high, low = np.argmax(dataset["taper"].values), np.argmin(dataset["mass_ratio"].values)
    return int((where == high * dataset.sizes["mass_ratio"] + low).sum()), len(where)


def _jump_spread(dataset: xarray.Dataset) -> tuple[int, int]:
    """Return at how many gaps and positions the jumps up of all rigs lie close together."""
    jumps = dataset["jump_up"]
    across = ("taper", "mass_ratio")
    everywhere = jumps.notnull().all(across)
    spread = (jumps.max(across) - jumps.min(across)).where(everywhere).values.ravel()
    spread = spread[np.isfinite(spread)]
    return int((spread < ALIKE).sum()), len(spread)


def to_markdown(counts: list[Count], dataset: xarray.Dataset) -> str:
    """Return the table of shares, beside the verdicts on the single figures."""
    verdicts = _paper_verdicts()
    lines = [
        "| claim | paper | steps along | level | against | of steps | along where all is periodic "
        "| lines that hold | figures of the paper |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for c in counts:
        of = max(1, c.pairs)
        shares = " | ".join(f"{100 * n / of:.0f} %" for n in (c.with_it, c.level, c.against))
        lines.append(
            f"| {c.claim} | {c.source} | {shares} | {c.pairs} | {c.calm_with_it} of {c.calm_pairs} "
            f"| {c.whole_lines} of {c.lines} "
            f"| {verdicts.get(c.claim, '')} |"
        )
    corner, jump = _corner(dataset), _jump_spread(dataset)
    claims = (
        ("largest peak at high taper with low mass", corner),
        ("the jump up is at almost the same ratio in all cases", jump),
    )
    lines += [
        "",
        "| claim (4.3) | gaps and positions where it holds | figures of the paper |",
        "|---|---|---|",
    ]
    lines += [f"| {c} | {n} of {of} | {verdicts.get(c, '')} |" for c, (n, of) in claims]
    lines += [
        "",
        "A step is from one value of the axis to the next, all else the same, both rigs touching "
        f"the stop. It is level below {RELATIVE_SLACK:.0%} of a peak or an area, "
        f"{SLACK['settled_shift']} of a ratio. A line, all steps along an axis, holds with no step "
        "against and at least one along. Last column: verdicts of "
        "`experiments/gandhi_vyas_2017`, consistent formulation.",
    ]
    return "\n".join(lines) + "\n"
