"""Ever stiffer stops beside their limit: an impact with restitution, in closed form.

x'' + 2 zeta x' + x = cos(w t) with x <= 1; x' becomes -r x' at the stop. Its motions with one
impact per period: Shaw and Holmes 1983, J. Sound Vib. 90, 129.

python experiments/impact_oscillator/impact_law.py
"""

import sys
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import scipy

sys.path.insert(0, str(Path(__file__).parents[1]))
import common

import vibrojax as vj

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
DAMPING_RATIO, GAP, RESTITUTION, W = 0.05, 1.0, 0.7, 1.4
STIFFNESSES = 10.0 ** np.arange(1, 8)
"""Of the stop, over that of the spring: p0."""


class Orbit(NamedTuple):
    """A motion with one impact in every period of the force."""

    speed: float
    """Before the impact."""
    amplitude: float
    """Half of peak to peak."""
    multiplier: float
    """Largest modulus of the Floquet multipliers."""


def impact_orbit(w: float = W, r: float = RESTITUTION) -> Orbit:
    """The motion with restitution: a quadratic equation for the speed before the impact."""
    flow = np.array([[0.0, 1.0], [-1.0, -2 * DAMPING_RATIO]])
    period, up = 2 * np.pi / w, np.array([0.0, 1.0])
    whole = scipy.linalg.expm(period * flow)
    # (x - xp, x' - xp') after the impact is speed * (row - r up); xp is the forced motion alone.
    row = np.linalg.solve(whole - np.eye(2), up + r * whole @ up)
    gain = 1 / (1 - w**2 + 2j * DAMPING_RATIO * w)
    a, b = row[0] ** 2 + (row[1] / w) ** 2, -2 * GAP * row[0]
    speed = max(np.roots([a, b, GAP**2 - abs(gain) ** 2]).real)
    forced = np.array([GAP - speed * row[0], -speed * row[1]])
    phase = np.angle(forced[0] - 1j * forced[1] / w)  # of the forced motion at the impact
    time = np.linspace(0, period, 20001)
    free = np.array([GAP, -r * speed]) - forced
    values, vectors = np.linalg.eig(flow)
    parts = vectors[0] * np.linalg.solve(vectors, free.astype(complex))
    x = (parts @ np.exp(np.outer(values, time))).real + abs(gain) * np.cos(w * time + phase)
    force = np.cos(phase - np.angle(gain))
    before = force - GAP - 2 * DAMPING_RATIO * speed
    after = force - GAP + 2 * DAMPING_RATIO * r * speed
    impact = np.array([[-r, 0.0], [-(after + r * before) / speed, -r]])
    assert x.max() <= GAP + 1e-9  # it does not go through the stop
    leading = np.abs(np.linalg.eigvals(whole @ impact)).max()
    return Orbit(float(speed), float(GAP - x.min()) / 2, float(leading))


def system(stiffness: float) -> vj.model.Oscillator:
    """The same with a stop of this stiffness whose damping makes this restitution."""
    law = vj.KelvinVoigt.from_restitution(RESTITUTION, stiffness=stiffness, mass=1.0)
    stop = vj.Stop(None, GAP, law)
    return vj.model.Oscillator(1.0, 1.0, 2 * DAMPING_RATIO, stops=stop, drive=vj.PointForce(1.0))


def with_stop(stiffness: float) -> tuple[float, float]:
    """Amplitude and leading multiplier with a stop, from the branch through free flight."""
    branch = vj.continue_response(
        system(stiffness), frequency=vj.Range(0.4 / (2 * np.pi), 2.2 / (2 * np.pi))
    )
    at = branch.resample([W / (2 * np.pi)])
    found = at.amplitude_ratio.values[0], at.leading_multiplier.values[0]
    assert at.sizes["crossing"] == 1
    return float(found[0][0]), float(found[1][0])


def compute(stiffnesses: np.ndarray = STIFFNESSES) -> dict[str, Any]:
    """Differences from the limit by stiffness."""
    limit = impact_orbit()
    amplitude, multiplier = np.array([with_stop(float(k)) for k in stiffnesses]).T
    return {
        "limit": limit._asdict(),
        "stiffness": stiffnesses.tolist(),
        "amplitude": amplitude.tolist(),
        "multiplier": multiplier.tolist(),
        "amplitude_difference": (amplitude - limit.amplitude).tolist(),
        "multiplier_difference": (multiplier - limit.multiplier).tolist(),
    }


def draw(found: dict[str, Any], path: Path) -> None:
    """Draw the differences over stiffness, beside the slope of the theory."""
    figure, axes = plt.subplots(figsize=(8.5, 5.4), layout="constrained")
    stiffness = np.array(found["stiffness"])
    for name, color, marker in (("amplitude", "#0060a8", "o"), ("multiplier", "#d1590a", "D")):
        size = np.abs(found[f"{name}_difference"]) / found["limit"][name]
        axes.loglog(stiffness, size, color=color, marker=marker, lw=1.8, label=name)
    slope = np.abs(found["amplitude_difference"][-1]) / found["limit"]["amplitude"]
    theory = slope * (stiffness / stiffness[-1]) ** -0.5
    axes.loglog(
        stiffness, theory, color="0.4", ls="--", lw=1.2, label="stiffness to the power -1/2"
    )
    axes.set_xlabel("stiffness of the stop over that of the spring, p0", fontsize=12)
    axes.set_ylabel("relative difference from the impact", fontsize=12)
    common.finish(axes)
    axes.legend(fontsize=11, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def main() -> None:
    found = compute()
    common.write_json(HERE / "results" / "impact_law.json", found)
    draw(found, HERE / "pictures" / "impact_law.png")
    print(found["limit"])
    columns = ("stiffness", "amplitude", "amplitude_difference", "multiplier_difference")
    for row in zip(*(found[name] for name in columns), strict=True):
        print("| " + " | ".join(f"{value:.7g}" for value in row) + " |")


if __name__ == "__main__":
    main()
