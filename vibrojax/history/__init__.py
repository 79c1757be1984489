"""Motions in time, and what is read from them."""

from vibrojax.history.contacts import Contacts as Contacts
from vibrojax.history.cycles import Cycles as Cycles
from vibrojax.history.energy import EnergyFlow as EnergyFlow
from vibrojax.history.histories import Histories as Histories
from vibrojax.history.history import History as History
from vibrojax.history.poincare import PoincareSection as PoincareSection
from vibrojax.history.shock import ShockSpectrum as ShockSpectrum
from vibrojax.history.shock import shock_response_spectrum as shock_response_spectrum
from vibrojax.history.spectrum import Spectrum as Spectrum
