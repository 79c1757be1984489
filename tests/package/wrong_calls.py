"""Calls that are wrong as a new user gets them wrong; prints what each of them is answered.

A program of its own: in the tests beartype would refuse them first.
"""

import json
import traceback

import jax
import numpy as np

import vibrojax as vj

RIG = vj.default_rig()
BATCH = vj.default_rig(gap=jax.numpy.array([1e-4, 2e-4]))
AT = {"frequency_ratio": 1.1}
MEASURED = vj.io.MeasuredCurve(
    np.array([1.0, 1.1, 1.2]), "frequency_ratio", amplitude=np.array([1.0, 2.0, 3.0])
)


def own_rig(gap, stiffness):
    return vj.default_rig(gap=gap, stiffness=stiffness)


def peak(response):
    return response.peak()


BAND = vj.Range(0.9, 1.3)
CALLS = {
    "length must be a number": lambda: vj.Cantilever("0.2", 0.025, 1e-3, 130e9, 8250.0),
    "law must be a contact law": lambda: vj.Stop(0.5, 1e-3, 5500.0),
    "stops must be a Stop or a list": lambda: vj.ImpactingBeam(RIG.beam, stops=None),
    "drive must be a drive (BaseMotion, NoDrive or PointForce), got 0.0002.": lambda: (
        vj.ImpactingBeam(RIG.beam, drive=2e-4)
    ),
    "max_periods must be a whole number of at least 17": lambda: vj.SweepSettings(max_periods=3),
    "tolerance must be above 0": lambda: vj.RegimeSettings(tolerance=-1.0),
    "period_tolerance must be above 0": lambda: vj.BasinSettings(period_tolerance=0.0),
    "settings must be SweepSettings": lambda: vj.frequency_sweep(RIG, settings="fast", **AT),
    "Settings of a study go into settings=": lambda: vj.frequency_sweep(
        RIG, direction="forward", **AT
    ),
    "gap is a range, Range(low=0.0001": lambda: vj.frequency_sweep(
        vj.default_rig, gap=vj.Range(1e-4, 1e-3), **AT
    ),
    "is a range without width": lambda: vj.Range(1e-3, 1e-4),
    "start must be from 0 to 1": lambda: vj.Range(0.0, 1.0, 2.0),
    "num_modes must be a whole number": lambda: vj.ImpactingBeam(RIG.beam, num_modes=5.0),
    "beam must be a Cantilever, got an ImpactingBeam. Give its beam.": lambda: vj.modes(RIG),
    "s must be a number or a list of numbers, got 'tip'.": lambda: vj.modes(RIG.beam).shape("tip"),
    "frequency_ratio must be a number or a list of numbers, got '1.1'.": lambda: vj.frequency_sweep(
        RIG, frequency_ratio="1.1"
    ),
    "frequency_ratio is empty: give at least one value (ratio).": lambda: vj.frequency_sweep(
        RIG, frequency_ratio=[]
    ),
    "Unknown argument 'frequency_rato'": lambda: vj.frequency_sweep(
        RIG, frequency_rato=[1.0], **AT
    ),
    "Did you mean 'gap'": lambda: vj.frequency_sweep(vj.default_rig, gaps=[1e-3], **AT),
    "needs a value of 'stiffness'": lambda: vj.frequency_sweep(own_rig, gap=[1e-3], **AT),
    "must return a system, got None": lambda: vj.frequency_sweep(lambda gap: None, gap=1e-3, **AT),
    "direction must be one of": lambda: vj.frequency_sweep(
        RIG, **AT, settings=vj.SweepSettings(direction="up")
    ),
    "stepper must be a stepper (ExactContact, ExponentialSplitting or LinearlyImplicit)": lambda: (
        vj.frequency_sweep(RIG, **AT, settings=vj.SweepSettings(stepper="exact"))
    ),
    "tolerance must be a number": lambda: vj.frequency_sweep(
        RIG, **AT, settings=vj.SweepSettings(tolerance="low")
    ),
    "taper must be at least 0": lambda: vj.frequency_sweep(vj.default_rig, taper=[-1e-3], **AT),
    "frequency_ratio must be one number": lambda: vj.periodic_response(
        RIG, frequency_ratio=[1.0, 1.1]
    ),
    "frequency_ratio must be a number, got '1.1'.": lambda: vj.periodic_response(
        RIG, frequency_ratio="1.1"
    ),
    "Call it first: default_rig(...)": lambda: vj.periodic_response(vj.default_rig, **AT),
    "method must be a Shooting or a HarmonicBalance, got 'shooting'.": lambda: vj.periodic_response(
        RIG, **AT, settings=vj.PeriodicSettings(method="shooting")
    ),
    "Give exactly one vj.Range": lambda: vj.continue_response(RIG, frequency_ratio=1.1),
    "own_rig needs a value": lambda: vj.continue_response(
        own_rig, frequency_ratio=vj.Range(0.8, 1.4), gap=1e-3
    ),
    "stepper must be a diffrax solver": lambda: vj.simulate(RIG, periods=3, stepper="rk4", **AT),
    "Call it first: ExactContact(...).": lambda: vj.simulate(
        RIG, periods=3, stepper=vj.ExactContact, **AT
    ),
    "periods must be a number, got '3'.": lambda: vj.simulate(RIG, periods="3", **AT),
    "periods and samples_per_period, samples or": lambda: vj.simulate(RIG, periods=2**63, **AT),
    "duration and samples_per_period, samples or": lambda: vj.simulate(RIG, duration=2**63, **AT),
    "periods must be above 0": lambda: vj.simulate(RIG, periods=-3, **AT),
    "initial_states must be a list": lambda: vj.simulate(RIG, periods=3, initial_states=[], **AT),
    "give frequency (Hz)": lambda: vj.simulate(RIG, periods=3),
    "give it in the call": lambda: vj.parameter_map(own_rig, gap=[1e-3], **AT),
    "make_system must be a function": lambda: vj.parameter_map(RIG, **AT),
    "guess must be a dict of numbers by name, got ['stiffness'].": lambda: vj.identify(
        vj.default_rig, MEASURED, guess=["stiffness"]
    ),
    "Did you mean 'stiffness'": lambda: vj.identify(vj.default_rig, MEASURED, {"stifness": 1.0}),
    "Use regimes for many": lambda: vj.lyapunov_exponent(RIG, frequency=[1.0, 2.0]),
    "study must be a function": lambda: vj.check_resolution(3, RIG),
    "system must be a system": lambda: vj.basins(3, **AT),
    "height must be above 0 (hinge) and at most 0.03 m": lambda: vj.default_pendulum(
        length=np.array([0.2, 0.03])
    ),
    "mass must be": lambda: vj.MatrixSystem(1.0, 1.0, 1.0, response_map=[1.0]),
    "stiffness must be a number, got None.": lambda: vj.KelvinVoigt(None),
    "amplitude must be a number, got None.": lambda: vj.BaseMotion(None),
    "Cantilever needs width": lambda: vj.Cantilever(0.2),
    "Unknown argument 'lenght' of Cantilever. Did you mean 'length'?": lambda: vj.Cantilever(
        lenght=0.2, width=0.025, thickness=1e-3, youngs_modulus=130e9, density=8250.0
    ),
    "length is given twice": lambda: vj.Cantilever(0.2, length=0.2),
    "Only amplitude may be given to BaseMotion without a name, got 20.0 beyond.": lambda: (
        vj.BaseMotion(1e-3, 20.0)
    ),
    "tolerance must be a number, got [0.0001]. Give what is in the list.": lambda: (
        vj.frequency_sweep(RIG, **AT, settings=vj.SweepSettings(tolerance=[1e-4]))
    ),
    "tolerance must be a number, got None.": lambda: vj.frequency_sweep(
        RIG, **AT, settings=vj.SweepSettings(tolerance=None)
    ),
    "guess must be a PeriodicResponse": lambda: vj.periodic_response(RIG, guess="x", **AT),
    "MatrixSystem or StateSpace), got 'x'": lambda: vj.single_contact_response("x", **AT),
    "path must be a path, got None.": lambda: vj.io.read_rig(None),
    "store must be a path, got 3.": lambda: vj.parameter_map(own_rig, store=3, **AT),
    "measures must be": lambda: vj.parameter_map(own_rig, measures=3, **AT),
    "gradients must be a text or a list of texts, got 3.": lambda: vj.parameter_map(
        own_rig, gradients=3, **AT
    ),
    "system holds a batch, and this call takes one: its gap has the shape (3,)": lambda: (
        vj.periodic_response(vj.default_rig(gap=np.array([1e-4, 2e-4, 3e-4])), **AT)
    ),
    "system holds a batch": lambda: vj.frequency_sweep(BATCH, **AT),
    "its stiffness has the shape (2,)": lambda: vj.parameter_map(
        lambda gap: vj.default_rig(gap=gap, stiffness=np.array([1e3, 2e3])), gap=[1e-4], **AT
    ),
    "frequency_sweep cannot be traced by JAX": lambda: jax.jit(
        lambda ratio: vj.frequency_sweep(RIG, frequency_ratio=ratio).peak_ratio
    )(1.1),
    "parameter_map(gradients=...)": lambda: jax.grad(
        lambda gap: vj.parameter_map(own_rig, gap=gap, stiffness=1e3, **AT)
    )(1e-3),
    "These studies can: modes, motion, simulate, periodic_response": lambda: jax.vmap(
        lambda gap: vj.continue_response(
            vj.default_rig(gap=gap), frequency_ratio=vj.Range(0.9, 1.1)
        )
    )(np.array([1e-4, 2e-4])),
    "This study cannot be traced by JAX": lambda: jax.grad(
        lambda gap: vj.frequency_sweep(lambda: vj.default_rig(gap=gap), **AT)
    )(1e-3),
    "variables['gap'] must be a low bound and a higher one": lambda: vj.optimise(
        own_rig, peak, variables={"gap": (1e-3, 1e-4)}, stiffness=5e3, frequency_ratio=BAND
    ),
    "in variables. Did you mean 'gap'": lambda: vj.optimise(
        own_rig, peak, variables={"gpa": (1e-4, 1e-3)}, stiffness=5e3, frequency_ratio=BAND
    ),
    "constraints[0] must be a Constraint": lambda: vj.optimise(
        own_rig,
        peak,
        variables={"gap": (1e-4, 1e-3)},
        constraints=[peak],
        stiffness=5e3,
        frequency_ratio=BAND,
    ),
    "Designs need stops that are linear": lambda: vj.optimise(
        lambda gap: vj.ImpactingBeam(
            RIG.beam, vj.Stop(0.5, gap, vj.Hertz(1e6)), vj.BaseMotion(1e-4)
        ),
        peak,
        variables={"gap": (1e-4, 1e-3)},
        frequency_ratio=BAND,
    ),
    "Give at least one number of the rig by name": lambda: vj.design.respond(
        vj.default_rig, frequency_ratio=BAND
    ),
    "distributions['gap'] must be a continuous distribution": lambda: vj.propagate(
        own_rig, {"gap": 1e-4}, {"peak": peak}, stiffness=5e3, frequency_ratio=BAND
    ),
    "objectives must be two functions by name": lambda: vj.design.pareto(
        own_rig, {"peak": peak}, variables={"gap": (1e-4, 1e-3)}, frequency_ratio=BAND
    ),
    "width must be below 1": lambda: vj.design.Tolerance(20.0, relative=True),
    "A Constraint needs a bound": lambda: vj.design.Constraint(peak),
    "limiters must be Limiters, got 3.": lambda: vj.ElasticPendulum(
        0.2, 0.01, 1e-3, 3e8, 850.0, limiters=3
    ),
    "stepper must be": lambda: vj.Shooting(stepper="Tsit5"),
    "point_masses[0] must be a PointMass, got 0.01.": lambda: vj.Cantilever(
        0.2, 0.025, 1e-3, 130e9, 8250.0, point_masses=[0.01]
    ),
}


def answer(call):
    try:
        call()
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1].filename
        return type(error).__name__, "vibrojax" in place, str(error)
    return "nothing", False, ""


if __name__ == "__main__":
    print(json.dumps({words: answer(call) for words, call in CALLS.items()}))
