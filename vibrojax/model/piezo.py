"""Piezoelectric layers on a beam, and what a base-excited harvester does without stops.

Source: Erturk and Inman 2009, Smart Materials and Structures 18, 025009 (bimorph, series and
parallel connection of the layers).
"""

import equinox as eqx
from jaxtyping import Array, Float

from vibrojax._tools.checks import check_choice, check_positive, check_range, number_field
from vibrojax._tools.described import described
from vibrojax._tools.signatures import validated
from vibrojax.model.beam import Cantilever

Number = float | Float[Array, "..."]


@validated
class PiezoLayers(eqx.Module):
    """What the layers between two places of a beam are to a circuit.

    A voltage v bends the beam by a moment `moment_per_volt` v at both ends of the layers; the
    charge that flows is as much per slope between them.

    Raises `ValueError` for a capacitance that is not above 0, or places out of order.
    """

    moment_per_volt: Number = number_field("N m/V")
    """Electromechanical coupling, N m/V or C; its sign decides that of the voltage only."""
    capacitance: Number = number_field("F")
    """Capacitance between the electrodes, F."""
    start: Number = number_field(default=0.0)
    """Where the electrodes begin, x/L."""
    end: Number = number_field(default=1.0)
    """Where they end, x/L."""

    def __check_init__(self) -> None:
        """Refuse concrete values that are no layers."""
        check_range("moment_per_volt", self.moment_per_volt, allowed="a finite number (N m/V)")
        check_positive("capacitance", self.capacitance, "F")
        for name in ("start", "end"):
            check_range(name, getattr(self, name), 0.0, 1.0, allowed="from 0 (root) to 1 (tip)")
        ends = self.start, self.end
        if all(isinstance(end, float | int) for end in ends) and not ends[0] < ends[1]:
            raise ValueError(f"end must be beyond start = {ends[0]!r}, got {ends[1]!r}.")

    def __repr__(self) -> str:
        return described(self)


@validated(traceable=True)
def bimorph(
    *,
    length: Number,
    width: Number,
    substrate_thickness: Number,
    layer_thickness: Number,
    substrate_modulus: Number,
    layer_modulus: Number,
    substrate_density: Number,
    layer_density: Number,
    piezoelectric_constant: Number,
    permittivity: Number,
    connection: str = "series",
    mass_ratio: Number = 0.0,
) -> tuple[Cantilever, PiezoLayers]:
    """Return the beam and the layers of a symmetric bimorph with electrodes along all of it.

        beam, layers = vj.model.bimorph(length=50.8e-3, width=31.8e-3, ...)

    The beam is the one of equal bending stiffness, mass and thickness. Source: Erturk and Inman
    2009, series and parallel connection.

    Parameters:
        length: m.
        width: m.
        substrate_thickness: of the layer in the middle, m.
        layer_thickness: of each piezoelectric layer, m.
        substrate_modulus: Young's modulus of the middle, Pa.
        layer_modulus: of the piezoelectric layers at constant electric field (c11), Pa.
        substrate_density: kg/m3.
        layer_density: kg/m3.
        piezoelectric_constant: effective stress constant e31 of the layers, C/m2 (negative).
        permittivity: of the layers at constant strain (eps33), F/m.
        connection: `series` or `parallel` connection of the two layers.
        mass_ratio: tip mass over that of the beam.

    Raises `ValueError` for numbers that are no bimorph.
    """
    check_choice("connection", connection, ("series", "parallel"))
    for name, value, unit in (
        ("length", length, "m"),
        ("width", width, "m"),
        ("substrate_thickness", substrate_thickness, "m"),
        ("layer_thickness", layer_thickness, "m"),
        ("substrate_modulus", substrate_modulus, "Pa"),
        ("layer_modulus", layer_modulus, "Pa"),
        ("substrate_density", substrate_density, "kg/m3"),
        ("layer_density", layer_density, "kg/m3"),
        ("permittivity", permittivity, "F/m"),
    ):
        check_positive(name, value, unit)
    check_range("piezoelectric_constant", piezoelectric_constant, allowed="a finite number (C/m2)")
    half, whole = substrate_thickness / 2, substrate_thickness + 2 * layer_thickness
    outer = (half + layer_thickness) ** 3 - half**3
    bending = 2 * width / 3 * (substrate_modulus * half**3 + layer_modulus * outer)
    line_mass = width * (
        substrate_density * substrate_thickness + 2 * layer_density * layer_thickness
    )
    beam = Cantilever(
        length=length,
        width=width,
        thickness=whole,
        youngs_modulus=12 * bending / (width * whole**3),
        density=line_mass / (width * whole),
        mass_ratio=mass_ratio,
    )
    arm = (layer_thickness + substrate_thickness) / 2
    moment = -piezoelectric_constant * width * arm
    one_layer = permittivity * width * length / layer_thickness
    if connection == "series":
        return beam, PiezoLayers(moment, one_layer / 2)
    return beam, PiezoLayers(2 * moment, 2 * one_layer)
