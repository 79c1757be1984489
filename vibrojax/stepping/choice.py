"""Which stepper suits a system."""

import equinox as eqx

from vibrojax.model.equations import AbstractEquations
from vibrojax.model.stops import Stop
from vibrojax.model.systems import AbstractSystem, equation_kinds
from vibrojax.stepping.contact_phases import MAX_STOPS, ContactPhases, phases_of
from vibrojax.stepping.linearly_implicit import LinearlyImplicit
from vibrojax.stepping.stepper import AbstractStepper, ExactContact, ExponentialSplitting


def _stops(system: AbstractSystem) -> tuple[Stop, ...]:
    """Stops of a system, with their numbers concrete where the system holds them itself."""
    own = getattr(system, "stops", None)
    return own if own is not None else eqx.filter_eval_shape(system.equations).stops


def is_exact(system: AbstractSystem) -> bool:
    """Return whether flight and contact of the system can be propagated exactly."""
    linear = equation_kinds(system).linear_between_contacts
    if linear is None or (linear.stiffness_sign is not None and not linear.free):
        # What falls away ends at rest on its stops, where landings come too thick.
        return False
    stops = _stops(system)
    return all(stop.is_linear for stop in stops) and len(stops) <= MAX_STOPS


def choose_stepper(
    system: AbstractSystem,
    stepper: AbstractStepper | None,
    tolerance: float,
    steps_per_period: int | None,
    lowest: tuple[str, float] | None = None,
) -> AbstractStepper:
    """Return the stepper asked for, or the one that suits the stops of the system.

    `lowest` is the lowest frequency of a study and its name. Raises `ValueError` when the stepper
    asked for cannot do the stops or, there, the damping.
    """
    exact = is_exact(system)
    if isinstance(stepper, ExactContact) and not exact:
        raise ValueError(
            f"ExactContact needs at most {MAX_STOPS} stops that are linear in contact, with no "
            "smoothing, on a system that is linear but for them, without modes that fall away. Use "
            "ExponentialSplitting() or LinearlyImplicit(), or leave the stepper to vibrojax."
        )
    if stepper is None and exact:
        return ExactContact(tolerance, steps_per_period)
    if stepper is None:
        linear = equation_kinds(system).linear_between_contacts
        modal = linear is not None and linear.is_modal
        # Modes that are coupled have no exact drift of their own.
        suits = ExponentialSplitting if modal else LinearlyImplicit
        stepper = suits(tolerance, steps_per_period)
    if isinstance(stepper, LinearlyImplicit):
        stepper.check_system(system, lowest)
    return stepper


def prepare_motion(system: AbstractSystem, equations: AbstractEquations) -> ContactPhases | None:
    """Compute the phases of `ExactContact` where that stepper suits the system."""
    if equations.linear_between_contacts is not None and is_exact(system):
        return phases_of(equations.linear_between_contacts)
    return None
