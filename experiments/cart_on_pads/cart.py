"""The cart before a pad, its records, and its mass from the impulse."""

import dataclasses
from pathlib import Path

import numpy as np

import vibrojax as vj

HERE = Path(__file__).parent
PADS = (40, 4)
"""Thickness of the pads, mm."""
RUNS = ("Run 1", "Run 2", "Run 3", "Run 4", "Run 5")
MASS = 0.578
"""kg, as the impulses on the 40 mm pad say (`mass_by_impulse`)."""
GUESS = {"stiffness": 60.0, "damping": 1.0, "initial_velocity": None}
"""First values in N/m and N s/m; the velocity begins with that of the record."""
DEVIATION = {"contact_force": 0.1, "velocity": 0.02}
"""Standard deviations, N and m/s: of what such a model leaves, some five times the noise."""
AT_REST = 20
"""Samples of the force before the cart moves, from which the offset is read."""


def with_law(law: vj.model.AbstractContactLaw, mass: float) -> vj.model.Oscillator:
    """Make a free body in front of a pad."""
    return vj.model.Oscillator(mass, stops=(vj.Stop(None, 0.0, law),))


def cart(stiffness: float, damping: float, mass: float) -> vj.model.Oscillator:
    """Make the cart before a pad that cannot pull."""
    return with_law(vj.KelvinVoigt(stiffness, damping, tension=False), mass)


def records(
    pad: int, *, velocity: bool = False, margin: float = 0.5
) -> dict[str, vj.io.MeasuredHistory]:
    """Read the impacts of the five runs on a pad, by the name of the run.

    The velocity is that of the 25 Hz channel. `margin` is as of `MeasuredHistory.impacts`.
    """
    channels = ("contact_force", "velocity") if velocity else ("contact_force",)
    left_out = {} if velocity else {"velocity": None}
    found = vj.io.read_measured_history(
        HERE / "data" / f"pad_{pad:02d}mm.csv",
        columns={
            "contact_force": "Force (N)",
            "displacement": None,
            "acceleration": None,
            **left_out,
        },
        deviation={name: DEVIATION[name] for name in channels},
        gain={"contact_force": -1.0},
        initial_displacement=0.0,
        initial_velocity=0.82,
    )
    impacts = {}
    for run in found:
        offset = {"contact_force": float(np.median(run.contact_force[:AT_REST]))}
        (impact,) = dataclasses.replace(run, offset=offset).impacts(margin=margin)
        name = run.label.split(", ")[-1]
        impacts[name] = dataclasses.replace(impact, label=name)
    return {name: impacts[name] for name in RUNS}


def mass_by_impulse(pad: int) -> dict[str, dict[str, float]]:
    """Integral of the force over the change of velocity, kg, by run and by reading.

    The velocity is read at the samples next to the contact, or where it is largest.
    """
    found = {}
    contacts = records(pad, margin=0.0)
    for name, run in records(pad, velocity=True).items():
        start, end = run.window
        inside = (run.time >= start) & (run.time <= end)
        force = run.offset["contact_force"] - run.contact_force
        impulse = np.trapezoid(force[inside], run.time[inside])
        first, last = contacts[name].window
        there = np.isfinite(run.velocity)
        before = run.velocity[there & (run.time < first)]
        after = run.velocity[there & (run.time > last)]
        found[name] = {
            "beside_contact": float(impulse / (before[-1] - after[0])),
            "largest": float(impulse / (before[-10:].max() - after[:10].min())),
        }
    return found
