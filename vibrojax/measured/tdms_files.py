"""TDMS files of LabVIEW, by npTDMS: groups of channels, with their units and clocks."""

from typing import Any

import numpy as np

from vibrojax.measured.clocks import Clock
from vibrojax.measured.groups import Array
from vibrojax.measured.table import NoTable

_UNITS = ("unit_string", "NI_UnitDescription", "Unit", "unit", "units")


def read_tdms(file: Any) -> dict[str, Any]:
    """Return the groups of an open `nptdms.TdmsFile`; channels are read later."""
    if file.file_status.incomplete_final_segment:
        raise NoTable("is cut short: the values of its last segment are not all there")
    return {group.name: _channels(group.channels()) for group in file.groups()}


def _channels(channels: list[Any]) -> dict[str, Any]:
    starts = [c.properties.get("wf_start_time") for c in channels]
    first = min((s for s in starts if isinstance(s, np.datetime64)), default=None)
    found = {}
    for channel, start in zip(channels, starts, strict=True):
        properties = channel.properties
        unit = next((str(properties[n]) for n in _UNITS if properties.get(n)), None)
        clock = None
        if "wf_increment" in properties:
            clock = Clock(
                float(properties.get("wf_start_offset", 0.0)),
                float(properties["wf_increment"]),
                str(properties.get("wf_xunit_string") or "s"),
            )
            if clock.axis == "time" and isinstance(start, np.datetime64):
                late = (start - first) / np.timedelta64(1, "s") / clock.size
                clock = clock._replace(start=clock.start + float(late))
        shape = (len(channel),)
        found[channel.name] = Array(shape, lambda c=channel: np.asarray(c[:]), unit, clock=clock)
    return found
