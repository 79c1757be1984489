"""Seconds of studies that stand on the engines of sweeps, when all is compiled.

    python benchmarks/studies.py                        every study; some ten minutes with compiling
    python benchmarks/studies.py basins "other laws"    some

Each is run once, and then twice more; the faster counts, in seconds of the processor.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

import vibrojax as vj

AXES: dict[str, Any] = {
    "gap": np.linspace(2e-4, 6e-4, 4),
    "stiffness": np.geomspace(2000.0, 20000.0, 4),
}
PENDULUM = vj.default_pendulum().linearised(6)


def other_law() -> vj.ImpactingBeam:
    """The default rig on a stop of Hunt and Crossley."""
    rig, law = vj.default_rig(), vj.HuntCrossley(stiffness=5e5, dissipation=0.2)
    stop = vj.Stop(0.5, 0.4e-3, law)
    return vj.ImpactingBeam(rig.beam, (stop,), drive=rig.drive, damping_ratio=0.018)


def gradients(response: str) -> Callable[[], object]:
    """A map with derivatives by both of its axes."""
    ratios = np.linspace(0.9, 1.3, 12)
    return lambda: vj.parameter_map(
        vj.default_rig,
        frequency_ratio=ratios,
        response=response,
        gradients=["gap", "stiffness"],
        progress=False,
        **AXES,
    )


def regimes_of(system: Any, settings: vj.RegimeSettings, **frequencies: Any) -> Callable[[], Any]:
    """Regimes over 64 frequencies, from rest."""
    return lambda: vj.regimes(system, settings=settings, progress=False, **frequencies)


def basins_of_the_rig() -> object:
    """Twenty by twenty starts in the first mode."""

    def start(displacement, speed):
        still = jnp.zeros(5)
        return still.at[0].set(displacement), still.at[0].set(speed)

    return vj.basins(
        vj.default_rig(),
        frequency_ratio=1.15,
        start=start,
        displacement=np.linspace(-1e-3, 1e-3, 20),
        speed=np.linspace(-0.06, 0.06, 20),
        settings=vj.BasinSettings(transient=50),
        progress=False,
    )


def basins_of_the_pendulum() -> object:
    """Twenty-four by twenty-four starts of the model in six modes, 400 steps a drive period."""
    straight = PENDULUM.modal_coordinates(np.ones(vj.default_pendulum().num_links))

    def start(angle, rate):
        return angle * straight, rate * straight

    stepper = vj.LinearlyImplicit(steps_per_period=400)
    return vj.basins(
        PENDULUM,
        frequency=5.7,
        start=start,
        angle=np.linspace(-0.2, 0.2, 24),
        rate=np.linspace(-5.0, 5.0, 24),
        settings=vj.BasinSettings(transient=20, stepper=stepper),
        progress=False,
    )


def sweep_of(settle: str) -> Callable[[], object]:
    """Both directions, 60 ratios, jumps refined."""
    settings, ratios = vj.SweepSettings(settle=settle), np.linspace(0.95, 1.3, 60)
    return lambda: vj.frequency_sweep(other_law(), frequency_ratio=ratios, settings=settings)


LONG = vj.RegimeSettings(transient=100, periods=100)
SHORT = vj.RegimeSettings(transient=40, periods=40, steps_per_period=400)
STUDIES: dict[str, Callable[[], Any]] = {
    "gradients, periodic": gradients("periodic"),
    "gradients, sweep": gradients("sweep"),
    "regimes": regimes_of(
        lambda gap: vj.default_rig(gap=gap),
        LONG,
        frequency_ratio=np.linspace(0.9, 1.6, 64),
        gap=[2e-4, 4e-4],
    ),
    "regimes, pendulum": regimes_of(PENDULUM, SHORT, frequency=np.linspace(3.0, 9.0, 64)),
    "basins": basins_of_the_rig,
    "basins, pendulum": basins_of_the_pendulum,
    "other laws": sweep_of("follow"),
    "other laws, marched": sweep_of("march"),
}


def main() -> None:
    for name, study in STUDIES.items():
        if len(sys.argv) > 1 and not any(name.startswith(asked) for asked in sys.argv[1:]):
            continue
        study()
        seconds = []
        for _ in range(2):
            begun = time.process_time()
            study()
            seconds.append(time.process_time() - begun)
        print(f"{name:24s} {min(seconds):7.2f} s", flush=True)


if __name__ == "__main__":
    main()
