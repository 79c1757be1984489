"""Waveforms at the five frequencies of fig. 5, settled, and the regime of each."""

from dataclasses import replace

import jax
import numpy as np
from pendulum import FREQUENCIES, MARCHED, PRINTED, STEPS, full_starts, modal, modal_starts

import vibrojax as vj

SHOWN = 15
"""Drive periods drawn."""


def run(
    starts: int = 3, settled: int = 120, lyapunov: bool = True
) -> tuple[vj.history.Histories, dict]:
    """Return a history at each frequency, and the regimes from several starts."""
    states = full_starts(starts, seed=2)
    histories = vj.simulate(
        vj.default_pendulum(),
        frequency=FREQUENCIES,
        periods=settled + SHOWN,
        samples_per_period=100,
        initial_states=[(states[0, :17], states[0, 17:])],
        stepper=vj.LinearlyImplicit(steps_per_period=STEPS),
    )
    jax.block_until_ready(histories.lanes.time)
    periods = 100 if lyapunov else 40
    settings = replace(MARCHED, periods=periods, lyapunov=lyapunov)
    common = {"frequency": FREQUENCIES, "settings": settings, "progress": False}
    found = {
        "links": vj.regimes(vj.default_pendulum(), starts=states, **common),
        "modes": vj.regimes(modal(), starts=modal_starts(starts, seed=2), **common),
    }
    return histories, {"printed": list(PRINTED.values())} | {
        name: table(regimes) for name, regimes in found.items()
    }


def table(found: vj.regime.Regimes) -> dict:
    """Period, kind, exponent and bending at every frequency, from every start."""
    return {
        "frequency_Hz": np.asarray(found.frequencies).tolist(),
        "period": found.period.T.tolist(),
        "regime": [[vj.Regime(int(k)).word for k in row] for row in found.regime.T],
        "lyapunov_per_s": found.lyapunov_exponent.T.tolist(),
        "standard_error_per_s": found.lyapunov_standard_error.T.tolist(),
        "cross_well": found["cross_well"].T.tolist(),
        "chord_reduction_max_m": found["chord_reduction_max"].T.tolist(),
        "strain_power_rms_W": found["strain_power_rms"].T.tolist(),
    }
