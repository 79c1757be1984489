"""What a rig file may hold: its tables, their keys and the kind of every value."""

from typing import NamedTuple

from vibrojax.model.laws import Hertz, HuntCrossley, KelvinVoigt, StandardLinearSolid


class Key(NamedTuple):
    """Kind of a value, whether it has to be there, and how large a whole number may be."""

    kind: str
    required: bool = False
    most: int = 1_000_000


NUMBER = "a number"
WHOLE = "a whole number"
TEXT = "a text in quotes"
SWITCH = "true or false"
RANGE = "[start, end, points]"
NUMBER_OR_FALSE = "a number or false"
RANGE_OR_NUMBER = "[start, end, points] or one number"
TEXTS = "a list of texts in quotes"
AXES = "a table [map.axes]"
GROUPS = "one or more tables [[map.zipped]]"
MASSES = "one or more tables [[beam.point_masses]]"

MOST_MODES = 1000

KEYS = {
    "beam": {
        "length": Key(NUMBER, True),
        "width": Key(NUMBER, True),
        "thickness": Key(NUMBER, True),
        "youngs_modulus": Key(NUMBER, True),
        "density": Key(NUMBER, True),
        "taper": Key(NUMBER),
        "mass_ratio": Key(NUMBER),
        "point_masses": Key(MASSES),
    },
    "beam.point_masses": {
        "mass": Key(NUMBER, True),
        "position": Key(NUMBER),
    },
    "stop": {
        "position": Key(NUMBER, True),
        "gap": Key(NUMBER, True),
        "side": Key(WHOLE),
        "smoothing": Key(NUMBER),
        "law": Key(TEXT),
    },
    "drive": {
        "kind": Key(TEXT, True),
        "amplitude": Key(NUMBER, True),
        "position": Key(NUMBER),
    },
    "model": {
        "damping_ratio": Key(NUMBER, True),
        "num_modes": Key(WHOLE, most=MOST_MODES),
        "formulation": Key(TEXT),
    },
    "sweep": {
        "frequency_ratio": Key(RANGE),
        "frequency": Key(RANGE),
        "direction": Key(TEXT),
        "tolerance": Key(NUMBER),
        "steps_per_period": Key(WHOLE),
        "max_period": Key(WHOLE),
        "max_periods": Key(WHOLE),
        "refine_jumps": Key(NUMBER_OR_FALSE),
    },
}
MAP_KEYS = {
    "response": Key(TEXT),
    "frequency_ratio": Key(RANGE_OR_NUMBER),
    "frequency": Key(RANGE_OR_NUMBER),
    "direction": Key(TEXT),
    "tolerance": Key(NUMBER),
    "measures": Key(TEXTS),
    "keep_curves": Key(SWITCH),
    "gradients": Key(TEXTS),
    "axes": Key(AXES),
    "zipped": Key(GROUPS),
}
"""Keys of [map], which `examples/map.toml` explains."""
LAWS = {
    "kelvin_voigt": (
        KelvinVoigt,
        {"stiffness": Key(NUMBER, True), "damping": Key(NUMBER), "tension": Key(SWITCH)},
    ),
    "hertz": (Hertz, {"stiffness": Key(NUMBER, True), "exponent": Key(NUMBER)}),
    "hunt_crossley": (
        HuntCrossley,
        {
            "stiffness": Key(NUMBER, True),
            "dissipation": Key(NUMBER),
            "exponent": Key(NUMBER),
        },
    ),
    "standard_linear_solid": (
        StandardLinearSolid,
        {
            "stiffness": Key(NUMBER, True),
            "maxwell_stiffness": Key(NUMBER, True),
            "relaxation_time": Key(NUMBER, True),
        },
    ),
}
"""Contact laws by their name in a rig file, each with the keys it adds to [[stop]]."""
SPACED_KEYS = ("start", "end", "points", "spacing")
SPACINGS = ("linear", "log")
KINDS_OF_RESPONSE = ("sweep", "periodic", "continuation")
KINDS_OF_DRIVE = ("base_motion", "point_force")
