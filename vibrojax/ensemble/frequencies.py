"""The drive frequencies of a study, and in which directions they are passed."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import ArrayLike

from vibrojax._tools.checks import check_frequencies, concrete
from vibrojax.model.systems import AbstractSystem

DIRECTIONS: dict[str, tuple[str, ...]] = {
    "both": ("forward", "backward"),
    "forward": ("forward",),
    "backward": ("backward",),
}


def frequency_axis(
    ratio: ArrayLike | Sequence[float] | None, frequency: ArrayLike | Sequence[float] | None
) -> tuple[str, np.ndarray]:
    """Return the name of the frequency axis that was given and its values.

    Raises `ValueError` unless one of the two is given and increases.
    """
    if (ratio is None) == (frequency is None):
        raise ValueError("Give frequency_ratio or frequency, one of the two.")
    advice = "Sort it; the backward sweep is made for you."
    if ratio is not None:
        return "frequency_ratio", check_frequencies("frequency_ratio", ratio, "(ratio)", advice)
    return "frequency", check_frequencies("frequency", frequency, "Hz", advice)


def check_drive(system: AbstractSystem) -> None:
    """Refuse, with a `ValueError`, a system that nothing drives."""
    reference, unit = system.drive.reference
    size = concrete(reference)
    if unit == "m" or (size is not None and not (size > 0).all()):
        raise ValueError(
            "A frequency sweep needs a drive with an amplitude above 0, got "
            f"{system.drive!r}. Give the system drive=BaseMotion(...) or PointForce(...)."
        )
