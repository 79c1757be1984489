"""Single periodic motions."""

from vibrojax.steady.periodic_result import PeriodicResponse as PeriodicResponse
from vibrojax.steady.single_contact_response import SingleContactResponse as SingleContactResponse
