"""Three design problems: rig, what is sought, bounds, constraints, range of the frequency."""

from collections.abc import Callable
from typing import Any, NamedTuple

import vibrojax as vj


class Problem(NamedTuple):
    """A design problem, as `vj.optimise` takes it."""

    title: str
    make_system: Callable[..., Any]
    objective: Callable[[Any], Any]
    maximise: bool
    unit: str
    variables: dict[str, tuple[float, float]]
    constraint: Callable[[Any], Any] | None
    most: float
    """Largest value of the constrained function."""
    frequency: dict[str, vj.Range]
    map_axes: tuple[str, str]
    """The two variables over which a map is made around the optimum."""


MOST_FORCE = 2.0
"""N, at the stop of the tapered beam."""


def tapered(gap, position, stiffness, taper, mass_ratio) -> vj.ImpactingBeam:
    """The default rig of Gandhi and Vyas 2017, two modes."""
    return vj.default_rig(
        gap=gap,
        position=position,
        stiffness=stiffness,
        taper=taper,
        mass_ratio=mass_ratio,
        num_modes=2,
    )


def half_power_band(response) -> Any:
    return response.half_power_bandwidth()


def contact_force(response) -> Any:
    return response.peak("contact_force")


DRIVE, LARGEST = 10.0, 5e-3
"""Amplitude of the force on the beam of Ledezma-Ramirez et al., N, and of the tip that is allowed,
m."""


def soft_support(gap, stiffness, damping) -> vj.ImpactingBeam:
    """The cantilever of Ledezma-Ramirez et al. over a soft support at its tip, two modes."""
    beam = vj.Cantilever(
        length=0.40, width=0.038, thickness=0.003, youngs_modulus=70e9, density=2700.0
    )
    stop = vj.Stop(position=1.0, gap=gap, law=vj.KelvinVoigt(stiffness, damping), side=-1)
    drive = vj.PointForce(DRIVE, 0.07 / 0.40)
    return vj.ImpactingBeam(beam, stop, drive=drive, damping_ratio=0.01, num_modes=2)


def tip_amplitude(response) -> Any:
    """Half the way of the tip from end to end, mm."""
    return 1e3 * DRIVE * response.peak("amplitude_ratio")


BAND = 40.0, 60.0
"""Hz, of the harvester."""


def harvester(gap, stiffness, resistance) -> vj.Harvester:
    """The bimorph of Erturk and Inman 2009 with a tip mass of 12 g and a stop at the tip."""
    beam, layers = vj.model.bimorph(
        length=50.8e-3,
        width=31.8e-3,
        substrate_thickness=0.14e-3,
        layer_thickness=0.26e-3,
        substrate_modulus=105e9,
        layer_modulus=66e9,
        substrate_density=9000.0,
        layer_density=7800.0,
        piezoelectric_constant=-12.54,
        permittivity=1500 * 8.854e-12,
        connection="series",
        mass_ratio=0.012 / ((9000.0 * 0.14e-3 + 2 * 7800.0 * 0.26e-3) * 31.8e-3 * 50.8e-3),
    )
    stop = vj.Stop(1.0, gap, vj.KelvinVoigt(stiffness, 0.5))
    rig = vj.ImpactingBeam(beam, (stop,), vj.BaseMotion(50e-6), damping_ratio=0.027, num_modes=2)
    return vj.Harvester(rig, layers, resistance=resistance, report="power")


def mean_power(response) -> Any:
    """Mean power over the band, mW."""
    return 1e3 * response.mean("mean_power")


PROBLEMS = {
    "band": Problem(
        title="Widest half-power band of the tapered beam at 2 N",
        make_system=tapered,
        objective=half_power_band,
        maximise=True,
        unit="frequency ratio",
        variables={
            "gap": (1e-4, 1e-3),
            "position": (0.3, 0.9),
            "stiffness": (500.0, 2e4),
            "taper": (0.0, 0.9),
            "mass_ratio": (0.1, 2.0),
        },
        constraint=contact_force,
        most=MOST_FORCE,
        frequency={"frequency_ratio": vj.Range(0.95, 1.4)},
        map_axes=("gap", "stiffness"),
    ),
    "quiet": Problem(
        title="Least contact force of the soft support, tip within 5 mm",
        make_system=soft_support,
        objective=contact_force,
        maximise=False,
        unit="N",
        variables={"gap": (5e-4, 8e-3), "stiffness": (100.0, 5e3), "damping": (0.5, 20.0)},
        constraint=tip_amplitude,
        most=1e3 * LARGEST,
        frequency={"frequency": vj.Range(12.0, 22.0)},
        map_axes=("gap", "stiffness"),
    ),
    "power": Problem(
        title="Mean power of the harvester over 40 to 60 Hz",
        make_system=harvester,
        objective=mean_power,
        maximise=True,
        unit="mW",
        variables={"gap": (5e-5, 1e-3), "stiffness": (100.0, 2e4), "resistance": (1e4, 1e6)},
        constraint=None,
        most=0.0,
        frequency={"frequency": vj.Range(*BAND)},
        map_axes=("gap", "resistance"),
    ),
}
