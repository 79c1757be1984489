"""Numbers of a record, not of the rig: how its motion begins, and what its sensors do."""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vibrojax.measured.history import CHANNELS, MeasuredHistory
from vibrojax.model.systems import AbstractSystem

BEGINNING = ("initial_displacement", "initial_velocity")
OF_SENSORS = ("gain", "offset", "delay")
AT_REST = {"gain": 1.0, "offset": 0.0, "delay": 0.0}
RECORD_NUMBERS = (*BEGINNING, *(f"{name}_{part}" for part in OF_SENSORS for name in CHANNELS))


class Sensors(NamedTuple):
    """What the sensors of a record do, by channel: measured = gain * true(t - delay) + offset."""

    gain: Float[Array, " channels"]
    offset: Float[Array, " channels"]
    delay: Float[Array, " channels"]


class Recorded(eqx.Module):
    """A trial rig, and numbers of the record it is compared with."""

    system: AbstractSystem
    numbers: Float[Array, " numbers"]


@dataclass(frozen=True)
class RecordedBy:
    """Makes trial rigs together with numbers of their record: some of its arguments."""

    make: Callable[..., AbstractSystem]
    names: tuple[str, ...]

    def __call__(self, **arguments: Any) -> Recorded:
        """Make the rig of the other arguments."""
        numbers = jnp.stack([jnp.asarray(arguments.pop(name), float) for name in self.names])
        return Recorded(self.make(**arguments), numbers)


def record_numbers_in(make: Callable[..., Any], names: Iterable[str]) -> tuple[str, ...]:
    """Return those of the names that are numbers of records, not arguments of the function."""
    own = inspect.signature(make).parameters
    return tuple(name for name in names if name in RECORD_NUMBERS and name not in own)


def has_number(history: MeasuredHistory, name: str) -> bool:
    """Whether a history has this number of a record: a channel of its own, or a beginning."""
    channel, _, part = name.rpartition("_")
    if part in OF_SENSORS:
        return channel in history.channels
    return not history.settled


def first_value(history: MeasuredHistory, name: str) -> float:
    """Return what the history says of this number; of a velocity else its first one measured."""
    channel, _, part = name.rpartition("_")
    if part in OF_SENSORS:
        return getattr(history, part).get(channel, AT_REST[part])
    said = getattr(history, name)
    if said is None and name == "initial_velocity" and history.velocity is not None:
        shown = history.windowed().velocity
        assert shown is not None
        first = float(shown[np.flatnonzero(np.isfinite(shown))[0]])
        said = (first - first_value(history, "velocity_offset")) / first_value(
            history, "velocity_gain"
        )
    return said or 0.0


def with_numbers(history: MeasuredHistory, numbers: Mapping[str, float]) -> MeasuredHistory:
    """Return the history with these numbers of a record as known."""
    for name, value in numbers.items():
        channel, _, part = name.rpartition("_")
        if part not in OF_SENSORS:
            history = replace(history, **{name: value})
        elif channel in history.channels:
            history = replace(history, **{part: {**getattr(history, part), channel: value}})
    return history


def unit_of(name: str) -> str:
    """Return the unit of a number of records."""
    channel, _, part = name.rpartition("_")
    if name in BEGINNING:
        return CHANNELS[part]
    return {"gain": "1", "offset": CHANNELS[channel], "delay": "s"}[part]


def size_of(history: MeasuredHistory, name: str) -> float:
    """Return a change of this number that matters, about: the unit in which it is sought."""
    part = history.windowed()
    span = float(np.ptp(part.time))
    channel, _, kind = name.rpartition("_")
    if kind == "offset":
        return _largest(part, channel)
    if kind == "delay":
        return span / 10
    velocity = abs(first_value(history, "initial_velocity"))
    if name == "initial_velocity":
        return velocity or (_largest(part, "velocity") if "velocity" in part.channels else 1.0)
    if "displacement" in part.channels:
        return _largest(part, "displacement")
    return abs(first_value(history, name)) or velocity * span / 10 or 1e-3


def _largest(history: MeasuredHistory, channel: str) -> float:
    return float(np.nanmax(np.abs(history.channels[channel]), initial=0.0)) or 1.0


def numbers_of(history: MeasuredHistory) -> Float[np.ndarray, " numbers"]:
    """Return all numbers of a record: its beginning, then gains, offsets, delays by channel."""
    begun = [
        history.release or history.initial_displacement or 0.0,
        history.initial_velocity or 0.0,
    ]
    sensors = [getattr(history, p).get(c, AT_REST[p]) for p in OF_SENSORS for c in history.channels]
    return np.array([*begun, *sensors])


def places_of(names: Iterable[str], channels: tuple[str, ...]) -> tuple[int, ...]:
    """Return where these numbers stand among all those of a record with these channels."""
    all_names = [*BEGINNING, *(f"{c}_{part}" for part in OF_SENSORS for c in channels)]
    return tuple(all_names.index(name) for name in names)


def apart(numbers: Float[Array, " numbers"]) -> tuple[Float[Array, " 2"], Sensors]:
    """Return the beginning and the sensors of all numbers of a record."""
    begun, rest = numbers[: len(BEGINNING)], numbers[len(BEGINNING) :]
    return begun, Sensors(*rest.reshape(len(OF_SENSORS), -1))
