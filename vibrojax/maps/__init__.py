"""Parametric maps."""

from vibrojax.maps.basin_map import BasinFractions as BasinFractions
from vibrojax.maps.planning import MapPlan as MapPlan
from vibrojax.maps.store_files import StoreFull as StoreFull
from vibrojax.maps.store_files import StoreInUse as StoreInUse
from vibrojax.maps.store_files import StoreReadOnly as StoreReadOnly
