"""One stop, integrated by scipy from touch to departure: independent of how vibrojax does it."""

import numpy as np
from scipy.integrate import solve_ivp


def integrate(rate, signal, start, end, inside=False):
    """Integrate rate(time, state, in_contact) until `end`; contact while signal(state) > 0.

    Returns the state there, the times at which contact changed, and the largest signal.
    """
    time, state, changes, largest = 0.0, np.asarray(start, float), [], 0.0
    while True:
        sign = -1.0 if inside else 1.0

        def crossing(t, x, sign=sign):
            return sign * signal(x)

        crossing.terminal, crossing.direction = True, 1.0
        found = solve_ivp(
            lambda t, x, inside=inside: rate(t, x, inside),
            (time, end),
            state,
            method="DOP853",
            rtol=1e-12,
            atol=1e-16,
            events=crossing,
            max_step=1e-3,
        )
        if inside:
            largest = max(largest, max(signal(x) for x in found.y.T))
        if found.status != 1:
            return found.y[:, -1], np.array(changes), largest
        time, state, inside = found.t[-1], found.y[:, -1], not inside
        changes.append(time)
