"""Every public call with junk in the place of one argument; prints what is answered badly.

A program of its own: in the tests beartype would refuse first. What is accepted ends where the
computing would begin, with `Reached`. Every argument meets the junk of `FIRST`; with `all` it meets
all kinds, so do arguments of methods, and hypothesis draws more.
"""

import datetime
import inspect
import json
import os
import pkgutil
import re
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

import jax
import numpy as np
import scipy.stats
import xarray

import vibrojax as vj


class Reached(BaseException):
    """The call was taken: the computing would begin."""


def reached(*args, **kwargs):
    raise Reached


ENGINES = {
    "vibrojax.sweep.frequency_sweep": ["compile_ahead"],
    "vibrojax.regime.basins": ["attractors_over"],
    "vibrojax.regime.bifurcation": ["carried_points"],
    "vibrojax.regime.regimes": ["regime_points"],
    "vibrojax.branches.continue_response": ["follow_branches", "follow_from"],
    "vibrojax.branches.fold_curves": ["compile_search"],
    "vibrojax.steady.single_contact_response": ["evaluate", "_touches"],
    "vibrojax.identification.identify._Fits": ["run"],
    "vibrojax.maps.parameter_map": ["_run", "plan_of"],
    "vibrojax.history.simulate": ["solve", "_solve_all"],
    "vibrojax.steady.periodic_response": ["is_alone", "with_columns", "shoot"],
    "vibrojax.regime.lyapunov": ["_exponent"],
    "vibrojax.branches.folds": ["_search"],
    "vibrojax.explorer.explore": ["Explorer"],
    "vibrojax.design.optimise": ["search_design"],
    "vibrojax.design.pareto": ["search_front"],
    "vibrojax.design.propagate": ["propagated"],
    "vibrojax.design.rig_evaluator": ["systems_with_slopes"],
}


def stop_engines():
    for place, names in ENGINES.items():
        owner = pkgutil.resolve_name(place)
        for name in names:
            assert hasattr(owner, name), (place, name)
            setattr(owner, name, reached)


def rig(gap=4e-4, stiffness=5500.0):
    return vj.default_rig(gap=gap, stiffness=stiffness, num_modes=1)


RIG = rig()
LAW, DRIVE = vj.KelvinVoigt(1e3), vj.BaseMotion(1e-4)
STOP = vj.Stop(0.5, 1e-3, LAW)
SIZES = dict(length=0.2, width=0.02, thickness=1e-3, youngs_modulus=1e11, density=8e3)
MEASURED = vj.io.MeasuredCurve(
    np.array([1.0, 1.1, 1.2]), "frequency_ratio", amplitude=np.array([1.0, 2.0, 3.0])
)
BIMORPH = dict(
    length=0.05,
    width=0.03,
    substrate_thickness=1e-4,
    layer_thickness=3e-4,
    substrate_modulus=1e11,
    layer_modulus=6e10,
    substrate_density=9e3,
    layer_density=8e3,
    piezoelectric_constant=-16.6,
    permittivity=1e-8,
)
CHAIN = vj.model.FiniteElements(
    mass=np.eye(30), stiffness=2 * np.eye(30) - np.eye(30, k=1) - np.eye(30, k=-1)
)
FOLD = vj.branches.SpecialPoint("fold", 1.1, 2.0, 3.0, np.zeros(2), 0)
TIME = np.linspace(0.0, 1.0, 50)
TABLE = {"time [s]": TIME, "displacement [m]": np.sin(40 * TIME)}
CURVE = {"frequency [Hz]": [1.0, 2.0, 3.0], "amplitude [m]": [1e-3, 2e-3, 1e-3]}
MAP = xarray.Dataset(
    {"peak_amplitude_ratio": (("gap", "taper"), np.ones((2, 2)))},
    {"gap": [1e-4, 2e-4], "taper": [0.0, 0.5]},
)


def start(displacement, velocity):
    return [displacement], [velocity]


def settings(**own):
    return own


RECORD = vj.io.MeasuredHistory(
    np.linspace(0.0, 0.5, 20),
    contact_force=np.maximum(np.sin(np.linspace(0.0, 6.0, 20)), 0.0),
    initial_velocity=0.5,
)


def by_law(law, mass):
    return vj.model.Oscillator(mass, stops=(vj.Stop(None, 0.0, law),))


def peak(response):
    return response.peak()


DESIGNS = dict(variables={"gap": (1e-4, 1e-3)}, frequency_ratio=vj.Range(0.9, 1.1), stiffness=5e3)
TOLERANCES = {"gap": vj.design.Tolerance(2e-5)}


CALLS = {
    "Cantilever": (vj.Cantilever, SIZES),
    "PointMass": (vj.PointMass, dict(mass=0.1)),
    "Stop": (vj.Stop, dict(position=0.5, gap=1e-3, law=LAW)),
    "KelvinVoigt": (vj.KelvinVoigt, dict(stiffness=1e3)),
    "HuntCrossley": (vj.HuntCrossley, dict(stiffness=1e3)),
    "Hertz": (vj.Hertz, dict(stiffness=1e3)),
    "StandardLinearSolid": (
        vj.StandardLinearSolid,
        dict(stiffness=1e3, maxwell_stiffness=1e3, relaxation_time=1e-3),
    ),
    "BaseMotion": (vj.BaseMotion, dict(amplitude=1e-4)),
    "PointForce": (vj.PointForce, dict(amplitude=1.0)),
    "Harmonic": (vj.Harmonic, dict(frequency=10.0)),
    "Chirp": (vj.Chirp, dict(start=1.0, end=2.0, duration=3.0)),
    "Motion": (
        vj.model.Motion,
        dict(equations=RIG.equations(), drive=DRIVE, waveform=vj.Harmonic(10.0)),
    ),
    "ImpactingBeam": (vj.ImpactingBeam, dict(beam=RIG.beam, stops=STOP, drive=DRIVE)),
    "MatrixSystem": (
        vj.MatrixSystem,
        dict(
            mass=[[1.0]],
            damping=[[1.0]],
            stiffness=[[100.0]],
            response_map=[1.0],
            stops=vj.Stop(None, 1e-3, LAW),
            stop_map=[[1.0]],
            drive=DRIVE,
            input_map=[1.0],
        ),
    ),
    "StateSpace": (
        vj.StateSpace,
        dict(
            flow=[[0.0, 1.0], [-100.0, -1.0]],
            response_map=[1.0, 0.0],
            stops=vj.Stop(None, 1e-3, LAW),
            stop_map=[[1.0, 0.0]],
            force_map=[[0.0], [1.0]],
            drive=DRIVE,
            input_map=[0.0, 1.0],
        ),
    ),
    "PiezoLayers": (vj.model.PiezoLayers, dict(moment_per_volt=1e-5, capacitance=1e-8)),
    "bimorph": (vj.model.bimorph, BIMORPH),
    "Harvester": (
        vj.Harvester,
        dict(rig=RIG, layers=vj.model.PiezoLayers(1e-5, 1e-8), resistance=1e4),
    ),
    "MaxwellChain": (
        vj.model.MaxwellChain,
        dict(stiffness=1e3, maxwell_stiffness=[1e3], relaxation_time=[1e-3]),
    ),
    "Sampled": (vj.Sampled, dict(time=[0.0, 1.0], values=[0.0, 1.0])),
    "Tones": (vj.Tones, dict(frequencies=[1.0, 2.0])),
    "FiniteElements": (
        vj.model.FiniteElements,
        dict(mass=np.eye(8), stiffness=np.diag(np.arange(1.0, 9.0)) ** 2),
    ),
    "reduce": (
        vj.model.reduce,
        dict(elements=CHAIN, highest_frequency=0.02, response_map=CHAIN.row(node=1)),
    ),
    "Oscillator": (vj.model.Oscillator, dict(mass=0.1, stiffness=20.0, drive=DRIVE)),
    "Joined": (
        vj.Joined,
        dict(first=RIG, second=vj.model.Oscillator(0.1, 20.0), between=STOP),
    ),
    "KelvinVoigt.from_restitution": (
        vj.KelvinVoigt.from_restitution,
        dict(restitution=0.7, stiffness=1e3, mass=0.1),
    ),
    "HuntCrossley.from_restitution": (
        vj.HuntCrossley.from_restitution,
        dict(restitution=0.7, speed=0.1, stiffness=1e3),
    ),
    "ImpactingBeam.mass_at": (RIG.mass_at, dict(stop=1)),
    "ElasticPendulum": (vj.ElasticPendulum, SIZES),
    "LinearisedPendulum": (
        vj.LinearisedPendulum,
        dict(pendulum=vj.default_pendulum(num_links=3), num_modes=2),
    ),
    "Limiters": (vj.model.Limiters, dict(height=0.1, distance=0.01, law=LAW)),
    "HarmonicBalance": (vj.HarmonicBalance, {}),
    "Shooting": (vj.Shooting, {}),
    "ExactContact": (vj.ExactContact, {}),
    "ExponentialSplitting": (vj.ExponentialSplitting, {}),
    "LinearlyImplicit": (vj.LinearlyImplicit, {}),
    "LevenbergMarquardt": (vj.identification.LevenbergMarquardt, {}),
    "Optax": (vj.identification.Optax, dict(optimiser=__import__("optax").adam(0.1))),
    "SweepSettings": (vj.SweepSettings, {}),
    "PeriodicSettings": (vj.PeriodicSettings, {}),
    "ContinuationSettings": (vj.ContinuationSettings, {}),
    "RegimeSettings": (vj.RegimeSettings, {}),
    "BasinSettings": (vj.BasinSettings, {}),
    "Range": (vj.Range, dict(low=0.0, high=1.0)),
    "BasinFractions": (
        vj.maps.BasinFractions,
        dict(start=start, displacement=[0.0, 1e-3], velocity=[0.0, 1.0]),
    ),
    "MeasuredCurve": (
        vj.io.MeasuredCurve,
        dict(frequency=np.ones(3), frequency_name="frequency", amplitude=np.ones(3)),
    ),
    "MeasuredHistory": (
        vj.io.MeasuredHistory,
        dict(time=TIME, displacement=np.sin(TIME), frequency=9.0),
    ),
    "default_rig": (vj.default_rig, {}),
    "default_pendulum": (vj.default_pendulum, {}),
    "modes": (vj.modes, dict(beam=RIG.beam, num_modes=1)),
    "motion": (vj.motion, dict(system=RIG, frequency=20.0)),
    "simulate": (vj.simulate, dict(system=RIG, frequency=20.0, periods=2)),
    "simulate by ratio": (vj.simulate, dict(system=RIG, frequency_ratio=1.0, duration=0.2)),
    "periodic_response by frequency": (vj.periodic_response, dict(system=RIG, frequency=20.0)),
    "periodic_response": (vj.periodic_response, dict(system=RIG, frequency_ratio=1.1)),
    "fold_response": (
        vj.fold_response,
        dict(system=RIG, near=FOLD, axis="frequency_ratio"),
    ),
    "lyapunov_exponent": (vj.lyapunov_exponent, dict(system=RIG, frequency_ratio=1.1)),
    "single_contact_response": (
        vj.single_contact_response,
        dict(system=RIG, frequency_ratio=[1.0, 1.1]),
    ),
    "frequency_sweep": (
        vj.frequency_sweep,
        dict(system=rig, frequency_ratio=[1.0, 1.1], gap=[1e-4, 2e-4]),
    ),
    "bifurcation_diagram": (
        vj.bifurcation_diagram,
        dict(system=rig, frequency_ratio=[1.0, 1.1], gap=1e-4),
    ),
    "regimes": (vj.regimes, dict(system=rig, frequency_ratio=[1.0, 1.1], gap=[1e-4])),
    "basins": (
        vj.basins,
        dict(
            system=rig,
            start=start,
            frequency_ratio=1.1,
            displacement=[0.0, 1e-3],
            velocity=[0.0, 1.0],
            gap=1e-4,
        ),
    ),
    "basins of random states": (
        vj.basins,
        dict(system=rig, frequency_ratio=1.1, starts=3, gap=1e-4),
    ),
    "continue_response": (
        vj.continue_response,
        dict(system=rig, frequency_ratio=vj.Range(0.9, 1.1), gap=1e-4),
    ),
    "fold_curves": (
        vj.fold_curves,
        dict(system=rig, frequency_ratio=vj.Range(0.9, 1.1), gap=vj.Range(1e-4, 2e-4)),
    ),
    "explore": (vj.explore, dict(make_system=rig, gap=vj.Range(1e-4, 2e-4), stiffness=5e3)),
    "simulate over lists": (
        vj.simulate,
        dict(system=rig, frequency=[20.0, 21.0], periods=2, gap=[1e-4]),
    ),
    "parameter_map": (
        vj.parameter_map,
        dict(make_system=rig, frequency_ratio=[1.0, 1.1], gap=[1e-4, 2e-4], stiffness=5e3),
    ),
    "identify": (
        vj.identify,
        dict(make_system=rig, measured=MEASURED, guess={"stiffness": 5e3}, gap=1e-4),
    ),
    "compare_laws": (
        vj.compare_laws,
        dict(make_system=by_law, measured=RECORD, laws=["hertz", "no_tension"], mass=0.5),
    ),
    "optimise": (vj.optimise, dict(make_system=rig, objective=peak, **DESIGNS)),
    "design.pareto": (
        vj.design.pareto,
        dict(make_system=rig, objectives={"peak": peak, "other": peak}, **DESIGNS),
    ),
    "propagate": (
        vj.propagate,
        dict(
            make_system=rig,
            distributions={"gap": scipy.stats.norm(4e-4, 1e-5)},
            measures={"peak": peak},
            frequency_ratio=vj.Range(0.9, 1.1),
            stiffness=5e3,
        ),
    ),
    "design.respond": (
        vj.design.respond,
        dict(make_system=rig, frequency_ratio=vj.Range(0.9, 1.1), gap=1e-4),
    ),
    "design.band": (
        vj.design.band,
        dict(
            make_system=rig,
            tolerances=TOLERANCES,
            frequency_ratio=vj.Range(0.9, 1.1),
            stiffness=5e3,
        ),
    ),
    "design.OptimiseSettings": (vj.design.OptimiseSettings, {}),
    "design.PropagationSettings": (vj.design.PropagationSettings, {}),
    "design.Constraint": (vj.design.Constraint, dict(function=peak, most=1.0)),
    "design.Tolerance": (vj.design.Tolerance, dict(width=1e-5)),
    "design.Robust": (vj.design.Robust, dict(tolerances=TOLERANCES)),
    "check_resolution": (vj.check_resolution, dict(study=reached, system=RIG)),
    "zipped": (vj.zipped, dict(gap=[1.0, 2.0], taper=[0.0, 0.1])),
    "plot_map": (vj.plot_map, dict(dataset=MAP)),
    "plot_map_summary": (vj.plot_map_summary, dict(dataset=MAP)),
    "read_rig": (vj.io.read_rig, dict(path="nowhere.toml")),
    "read_measured_curve": (vj.io.read_measured_curve, dict(source=CURVE)),
    "read_measured_history": (vj.io.read_measured_history, dict(source=TABLE, frequency=9.0)),
    "Modes.shape": (vj.modes(RIG.beam).shape, dict(s=0.5)),
    "Modes.to_xarray": (vj.modes(RIG.beam).to_xarray, {}),
}
"""Valid calls by name, in which one argument after the other is replaced."""


def object_array():
    return np.array([object(), None], dtype=object)


JUNK = {
    "None": lambda: None,
    "True": lambda: True,
    "0": lambda: 0,
    "-1": lambda: -1,
    "nan": lambda: float("nan"),
    "inf": lambda: float("inf"),
    "-inf": lambda: float("-inf"),
    "1e300": lambda: 1e300,
    "complex": lambda: 1.0 + 2.0j,
    "text": lambda: "x",
    "empty text": lambda: "",
    "bytes": lambda: b"x",
    "empty list": lambda: [],
    "list of one": lambda: [1e-4],
    "list of text": lambda: ["a"],
    "nested list": lambda: [[1.0, 2.0], [3.0]],
    "empty dict": dict,
    "dict": lambda: {"a": 1},
    "set": lambda: {1, 2},
    "object": object,
    "class": lambda: int,
    "lambda": lambda: lambda *args: None,
    "module": lambda: json,
    "object array": object_array,
    "empty array": lambda: np.zeros(0),
    "matrix": lambda: np.ones((2, 3)),
    "large integer": lambda: 10**12,
    "huge integer": lambda: 10**400,
    "date": lambda: datetime.datetime(2020, 1, 1),
    "mixed list": lambda: ["a", 1.0],
    "path": lambda: Path("nowhere"),
    "waveform": lambda: vj.Harmonic(1.0),
    "status": lambda: vj.Status.settled,
    "tracer": lambda: None,  # made where it is used
}
FIRST = ("None", "text", "list of one")
"""Junk that meets every argument in the default tests."""


def arguments(name):
    function, given = CALLS[name]
    variable = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    own = [
        p.name for p in inspect.signature(function).parameters.values() if p.kind not in variable
    ]
    return list(dict.fromkeys([*own, *given]))


def given_names(name):
    """All names that a sentence about a call may say."""
    files = ["source", "curves", "Measured curve", "Measured history", "Rig file"]
    return [*arguments(name), "limiters", "axis", "variable", "quantity", *files]


def words(text):
    return frozenset(text.split())


NUMBERS = words(
    "length width thickness youngs_modulus density taper mass_ratio mass position gap smoothing "
    "stiffness damping dissipation exponent maxwell_stiffness relaxation_time amplitude frequency "
    "start end duration damping_ratio tip_mass joint_damping bearing_damping gravity height "
    "distance base_amplitude limiter_height limiter_distance contact_stiffness contact_damping "
    "joint_damping_time restitution speed force moment_per_volt capacitance resistance inductance "
    "substrate_thickness layer_thickness substrate_modulus layer_modulus substrate_density "
    "layer_density piezoelectric_constant permittivity frequencies"
)
"""What a system is made of: 0 may do, batches and traced values are legal."""
FLAGS = words(
    "tension proportional lyapunov strobes is_ratio align_phase settled progress spectrum "
    "distinguish_phases keep_curves dry_run skip_unusable static_correction maximise relative "
    "stable isolas together"
)
MAKERS = {n for n, (function, _) in CALLS.items() if inspect.isclass(function)}
MAKERS |= {"default_rig", "default_pendulum", "bimorph"}
MAKERS |= {n for n in CALLS if "from_restitution" in n}
SIGNED = words(
    "barrier release direction gap gravity force moment_per_volt free_modes piezoelectric_constant "
    "low high initial_displacement initial_velocity"
)
LEGAL = {
    "None": words("position smoothing refine_jumps"),
    "0": words("seed transient derivative s gap stiffness measurement"),
    "-1": words("side"),
    "list of one": words(
        "frequency frequency_ratio contact_fraction response_map input_map gap stiffness release s "
        "amplitude_deviation contact_force_deviation gap_ratios load frequencies maxwell_stiffness "
        "relaxation_time drive_amplitude"
    ),
    "empty dict": words(
        "deviation units bounds transforms columns parameters measures share_of gain offset delay"
    ),
    "dict": words("parameters share_of"),
    "empty list": words(
        "gradients private split observables notes point_masses stops measures s orders share_of "
        "direction lines gap_ratios index constraints logarithmic maximise"
    ),
    "list of text": words("observables notes"),
    "empty array": words(
        "point_masses stops direction lines measures s orders share_of gap_ratios index constraints"
    ),
    "text": words("label store path"),
    "empty text": words("label frame quantity drive_signal"),
    "class": words("search measures objective function"),
    "lambda": words("search stepper objective function solver"),
    "path": words("store path"),
    "waveform": words("waveform"),
    "matrix": words("s"),
    "tracer": words("frequency frequency_ratio release s"),
    "large integer": words(
        "seed gap stiffness release barrier memory frequency frequency_ratio size longest_step "
        "lines rigid_within low high initial_displacement initial_velocity start_size mass"
    ),
}
"""Junk that is none for some arguments, by hand: not from the annotations that are tested."""
TRACEABLE = words("motion simulate periodic_response lyapunov_exponent Modes.shape")
TRACEABLE |= {"simulate over lists"}
OF_METHODS = words(
    "level threshold phase start stop overlap reference prominence values gap position frequency "
    "gap_ratio reach"
)


def legal(name, argument, junk):
    """Whether a call may take it."""
    if argument == "prepared":  # what a method of stepping put there itself
        return True
    parameter = inspect.signature(CALLS[name][0]).parameters.get(argument)
    if junk == "None" and parameter is not None and parameter.default is None:
        return True
    if junk == "True":
        return argument in FLAGS
    if junk in ("0", "-1") and argument in SIGNED:
        return True
    if "." in name and argument in OF_METHODS:
        return junk in ("0", "-1", "large integer", "tracer", "list of one")
    if name == "design.Constraint" and argument in ("least", "most"):
        return junk in ("0", "-1", "large integer")
    if name == "compare_laws" and argument == "guess":  # of numbers that are not of the laws
        return junk == "empty dict"
    if name == "design.Constraint" and argument == "name":
        return junk in ("text", "empty text")
    if name in MAKERS and argument in NUMBERS:
        return junk in ("0", "matrix", "tracer", "large integer") or argument in LEGAL.get(junk, ())
    if junk == "tracer" and name.split(" by ")[0] not in TRACEABLE:
        return False
    return argument in LEGAL.get(junk, ())


def answer(name, argument, junk):
    """What a call with junk is answered: kind, whether vibrojax says it, the sentence."""
    function, given = CALLS[name]

    def call(value):
        function(**given | {argument: value})

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if isinstance(junk, str) and junk == "tracer":
                jax.eval_shape(lambda value: [call(value)][1:], 1.0)
            else:
                call(JUNK[junk]() if isinstance(junk, str) and junk in JUNK else junk)
        except Reached:
            return "taken", True, ""
        except Exception as error:
            frames = [f.filename for f in traceback.extract_tb(error.__traceback__)]
            frames = [f for f in frames if "_src" not in f and "equinox" not in f]
            return type(error).__name__, "vibrojax" in frames[-1], str(error)
        finally:
            import matplotlib.pyplot as plt

            plt.close("all")
    return "taken", True, ""


def fault(name, argument, junk, kind, by_vibrojax, sentence):
    """What is neither a result that is allowed nor one sentence of vibrojax that names it."""
    case = f"{name}({argument}={junk}): {kind}: {sentence}"
    if kind == "taken":
        return None if legal(name, argument, junk) else case
    named = "|".join(re.escape(n.rstrip("s")) for n in given_names(name))
    says = re.search(rf"\b({named})", sentence) and "\n" not in sentence and len(sentence) < 900
    return None if kind == "ValueError" and by_vibrojax and says else case


def every(junk=FIRST):
    """All arguments of all calls with some kinds of junk."""
    return [(n, a, j) for n in CALLS for a in arguments(n) for j in junk]


def add_methods():
    """Add methods of results, which have to be computed."""
    history = vj.simulate(RIG, frequency=20.0, periods=4)
    histories = vj.simulate(rig, frequency=20.0, gap=[1e-4, 2e-4], periods=4)
    point = vj.periodic_response(RIG, frequency_ratio=1.1)
    sweep = vj.frequency_sweep(
        RIG,
        frequency_ratio=[1.0, 1.1],
        settings=vj.SweepSettings(refine_jumps=None, max_period=2, max_periods=20),
    )
    branch = vj.continue_response(RIG, frequency_ratio=vj.Range(1.05, 1.1))
    pendulum = vj.default_pendulum(num_links=3)
    basins = vj.basins(
        RIG,
        start=start,
        frequency_ratio=1.0,
        displacement=[0.0, 1e-3],
        velocity=[0.0, 1.0],
        settings=vj.BasinSettings(periods=24),
    )
    diagram = vj.bifurcation_diagram(
        RIG,
        frequency_ratio=[1.0, 1.1],
        settings=vj.RegimeSettings(
            transient=20,
            periods=20,
            lyapunov=False,
            max_period=4,
            samples_per_period=32,
            spectrum=False,
        ),
    )
    regimes = vj.regimes(
        RIG,
        frequency_ratio=[1.0],
        settings=vj.RegimeSettings(transient=20, periods=20, lyapunov=False, max_period=4),
    )
    closed = vj.single_contact_response(RIG, frequency_ratio=[1.0, 1.1])
    fit = vj.identify(rig, MEASURED, guess={"stiffness": 5e3}, gap=4e-4, searches=1)
    explorer = vj.explore(rig, gap=vj.Range(3e-4, 5e-4), stiffness=5500.0)
    response = vj.design.respond(rig, gap=4e-4, frequency_ratio=vj.Range(1.05, 1.1))
    spectrum, cycles = history.spectrum(), history.cycles()
    methods = {
        "History": (history, "displacement velocity acceleration spectrum cycles poincare peak"),
        "History.plot": (history, "plot"),
        "Histories": (histories, "cycles plot"),
        "Spectrum": (spectrum, "decibels peaks plot"),
        "EnergyFlow": (history.energy(), "mean_share plot"),
        "PoincareSection": (history.poincare(), "plot"),
        "Cycles": (cycles, "plot"),
        "PeriodicResponse": (point, "history"),
        "FrequencyResponse": (sweep, "plot"),
        "Branch": (branch, "plot"),
        "Basins": (basins, "plot"),
        "BifurcationDiagram": (diagram, "plot"),
        "Regimes": (regimes, "plot"),
        "SingleContactResponse": (closed, "folds plot"),
        "Identification": (fit, "residuals system branch plot"),
        "Explorer": (explorer, "figure"),
        "Response": (response, "peak peak_frequency resonance_shift area mean"),
        "ElasticPendulum": (pendulum, "natural_frequencies linearised"),
    }
    for owner, (result, names) in methods.items():
        for method in names.split():
            CALLS[f"{owner.split('.')[0]}.{method}"] = getattr(result, method), {}
    CALLS["Identification.profile"] = fit.profile, dict(name="stiffness")
    CALLS["Identification.report"] = fit.report, dict(path="report.html")
    CALLS["Identification.what_next"] = fit.what_next, dict(name="stiffness", gap=5e-4)
    CALLS["Basins.name_of"] = basins.name_of, dict(attractor=0)
    CALLS["Regimes.fraction"] = regimes.fraction, dict(kind="chaotic")
    CALLS["Explorer.curve"] = explorer.curve, dict(gap=4e-4)
    CALLS["Explorer.branch"] = explorer.branch, dict(gap=4e-4)
    CALLS["Explorer.orbit"] = explorer.orbit, dict(frequency=40.0)
    CALLS["Explorer.save"] = explorer.save, dict(path="explorer.png")
    for result in ("sweep", "branch", "basins", "diagram", "regimes", "closed"):
        CALLS[f"{result}.save"] = locals()[result].save, dict(path="saved.nc")
    CALLS["History.quantity"] = history.quantity, dict(name="displacement")
    CALLS["Histories.at"] = histories.at, dict(gap=1e-4)
    CALLS["Spectrum.up_to"] = spectrum.up_to, dict(span=50.0)
    CALLS["Cycles.statistics"] = cycles.statistics, dict(edges=[10.0, 30.0])
    CALLS["Branch.resample"] = branch.resample, dict(values=[1.06, 1.07])


def drawn_at_random(examples):
    """Draw junk of any depth for any argument: raise where one is answered badly."""
    from hypothesis import HealthCheck, given, settings
    from hypothesis import strategies as st
    from hypothesis.extra.numpy import array_shapes, arrays

    # Whole numbers that would be taken are few: every number of modes compiles anew.
    whole = st.integers(max_value=2) | st.integers(min_value=10**10)
    plain = st.none() | st.booleans() | whole | st.floats() | st.text(max_size=5)
    never = (
        st.builds(object)
        | st.complex_numbers()
        | st.binary(max_size=5)
        | st.dates()
        | st.sets(st.integers())
        | st.functions(like=lambda *unknown: None)
    )
    nested = st.recursive(
        plain | never,
        lambda inside: (
            st.lists(inside, max_size=3) | st.dictionaries(st.text(max_size=5), inside, max_size=2)
        ),
        max_leaves=5,
    )
    held = arrays(float, array_shapes(max_dims=3, min_side=0, max_side=3))
    functions = words("study system make_system start search stepper measures prepared solver")

    @settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(
        st.sampled_from([case[:2] for case in every(("",))]),
        (never.map(lambda junk: (junk, True))) | (nested | held).map(lambda junk: (junk, False)),
    )
    def holds(call, drawn):
        value, is_never = drawn
        row = answer(*call, value)
        if row[0] == "taken":
            assert not is_never or call[1] in functions, (call, value)
        else:
            assert fault(*call, value, *row) is None, (call, value, row)

    holds()


if __name__ == "__main__":
    public = {n for n in vj.__all__ if inspect.isfunction(getattr(vj, n))}
    assert public <= set(CALLS), "a public function without a call here"
    os.chdir(tempfile.mkdtemp())  # where a path is a name
    thorough = sys.argv[1:] == ["all"]
    if thorough:
        add_methods()
    stop_engines()
    cases = every(tuple(JUNK) if thorough else FIRST)
    print(json.dumps([found for case in cases if (found := fault(*case, *answer(*case)))]))
    if thorough:
        drawn_at_random(2000)
