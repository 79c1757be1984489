"""What a rig file may hold: its tables, their keys and the kind of every value."""

from typing import NamedTuple

from vibrojax.model.laws import Hertz, HuntCrossley, KelvinVoigt
from vibrojax.model.relaxing_laws import StandardLinearSolid


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


def _keys(kind: str, names: str, required: bool = False) -> dict[str, Key]:
    """Return several keys of one kind, their names between spaces."""
    return {name: Key(kind, required) for name in names.split()}


KEYS = {
    "beam": {
        **_keys(NUMBER, "length width thickness youngs_modulus density", required=True),
        **_keys(NUMBER, "taper mass_ratio"),
        "point_masses": Key(MASSES),
    },
    "beam.point_masses": _keys(NUMBER, "mass", required=True) | _keys(NUMBER, "position"),
    "stop": {
        **_keys(NUMBER, "position gap", required=True),
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
        **_keys(RANGE, "frequency_ratio frequency"),
        "direction": Key(TEXT),
        "tolerance": Key(NUMBER),
        **_keys(WHOLE, "steps_per_period max_period max_periods"),
        "settle": Key(TEXT),
        "refine_jumps": Key(NUMBER_OR_FALSE),
    },
}
MAP_KEYS = {
    "response": Key(TEXT),
    **_keys(RANGE_OR_NUMBER, "frequency_ratio frequency"),
    "direction": Key(TEXT),
    "tolerance": Key(NUMBER),
    "measures": Key(TEXTS),
    "keep_curves": Key(SWITCH),
    "gradients": Key(TEXTS),
    "axes": Key(AXES),
    "zipped": Key(GROUPS),
}
"""Keys of [map], which `examples/map.toml` explains."""
_STIFFNESS = _keys(NUMBER, "stiffness", required=True)
LAWS = {
    "kelvin_voigt": (
        KelvinVoigt,
        _STIFFNESS | _keys(NUMBER, "damping") | _keys(SWITCH, "tension"),
    ),
    "hertz": (Hertz, _STIFFNESS | _keys(NUMBER, "exponent")),
    "hunt_crossley": (HuntCrossley, _STIFFNESS | _keys(NUMBER, "dissipation exponent")),
    "standard_linear_solid": (
        StandardLinearSolid,
        _STIFFNESS | _keys(NUMBER, "maxwell_stiffness relaxation_time", required=True),
    ),
}
"""Contact laws by their name in a rig file, each with the keys it adds to [[stop]]."""
SPACED_KEYS = ("start", "end", "points", "spacing")
SPACINGS = ("linear", "log")
KINDS_OF_RESPONSE = ("sweep", "periodic", "continuation")
KINDS_OF_DRIVE = ("base_motion", "point_force")
