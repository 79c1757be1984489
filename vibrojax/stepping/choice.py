"""Which method suits a system."""

import equinox as eqx

from vibrojax.model.equations import AbstractEquations
from vibrojax.model.stops import Stop
from vibrojax.model.systems import AbstractSystem
from vibrojax.stepping.contact_phases import MAX_STOPS, ContactPhases, contact_phases
from vibrojax.stepping.linearly_implicit import LinearlyImplicit
from vibrojax.stepping.method import AbstractMethod, ExactContact, ExponentialSplitting


def _stops(system: AbstractSystem) -> tuple[Stop, ...]:
    """Stops of a system, with their numbers concrete where the system holds them itself."""
    own = getattr(system, "stops", None)
    return own if own is not None else _shapes(system).stops


def _shapes(system: AbstractSystem) -> AbstractEquations:
    """Equations without their numbers."""
    return eqx.filter_eval_shape(system.equations)


def is_exact(system: AbstractSystem) -> bool:
    """Return whether flight and contact of the system can be propagated exactly."""
    linear = _shapes(system).linear_between_contacts
    if linear is None or linear.stiffness_sign is not None:
        # What falls away ends at rest on its stops, where landings come too thick.
        return False
    stops = _stops(system)
    return all(stop.is_linear for stop in stops) and len(stops) <= MAX_STOPS


def choose_method(
    system: AbstractSystem,
    method: AbstractMethod | None,
    tolerance: float,
    steps_per_period: int | None,
) -> AbstractMethod:
    """Return the method asked for, or the one that suits the stops of the system.

    Raises `ValueError` when the method asked for is none, or cannot do the stops or the damping.
    """
    if method is not None and not isinstance(method, AbstractMethod):
        raise ValueError(
            "method must be ExactContact(), ExponentialSplitting() or LinearlyImplicit(), with its "
            f"settings, got {method!r}. Leave it out to have it chosen."
        )
    exact = is_exact(system)
    if isinstance(method, ExactContact) and not exact:
        raise ValueError(
            f"ExactContact needs at most {MAX_STOPS} stops that are linear in contact, with no "
            "smoothing, on a system that is linear but for them, without modes that fall away. Use "
            "ExponentialSplitting() or LinearlyImplicit(), or leave the method to vibrojax."
        )
    if isinstance(method, LinearlyImplicit):
        method.check_system(system)
    if method is not None:
        return method
    if exact:
        return ExactContact(tolerance, steps_per_period)
    linear = _shapes(system).linear_between_contacts
    modal = linear is not None and linear.damping_coupling is None
    # Modes that the damping couples have no exact drift of their own.
    return (ExponentialSplitting if modal else LinearlyImplicit)(tolerance, steps_per_period)


_contact_phases = eqx.filter_jit(contact_phases)


def prepare_motion(system: AbstractSystem, equations: AbstractEquations) -> ContactPhases | None:
    """Compute the phases of `ExactContact` where that method suits the system."""
    if equations.linear_between_contacts is not None and is_exact(system):
        return _contact_phases(equations.linear_between_contacts)
    return None
