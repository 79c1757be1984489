"""The response of the pair of beams that meet, with damping and contact assumed, to a picture.

python experiments/stuttgart_rig/pair.py    # a minute
"""

import json

import matplotlib
import numpy as np
from rig import GAP, HERE, pair

import vibrojax as vj

matplotlib.use("Agg")
import matplotlib.pyplot as plt

DAMPING = {0.002: "#0060a8", 0.003: "#d55e00"}
"""Damping ratios, and their colours."""
MEASURED = {"frequency": (0.98, 1.04), "amplitude": (0.8, 1.8)}
"""Axes of figure 11 of the source: frequency over 28.2 Hz, amplitude over the gap."""


def main() -> None:
    """Follow a branch for each damping ratio, and draw them."""
    figure, axes = plt.subplots(figsize=(8, 4.6), layout="constrained")
    results = []
    for damping_ratio, color in DAMPING.items():
        system = pair(damping_ratio=damping_ratio)
        settings = vj.ContinuationSettings(max_points=1500)
        over = vj.Range(0.97, 1.05)
        branch = vj.continue_response(system, frequency_ratio=over, settings=settings)
        print(branch)
        ratio = branch.to_xarray()["first_harmonic_ratio"].values
        amplitude = ratio * float(system.drive.amplitude) / GAP
        stable = np.where(branch.stable, amplitude, np.nan)
        name = f"damping ratio {100 * damping_ratio:g} %"
        axes.plot(branch.values, amplitude, "--", color=color, linewidth=1)
        axes.plot(branch.values, stable, color=color, linewidth=2.2, label=name)
        top = int(np.argmax(amplitude))
        results.append(
            {
                "damping_ratio": damping_ratio,
                "touch_frequency_ratio": float(branch.grazings[0]),
                "largest_amplitude_over_gap": float(amplitude[top]),
                "its_frequency_ratio": float(branch.values[top]),
            }
        )
    (low, high), (bottom, top) = MEASURED.values()
    corner, size = (low, bottom), (high - low, top - bottom)
    box = plt.Rectangle(corner, *size, fill=False, color="0.4", label="axes of the measurement")
    axes.add_patch(box)
    axes.set(
        xlabel="drive frequency over first natural frequency of the right beam",
        ylabel="first harmonic over gap",
        ylim=(0, None),
    )
    axes.legend(loc="upper left")
    figure.savefig(HERE / "pair.png", dpi=110)
    (HERE / "pair.json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
