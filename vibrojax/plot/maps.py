"""Pictures of maps; what draws them is imported when they are drawn."""

from typing import TYPE_CHECKING, Any

from vibrojax._tools.signatures import validated

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


@validated
def plot_map(
    dataset: "xarray.Dataset",
    variable: str | None = None,
    *,
    x: str | None = None,
    y: str | None = None,
    **selection: Any,
) -> "Figure":
    """Draw one variable of a map over two of its axes, from the dataset alone.

    Jumps are lines over a frequency axis, regimes (period, aperiodic, with or without hysteresis)
    are bounded, lanes without a value are hatched. What axes are left become panels; with one axis
    in all, the variable is drawn as lines.

    Parameters:
        dataset: result of `parameter_map`, or `xarray.open_zarr(store)`.
        variable: what to draw; by default `peak_amplitude_ratio`, else `amplitude_ratio`.
        x, y: names of the axes to draw over.
        selection: a value of any other axis, the nearest one is taken; `direction` by name.

    Raises `ValueError` for an unknown variable or axis, x the same as y, a value that is not on
    its axis, or more panels than can be read.
    """
    from vibrojax.plot import map_plot

    return map_plot.plot_map(dataset, variable, x=x, y=y, **selection)


@validated
def plot_map_summary(dataset: "xarray.Dataset") -> "Figure":
    """Draw a map on one page: its measures, what they depend on most, and how its lanes ended.

    Up to four measures are drawn over the two longest axes, with the others at their middle value.
    Of the first measure there are the effects of at most three parameters: the median over all
    other axes, and the band that holds 80 % of the systems.

    `dataset` is a result of `parameter_map`. Raises `ValueError` for one that is no map, or has no
    measure over a parameter with two values.
    """
    from vibrojax.plot import map_summary

    return map_summary.plot_map_summary(dataset)
