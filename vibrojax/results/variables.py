"""Every output variable once: its unit and its long name."""

from typing import NamedTuple


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
    "contacts_per_period": Variable("1", "Contacts per drive period"),
    "gap_ratio": Variable("ratio", "Gap over drive amplitude"),
    "touch_gap_ratio": Variable("ratio", "Gap over drive amplitude at which the beam just touches"),
    "contact_free_amplitude_ratio": Variable("ratio", "Amplitude without contact over drive"),
    "valid": Variable("1", "Whether the motion exists"),
    "period": Variable("1", "Period of the motion in drive periods (0: none found)"),
    "status": Variable("1", "How the lane ended"),
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
    "residual": Variable("1", "Relative residual of the motion"),
    "arclength": Variable("1", "Way along the branch"),
    "natural_frequency": Variable("Hz", "First natural frequency of the unstopped beam"),
    "frequency": Variable("Hz", "Drive frequency"),
    "frequency_ratio": Variable("1", "Drive frequency over first natural frequency"),
}
