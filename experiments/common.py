"""What the experiments with branches share: a table beside reference values, and the drawing."""

import itertools
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

import vibrojax as vj

DASHES = (0, (4, 1.6))
MARKS = {
    "fold": ("o", "fold"),
    "grazing": ("s", "first touch"),
    "period_doubling": ("D", "period doubling"),
    "neimark_sacker": ("^", "Neimark-Sacker"),
}


class Row(NamedTuple):
    """A number that was computed, beside the one it is compared with."""

    quantity: str
    reference: float
    computed: float
    decimals: int
    """Decimals of the reference as it is known."""

    @property
    def difference(self) -> float:
        return self.computed - self.reference


def to_markdown(rows: list[Row]) -> str:
    lines = ["| quantity | reference | vibrojax | difference |", "|---|---|---|---|"]
    for r in rows:
        d = r.decimals
        lines.append(
            f"| {r.quantity} | {r.reference:.{d}f} | {r.computed:.8f} | {r.difference:+.1e} |"
        )
    return "\n".join(lines) + "\n"


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write one line per key: curves are long."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in data.items())
    path.write_text("{\n" + lines + "\n}\n")


def place(
    branch: vj.branches.Branch, y: np.ndarray, point: vj.branches.SpecialPoint
) -> tuple[float, float]:
    """Where a special point lies on a curve of the branch: its (broken) index and its height."""
    x, last = branch.values, len(y) - 1
    if point.kind == "fold" and 0 < point.after < last:
        near = slice(point.after - 1, point.after + 2)
        bend, slope, _ = np.polyfit((-1, 0, 1), x[near], 2)
        share = float(np.clip(-slope / (2 * bend), -1, 1)) if bend else 0.0
        return point.after + share, float(np.polyval(np.polyfit((-1, 0, 1), y[near], 2), share))
    at = min(point.after, last - 1)
    step = x[at + 1] - x[at]
    share = float(np.clip((point.parameter - x[at]) / step, 0, 1)) if step else 0.5
    return at + share, float(y[at] + share * (y[at + 1] - y[at]))


def draw_branch(
    axes: Axes,
    branch: vj.branches.Branch,
    x: np.ndarray,
    y: np.ndarray,
    color: str,
    width: float = 2.2,
) -> None:
    """Draw a branch: stable solid, unstable dashed, changing at special points where there are any.

    `x` is the parameter in the unit to draw, `y` the curve.
    """
    index = np.arange(len(y), dtype=float)
    scale = x[0] / branch.values[0]
    points = [(*place(branch, y, p), p.parameter * scale) for p in branch.special_points]
    special = np.array(points).reshape(-1, 3)
    changes = []
    for i in np.flatnonzero(np.diff(branch.stable.astype(int))):
        within = special[(special[:, 0] >= i) & (special[:, 0] <= i + 1), 0]
        changes.append(within[0] if len(within) else i + 1.0)
    index = np.concatenate([index, special[:, 0]])
    order = np.argsort(index, kind="stable")
    index = index[order]
    x = np.concatenate([x, special[:, 2]])[order]
    y = np.concatenate([y, special[:, 1]])[order]
    stable = bool(branch.stable[0])
    for start, stop in itertools.pairwise([0.0, *changes, index[-1]]):
        line = {"lw": width, "ls": "-"} if stable else {"lw": 0.75 * width, "ls": DASHES}
        part = (index >= start) & (index <= stop)
        axes.plot(x[part], y[part], color=color, zorder=3, **line)
        stable = not stable


def mark(axes: Axes, x: float, y: float, kind: str, color: str, size: float = 8.5) -> None:
    style = {"mfc": "white", "mec": color, "mew": 1.8, "ls": "none", "zorder": 5}
    axes.plot(x, y, MARKS[kind][0], ms=size, **style)


def label(axes: Axes, x: float, y: float, text: str, offset: tuple[float, float], color: str):
    """Write a number beside a special point; the offset is in points."""
    side = "left" if offset[0] > 0 else "right" if offset[0] < 0 else "center"
    style = {"textcoords": "offset points", "fontsize": 10, "color": color, "zorder": 6}
    style["bbox"] = {"fc": "white", "ec": "none", "pad": 0.8, "alpha": 0.85}
    axes.annotate(text, (x, y), xytext=offset, ha=side, va="center", **style)


def legend_entries(kinds: tuple[str, ...], grey: str = "0.35") -> list[Line2D]:
    entries = [
        Line2D([], [], color=grey, lw=2.2, label="stable"),
        Line2D([], [], color=grey, lw=1.7, ls=DASHES, label="unstable"),
    ]
    for kind in kinds:
        marker, words = MARKS[kind]
        style = {"mfc": "white", "mec": grey, "mew": 1.8, "ms": 8}
        entries.append(Line2D([], [], marker=marker, ls="none", label=words, **style))
    return entries


def finish(axes: Axes) -> None:
    axes.grid(color="0.9", lw=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=11)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
