"""Shared set-up: shapes of every annotated array are checked while the tests run."""

import sys
from pathlib import Path

from jaxtyping import install_import_hook

# Before anything imports vibrojax, so that all of it is checked.
_hook = install_import_hook("vibrojax", "beartype.beartype")

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))  # exact_propagation, the oracle

import pytest  # noqa: E402

import vibrojax as vj  # noqa: E402


def make_rig(
    *,
    taper=0.5,
    mass_ratio=0.5,
    gap=0.4e-3,
    position=0.5,
    stiffness=5500.0,
    damping=5e-5,
    tension=True,
    side=1,
    amplitude=0.2e-3,
    damping_ratio=0.018,
    num_modes=5,
    formulation="consistent",
) -> vj.ImpactingBeam:
    """The default rig (design.md 2.2), any of its numbers changed by name."""
    beam = vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0, taper=taper, mass_ratio=mass_ratio)
    stop = vj.Stop(position, gap, vj.KelvinVoigt(stiffness, damping, tension), side=side)
    return vj.ImpactingBeam(
        beam,
        stops=(stop,),
        drive=vj.BaseMotion(amplitude),
        damping_ratio=damping_ratio,
        num_modes=num_modes,
        formulation=formulation,
    )


@pytest.fixture(scope="session")
def rig():
    """Builder of the default rig with any of its numbers changed by name."""
    return make_rig
