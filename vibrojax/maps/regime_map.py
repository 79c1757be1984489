"""Maps of regimes: which kind of motion there is, with the state carried along the frequency."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from vibrojax._tools.checks import check_known
from vibrojax.ensemble.frequencies import DIRECTIONS
from vibrojax.maps.responses import (
    MARCHED,
    STATUS,
    AbstractMapResponse,
    Computed,
    Grid,
    Layout,
    Points,
    worst_of,
)
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.model.systems import AbstractSystem, as_arrays
from vibrojax.regime.poincare_map import PoincareMap
from vibrojax.regime.regime_points import carried_points
from vibrojax.regime.settings import RegimeSettings
from vibrojax.results.variables import RESPONSE
from vibrojax.stepping.stepper import AbstractStepper

VARIABLES = (
    "period",
    "regime",
    "status",
    "return_error",
    "lyapunov_exponent",
    "lyapunov_standard_error",
    *RESPONSE,
    "cross_well",
    "crossings_per_period",
    "displacement_rms",
    "strain_energy_mean",
    "strain_energy_max",
    "strain_power_rms",
)
OFFERED = (
    "chaotic_fraction",
    "periodic_fraction",
    "largest_lyapunov_exponent",
    "largest_strain_power",
    "peak_amplitude_ratio",
    "peak_frequency",
    "largest_contact_force",
    "natural_frequency",
)


class RegimeMap(AbstractMapResponse):
    """Regimes with the motion carried along the frequencies, as `bifurcation_diagram` does it.

    Derivatives are those of the periodic motions; others have none (NaN). `lane_steps` is not
    counted (-1).
    """

    settings: RegimeSettings

    def march_stepper(self, sample: AbstractSystem, grid: Grid) -> AbstractStepper:
        """Return the stepper asked for, or the one that suits the system."""
        return self.settings.stepper_of(sample, grid.axis)

    def check(self, sample: AbstractSystem, grid: Grid) -> None:
        """Refuse a system that nothing drives, and observables that it has not."""
        self.march_stepper(sample, grid)
        equations = as_arrays(sample).equations()
        known = equations.observables(jnp.zeros(equations.size))
        for name in self.settings.observables:
            check_known("observable", name, known)

    @property
    def layout(self) -> Layout:
        """Kinds, periods, exponents, contacts, energies, the observables and strobes asked for."""
        settings = self.settings
        kept = ("displacement", "velocity") if settings.strobes else ()
        more = (f"{name}_{kind}" for name in settings.observables for kind in ("max", "rms"))
        return Layout(
            (*dict.fromkeys((*VARIABLES, *more, *kept)),),
            OFFERED,
            MARCHED,
            STATUS,
            "direction",
            DIRECTIONS[settings.direction],
            dict.fromkeys(kept, ("strobe", settings.periods)),
            24 + 2 * settings.periods,
        )

    def compute(self, maker: RigMaker, index: tuple[np.ndarray, ...], grid: Grid) -> Computed:
        """Carry the rigs of a block along the frequencies."""
        sample = maker.first_of(index)
        poincare = PoincareMap(self.march_stepper(sample, grid), maker.rigs(index))
        ways = DIRECTIONS[self.settings.direction]
        lanes, size = poincare.weight.shape
        rig = np.repeat(np.arange(lanes), len(ways))[:, None]
        found = carried_points(
            poincare,
            np.repeat(rig, len(grid.values), axis=1),
            poincare.angular_frequency(grid.axis, rig, grid.values) + 0 * rig,
            np.tile([way == "backward" for way in ways], lanes),
            np.zeros((len(rig), size)),
            dataclasses.replace(self.settings, spectrum=False),
        )
        shape = (lanes, len(ways), len(grid.values))
        found = {n: v.reshape(*shape, *v.shape[2:]) for n, v in found.items()}
        return Computed(
            curves={name: found[name] for name in self.layout.variables},
            numbers={"natural_frequency": poincare.natural_frequency},
            points=Points(found["state"], found["period"]),
            lane_status=worst_of(found["status"]),
            lane_steps=np.full(lanes, -1, np.int64),
        )
