"""Rigs to start from."""

from jaxtyping import Array, Float

from vibrojax._tools.checks import check_not_negative
from vibrojax._tools.signatures import validated
from vibrojax.model.beam import Cantilever
from vibrojax.model.drives import BaseMotion
from vibrojax.model.impacting_beam import ImpactingBeam
from vibrojax.model.laws import KelvinVoigt
from vibrojax.model.stops import Stop

Number = float | Float[Array, "..."]


@validated(traceable=True)
def default_rig(
    *,
    taper: Number = 0.5,
    mass_ratio: Number = 0.5,
    gap: Number = 0.4e-3,
    position: Number = 0.5,
    stiffness: Number = 5500.0,
    damping: Number = 5e-5,
    damping_ratio: Number = 0.018,
    base_amplitude: Number = 0.2e-3,
    length: Number = 0.2,
    width: Number = 0.025,
    thickness: Number = 1e-3,
    youngs_modulus: Number = 130e9,
    density: Number = 8250.0,
    num_modes: int = 5,
    formulation: str = "consistent",
) -> ImpactingBeam:
    """Make the default rig: a tapered cantilever on a shaker that hits one stop.

    Any number can be changed by name, swept (`vj.frequency_sweep(vj.default_rig, gap=[...], ...)`)
    or fitted. Raises `ValueError` for numbers that are no rig.

    PRINTED in Gandhi and Vyas 2017: stiffness, damping, damping_ratio, base_amplitude and
    num_modes; taper and mass_ratio are one case of each of its figures 7 to 10.
    ASSUMED here: length, width, thickness, youngs_modulus and density, because Table 1 of the
    paper is missing from its text, and with them gap and position: one caption has a gap of 4 mm
    at mid-span, which the assumed beam never reaches (1.9 mm). So its frequencies in Hz are not
    the paper's; ratios of frequency and amplitude can be compared.

    Parameters:
        taper: the width at the tip is width (1 - taper).
        mass_ratio: tip mass over density * root area * length.
        gap: clearance between the beam at rest and the stop, m.
        position: place of the stop, x/length.
        stiffness: of the stop, N/m.
        damping: of the stop, N s/m.
        damping_ratio: of every mode, fraction of critical.
        base_amplitude: amplitude of the base, m.
        length: of the beam, m.
        width: at the root, m.
        thickness: in the direction of motion, m.
        youngs_modulus: Pa.
        density: kg/m3.
        num_modes: modes kept.
        formulation: `consistent`, or `as_printed` to replicate the paper.
    """
    check_not_negative("base_amplitude", base_amplitude, "m")
    beam = Cantilever(
        length=length,
        width=width,
        thickness=thickness,
        youngs_modulus=youngs_modulus,
        density=density,
        taper=taper,
        mass_ratio=mass_ratio,
    )
    return ImpactingBeam(
        beam=beam,
        stops=(Stop(position=position, gap=gap, law=KelvinVoigt(stiffness, damping)),),
        drive=BaseMotion(amplitude=base_amplitude),
        damping_ratio=damping_ratio,
        num_modes=num_modes,
        formulation=formulation,
    )
