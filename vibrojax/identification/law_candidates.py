"""Contact laws that may explain a force record, and what of them is tried first."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from vibrojax._tools.checks import nearest
from vibrojax._tools.described import in_short
from vibrojax.identification.record_numbers import first_value
from vibrojax.measured.history import MeasuredHistory
from vibrojax.model.laws import AbstractContactLaw, Hertz, HuntCrossley, KelvinVoigt
from vibrojax.model.relaxing_laws import StandardLinearSolid

TOUCHING = 0.1
"""Share of the largest force above which a sample is in contact."""


class Impact(NamedTuple):
    """What the records say of an impact, on the whole."""

    force: float
    """Largest force, N."""
    duration: float
    """s."""
    velocity: float
    """Of approach, m/s."""

    @property
    def stiffness(self) -> float:
        """Of a linear spring on which a free mass has such an impact, N/m."""
        return np.pi * self.force / (self.velocity * self.duration)

    @property
    def depth(self) -> float:
        """Largest penetration of that spring, m."""
        return self.force / self.stiffness

    @property
    def damping(self) -> float:
        """Damping with a tenth of what is critical, N s/m."""
        return 0.2 * self.stiffness * self.duration / np.pi


@dataclass(frozen=True)
class Candidate:
    """A law to try: how it is made from numbers, and their first values."""

    make: Callable[..., AbstractContactLaw]
    guess: dict[str, float]


def impact_of(histories: Sequence[MeasuredHistory]) -> Impact:
    """Read off size, length and velocity of the impacts. Raises `ValueError` without a force."""
    forces, durations, velocities = [], [], []
    for history in histories:
        part = history.windowed()
        if part.contact_force is None:
            raise ValueError(
                f"measured: {history.label or 'a history'} has no contact_force, by which laws are "
                "compared."
            )
        there = np.isfinite(part.contact_force)
        off = first_value(history, "contact_force_offset")
        force = np.abs(part.contact_force[there] - off) / abs(
            first_value(history, "contact_force_gain")
        )
        touching = force > TOUCHING * force.max()
        time = part.time[there]
        forces.append(force.max())
        durations.append(np.sum(np.diff(time) * touching[1:]))
        velocities.append(abs(first_value(history, "initial_velocity")))
    found = [float(np.median(values)) for values in (forces, durations, velocities)]
    return Impact(found[0], found[1], found[2] or 1.0)


def known_laws(impact: Impact) -> dict[str, Candidate]:
    """Return the laws that are tried unless others are asked for."""
    k, c = impact.stiffness, impact.damping
    curved = k / np.sqrt(impact.depth)

    def no_tension(stiffness, damping):
        return KelvinVoigt(stiffness, damping, tension=False)

    return {
        "kelvin_voigt": Candidate(KelvinVoigt, {"stiffness": k, "damping": c}),
        "no_tension": Candidate(no_tension, {"stiffness": k, "damping": c}),
        "hunt_crossley": Candidate(
            HuntCrossley, {"stiffness": curved, "dissipation": 0.2 / impact.velocity}
        ),
        "hertz": Candidate(Hertz, {"stiffness": curved}),
        "standard_linear_solid": Candidate(
            StandardLinearSolid,
            {
                "stiffness": k,
                "maxwell_stiffness": 0.3 * k,
                "relaxation_time": impact.duration / np.pi,
            },
        ),
    }


def candidates_of(given: Any, impact: Impact) -> dict[str, Candidate]:
    """Return the laws to compare by name. Raises `ValueError` for what is none."""
    known = known_laws(impact)
    if given is None:
        return known
    if not isinstance(given, Mapping):
        try:
            given = dict.fromkeys([given] if isinstance(given, str) else given)
        except TypeError:
            raise ValueError(
                f"laws must be names of {', '.join(known)}, or a dict from names to laws, got "
                f"{in_short(given)}."
            ) from None
    found = {}
    for name, one in given.items():
        if one is None:
            if name not in known:
                raise ValueError(f"laws: there is no law {name!r}. {nearest(str(name), known)}")
            found[name] = known[name]
            continue
        try:
            make, guess = one
            found[name] = Candidate(make, {n: float(v) for n, v in guess.items()})
        except (TypeError, ValueError, AttributeError):
            raise ValueError(
                f"laws: {name} must be a function that makes a law and a dict of first values, "
                f"(function, dict(stiffness=100.0)), got {in_short(one)}."
            ) from None
        if not callable(make):
            raise ValueError(f"laws: {name} must be made by a function, got {in_short(make)}.")
    if len(found) < 2:
        raise ValueError(f"laws must be at least two to compare, got {list(found)}.")
    return found
