"""Basins over bearing angle and rate of the straight pendulum at drive phase 0, modal model."""

import time

import numpy as np
from pendulum import COARSER, LINKS, modal

import vibrojax as vj

UNITS = {"angle": "rad", "rate": "rad/s"}


def run(
    frequency: float, count: int, transient: int = 150, **numbers
) -> tuple[vj.regime.Basins, dict]:
    """Return the basins on a grid of count by count starts."""
    system = modal(**numbers)
    straight = np.asarray(system.modal_coordinates(np.ones(LINKS)))

    def start(angle, rate):
        return angle * straight, rate * straight

    begun, worked = time.perf_counter(), time.process_time()
    found = vj.basins(
        system,
        frequency=frequency,
        start=start,
        angle=np.linspace(-0.14, 0.14, count),
        rate=np.linspace(-4.0, 4.0, count),
        units=UNITS,
        progress=False,
        settings=vj.BasinSettings(
            transient=transient,
            periods=24,
            max_period=12,
            period_tolerance=0.02,
            distinguish_phases=True,
            stepper=COARSER,
        ),
    )
    seconds, processor = time.perf_counter() - begun, time.process_time() - worked
    attractors = [
        {
            "name": found.name_of(k + 1),
            "period": int(found.period[k]),
            "cross_well": bool(found.cross_well[k]),
            "share": float(found.share[k]),
            "standard_error": float(found.standard_error[k]),
            "mean_displacement_m": float(found.mean_displacement[k]),
            "strain_power_rms_W": float(found.strain_power_rms[k]),
        }
        for k in range(found.period.shape[-1])
        if found.share[k] > 0
    ]
    by_period: dict[str, float] = {}
    for one in attractors:
        name = f"period {one['period']}" if one["period"] else "no period"
        by_period[name] = by_period.get(name, 0.0) + one["share"]
    return found, {
        "frequency_Hz": frequency,
        "starts": found.count,
        "numbers": numbers,
        "attractors": attractors,
        "share_by_period": by_period,
        "boundary_share": float(found.boundary_share),
        "diverged_share": float(found.diverged_share),
        "mean_periods_marched": float(found.periods_marched.mean()),
        "seconds": seconds,
        "processor_s": processor,
    }
