"""How soft stops are that stand for rigid ones."""

from dataclasses import replace

import equinox as eqx
import numpy as np

from vibrojax._tools.described import shown_value
from vibrojax.model.laws import AbstractContactLaw
from vibrojax.model.stop_forces import contact_slope
from vibrojax.model.systems import (
    AbstractSystem,
    SystemType,
    as_arrays,
    equations_of,
    held_stops,
    with_changed_stops,
)


class StopSoftness(eqx.Module):
    """How long a stop is touched, beside the periods of what it stops."""

    stop: int = eqx.field(static=True)
    """Number of the stop, from 1."""
    mass: float
    """Mass that a sudden force at the stop moves, kg (`mass_at`)."""
    stiffness_ratio: float
    """Stiffness of the stop over that of the first mode there, p0 = Ks phi_1^2/(m_1 w_1^2)."""
    contact_duration: float
    """Half a swing of that mass on the stop, s."""
    first_period: float
    """Of the first mode, s."""
    highest_period: float
    """Of the highest mode that is kept, s."""
    drive_period: float | None
    """s; None where there are several."""
    stiff_enough: AbstractContactLaw | None
    """The law that would reach the error asked for, that of the stop if it does; None: unknown."""

    def __repr__(self) -> str:
        lasts = self.contact_duration
        beside = {"the first mode": self.first_period, "the highest": self.highest_period}
        if self.drive_period is not None:
            beside["the drive"] = self.drive_period
        parts = ", ".join(f"{lasts / period:.3g} of {name}" for name, period in beside.items())
        lines = [
            f"stop {self.stop}: p0 = {self.stiffness_ratio:.4g}, mass {self.mass:.4g} kg",
            f"  contact of {lasts:.3g} s, in periods {parts}",
        ]
        if lasts < self.highest_period < self.first_period:
            lines.append("  shorter than the period of the highest mode: keep more modes")
        law = self.stiff_enough
        lines.append(f"  stiff enough: {'not known' if law is None else shown_value(law)}")
        return "\n".join(lines)


def with_shorter_contacts(system: SystemType, factor: float) -> SystemType | None:
    """Return the system with stiffer stops, on which contacts last 1/factor as long.

    None where it has no stops, or a law that does not say how.
    """
    laws = [stop.law.with_shorter_contacts(factor) for stop in held_stops(system)]
    if not laws or any(law is None for law in laws):
        return None
    return with_changed_stops(
        system, lambda stop: replace(stop, law=stop.law.with_shorter_contacts(factor))
    )


def softness_of_stops(
    system: AbstractSystem, factor: float | None, drive_period: float | None
) -> tuple[StopSoftness, ...]:
    """Return how soft each stop is, and the law whose contacts are `factor` times shorter.

    Nothing for a system that is not linear between contacts; no law where the factor is not known.
    """
    equations = equations_of(as_arrays(system)).linear_between_contacts
    if equations is None:
        return ()
    rates = np.asarray(equations.angular_frequency)
    found = []
    for k, stop in enumerate(equations.stops):
        slope = float(contact_slope(stop))
        per_force = np.asarray(equations.stop_map[k] * equations.force_map[:, k])
        mass = 1 / float(np.sum(per_force))
        found.append(
            StopSoftness(
                stop=k + 1,
                mass=mass,
                stiffness_ratio=slope * float(per_force[0]) / float(rates[0]) ** 2,
                contact_duration=float(np.pi * np.sqrt(mass / slope)),
                first_period=2 * np.pi / float(rates[0]),
                highest_period=2 * np.pi / float(rates.max()),
                drive_period=drive_period,
                stiff_enough=None if factor is None else stop.law.with_shorter_contacts(factor),
            )
        )
    return tuple(found)
