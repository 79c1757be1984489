"""Free releases: the seven of the paper, the contact damping they ask for, energy and rubber."""

from typing import NamedTuple

import numpy as np
import rig
from reading import part, peak_in_g, through_analyser
from rig import CONTACT_DAMPING, PRINTED, RELEASES, STIFFNESS

import vibrojax as vj

RECORD, SPAN = 3.2, 500.0
RATE = 4 * 2.56 * SPAN
FINE_RATE = 65536.0
FIRST = {"release": 10e-3, "duration": 0.06, "sampling_rate": FINE_RATE}
BEFORE_TOUCH = 0.015
"""s; the release itself is over by then, and the first touch comes at 0.021 s."""
ALLOWED = 0.03
OUT_OF_REACH = 1.0
"""m of gap: as if there were no support."""
MAXWELL = 3.0
"""Stiffness of the Maxwell element of the rubber over the slow one: the least that loses enough."""


class Release(NamedTuple):
    """One release and what is read off it."""

    height: float
    history: vj.history.History
    contacts: vj.history.Contacts
    spectrum: vj.history.Spectrum
    peak_acceleration: float
    """g, after the start."""


def releases() -> tuple[list[Release], dict[str, vj.history.EnergyFlow]]:
    """Return the seven releases, and the energies of the last with and without the support."""
    histories = vj.simulate(
        rig.released_rig(),
        release=RELEASES,
        gap=[rig.GAP, OUT_OF_REACH],
        duration=RECORD,
        sampling_rate=RATE,
    )
    found = []
    for height in RELEASES:
        history = histories.at(release=height, gap=rig.GAP)
        spectrum = history.spectrum("acceleration", window="boxcar", span=SPAN, units="g")
        peak = peak_in_g(part(history, 0.0, 1.0), start=BEFORE_TOUCH)
        found.append(Release(height, history, history.contacts(), spectrum, peak))
    free = histories.at(release=RELEASES[-1], gap=OUT_OF_REACH)
    return found, {"with": found[-1].history.energy(), "without": free.energy()}


def table_of_releases(found: list[Release]) -> list[dict]:
    rows = []
    for one in found:
        lines = one.spectrum.peaks(8)
        rows.append(
            {
                "release_m": one.height,
                "acceleration_at_release_g": abs(float(one.history.acceleration()[0]))
                / rig.GRAVITY,
                "peak_acceleration_g": one.peak_acceleration,
                "peak_force_N": float(np.max(one.contacts.peak_force, initial=0.0)),
                "contacts": len(one.contacts),
                "touch_s": one.contacts.touch.round(6).tolist(),
                "departure_s": one.contacts.departure.round(6).tolist(),
                "restitution": one.contacts.restitution.round(4).tolist(),
                "energy_lost_J": one.contacts.energy_lost.tolist(),
                "lines": [[round(p.frequency, 2), round(p.amplitude, 5), p.name] for p in lines],
                "lines_resolution_Hz": one.spectrum.resolution,
            }
        )
    return rows


def against_damping(values: list[float]) -> dict[str, list[float]]:
    """Peaks of the 10 mm release against contact damping."""
    histories = vj.simulate(
        rig.released_rig(), damping=values, release=10e-3, duration=0.12, sampling_rate=FINE_RATE
    )
    table = {"damping": values, "acceleration_g": [], "force_N": [], "analyser_g": []}
    for history in histories:
        table["acceleration_g"].append(peak_in_g(history, BEFORE_TOUCH))
        table["force_N"].append(history.peak("contact_force").value)
        seen = through_analyser(history)[round(BEFORE_TOUCH * FINE_RATE) :]
        table["analyser_g"].append(float(np.abs(seen).max()))
    return table


def range_of_damping(table: dict[str, list[float]]) -> dict[str, list[float] | bool]:
    """Where the peaks lie within 3 % of the printed ones, N s/m."""
    fine = np.linspace(0.0, max(table["damping"]), 6001)
    inside = {}
    for name, printed in (("acceleration_g", "free_acceleration"), ("force_N", "free_force")):
        values = np.interp(fine, table["damping"], table[name])
        inside[name] = np.abs(values / PRINTED[printed]["theory"] - 1) <= ALLOWED
    inside["both"] = inside["acceleration_g"] & inside["force_N"]
    return {
        name: [round(float(fine[within][k]), 2) for k in (0, -1)] if within.any() else []
        for name, within in inside.items()
    }


def rubber_laws(loss: float) -> dict:
    """Laws without a jump at touch that take this energy, J, in the first contact of 10 mm."""
    laws = {
        "relaxation_time_s": (solid, [0.1e-3, 0.13e-3, 0.16e-3, 0.2e-3, 0.3e-3]),
        "dissipation_s_per_m": (crossley, [0.6, 1.0, 1.3, 1.5, 2.0]),
    }
    found: dict = {"loss_J": loss, "maxwell_stiffness_N_per_m": MAXWELL * STIFFNESS}
    for name, (law, values) in laws.items():
        histories = vj.simulate(
            lambda value, law=law: rig.stopped_by(law(value)), value=values, **FIRST
        )
        losses = [_first_loss(history) for history in histories]
        found[name] = float(np.interp(loss, losses, values))
        found[name + "_tried"] = {"values": values, "loss_J": losses}
    return found


def _first_loss(history: vj.history.History) -> float:
    """Return the work of the first contact on the beam, J, off samples: its force has no jump."""
    power = np.asarray(history.quantity("contact_force") * history.velocity())
    touching = np.flatnonzero(power)
    apart = np.flatnonzero(np.diff(touching) > 1e-3 * FINE_RATE)
    first = power[touching[0] : touching[apart[0]] + 2 if len(apart) else None]
    return float(-np.trapezoid(first) / FINE_RATE)


def solid(relaxation_time) -> vj.StandardLinearSolid:
    return vj.StandardLinearSolid(STIFFNESS, MAXWELL * STIFFNESS, relaxation_time)


def crossley(dissipation) -> vj.HuntCrossley:
    return vj.HuntCrossley(STIFFNESS, dissipation, exponent=1.0)


def against_modes(counts: list[int], rubber: dict) -> dict[str, dict[str, list[float]]]:
    """Peaks of the 10 mm release against the number of modes, for every contact law."""
    laws = {
        "Kelvin-Voigt, c1 = 0": vj.KelvinVoigt(STIFFNESS, 0.0),
        f"Kelvin-Voigt, c1 = {CONTACT_DAMPING:g} N s/m": vj.KelvinVoigt(STIFFNESS, CONTACT_DAMPING),
    }
    if rubber:
        laws["standard linear solid"] = solid(rubber["relaxation_time_s"])
        laws["Hunt-Crossley"] = crossley(rubber["dissipation_s_per_m"])
    table: dict[str, dict[str, list[float]]] = {}
    for name, law in laws.items():
        # gradient="forward" compiles three times faster
        histories = (
            vj.simulate(rig.stopped_by(law, n), **FIRST, gradient="forward") for n in counts
        )
        rows = [_peaks(history) for history in histories]
        table[name] = {"modes": counts} | {key: [row[key] for row in rows] for key in rows[0]}
    return table


def _peaks(history: vj.history.History) -> dict[str, float]:
    """Peaks during the first contact, and over the record as the analyser sees it.

    Read off the samples, which are close enough that a peak just after a touch is within 0.1 %.
    """
    skipped = round(BEFORE_TOUCH * FINE_RATE)
    acceleration = np.abs(np.asarray(history.acceleration()))[skipped:] / rig.GRAVITY
    force = np.asarray(history.quantity("contact_force"))[skipped:]
    pushed = np.flatnonzero(force)
    gaps = np.flatnonzero(np.diff(pushed) > 1)
    # Up to the end of the last contact before the beam is away for more than 1 ms.
    long = [k for k in gaps if pushed[k + 1] - pushed[k] > 1e-3 * FINE_RATE]
    first = slice(pushed[0], pushed[long[0]] + 2 if long else pushed[-1] + 2)
    return {
        "first_contact_g": float(acceleration[first].max()),
        "record_g": float(acceleration.max()),
        "analyser_g": float(np.abs(through_analyser(history)[skipped:]).max()),
        "force_N": float(force.max()),
        "release_g": float(np.abs(np.asarray(history.acceleration())[0]) / rig.GRAVITY),
    }


def decay_time(energy: vj.history.EnergyFlow, share: float) -> float:
    """When no more than a share of the first energy is left, s; NaN if that is not reached."""
    left = energy.total / energy.total[0]
    return float(energy.time[np.argmax(left <= share)]) if (left <= share).any() else float("nan")


def table_of_energies(found: dict[str, vj.history.EnergyFlow]) -> dict[str, dict]:
    table = {}
    for name, energy in found.items():
        higher = energy.share[:, 1:].sum(axis=1)
        table[name] = {
            "start_J": float(energy.total[0]),
            "share_at_start": energy.share[0].tolist(),
            "share_at_0.1_s": energy.mean_share(0.09, 0.11).tolist(),
            "mean_share_0.02_to_0.2_s": energy.mean_share(0.02, 0.2).tolist(),
            "largest_share_of_higher_modes": float(higher.max()),
            "time_of_it_s": float(energy.time[np.argmax(higher)]),
            "lost_in_beam_by_mode_J": energy.beam_loss[-1].tolist(),
            "lost_in_contact_J": float(energy.contact_loss[-1].sum()),
            "lost_in_contact_at_0.1_s_J": float(energy.contact_loss[energy.time <= 0.1][-1].sum()),
            "left_at_0.2_s": float(energy.total[energy.time <= 0.2][-1] / energy.total[0]),
            "decay_s": {f"{s:g}": decay_time(energy, s) for s in (0.5, 0.3679, 0.1, 0.01)},
            "balance": float(np.abs(energy.balance).max()),
        }
    return table
