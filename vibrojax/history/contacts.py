"""The contacts of a history, one by one, and its largest values: exact between the samples."""

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from vibrojax._tools.checks import check_range, is_traced, nearest
from vibrojax._tools.signatures import validated
from vibrojax.history.between_samples import contact_rows, largest
from vibrojax.history.finer_steps import Rows
from vibrojax.history.samples import SampledMotion
from vibrojax.results.status import Status

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
        import xarray

        data = {
            name: ("contact", getattr(self, name), {"units": units, "long_name": label})
            for name, (units, label) in COLUMNS.items()
        }
        number = {"units": "1", "long_name": "Contact, from 1"}
        return xarray.Dataset(data, {"contact": ("contact", np.arange(1, len(self) + 1), number)})

    @validated
    def plot(self, *columns: str) -> "Figure":
        """Draw columns of the table against the time of touch, one panel each.

        `columns` are names of fields; by default `peak_force` and `approach_speed`. Raises
        `ValueError` for an unknown column, or when there is no contact to draw.
        """
        columns = columns or ("peak_force", "approach_speed")
        for name in columns:
            if name not in COLUMNS:
                raise ValueError(f"Unknown column {name!r}. {nearest(str(name), COLUMNS)}")
        if not len(self):
            raise ValueError("There are no contacts to draw.")
        from vibrojax.plot.contacts import plot_contacts

        return plot_contacts(self.to_xarray(), columns)

    def __repr__(self) -> str:
        head = f"Contacts({len(self)})"
        if not len(self):
            return head
        names = {
            "stop": "stop",
            "touch": "touch [s]",
            "duration": "duration [s]",
            "peak_force": "peak force [N]",
            "penetration": "penetration [m]",
            "approach_speed": "approach [m/s]",
            "restitution": "restitution",
            "energy_lost": "energy lost [J]",
        }
        lines = [head, "  ".join(f"{label:>15s}" for label in names.values())]
        for i in range(min(len(self), SHOWN)):
            values = (getattr(self, name)[i] for name in names)
            lines.append("  ".join(f"{value:>15.6g}" for value in values))
        if len(self) > SHOWN:
            lines.append(f"... and {len(self) - SHOWN} more")
        return "\n".join(lines)


def contacts_of(history: SampledMotion) -> Contacts:
    """Tabulate the contacts of a history; see `History.contacts`."""
    time, states = samples_of(history, "contacts")
    found = contact_rows(history.motion, time, states)
    tables = [_contacts(rows, stop + 1) for stop, rows in enumerate(found)]
    tables = tables or [{field.name: np.zeros(0) for field in fields(Contacts)}]
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    begun = np.where(np.isnan(columns["touch"]), time[0], columns["touch"])
    order = np.argsort(begun, kind="stable")
    columns = {name: column[order] for name, column in columns.items()}
    columns["stop"] = columns["stop"].astype(int)
    return Contacts(**columns)


def _contacts(rows: Rows, stop: int) -> dict[str, np.ndarray]:
    """Join the stretches of one stop to contacts."""
    (first,) = np.nonzero(~rows.follows)
    count = first.size
    last = np.append(first[1:], rows.start.size)[:count] - 1

    def joined(function, values):
        return function.reduceat(values, first) if count else np.zeros(0)

    touch = np.where(rows.touched[first], rows.start[first], np.nan)
    departure = np.where(rows.departed[last], rows.end[last], np.nan)
    # NaN where the end is not known, else 0.
    begun, ended = touch - touch, departure - departure
    approach, leaving = rows.rate_start[first] + begun, ended - rows.rate_end[last]
    kept = np.where(np.isnan(ended), 0.0, rows.stored_end[last])
    brought = np.where(np.isnan(begun), 0.0, rows.stored_start[first])
    moving = approach > 0
    return {
        "stop": np.full(count, float(stop)),
        "touch": touch,
        "departure": departure,
        "duration": departure - touch,
        "peak_force": joined(np.maximum, rows.highest),
        "lowest_force": joined(np.minimum, rows.lowest),
        "penetration": joined(np.maximum, rows.deepest),
        "impulse": joined(np.add, rows.impulse),
        "approach_speed": approach,
        "departure_speed": leaving,
        "restitution": np.where(moving, leaving / np.where(moving, approach, 1.0), np.nan),
        "energy_lost": joined(np.add, rows.loss) + kept - brought,
    }


def peak_of(
    history: SampledMotion,
    quantity: str,
    position: ArrayLike | None,
    start: float | int,
) -> Peak:
    """Return the largest value of a quantity; see `History.peak`."""
    time, states = samples_of(history, "peaks")
    allowed = f"at most {time[-1]:.6g} s, the end of the history"
    check_range("start", start, -np.inf, time[-1], allowed=allowed)
    if quantity == "contact_force":
        shape = np.zeros(history.coordinates.shape[1])
    else:
        shape = np.asarray(history.shape_at(position))
    return Peak(*largest(history.motion, time, states, quantity, shape, float(start)))


def samples_of(
    history: SampledMotion, what: str
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, "samples states"]]:
    """Return times and states of one finished history.

    Raises `ValueError` for a traced one, lanes, one that diverged and one of a single sample.
    """
    if is_traced(history.time) or np.ndim(history.time) != 1:
        raise ValueError(
            f"The {what} are those of one history outside jit and vmap, got lanes of shape "
            f"{np.shape(history.time)[:-1]}. Take one: jax.tree.map(lambda a: a[0], history)."
        )
    if int(history.status) != Status.completed.value:
        status = Status(int(history.status)).name
        raise ValueError(f"This history has no {what}: its status is {status}.")
    time = np.asarray(history.time)
    if time.size < 2:
        raise ValueError(f"A history of one sample has no {what}.")
    columns = (history.coordinates, history.rates, history.memory)
    return time, np.concatenate([np.asarray(c) for c in columns], axis=1)
