"""Picture of the motions that coexist at one frequency."""

from collections.abc import Sequence

import numpy as np
import xarray
from matplotlib.figure import Figure

from vibrojax.plot.style import LINE_STYLES, chosen_in, finish, key_of, new_picture, shades

LOST = {0: "without a period", -1: "diverged"}
"""What became of starts that lead to no motion."""


def plot_coexisting(
    found: xarray.Dataset, orbits: Sequence[tuple[np.ndarray, np.ndarray]], samples: int
) -> Figure:
    """Draw every motion in the plane of displacement and velocity, marked at drive phase 0.

    `orbits` are the displacements (m) and velocities (m/s) over a period, with so many samples to
    a drive period.
    """
    figure, axes = new_picture()
    leads_to = found["leads_to"].values
    for k, (orbit, color) in enumerate(zip(orbits, shades(len(orbits)), strict=True)):
        across, along = 1e3 * orbit[0], orbit[1]
        style = LINE_STYLES[k % len(LINE_STYLES)]
        period, amplitude = (found[n].values[k] for n in ("period", "amplitude_ratio"))
        starts = f"{np.sum(leads_to == k + 1)} of {len(leads_to)} starts"
        label = f"{k + 1}: period {period}, amplitude ratio {amplitude:.4g}, from {starts}"
        axes.plot(across, along, color=color, linestyle=style, linewidth=2.0, label=label)
        strobed = slice(0, -1, samples)
        axes.plot(across[strobed], along[strobed], "o", color=color, markersize=7)
    counts = {words: np.sum(leads_to == number) for number, words in LOST.items()}
    lost = [f"{count} starts {words}" for words, count in counts.items() if count]
    title = "; ".join([f"{chosen_in(found)}; dots: drive phase 0", *lost])
    return finish(figure, axes, "Displacement (mm)", "Velocity (m/s)", key_of(axes), title)
