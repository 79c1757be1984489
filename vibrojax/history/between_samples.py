"""What happens between the samples of a history: contacts, energies and true peaks.

Exactly where the stops are linear in contact (`exact_cells`), else by the steps of
`ExponentialSplitting` taken again from every sample (`finer_steps`).
"""

from types import ModuleType

from vibrojax.history import exact_cells, finer_steps
from vibrojax.model.systems import Motion


def engine_of(motion: Motion) -> ModuleType:
    """Return what has the `cells` and the `largest` value of a motion.

    Raises `ValueError` for systems that are not linear but for their stops, and where stops are not
    linear in contact for modes that damping couples, free bodies, and forces that stay the same.
    """
    linear = motion.equations.linear_between_contacts
    if linear is None:
        raise ValueError(
            "The motion between samples is known of systems that are linear but for their stops "
            f"(ImpactingBeam, MatrixSystem), not of {type(motion.equations).__name__}."
        )
    if linear.stiffness_sign is not None and not linear.free:
        raise ValueError(
            "The motion between samples is not known of systems with modes that fall away from "
            "rest (LinearisedPendulum). Read contact_force and quantity(...) of a history with "
            "more samples_per_period."
        )
    if motion.prepared is not None:
        return exact_cells
    if not linear.is_modal:
        raise ValueError(
            "A stop is not linear in contact, and modes are coupled, a body is free or a force "
            "stays the same: for this the motion between samples is not known. Use KelvinVoigt "
            "stops without smoothing."
        )
    return finer_steps
