"""How far the curve of a branch may lie from where it is computed, under tolerances of the rig."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.branches.settings import ContinuationSettings
from vibrojax.design.known_branch import PARAMETER
from vibrojax.design.measures import READ, variable_of
from vibrojax.design.respond import respond
from vibrojax.design.robust import Tolerance
from vibrojax.ensemble.arguments import default_of
from vibrojax.ensemble.ranges import Range
from vibrojax.model.systems import AbstractSystem
from vibrojax.results.derived import DERIVED
from vibrojax.results.variables import PLAIN, axis_description, described_as

if TYPE_CHECKING:
    import xarray


@validated
def band(
    make_system: Callable[..., AbstractSystem],
    tolerances: Mapping[str, Tolerance],
    *,
    frequency_ratio: Range | None = None,
    frequency: Range | None = None,
    settings: ContinuationSettings | None = None,
    **numbers: Any,
) -> "xarray.Dataset":
    """Return how the curve of a rig's branch moves under tolerances: for `branch.plot(band=...)`.

        band = vj.design.band(
            vj.default_rig,
            dict(gap=vj.design.Tolerance(2e-5), stiffness=vj.design.Tolerance(0.2, relative=True)),
            frequency_ratio=vj.Range(0.85, 1.31),
        )
        branch.plot(band=band)

    To first order: by derivatives of every point of the branch, folds included, stable and not.

    Parameters:
        make_system: a function from named numbers to a system with linear stops.
        tolerances: `vj.design.Tolerance(...)` by name of a number.
        frequency_ratio, frequency: the drive frequencies over which the branch is followed (ratio
            to the first natural frequency of the unstopped system, or Hz): `vj.Range(low, high)`.
        settings: how it is followed, `vj.ContinuationSettings(...)`.
        numbers: arguments of the function; one with a tolerance that is not given here has its
            default.

    The dataset has the dimensions `point` along the branch and `number`, and for each variable
    `<variable>_change`, with `frequency_change`: how far the curve moves when the number is larger
    by its tolerance, the motion being followed across its curve. Raises `ValueError` as
    `vj.design.respond` does, for no tolerances, or one of a number that has no value.
    """
    import xarray

    if not tolerances:
        raise ValueError(
            "tolerances is empty: give at least one, such as dict(gap=Tolerance(2e-5))."
        )
    given = dict(numbers)
    for name in tolerances:
        value = given.get(name, default_of(make_system, name))
        if isinstance(value, bool | str | None) or np.ndim(value) != 0:
            raise ValueError(
                f"tolerances has {name!r}, which is no real number of the rig, got "
                f"{in_short(value)}: give it by name, such as {name}=1.0."
            )
        given[name] = float(value)
    how: dict[str, Any] = {"frequency_ratio": frequency_ratio, "frequency": frequency}
    response = respond(make_system, settings=settings, **how, **given)
    names, known = list(response.numbers), response.known
    widths = [t.width * (abs(given[n]) if t.relative else 1.0) for n, t in tolerances.items()]
    rows = [names.index(name) for name in tolerances]
    points = known.around(known.walk.points)
    moves = np.array([point.by_number[rows] for point in points])
    moves = moves * np.array(widths)[:, None]  # points, numbers, measured
    branch, dims = response.branch, ("number", "point")
    about = axis_description(branch.axis) | {"long_name": f"Change of {branch.axis} by a tolerance"}
    data: dict[str, Any] = {"frequency_change": (dims, moves[..., PARAMETER].T, about)}
    for name in (*READ, *DERIVED.get(branch.ratio_units, {})):
        variable = variable_of(name, branch.ratio_units)
        source = np.array([point.value[variable.column] for point in points])
        value, push = jax.linearize(variable.rule, source)
        changes = np.array([push(row) for row in moves[..., variable.column].T])
        about = described_as(name, branch.ratio_units)
        data[name] = ("point", np.asarray(value), about)
        change = about | {"long_name": f"{about['long_name']}: change by a tolerance"}
        data[f"{name}_change"] = (dims, changes, change)
    coordinates: dict[str, Any] = {
        "number": list(tolerances),
        "tolerance": (
            "number",
            widths,
            {"long_name": "Tolerance, either way", "units": "that of the number"},
        ),
        branch.axis: ("point", branch.values, axis_description(branch.axis)),
    }
    units = [axis_description(name)["units"] for name in tolerances]
    words = [
        f"{name.replace('_', ' ')} ± {width:.3g}" + ("" if unit in PLAIN else f" {unit}")
        for name, width, unit in zip(tolerances, widths, units, strict=True)
    ]
    attributes = {"axis": branch.axis, "tolerances": ", ".join(words)}
    return xarray.Dataset(data, coordinates, attrs=attributes)
