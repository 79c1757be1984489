"""Picture of how a Lyapunov exponent settles."""

import numpy as np
import xarray
from matplotlib.figure import Figure

from vibrojax.plot.style import COLORS, GREY, STYLES, finish, key_of, label_for, new_picture

STARTS_AT = 5
"""Share of the periods, percent, before which a mean is not drawn: it says nothing yet."""


def plot_lyapunov(found: xarray.Dataset) -> Figure:
    """Draw the mean rate up to every drive period, and the exponent with its error."""
    figure, axes = new_picture()
    rates, count = found["rate"].values, found["drive_period"].values
    mean = np.cumsum(rates) / count
    shown = slice(rates.size * STARTS_AT // 100, None)
    axes.plot(
        count[shown], mean[shown], color=COLORS["blue"], linewidth=2.0, label="mean rate so far"
    )
    value, error = (float(found[f"lyapunov_{name}"]) for name in ("exponent", "standard_error"))
    axes.axhline(value, color=COLORS["orange"], linestyle=STYLES["backward"], linewidth=1.5)
    axes.axhspan(
        value - 2 * error,
        value + 2 * error,
        color=COLORS["orange"],
        alpha=0.2,
        label=f"exponent {value:.4g} 1/s and two standard errors",
    )
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    return finish(figure, axes, "Drive periods", label_for(found["rate"]), key_of(axes))
