"""No study compiles anything in a second call, for another rig like it, or for a new closure."""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import scipy.stats
from unit_oscillator import oscillator

import vibrojax as vj
from vibrojax._tools import interrupts

GAP, OTHERS = 4e-4, (4.1e-4, 4.6e-4)
NEAR, ABOUT = [1.0, 1.1], vj.Range(0.9, 1.4)
QUIET = {"progress": False}
BRIEF = vj.RegimeSettings(transient=8, periods=16, max_period=2, samples_per_period=16)
FEW = vj.BasinSettings(transient=8, periods=8, max_period=2)
SWEEP = vj.SweepSettings(direction="forward", max_periods=40, max_period=2, refine_jumps=None)

DESCENT = vj.identification.Optax(optax.adam(0.05), 2)

Make = Callable[..., vj.model.AbstractSystem]


def rig(gap: float = GAP, stiffness: float = 5500.0) -> vj.ImpactingBeam:
    return vj.default_rig(gap=gap, stiffness=stiffness, num_modes=1)


def undriven(gap: float) -> vj.ImpactingBeam:
    driven = rig(gap)
    return vj.ImpactingBeam(driven.beam, driven.stops, vj.NoDrive(), 0.02, num_modes=1)


def renewed() -> Make:
    """Return a new closure that makes the same rigs."""

    def made(gap: float = GAP, stiffness: float = 5500.0) -> vj.ImpactingBeam:
        return rig(gap, stiffness)

    return made


class _Programs:
    """Programs compiled while `counting`; one listener for all, since none can be taken off."""

    def __init__(self) -> None:
        self.names: list[str] | None = None
        jax.monitoring.register_event_duration_secs_listener(self._listen)

    def _listen(self, event: str, _: float, **facts: Any) -> None:
        if event.endswith("backend_compile_duration") and self.names is not None:
            self.names.append(re.sub(r"^jit\((.*)\)$", r"\1", str(facts.get("fun_name", "?"))))

    @contextmanager
    def counting(self) -> Iterator[list[str]]:
        self.names = found = []
        try:
            yield found
        finally:
            self.names = None


PROGRAMS = _Programs()


def history(gap: float, **changes: Any) -> vj.history.History:
    return vj.simulate(
        rig(gap), frequency_ratio=1.1, **{"periods": 4, "samples_per_period": 32} | changes
    )


def branch(gap: float) -> Any:
    return vj.continue_response(rig(gap), frequency_ratio=ABOUT)


def doubling(gap: float) -> Any:
    """Return the branch of an oscillator whose period doubles."""
    return vj.continue_response(oscillator(gap / GAP), frequency=vj.Range(0.12, 0.16))


def response(gap: float, method: Any = None) -> vj.steady.PeriodicResponse:
    return vj.periodic_response(
        rig(gap), frequency_ratio=1.1, settings=vj.PeriodicSettings(method=method)
    )


def slope(gap: float, of: Callable[[Any], Any]) -> Any:
    return jax.grad(lambda value: jnp.sum(of(value)))(gap)


def start(x: float, speed: float) -> tuple[list[float], list[float]]:
    return [x], [speed]


def box(**settings: Any) -> vj.maps.BasinFractions:
    sides = {"x": vj.Range(-1e-4, 1e-4), "speed": vj.Range(-0.01, 0.01)}
    return vj.maps.BasinFractions(start, starts=3, **sides, **settings)


def map_of(make: Make, gap: float, kind: Any, **settings: Any) -> Any:
    return vj.parameter_map(
        make, frequency_ratio=NEAR, gap=[gap, 1.05 * gap], response=kind, **QUIET, **settings
    )


def curve(gap: float) -> vj.io.MeasuredCurve:
    ratio = np.linspace(1.0, 1.18, 7)
    found = vj.frequency_sweep(rig(GAP), frequency_ratio=ratio, settings=SWEEP, **QUIET)
    amplitude = np.asarray(found.amplitude_ratio)[0] * gap / GAP
    return vj.io.MeasuredCurve(
        ratio, "frequency_ratio", amplitude=amplitude, amplitude_deviation=0.05 * amplitude
    )


def recorded(gap: float) -> vj.io.MeasuredHistory:
    last = history(GAP, periods=60)
    time, motion = np.asarray(last.time)[-65:-1], np.asarray(last.displacement())[-65:-1]
    return vj.io.MeasuredHistory(
        time - time[0],
        displacement=motion * gap / GAP,
        deviation={"displacement": 1e-5},
        frequency_ratio=1.1,
    )


@dataclass(frozen=True)
class Case:
    """A study as a test calls it; `of_function` where it takes the function that makes rigs."""

    study: Callable[[Make, float], Any]
    of_function: bool = False
    own: tuple[str, ...] = ()
    """Programs that hold the function: a new closure may compile these, each once."""
    others: tuple[float, ...] = OTHERS
    """Gaps of other rigs, of which none needs a fallback that the first one did without."""


STUDIES: dict[str, Case] = {
    "modes": Case(
        lambda _, gap: vj.modes(vj.Cantilever(0.2 * gap / GAP, 0.025, 1e-3, 1e11, 8e3), 2)
    ),
    "modes_shape": Case(
        lambda _, gap: vj.modes(
            vj.Cantilever(0.2 * gap / GAP, 0.025, 1e-3, 1e11, 8e3), 2
        ).to_xarray()
    ),
    "motion": Case(lambda _, gap: vj.motion(rig(gap), frequency_ratio=1.1)),
    "frequency_sweep": Case(
        lambda _, gap: vj.frequency_sweep(
            rig(gap), frequency_ratio=NEAR, settings=SWEEP, **QUIET
        ).to_xarray()
    ),
    "frequency_sweep_refined": Case(
        lambda _, gap: vj.frequency_sweep(
            rig(gap), frequency_ratio=np.linspace(1.0, 1.25, 8), **QUIET
        ).to_xarray(),
        others=(4.2e-4, 4.6e-4),
    ),
    "frequency_sweep_of_a_function": Case(
        lambda make, gap: vj.frequency_sweep(
            make, frequency_ratio=NEAR, gap=[gap, 1.1 * gap], settings=SWEEP, **QUIET
        ),
        True,
    ),
    "simulate": Case(lambda _, gap: history(gap)),
    "simulate_a_list": Case(
        lambda make, gap: vj.simulate(
            make, gap=[gap, 1.1 * gap], frequency_ratio=1.1, periods=4, samples_per_period=32
        ),
        True,
    ),
    "simulate_a_release": Case(
        lambda _, gap: vj.simulate(undriven(gap), release=2e-4, periods=4, samples_per_period=32)
    ),
    "history_contacts": Case(lambda _, gap: history(gap).contacts().to_xarray()),
    "history_spectrum": Case(lambda _, gap: history(gap).spectrum()),
    "history_cycles": Case(lambda _, gap: history(gap).cycles()),
    "history_poincare": Case(lambda _, gap: history(gap).poincare()),
    "history_peak": Case(lambda _, gap: history(gap).peak()),
    "history_energy": Case(lambda _, gap: history(gap).energy()),
    "history_dataset": Case(lambda _, gap: history(gap).to_xarray()),
    "periodic_response": Case(lambda _, gap: repr(response(gap))),
    "periodic_response_balanced": Case(lambda _, gap: repr(response(gap, vj.HarmonicBalance()))),
    "periodic_response_shot": Case(lambda _, gap: repr(response(gap, vj.Shooting()))),
    "periodic_response_guessed": Case(
        lambda _, gap: vj.periodic_response(rig(gap), frequency_ratio=1.1, guess=response(GAP))
    ),
    "periodic_response_history": Case(lambda _, gap: response(gap).history(32)),
    "gradient_of_periodic_response": Case(
        lambda _, gap: slope(gap, lambda g: response(g).amplitude_ratio)
    ),
    "gradient_of_simulate": Case(lambda _, gap: slope(gap, lambda g: history(g).displacement())),
    "single_contact_response": Case(
        lambda _, gap: vj.single_contact_response(rig(gap), frequency_ratio=NEAR)
    ),
    "continue_response": Case(lambda _, gap: branch(gap).to_xarray()),
    "continue_response_over_axes": Case(
        lambda make, gap: vj.continue_response(make, frequency_ratio=ABOUT, gap=[gap, 1.05 * gap]),
        True,
    ),
    "continue_response_from_settled_marches": Case(
        lambda make, gap: vj.continue_response(
            make,
            frequency_ratio=vj.Range(1.0, 1.1),
            gap=np.linspace(3.2e-4, gap, 5),
            settings=vj.ContinuationSettings(max_points=60),
        ),
        True,
        others=(3.5e-4, 3.7e-4),
    ),
    "continue_response_in_a_number": Case(
        lambda make, gap: vj.continue_response(
            make, frequency_ratio=1.1, gap=vj.Range(gap, 1.1 * gap)
        ),
        True,
    ),
    "continue_response_balanced": Case(
        lambda _, gap: vj.continue_response(
            rig(gap),
            frequency_ratio=ABOUT,
            settings=vj.ContinuationSettings(method=vj.HarmonicBalance(samples=128)),
        )
    ),
    "continue_response_from_a_motion": Case(
        lambda _, gap: vj.continue_response(rig(gap), frequency_ratio=ABOUT, start=response(gap))
    ),
    "branch_switch": Case(lambda _, gap: doubling(gap).switch(), others=(4.05e-4, 4.6e-4)),
    "branch_resample": Case(lambda _, gap: branch(gap).resample(NEAR)),
    "fold_response": Case(
        lambda _, gap: vj.fold_response(
            rig(gap), branch(GAP).special_points[1], axis="frequency_ratio"
        )
    ),
    "gradient_of_fold_response": Case(
        lambda _, gap: slope(
            gap,
            lambda g: (
                vj.fold_response(
                    rig(g), branch(GAP).special_points[1], axis="frequency_ratio"
                ).parameter
            ),
        )
    ),
    "fold_curves": Case(
        lambda make, gap: vj.fold_curves(
            make, frequency_ratio=ABOUT, gap=vj.Range(gap, 1.02 * gap), max_points=5
        ),
        True,
    ),
    "regimes": Case(
        lambda make, gap: vj.regimes(
            make, frequency_ratio=NEAR, gap=[gap], starts=2, settings=BRIEF, **QUIET
        ).to_xarray(),
        True,
    ),
    "basins": Case(
        lambda make, gap: vj.basins(
            make, frequency_ratio=1.1, gap=[gap], starts=3, settings=FEW, **QUIET
        ).to_xarray(),
        True,
    ),
    "basins_of_a_plane": Case(
        lambda _, gap: vj.basins(
            rig(gap),
            frequency_ratio=1.1,
            start=lambda x, speed: ([x], [speed]),
            x=[-1e-4, 1e-4],
            speed=[-0.01, 0.01],
            settings=FEW,
            **QUIET,
        ).to_xarray()
    ),
    "basins_history": Case(
        lambda _, gap: vj.basins(
            rig(gap), frequency_ratio=[1.1], starts=3, settings=FEW, **QUIET
        ).history()
    ),
    "bifurcation_diagram": Case(
        lambda _, gap: vj.bifurcation_diagram(
            rig(gap), frequency_ratio=NEAR, settings=BRIEF, **QUIET
        ).to_xarray()
    ),
    "bifurcation_diagram_in_a_number": Case(
        lambda make, gap: vj.bifurcation_diagram(
            make, frequency_ratio=1.1, gap=[gap, 1.01 * gap], along="gap", settings=BRIEF, **QUIET
        ),
        True,
    ),
    "lyapunov_exponent": Case(
        lambda _, gap: vj.lyapunov_exponent(rig(gap), frequency_ratio=1.1, periods=8, transient=8)
    ),
    "identify_a_curve": Case(
        lambda make, gap: vj.identify(make, curve(gap), {"stiffness": 5000.0}),
        True,
        own=("systems_with_slopes",),
    ),
    "identify_a_curve_from_several_starts": Case(
        lambda make, gap: vj.identify(
            make, curve(gap), {"stiffness": 5000.0}, searches=int(gap / 1e-4) - 1
        ),
        True,
        own=("systems_with_slopes",),
        others=(3.3e-4, 5.1e-4),
    ),
    "identify_by_optax": Case(
        lambda make, gap: vj.identify(make, curve(gap), {"stiffness": 5000.0}, search=DESCENT),
        True,
        own=("systems_with_slopes",),
    ),
    "identify_a_history": Case(
        lambda make, gap: vj.identify(make, recorded(gap), {"stiffness": 5000.0}),
        True,
        own=("systems_with_slopes",),
    ),
    "identification_branch": Case(
        lambda make, gap: vj.identify(make, curve(gap), {"stiffness": 5000.0}).branch(),
        True,
        own=("systems_with_slopes",),
    ),
    "identification_profile": Case(
        lambda make, gap: vj.identify(make, curve(gap), {"stiffness": 5000.0}).profile(
            "stiffness", points=5
        ),
        True,
        own=("systems_with_slopes",),
    ),
    "identification_what_next": Case(
        lambda make, gap: vj.identify(make, curve(gap), {"stiffness": 5000.0}).what_next(
            "stiffness", gap=[gap]
        ),
        True,
        own=("systems_with_slopes", "systems_with_slopes"),
    ),
    "check_resolution": Case(
        lambda _, gap: vj.check_resolution(
            lambda system, method: vj.periodic_response(
                system,
                frequency_ratio=1.1,
                settings=vj.PeriodicSettings(method=method, tolerance=1e-2),
            ),
            rig(gap),
            samples=128,
        )
    ),
    "design_response": Case(
        lambda make, gap: vj.design.respond(make, gap=gap, frequency_ratio=ABOUT).slopes(
            lambda response: response.at("amplitude_ratio", 1.1)
        ),
        True,
        own=("systems_with_slopes",),
    ),
    "optimise": Case(
        lambda make, gap: vj.optimise(
            make,
            lambda response: response.peak(),
            variables={"gap": (gap, 1.1 * gap)},
            frequency_ratio=ABOUT,
            settings=vj.design.OptimiseSettings(starts=1, screened=2),
        ),
        True,
        own=("systems_with_slopes",) * 2,
    ),
    "propagate": Case(
        lambda make, gap: vj.propagate(
            make,
            {"gap": scipy.stats.norm(gap, 1e-6)},
            {"peak": lambda response: response.peak()},
            frequency_ratio=ABOUT,
            settings=vj.design.PropagationSettings(samples=4),
        ),
        True,
        own=("systems_with_slopes",) * 2,
    ),
    "explore": Case(
        lambda make, gap: vj.explore(
            make, frequency_ratio=ABOUT, gap=vj.Range(gap, 2 * gap)
        ).curve(),
        True,
    ),
    "explore_a_picture": Case(
        lambda make, gap: vj.explore(
            make, frequency_ratio=ABOUT, gap=vj.Range(gap, 2 * gap)
        ).figure(),
        True,
    ),
    "parameter_map_of_sweeps": Case(
        lambda make, gap: map_of(make, gap, "sweep"), True, own=("_made",)
    ),
    "parameter_map_of_branches": Case(
        lambda make, gap: map_of(make, gap, "continuation"), True, own=("_made",)
    ),
    "parameter_map_of_periodic_responses": Case(
        lambda make, gap: map_of(make, gap, "periodic"),
        True,
        own=("_made",),
    ),
    "parameter_map_of_regimes": Case(
        lambda make, gap: map_of(make, gap, BRIEF), True, own=("_made",)
    ),
    "parameter_map_of_basins": Case(
        lambda make, gap: map_of(make, gap, box(settings=FEW)), True, own=("_made",)
    ),
    "parameter_map_with_gradients": Case(
        lambda make, gap: map_of(make, gap, "periodic", gradients="gap"),
        True,
        own=("_made", "systems_with_slopes"),
    ),
}


def compiled_by(study: Callable[[Make, float], Any], make: Make, gap: float) -> Counter[str]:
    for thread in interrupts._background:  # what is compiled ahead and was not needed
        thread.join()
    with PROGRAMS.counting() as names:
        study(make, gap)
    return Counter(names)


@pytest.mark.parametrize("name", STUDIES)
def test_nothing_compiles_again(name):
    case = STUDIES[name]
    case.study(rig, GAP)
    assert not compiled_by(case.study, rig, GAP), "the same call again"
    for gap in case.others:
        assert not compiled_by(case.study, rig, gap), f"another rig: gap {gap}"
    if case.of_function:
        programs = compiled_by(case.study, renewed(), GAP)
        assert programs <= Counter(case.own), "a new closure"


def test_programs_are_counted():
    """Lest all else is quiet because the listener is deaf."""
    with PROGRAMS.counting() as names:
        jax.jit(lambda x: x + 1)(jnp.ones(3))
    assert names
