"""Picture of how a Lyapunov exponent settles."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from vibrojax.plot.style import GREY, LABEL, new_picture, outside_legend

if TYPE_CHECKING:
    from vibrojax.regime.lyapunov_result import LyapunovExponent

BLUE = "#0060a8"
STARTS_AT = 5
"""Share of the periods, percent, before which a mean is not drawn: it says nothing yet."""


def plot_lyapunov(found: "LyapunovExponent") -> Figure:
    """Draw the mean rate up to every drive period, and the exponent with its error."""
    figure, axes = new_picture()
    rates = np.asarray(found.rates)
    count = np.arange(1, rates.size + 1)
    begin = rates.size * STARTS_AT // 100
    mean = np.cumsum(rates) / count
    axes.plot(count[begin:], mean[begin:], color=BLUE, linewidth=2.0, label="mean rate so far")
    value, error = float(found.exponent), float(found.standard_error)
    axes.axhline(value, color="#d1590a", linestyle=(0, (5, 1.6)), linewidth=1.5)
    band = axes.axhspan(value - 2 * error, value + 2 * error, color="#d1590a", alpha=0.2)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set_xlabel("Drive periods", fontsize=LABEL)
    axes.set_ylabel("Rate at which neighbours part (1/s)", fontsize=LABEL)
    lines, labels = axes.get_legend_handles_labels()
    words = f"exponent {value:.4g} 1/s and two standard errors"
    outside_legend(axes, [*lines, band], [*labels, words])
    return figure
