"""What is measured of a periodic motion: signals with their units, and quantities of them."""

QUANTITIES = {
    "amplitude": "(max - min)/2",
    "peak": "max |y|",
    "peak_to_peak": "max - min",
    "rms": "root mean square",
    "first_harmonic": "amplitude of the first harmonic",
    "mean": "over a period",
}
OF_POWER = ("mean", "peak")
"""What of a power can be measured; all but the mean of other signals."""
SIGNALS = {
    "displacement": "m",
    "velocity": "m/s",
    "acceleration": "m/s2",
    "voltage": "V",
    "power": "W",
}
ORDERS = {"displacement": 0, "velocity": 1, "acceleration": 2, "voltage": 0, "power": 0}
"""Which derivative a signal is."""
DRIVES = {"force": "N"} | {name: SIGNALS[name] for name in list(SIGNALS)[:3]}
"""What a drive is measured as, with its unit: a force, or a motion of the base."""
FRAMES = ("relative", "absolute")
ELECTRIC = ("voltage", "power")
"""Signals that are no motions."""


def check_signal(signal: str, quantity: str, frame: str) -> None:
    """Raise `ValueError` for a quantity or a frame that a signal has not."""
    only = OF_POWER if signal == "power" else [q for q in QUANTITIES if q != "mean"]
    if quantity not in only:
        raise ValueError(
            f"quantity must be one of {', '.join(map(repr, only))} for a {signal}, got "
            f"{quantity!r}."
        )
    if signal in ELECTRIC and frame != "relative":
        raise ValueError(f"frame is of motions, got {frame!r} of a {signal}. Leave it out.")
