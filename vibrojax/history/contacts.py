"""The contacts of a history, one by one, and its largest values: exact between the samples."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from vibrojax._tools.checks import check_known, check_range
from vibrojax._tools.signatures import validated
from vibrojax.history.between_samples import engine_of
from vibrojax.history.corners import cut_at_corners
from vibrojax.history.finer_steps import OF_STOPS, Cells
from vibrojax.history.quantities import table
from vibrojax.history.samples import SampledMotion, times_of
from vibrojax.results.variables import with_unit

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


COLUMNS = {
    "stop": ("1", "Stop, from 1"),
    "touch": ("s", "Time of touch"),
    "departure": ("s", "Time of departure"),
    "duration": ("s", "Duration"),
    "peak_force": ("N", "Largest force"),
    "lowest_force": ("N", "Lowest force"),
    "penetration": ("m", "Largest penetration"),
    "impulse": ("N s", "Impulse"),
    "approach_speed": ("m/s", "Speed of the contact point at touch"),
    "departure_speed": ("m/s", "Speed of the contact point at departure"),
    "restitution": ("1", "Departure speed over approach speed"),
    "energy_lost": ("J", "Energy taken by the stop"),
}
SHOWN = 8
"""Contacts that the table of a `repr` shows."""


class Peak(NamedTuple):
    """A largest value and when it is reached."""

    value: float
    """With its sign, in SI units."""
    time: float
    """s."""


@dataclass(frozen=True, eq=False, repr=False)
class Contacts:
    """The contacts of one history, in order of the time at which they begin.

    NaN where a contact began before the history or is not over at its end, and for what follows
    from that end.
    """

    stop: Int[np.ndarray, " contacts"]
    """Which stop is touched, from 1."""
    touch: Float[np.ndarray, " contacts"]
    """When the contact begins, s."""
    departure: Float[np.ndarray, " contacts"]
    """When it ends, s: without tension where the force has fallen to zero."""
    duration: Float[np.ndarray, " contacts"]
    """s."""
    peak_force: Float[np.ndarray, " contacts"]
    """Largest force, N, the value just after the touch included."""
    lowest_force: Float[np.ndarray, " contacts"]
    """Lowest force, N; negative where the stop pulls."""
    penetration: Float[np.ndarray, " contacts"]
    """Largest penetration, m."""
    impulse: Float[np.ndarray, " contacts"]
    """Force over time, N s."""
    approach_speed: Float[np.ndarray, " contacts"]
    """Speed of the contact point into the stop at touch, m/s."""
    departure_speed: Float[np.ndarray, " contacts"]
    """Speed of the contact point off the stop at departure, m/s."""
    restitution: Float[np.ndarray, " contacts"]
    """Departure speed over approach speed."""
    energy_lost: Float[np.ndarray, " contacts"]
    """What the stop took from the body and had not given back at departure, J."""

    def __len__(self) -> int:
        return self.stop.size

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset over contact, with units and long names."""
        return table("contact", {n: (getattr(self, n), *COLUMNS[n]) for n in COLUMNS})

    @validated
    def plot(self, *columns: str) -> "Figure":
        """Draw columns of the table against the time of touch, one panel each.

        `columns` are names of fields; by default `peak_force` and `approach_speed`. Raises
        `ValueError` for an unknown column, or when there is no contact to draw.
        """
        columns = columns or ("peak_force", "approach_speed")
        for name in columns:
            check_known("column", name, COLUMNS)
        if not len(self):
            raise ValueError("There are no contacts to draw.")
        from vibrojax.plot.history import plot_contacts

        return plot_contacts(self.to_xarray(), columns)

    def __repr__(self) -> str:
        head = f"Contacts({len(self)})"
        if not len(self):
            return head
        names = ("stop", "touch", "duration", "peak_force", "penetration", "approach_speed")
        names = (*names, "restitution", "energy_lost")
        heads = [with_unit(name.replace("_", " "), COLUMNS[name][0]) for name in names]
        rows = [[f"{getattr(self, n)[i]:.6g}" for n in names] for i in range(len(self))[:SHOWN]]
        more = [f"... and {len(self) - SHOWN} more"] if len(self) > SHOWN else []
        lines = ["  ".join(f"{value:>15s}" for value in row) for row in (heads, *rows)]
        return "\n".join([head, *lines, *more])


def contacts_of(history: SampledMotion) -> Contacts:
    """Tabulate the contacts of a history; see `History.contacts`."""
    time, states = cut_at_corners(history.motion, times_of(history, "contacts"), history.states)
    touched, total = [], 0
    for cells in engine_of(history.motion).cells(history.motion, time, states):
        total = max(total, int(cells.number[-1]) + 1)
        kept = (cells.here | cells.there).any(axis=0)
        touched.append(Cells(*(column[..., kept] for column in cells)))
    found = Cells(*(np.concatenate(column, axis=-1) for column in zip(*touched, strict=True)))
    tables = [_contacts(found, stop, total) for stop in range(len(found.here))]
    tables = tables or [{name: np.zeros(0) for name in COLUMNS}]
    columns = {name: np.concatenate([table[name] for table in tables]) for name in COLUMNS}
    begun = np.where(np.isnan(columns["touch"]), time[0], columns["touch"])
    order = np.argsort(begun, kind="stable")
    columns = {name: column[order] for name, column in columns.items()}
    return Contacts(**columns | {"stop": columns["stop"].astype(int)})


def _contacts(cells: Cells, stop: int, total: int) -> dict[str, np.ndarray]:
    """Join the cells in which one stop is touched to contacts."""
    on = cells.here[stop] | cells.there[stop]
    number = cells.number[on]
    own = SimpleNamespace(**{name: getattr(cells, name)[stop, on] for name in OF_STOPS})
    follows = np.zeros(number.size, bool)
    follows[1:] = (np.diff(number) == 1) & own.there[:-1] & own.here[1:]
    (first,) = np.nonzero(~follows)
    count = first.size
    last = np.append(first[1:], number.size)[:count] - 1

    def joined(function, values):
        return function.reduceat(values, first) if count else np.zeros(0)

    # Not known where the history begins or ends in contact.
    cut = own.here[first] & (number[first] == 0)
    touch = np.where(cut, np.nan, own.start[first])
    cut = own.there[last] & (number[last] == total - 1)
    departure = np.where(cut, np.nan, own.end[last])
    # NaN where the end is not known, else 0.
    begun, ended = touch - touch, departure - departure
    approach, leaving = own.rate_start[first] + begun, ended - own.rate_end[last]
    kept = np.where(np.isnan(ended), 0.0, own.stored_end[last])
    brought = np.where(np.isnan(begun), 0.0, own.stored_start[first])
    moving = approach > 0
    return {
        "stop": np.full(count, stop + 1.0),
        "touch": touch,
        "departure": departure,
        "duration": departure - touch,
        "peak_force": joined(np.maximum, own.highest),
        "lowest_force": joined(np.minimum, own.lowest),
        "penetration": joined(np.maximum, own.deepest),
        "impulse": joined(np.add, own.impulse),
        "approach_speed": approach,
        "departure_speed": leaving,
        "restitution": np.where(moving, leaving / np.where(moving, approach, 1.0), np.nan),
        "energy_lost": joined(np.add, own.loss) + kept - brought,
    }


def peak_of(
    history: SampledMotion,
    quantity: str,
    position: ArrayLike | None,
    start: float | int,
) -> Peak:
    """Return the largest value of a quantity; see `History.peak`."""
    time, states = cut_at_corners(history.motion, times_of(history, "peaks"), history.states)
    allowed = f"at most {time[-1]:.6g} s, the end of the history"
    check_range("start", start, -np.inf, time[-1], allowed=allowed)
    if quantity == "contact_force":
        shape = np.zeros(history.coordinates.shape[1])
    else:
        shape = np.asarray(history.shape_at(position))
    largest = engine_of(history.motion).largest
    return Peak(*largest(history.motion, time, states, quantity, shape, float(start)))
