"""The nine natural frequencies of the pair of beams, measured and by models of it.

python experiments/stuttgart_rig/run.py    # half a minute
"""

import json

import numpy as np
from rig import (
    DRAWN,
    HERE,
    MEASURED,
    SOURCE,
    WIDTH,
    Factors,
    left_beam,
    point_masses_on_cantilevers,
    right_beam,
)
from scipy.optimize import least_squares

import vibrojax as vj

STEP = 1e-3
"""Of differences in the search: round-off in natural frequencies is some 1e-9."""


def frequencies(factors: Factors, **mini: float) -> dict[str, list[float]]:
    """Natural frequencies of both beams, Hz."""
    left, right = left_beam(factors), right_beam(factors, **mini)
    return {
        "left": left.frequencies(len(MEASURED["left"])).tolist(),
        "right": right.frequencies(len(MEASURED["right"])).tolist(),
    }


def on_cantilevers() -> dict[str, list[float | None]]:
    """The same of uniform cantilevers with point masses, which have no mini-beam."""
    left, right = (
        np.asarray(vj.modes(beam, 4).angular_frequency) / (2 * np.pi)
        for beam in point_masses_on_cantilevers()
    )
    return {"left": left.tolist(), "right": [*right[:2].tolist(), None, *right[2:].tolist()]}


def fitted_factors() -> Factors:
    """The factors that bring each beam nearest to what was measured, in the sense of squares."""
    left, right = (np.array(MEASURED[side]) for side in ("left", "right"))

    def of_left(logarithms):
        beam = left_beam(Factors(*np.exp(logarithms)))
        return 100 * (beam.frequencies(len(left)) / left - 1)

    def of_right(logarithms):
        whole, clamp, mini = np.exp(logarithms)
        beam = right_beam(Factors(right=whole, clamp=clamp, mini=mini))
        return 100 * (beam.frequencies(len(right)) / right - 1)

    begin = np.log(SOURCE)
    found = [
        least_squares(misfit, start, diff_step=STEP, xtol=1e-6).x
        for misfit, start in ((of_left, begin[:2]), (of_right, begin[2:]))
    ]
    return Factors(*np.exp(np.concatenate(found)).tolist())


def main() -> None:
    """Compute all columns of the table and write them."""
    fitted = fitted_factors()
    table = {
        "measured": MEASURED,
        "drawn": frequencies(DRAWN),
        "source": frequencies(SOURCE),
        "source_wide": frequencies(SOURCE, mini_width=WIDTH),
        "fitted": frequencies(fitted),
        "point_masses": on_cantilevers(),
    }
    content = {"frequencies_Hz": table, "fitted_factors": fitted._asdict()}
    (HERE / "results.json").write_text(json.dumps(content, indent=1) + "\n")
    for side, measured in MEASURED.items():
        for k, value in enumerate(measured):
            found = (row[side][k] or np.nan for name, row in table.items() if name != "measured")
            print(f"{side} {value} Hz ", *(f"{100 * (f / value - 1):+5.1f} %" for f in found))


if __name__ == "__main__":
    main()
