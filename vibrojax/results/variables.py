"""Every output variable once: its unit and its long name."""

from typing import Any, NamedTuple


class Variable(NamedTuple):
    """Unit and long name of an output; a unit of `ratio` is that of a displacement per drive."""

    units: str
    long_name: str


VARIABLES = {
    "amplitude_ratio": Variable("ratio", "Half peak-to-peak displacement of the tip over drive"),
    "peak_ratio": Variable("ratio", "Largest displacement of the tip, either side, over drive"),
    "rms_ratio": Variable("ratio", "RMS displacement of the tip over drive amplitude"),
    "receptance": Variable("m/N", "RMS displacement of the tip over RMS force"),
    "first_harmonic_ratio": Variable("ratio", "First harmonic amplitude of the tip over drive"),
    "contact_force": Variable("N", "Largest contact force"),
    "contact_fraction": Variable("1", "Share of the time in contact"),
    "impulse": Variable("N s", "Impulse of all contacts in a drive period"),
    "contacts_per_period": Variable("1", "Contacts per drive period"),
    "gap_ratio": Variable("ratio", "Gap over drive amplitude"),
    "touch_gap_ratio": Variable("ratio", "Gap over drive amplitude at which the beam just touches"),
    "contact_free_amplitude_ratio": Variable("ratio", "Amplitude without contact over drive"),
    "valid": Variable("1", "Whether the motion exists"),
    "period": Variable("1", "Period of the motion in drive periods (0: none found)"),
    "voltage": Variable("V", "Half peak-to-peak voltage"),
    "current": Variable("A", "Current"),
    "mean_power": Variable("W", "Mean power in the load"),
    "peak_power": Variable("W", "Largest power in the load"),
    "displacement": Variable("m", "Displacement"),
    "velocity": Variable("m/s", "Velocity"),
    "strain_energy": Variable("J", "Strain energy"),
    "strain_power": Variable("W", "Rate of strain energy"),
    "bearing_angle": Variable("rad", "Angle at the bearing"),
    "drive_periods": Variable("1", "Length of the cycle in drive periods"),
    "drive_phase": Variable("rad", "Phase of the drive"),
    "attractor": Variable("1", "Attractor, from 1 (0: the start was lost)"),
    "share": Variable("1", "Share of the starts"),
    "standard_error": Variable("1", "Standard error of the share, random starts assumed"),
    "share_low": Variable("1", "Low end of the 95 % interval of the share"),
    "share_high": Variable("1", "High end of the 95 % interval of the share"),
    "second_displacement": Variable("m", "Displacement of the second body"),
    "mean_displacement": Variable("m", "Mean displacement"),
    "strain_power_rms": Variable("W", "RMS rate of strain energy"),
    "attractors": Variable("1", "Attractors found"),
    "periodic_share": Variable("1", "Share of the starts that become periodic"),
    "periodic_share_error": Variable("1", "Standard error of the share that becomes periodic"),
    "largest_share": Variable("1", "Share of the starts that the most attracting motion has"),
    "largest_share_error": Variable("1", "Standard error of the largest share"),
    "cross_well_share": Variable("1", "Share of the starts whose motion crosses the barrier"),
    "most_attractors": Variable("1", "Most attractors of the curve"),
    "least_periodic_share": Variable("1", "Least share of periodic starts of the curve"),
    "diverged_share": Variable("1", "Share of the starts that diverged"),
    "boundary_share": Variable("1", "Share of the cells at a boundary of basins"),
    "chord_reduction": Variable("m", "Chord reduction"),
    "regime": Variable("1", "Kind of motion"),
    "return_error": Variable("1", "Relative error of the return after the period"),
    "lyapunov_exponent": Variable("1/s", "Largest Lyapunov exponent"),
    "lyapunov_standard_error": Variable("1/s", "Standard error of the Lyapunov exponent"),
    "cross_well": Variable("1", "Whether the response visits both sides of the barrier"),
    "crossings_per_period": Variable("1", "Crossings of the barrier per drive period"),
    "spectrum": Variable("m", "Amplitude of the displacement"),
    "order": Variable("1", "Frequency over drive frequency"),
    "strobe": Variable("1", "Drive periods since the window began"),
    "start": Variable("1", "Number of the initial state"),
    "chaotic_fraction": Variable("1", "Share of the points that are chaotic"),
    "periodic_fraction": Variable("1", "Share of the points that are periodic"),
    "largest_lyapunov_exponent": Variable("1/s", "Largest Lyapunov exponent of the curve"),
    "largest_strain_power": Variable("W", "Largest RMS rate of strain energy of the curve"),
    "status": Variable("1", "How the lane ended"),
    "beta": Variable("1", "Frequency parameter beta"),
    "modal_mass": Variable("kg", "Modal mass"),
    "participation": Variable("1", "Participation of the motion of the base"),
    "shape": Variable("1", "Mode shape, mass-normalised"),
    "place": Variable("1", "Place along the beam x/length"),
    "mode": Variable("1", "Mode, from 1"),
    "coordinate": Variable("1", "Coordinate, from 1"),
    "attractor_number": Variable("1", "Attractor, from 1"),
    "direction": Variable("1", "Direction of the sweep"),
    "stop": Variable("1", "Stop, from 1"),
    "cycle": Variable("1", "Cycle, from 1"),
    "point": Variable("1", "Point, from 1"),
    "crossing": Variable("1", "Passage of the branch, from 0"),
    "initial_state": Variable("m, m/s", "Modal displacements, then velocities, at phase 0"),
    "start_state": Variable("m, m/s", "State from which the search marched"),
    "rate": Variable("1/s", "Rate at which neighbours part, by drive period"),
    "relative_difference": Variable("1", "Distance of the sweep from the branch"),
    "on_branch": Variable("1", "On the branch (1), not on it (0), not compared (-1)"),
    "relative_change": Variable("1", "Largest relative change when computed more finely"),
    "rigid_error": Variable("1", "Relative error against rigid stops"),
    "periods_marched": Variable("1", "Drive periods marched to settle"),
    "steps": Variable("1", "Steps taken to settle and measure"),
    "peak_amplitude_ratio": Variable("ratio", "Peak amplitude ratio"),
    "peak_frequency": Variable("axis", "Frequency of the peak"),
    "resonance_shift": Variable("1", "Frequency of the peak over the first natural one, less 1"),
    "largest_contact_force": Variable("N", "Largest contact force of the curve"),
    "hysteresis_width": Variable("axis", "Distance between the jumps"),
    "hysteresis_area": Variable("ratio axis", "Area between the curves of both directions"),
    "aperiodic_fraction": Variable("1", "Share of the points without a period"),
    "fold": Variable("axis", "Folds of the branch"),
    "grazing": Variable("axis", "First touches of the branch"),
    "lane_status": Variable("1", "How the worst point of the lane ended"),
    "lane_steps": Variable("1", "Steps taken for all points of the lane"),
    "jump_up": Variable("axis", "Frequency at which the response jumps up"),
    "jump_down": Variable("axis", "Frequency at which the response jumps down"),
    "leading_multiplier": Variable("1", "Largest modulus of the Floquet multipliers"),
    "floquet_multiplier_real": Variable("1", "Real part of the Floquet multipliers"),
    "floquet_multiplier_imaginary": Variable("1", "Imaginary part of the Floquet multipliers"),
    "stable": Variable("1", "Whether the motion is stable (1) or not (0)"),
    "exact_points": Variable("1", "Whether the point is exact (1) or harmonic balance (0)"),
    "minimal_period": Variable("1", "Drive periods after which the motion repeats first"),
    "guess_distance": Variable("1", "Distance of the motion from the guess, over its size"),
    "residual": Variable("1", "Relative residual of the motion"),
    "arclength": Variable("1", "Way along the branch"),
    "natural_frequency": Variable("Hz", "First natural frequency of the unstopped beam"),
    "frequency": Variable("Hz", "Drive frequency"),
    "frequency_ratio": Variable("1", "Drive frequency over first natural frequency"),
}

DIFFERENTIATED = (
    "amplitude_ratio",
    "peak_ratio",
    "rms_ratio",
    "first_harmonic_ratio",
    "contact_force",
    "contact_fraction",
)
"""What is measured of every response and has derivatives."""
RESPONSE = (*DIFFERENTIATED, "contacts_per_period")
"""What is measured of every response: swept, followed or solved for."""


def described_as(name: str, ratio_units: str = "1", axis_units: str = "axis") -> dict[str, str]:
    """Return unit and long name of a variable as the attributes that xarray shows."""
    units, long_name = VARIABLES[name]
    units = {"ratio": ratio_units, "axis": axis_units}.get(units, units)
    return {"units": units, "long_name": long_name}


PLAIN = ("1", "ratio", "axis", "")
"""Units of plain numbers, which are not shown."""


def with_unit(long_name: str, units: str) -> str:
    """Return a name with its unit, `Contact force (N)`; that of a plain number alone."""
    return long_name if units in PLAIN else f"{long_name} ({units})"


def label_of(name: str, ratio_units: str = "1") -> str:
    """Return the long name of a variable with its unit."""
    units, long_name = VARIABLES[name]
    return with_unit(long_name, ratio_units if units == "ratio" else units)


def axis_unit(axis: str) -> str:
    """Return the unit of a parameter; 1 for names that only the user's function knows."""
    return VARIABLES[axis].units if axis in VARIABLES else PARAMETER_UNITS.get(axis, "1")


def named_value(name: str, value: Any, units: str | None = None) -> str:
    """Return a number with its name and unit, as titles and legends show it."""
    unit = axis_unit(name) if units is None else units
    shown = f"{value:g}" if isinstance(value, int | float) else str(value)
    return f"{name} = {shown}" + (f" {unit}" if unit not in PLAIN else "")


def axis_description(axis: str) -> dict[str, str]:
    """Return unit and long name of a parameter."""
    known = VARIABLES[axis].long_name if axis in VARIABLES else axis.replace("_", " ").capitalize()
    return {"units": axis_unit(axis), "long_name": known}


PARAMETER_UNITS = {
    "gap": "m",
    "stiffness": "N/m",
    "damping": "N s/m",
    "base_amplitude": "m",
    "length": "m",
    "width": "m",
    "thickness": "m",
    "youngs_modulus": "Pa",
    "density": "kg/m3",
    "resistance": "ohm",
    "inductance": "H",
}
"""Units of the numbers of the default rig and of a harvester's load; other names are taken as given
by the user."""


STATISTICS = {"max": "largest size", "mean": "mean", "rms": "RMS"}
"""Endings of the names of statistics of an observable, in words."""


def described_statistic(name: str) -> Variable:
    """Return unit and long name of a variable, also of a statistic such as `strain_power_rms`."""
    if name in VARIABLES:
        return VARIABLES[name]
    base, _, ending = name.rpartition("_")
    if ending in STATISTICS and base in VARIABLES:
        units, long_name = VARIABLES[base]
        return Variable(units, f"{long_name}, {STATISTICS[ending]}")
    return Variable("1", name.replace("_", " ").capitalize())
