"""The drive frequencies of a study, and in which directions they are passed."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_frequencies, concrete
from vibrojax.model.equations import AbstractEquations
from vibrojax.model.systems import AbstractSystem

DIRECTIONS: dict[str, tuple[str, ...]] = {
    "both": ("forward", "backward"),
    "forward": ("forward",),
    "backward": ("backward",),
}


SORTED = "Sort it; a study that goes downwards too takes the same values backwards itself."


def frequency_axis(
    ratio: ArrayLike | Sequence[float] | None, frequency: ArrayLike | Sequence[float] | None
) -> tuple[str, np.ndarray]:
    """Return the name of the frequency axis that was given and its values.

    Raises `ValueError` unless one of the two is given and increases.
    """
    if (ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    if ratio is not None:
        return "frequency_ratio", check_frequencies("frequency_ratio", ratio, "(ratio)", SORTED)
    return "frequency", check_frequencies("frequency", frequency, "Hz", SORTED)


def check_drive(system: AbstractSystem, needing: str = "This study needs") -> None:
    """Refuse, with a `ValueError` that begins with who needs one, a system that nothing drives."""
    reference, unit = system.drive.reference
    size = concrete(reference)
    if unit == "m" or (size is not None and not (size > 0).all()):
        raise ValueError(
            f"{needing} a drive with an amplitude above 0, got {system.drive!r}. "
            "Give the system drive=BaseMotion(...) or PointForce(...)."
        )


def check_axis(equations: AbstractEquations, axis: str) -> None:
    """Refuse, with a `ValueError`, ratios to a natural frequency that a system does not have."""
    if axis == "frequency_ratio" and equations.linear_between_contacts is None:
        raise ValueError("This system has no natural frequency: give frequency in Hz.")
