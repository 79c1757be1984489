"""Which method suits a system."""

from vibrojax.stepping.contact_phases import MAX_STOPS
from vibrojax.stepping.method import AbstractMethod, ExactContact, ExponentialSplitting
from vibrojax.systems.base import AbstractSystem


def choose_method(
    system: AbstractSystem,
    method: AbstractMethod | None,
    tolerance: float,
    steps_per_period: int | None,
) -> AbstractMethod:
    """Return the method asked for, or the one that suits the stops of the system.

    Raises `ValueError` when the method asked for cannot do the stops.
    """
    stops = getattr(system, "stops", ())
    exact = all(stop.is_linear for stop in stops) and len(stops) <= MAX_STOPS
    if isinstance(method, ExactContact) and not exact:
        raise ValueError(
            f"ExactContact needs at most {MAX_STOPS} stops that are linear in contact, with no "
            "smoothing. Use method=ExponentialSplitting(), or leave method out."
        )
    if method is not None:
        return method
    kind = ExactContact if exact else ExponentialSplitting
    return kind(tolerance, steps_per_period)
