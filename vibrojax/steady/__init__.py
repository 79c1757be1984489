"""Single periodic motions."""

from vibrojax.steady.periodic_result import PeriodicResponse as PeriodicResponse
from vibrojax.steady.single_contact_result import SingleContactResponse as SingleContactResponse
