"""What kinds of motion there are, as a number in the result and words for the reader."""

import enum

import numpy as np
from jaxtyping import Bool, Float, Int

QUIET = 4.0
"""Growth of a tangent over the whole window, as a power of e, that counts as none.

A motion on a torus has a bounded one, with a standard error of about as much."""
FAR = 10.0
"""Least return error of a quasi-periodic motion, in tolerances: nearer, a transient may last."""
CERTAIN = 3.0
"""Standard errors from which an exponent counts as different from zero."""


class Regime(enum.Enum):
    """The kind of motion of a lane."""

    periodic = 0
    """The motion returns after a whole number of drive periods."""
    quasi_periodic = 1
    """No period up to the largest one looked for, and neighbouring motions neither part nor meet:
    the largest Lyapunov exponent is zero within its error."""
    chaotic = 2
    """No period up to the largest one looked for, and neighbouring motions part: the largest
    Lyapunov exponent is above zero by more than three standard errors."""
    undecided = 3
    """Period and exponent do not fit together yet: a transient that is not over, a period longer
    than looked for, or a record too short. Give more transient, periods or max_period."""
    diverged = 4
    """The state stopped being finite, or an undamped motion grows without bound."""
    gave_up = 5
    """Contacts came too fast to be gone through: raise ExactContact(max_rounds=...)."""

    @property
    def word(self) -> str:
        """The kind as it stands in a legend."""
        return self.name.replace("_", "-")


def regime_of(
    period: Int[np.ndarray, "..."],
    growth: Float[np.ndarray, "..."],
    growth_error: Float[np.ndarray, "..."],
    return_error: Float[np.ndarray, "..."],
    tolerance: float,
    alive: Bool[np.ndarray, "..."],
) -> Int[np.ndarray, "..."]:
    """Return the kinds of motions, as the values of `Regime`.

    `growth` is the logarithm of the growth of a tangent over the whole window observed, the
    exponent times its length, with its standard error; NaN where it was not computed, and then
    motions without a period are undecided. `return_error` and `tolerance` are those of
    `period_number`.
    """
    known = np.isfinite(growth)
    total, error = np.where(known, growth, 0.0), np.where(known, growth_error, 0.0)
    parts = total > np.maximum(CERTAIN * error, QUIET)
    repeats = period > 0
    sure = known & (error <= QUIET)
    stays = sure & (np.abs(total) <= QUIET) & (return_error > FAR * tolerance)
    words = (Regime.diverged, Regime.periodic, Regime.chaotic, Regime.quasi_periodic)
    kind = np.select(
        [~alive, repeats & ~parts, ~repeats & parts, ~repeats & stays],
        [word.value for word in words],
        Regime.undecided.value,
    )
    return kind.astype(np.int32)
