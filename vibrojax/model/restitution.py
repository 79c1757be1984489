"""Stops by their coefficient of restitution: the exact relations, solved for what a law needs.

All is elementwise, and for a free mass: nothing else acts on it while it touches the stop.
"""

from collections.abc import Callable
from math import factorial

import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_range

Values = Float[Array, "..."]

_TERMS = 20
"""Of series where closed forms lose their digits: the last is below round-off there."""
_ORDERS = range(_TERMS - 1, -1, -1)
_BOTH = np.array([1 / factorial(n + 2) for n in _ORDERS])
_LEFT = np.array([(n + 1) / factorial(n + 2) for n in _ORDERS])
_ONE = np.array([1 / factorial(n + 1) for n in _ORDERS])


def check_restitution(restitution: object) -> None:
    """Raise `ValueError` unless a mass comes back from the stop, with no more than it came with."""
    allowed = "above 0 and at most 1 (no loss)"
    check_range("restitution", restitution, 0.0, 1.0, include_low=False, allowed=allowed)


def damping_ratio_of(restitution: ArrayLike, tension: bool) -> Values:
    """Return the damping ratio z = c/(2 sqrt(k m)) of a Kelvin-Voigt stop of this restitution e.

    A stop that pulls lets go where the depth is zero again: -ln e = pi z/sqrt(1 - z^2). One that
    does not lets go where the force is zero: -ln e = 2 z arccos(z)/sqrt(1 - z^2), and beyond
    critical damping 2 z arcosh(z)/sqrt(z^2 - 1). Source: Nagurka and Huang 2004; Schwager and
    Poeschel 2007, whose pi - arctan(...) of half periods is 2 arccos(z).
    """
    loss = -jnp.log(jnp.asarray(restitution, float))
    if tension:
        return loss / jnp.sqrt(jnp.pi**2 + loss**2)
    # As a function of z the loss is concave and at least 2 ln(2 z): Newton comes from the left.
    start = jnp.where(loss < 2, loss / jnp.pi, jnp.exp(loss / 2) / 2)
    return _inverse(lambda z: 2 * z * _arc(z), loss, start)


def approach_of(restitution: ArrayLike) -> Values:
    """Return a = 3/2 dissipation times speed of a Hunt-Crossley stop of this restitution e.

    It is the root of a - ln(1 + a) = -e a - ln(1 - e a). In t = ln((1 + a)/(1 - e a)) both are
    explicit, a = (t - 1 + exp(-t))/(1 - exp(-t)) and 1/e = (t - 1 + exp(-t))/(1 - (1 + t)
    exp(-t)). Source: Hunt and Crossley 1975, eqs. 10 to 13.
    """
    wanted = 1 / jnp.asarray(restitution, float)
    # 1/e is convex, and above both 1 + t/3 and t - 1: Newton comes down from the right.
    start = jnp.minimum(3 * (wanted - 1), wanted + 1)
    return _approach(_inverse(lambda t: _approach(t)[1], wanted, start))[0]


def _approach(t: Values) -> tuple[Values, Values]:
    """Speed of approach a, and 1/e, by the parameter t of `approach_of`."""
    near = t < 1
    small, large = jnp.where(near, t, 0.0), jnp.where(near, 1.0, t)
    both, left, one = (jnp.polyval(c, -small) for c in (_BOTH, _LEFT, _ONE))
    decay = jnp.exp(-large)
    kept = large - 1 + decay
    a = jnp.where(near, small * both / one, kept / (1 - decay))
    return a, jnp.where(near, both / left, kept / (1 - (1 + large) * decay))


def _arc(z: Values) -> Values:
    """Return arccos(z)/sqrt(1 - z^2), which is arcosh(z)/sqrt(z^2 - 1) beyond 1: no corner at 1."""
    near, below = jnp.abs(z - 1) < 0.05, z < 1
    low, high = jnp.where(below & ~near, z, 0.5), jnp.where(below | near, 2.0, z)
    small = jnp.where(near, (1 - z) / 2, 0.0)
    term, series = jnp.ones_like(z), jnp.zeros_like(z)
    for n in range(_TERMS):  # the hypergeometric function 2F1(1, 1; 3/2; small)
        series, term = series + term, term * small * (n + 1) / (n + 1.5)
    damped = jnp.arccos(low) / jnp.sqrt(1 - low**2)
    closed = jnp.where(below, damped, jnp.arccosh(high) / jnp.sqrt(high**2 - 1))
    return jnp.where(near, series, closed)


def _inverse(function: Callable[[Values], Values], wanted: Values, start: Values) -> Values:
    """Return where a function of one number has the wanted values; derivatives are implicit."""
    newton = optx.Newton(rtol=1e-13, atol=1e-14)

    def one(wanted, start):
        found = optx.root_find(
            lambda x, y: function(x) - y, newton, start, args=wanted, max_steps=64, throw=False
        )
        return found.value

    return jnp.vectorize(one)(wanted, start)
