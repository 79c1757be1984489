"""Compute ours beside every reference of tests/data and write docs/validation.json.

python docs/validation_numbers.py              all tables, some ten minutes, most of it compiling
python docs/validation_numbers.py modes folds  only these; the others are kept as they are
"""

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import vibrojax as vj

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from finite_element_beam import FiniteElementBeam  # noqa: E402

RESULT = Path(__file__).with_name("validation.json")
DIRECTIONS = ("forward", "backward")
NEAR_A_JUMP = 5e-3
"""Points closer to a jump than this share of the frequency are on either branch: not compared."""


def data(name):
    """Read one of the references."""
    return json.loads((ROOT / "tests" / "data" / f"{name}.json").read_text())


def relative(ours, reference, floor=0.0):
    """Return the largest relative difference; what is below `floor` counts as that much."""
    ours, reference = np.asarray(ours, float), np.asarray(reference, float)
    return float(np.max(np.abs(ours - reference) / np.maximum(np.abs(reference), floor)))


def rig_of(case):
    """Make the rig of one case of sweeps.json."""
    p = case["parameters"]
    return vj.default_rig(
        taper=p["mu"],
        mass_ratio=p["mr"],
        gap=p["lam"],
        position=p["s1"],
        formulation=p["variant"],
        num_modes=p["n_modes"],
    )


def beam_of(taper, mass_ratio):
    """Make the beam of the references, whose beta and shapes depend on these two only."""
    return vj.default_rig(taper=taper, mass_ratio=mass_ratio).beam


def modes():
    """Compare the first 8 modes."""
    reference = data("modes")
    rows = []
    for case in reference["cases"]:
        found = vj.modes(beam_of(case["mu"], case["Mr"]), num_modes=8)
        beta = np.array([mode["beta"] for mode in case["modes"]])
        norm = np.array([mode["modal_mass_consistent"] for mode in case["modes"]]) ** -0.5
        shapes = np.array([mode["phi"] for mode in case["modes"]]).T * norm
        participation = np.array([mode["participation_consistent"] for mode in case["modes"]])
        rows.append(
            {
                "taper": case["mu"],
                "mass ratio": case["Mr"],
                "beta 1, reference": beta[0],
                "beta 1, vibrojax": float(found.beta[0]),
                "beta 8, reference": beta[7],
                "beta 8, vibrojax": float(found.beta[7]),
                "largest relative difference of 8 betas": relative(found.beta, beta),
                "of 8 shapes at 5 places, over the largest value": float(
                    np.abs(found.shape(reference["points_s"]) - shapes).max() / np.abs(shapes).max()
                ),
                "of 8 participations, over the largest": float(
                    np.abs(found.participation - participation / norm).max()
                    / np.abs(participation / norm).max()
                ),
            }
        )
    return rows


def modes_12():
    """Compare the first 12 modes."""
    reference = data("modes_12")
    rows = []
    for case in reference["cases"]:
        found = vj.modes(beam_of(case["taper"], case["mass_ratio"]), num_modes=12)
        rows.append(
            {
                "taper": case["taper"],
                "mass ratio": case["mass_ratio"],
                "beta 12, reference": case["beta"][11],
                "beta 12, vibrojax": float(found.beta[11]),
                "largest relative difference of 12 betas": relative(found.beta, case["beta"]),
            }
        )
    return rows


def in_contact():
    """Compare the first frequency of the beam fixed to the spring of its stop."""
    rows = []
    for taper, mass_ratio in ((0.0, 0.5), (0.5, 0.5), (0.5, 5.0)):
        beam = beam_of(taper, mass_ratio)
        stop = vj.default_rig().stops[0]
        spring = stop.law.stiffness * beam.length**3 / (beam.youngs_modulus * beam.root_inertia)
        elements = 40
        whole = FiniteElementBeam(taper, mass_ratio, 3 * elements + 1, elements)
        wanted = _first_frequency(
            whole.beta, whole.shape(np.array([stop.position]))[0], 1.0, spring
        )
        scale = float(beam.frequency_scale) / (2 * np.pi)
        row = {"taper": taper, "mass ratio": mass_ratio, "finite elements (Hz)": wanted * scale}
        differences = {}
        for words, num_modes, formulation in (
            ("consistent, 5 modes", 5, "consistent"),
            ("consistent, 1 mode", 1, "consistent"),
            ("as printed, 5 modes", 5, "as_printed"),
            ("as printed, 12 modes", 12, "as_printed"),
        ):
            found = vj.modes(beam, num_modes, formulation)
            ours = _first_frequency(
                np.asarray(found.beta),
                np.asarray(found.shape(stop.position)),
                np.asarray(found.modal_mass) / float(beam.reference_mass),
                spring,
            )
            if num_modes == 5:
                row[f"{words} (Hz)"] = ours * scale
            differences[f"difference: {words}"] = f"{ours / wanted - 1:+.2%}"
        rows.append(row | differences)
    return rows


def _first_frequency(beta, shape, modal_mass, spring):
    """Return beta^2 of the lowest mode with a spring at the stop."""
    stiffness = np.diag(beta**4) + spring * np.outer(shape / modal_mass, shape)
    return np.sqrt(np.linalg.eigvals(stiffness).real.min())


def sweeps():
    """Compare settled sweeps at default settings, away from jumps."""
    rows = []
    for name, case in data("sweeps")["cases"].items():
        listed = sorted(set(case["forward"]["ratio"]) & set(case["backward"]["ratio"]))
        curve = vj.frequency_sweep(rig_of(case), frequency_ratio=listed)
        jumps = np.array([case["jump_up"], case["jump_down"]])
        pairs = {"amplitude_ratio": "half_pp_ratio", "contact_force": "max_contact_force"}
        worst, compared, other = dict.fromkeys(pairs, 0.0), 0, 0
        for k, direction in enumerate(DIRECTIONS):
            at = {ratio: i for i, ratio in enumerate(case[direction]["ratio"])}
            for i, ratio in enumerate(listed):
                period = case[direction]["period"][at[ratio]]
                if (np.abs(ratio / jumps - 1) < NEAR_A_JUMP).any() or period == 0:
                    continue
                if curve.period[k, i] != period:
                    other += 1
                    continue
                compared += 1
                for ours, theirs in pairs.items():
                    wanted = case[direction][theirs][at[ratio]]
                    difference = relative(getattr(curve, ours)[k, i], wanted, floor=1e-9)
                    worst[ours] = max(worst[ours], difference)
        rows.append(
            {
                "rig": name,
                "points compared": compared,
                "of another period": other,
                "largest relative difference of amplitude": worst["amplitude_ratio"],
                "of contact force": worst["contact_force"],
                "jump up, reference": case["jump_up"],
                "jump up, sweep": float(curve.jump_up),
                "jump down, reference": case["jump_down"],
                "jump down, sweep": float(curve.jump_down),
            }
        )
    return rows


def folds():
    """Compare folds of branches with the refined jumps."""
    rows = []
    for name, case in data("sweeps")["cases"].items():
        ratios = [r for direction in DIRECTIONS for r in case[direction]["ratio"]]
        margin = 5e-3
        branch = vj.continue_response(
            rig_of(case), frequency_ratio=vj.Range(min(ratios) - margin, max(ratios) + margin)
        )
        row = {"rig": name}
        for jump in ("jump_up", "jump_down"):
            fold = branch.folds[np.abs(branch.folds - case[jump]).argmin()]
            label = jump.replace("_", " ")
            row |= {
                f"{label}, reference": case[jump],
                f"{label}, fold": float(fold),
                f"{label}, relative difference": relative(fold, case[jump]),
            }
        rows.append(row)
    return rows


def single_contact():
    """Compare stable motions, each solved from the state of the reference."""
    sweeps_of, rows = data("sweeps")["cases"], []
    cases = data("single_contact")["cases"]
    count = max(len(case["ratio"]) for case in cases.values())
    for name, case in cases.items():
        one = rig_of(sweeps_of[name])
        tip = np.asarray(vj.modes(one.beam, one.num_modes, one.formulation).shape(1.0))
        # All cases as long as the longest, so that it compiles once for each formulation.
        at = np.resize(np.arange(len(case["ratio"])), count)
        found = _solve(
            jax.tree.map(lambda number: jnp.asarray(number, float), one),
            jnp.asarray(np.array(case["ratio"])[at]),
            jnp.asarray((np.array(case["state0"]) / np.tile(tip, 2))[at]),
        )
        rows.append(
            {
                "rig": name,
                "motions": len(case["ratio"]),
                "found": int((np.asarray(found.status)[: len(case["ratio"])] == 0).sum()),
                "largest relative difference of amplitude": relative(
                    found.amplitude_ratio, np.array(case["half_pp_ratio"])[at]
                ),
                "of contact force": relative(
                    found.contact_force, np.array(case["max_contact_force"])[at]
                ),
                "largest difference of leading multiplier": float(
                    np.abs(found.leading_multiplier - np.array(case["max_multiplier"])[at]).max()
                ),
            }
        )
    return rows


@eqx.filter_jit
def _solve(one, ratios, states):
    def solve(ratio, state):
        return vj.periodic_response(one, frequency_ratio=ratio, guess=state)

    return jax.vmap(solve)(ratios, states)


def soft_support():
    """Compare releases onto a soft support."""
    reference = data("soft_support")
    p, rows = reference["parameters"], []
    reference_mass = p["rho"] * p["b"] * p["h"] * p["L"]
    for case in reference["free"]:
        ratio = case.get("tip_mass", 0.0) / reference_mass
        beam = vj.Cantilever(p["L"], p["b"], p["h"], p["E"], p["rho"], mass_ratio=ratio)
        law = vj.KelvinVoigt(p["k1"], case["c1"], case.get("law") != "no_tension")
        rig = vj.ImpactingBeam(
            beam, vj.Stop(1.0, p["gap"], law, side=-1), damping_ratio=p["zeta"], num_modes=5
        )
        history = vj.simulate(
            rig, release=case["x0"], duration=0.5, samples_per_period=256, tolerance=1e-8
        )
        contacts = history.contacts()
        first = np.nan
        if case["contacts"]:
            ours = (contacts.touch[0], contacts.departure[0])
            first = float(np.abs(np.subtract(ours, case["first_contact"])).max())
        force = float(history.peak("contact_force").value)
        acceleration = abs(float(history.peak("acceleration").value)) / p["g"]
        rows.append(
            {
                "release (mm)": 1e3 * case["x0"],
                "contact damping (N s/m)": case["c1"],
                "tension": "yes" if case.get("law") != "no_tension" else "no",
                "contacts, reference": case["contacts"],
                "contacts, vibrojax": len(contacts),
                "times of the first contact, difference (s)": first,
                "peak force, reference (N)": case["peak_force"],
                "peak force, vibrojax (N)": force,
                "peak force, relative difference": relative(force, case["peak_force"], 1e-9),
                "peak acceleration, reference (g)": case["peak_acc_g"],
                "peak acceleration, vibrojax (g)": acceleration,
                "peak acceleration, relative difference": relative(
                    acceleration, case["peak_acc_g"]
                ),
            }
        )
    return rows


def pendulum():
    """Compare the elastic pendulum of 17 links."""
    reference, links = data("pendulum"), 17
    whole = vj.default_pendulum()
    equations, rows = whole.equations(), []

    def row(quantity, wanted, found, difference, kind):
        rows.append(
            {
                "quantity": quantity,
                "reference": wanted,
                "vibrojax": found,
                "largest difference": difference,
                "difference is": kind,
            }
        )

    frequencies = reference["linear_frequencies_hz"]
    for support, name, count in (
        ("hinged", "hinged_tip_gravity", links),
        ("clamped", "clamped_tip_gravity", 4),
    ):
        found = np.asarray(whole.natural_frequencies(support))[:count]
        wanted = frequencies[name]
        row(
            f"natural frequencies, {support}, first of {count} (Hz)",
            wanted[0],
            float(found[0]),
            relative(found, wanted),
            "relative, all of them",
        )
    off = [
        relative(
            equations.acceleration(jnp.array(c["alpha"]), jnp.array(c["omega"]), -c["ax0"]),
            c["acc"],
        )
        for c in reference["rhs_vectors"]
    ]
    row(f"accelerations in {len(off)} states", None, None, max(off), "relative")
    well = reference["static_well"]
    force = float(np.max(equations.contact_forces(jnp.array(well["alpha"]), jnp.zeros(links))))
    row(
        "force at rest on a limiter (N)",
        well["contact_force"],
        force,
        relative(force, well["contact_force"]),
        "relative",
    )
    case = reference["forced_5p7Hz"]
    for step in (2e-4, 1e-4):
        history = vj.simulate(
            whole,
            frequency=case["f"],
            duration=case["t"][-1],
            samples=len(case["t"]),
            initial_state=(np.full(links, case["alpha0"]), np.zeros(links)),
            stepper=vj.LinearlyImplicit(longest_step=step),
        )
        angle = np.asarray(history.coordinates)[1:, 0]
        row(
            f"bearing angle over {case['t'][-1]:g} s of impacts, last value, steps of {step:g} s"
            " (rad)",
            case["alpha1"][-1],
            float(angle[-1]),
            float(np.abs(angle - case["alpha1"]).max()),
            "absolute, whole course",
        )
    return rows


def conservation():
    """Follow the pendulum without damping and limiters against the reference."""
    from dataclasses import replace

    case, links = data("pendulum")["conservative"], 17
    free = replace(
        vj.default_pendulum(),
        joint_damping=0.0,
        bearing_damping=0.0,
        limiters=None,
        drive=vj.NoDrive(),
    )
    history = vj.simulate(
        free,
        frequency=5.0,
        duration=0.2,
        samples=40,
        initial_state=(np.array(case["alpha0"]), np.zeros(links)),
        stepper=diffrax.Dopri8(),
        tolerance=1e-11,
    )
    equations = free.equations()
    energy = jax.vmap(equations.kinetic_energy)(history.coordinates, history.rates)
    energy += jax.vmap(equations.potential_energy)(history.coordinates)
    at = np.round(np.array(case["t"]) / 0.2 * 40).astype(int)
    angles = float(np.abs(np.asarray(history.coordinates)[at] - case["alpha"]).max())
    return [
        {
            "quantity": "energy (J)",
            "reference": case["E0"],
            "vibrojax, last": float(energy[-1]),
            "largest difference over 0.2 s": relative(energy, case["E0"]),
            "difference is": "relative",
        },
        {
            "quantity": "angles of all links (rad)",
            "reference": None,
            "vibrojax, last": None,
            "largest difference over 0.2 s": angles,
            "difference is": "absolute",
        },
    ]


def gradients():
    """Compare derivatives of a steady state."""
    names = {
        "Ks": "stiffness (N/m)",
        "Cs": "damping (N s/m)",
        "lam": "gap (m)",
        "Omega": "angular frequency (rad/s)",
        "zeta": "damping ratio",
    }
    case = data("gradients")["cases"][0]
    p = case["parameters"]
    beam = vj.Cantilever(
        p["L"], p["b0"], p["h"], p["E"], p["rho"], taper=p["mu"], mass_ratio=p["mr"]
    )
    tip = np.asarray(vj.modes(beam, p["n_modes"]).shape(1.0))
    guess = np.array(case["state0"]) / np.tile(tip, 2)

    def outputs(theta):
        stiffness, damping, gap, frequency, ratio = theta
        law = vj.KelvinVoigt(stiffness, damping, tension=p["law"] == "printed")
        one = vj.ImpactingBeam(
            beam,
            vj.Stop(p["s1"], gap, law),
            vj.BaseMotion(p["sigma"]),
            damping_ratio=ratio,
            num_modes=p["n_modes"],
            formulation=p["variant"],
        )
        found = vj.periodic_response(one, frequency=frequency / (2 * np.pi), guess=guess)
        return jnp.stack([found.peak_ratio * p["sigma"], found.contact_force])

    at = jnp.array([case["Omega"] if name == "Omega" else p[name] for name in names])
    found = jax.jit(jax.jacfwd(outputs))(at)
    rows = []
    for row, (quantity, key) in enumerate(
        (("peak displacement (m)", "d_tip_peak"), ("contact force (N)", "d_force"))
    ):
        for column, (name, words) in enumerate(names.items()):
            wanted = case["gradients"][name][key]
            rows.append(
                {
                    "derivative of": quantity,
                    "by": words,
                    "reference": wanted,
                    "vibrojax": float(found[row, column]),
                    "relative difference": relative(found[row, column], wanted),
                }
            )
    return rows


TABLES = {
    maker.__name__: maker
    for maker in (
        modes,
        modes_12,
        in_contact,
        sweeps,
        folds,
        single_contact,
        gradients,
        soft_support,
        pendulum,
        conservation,
    )
}


def main(asked):
    """Make the tables that are asked for and keep the others."""
    result = json.loads(RESULT.read_text()) if RESULT.exists() else {"tables": {}}
    result["command"] = "python docs/validation_numbers.py"
    for name in asked or TABLES:
        began = time.perf_counter()
        result["tables"][name] = {
            "rows": TABLES[name](),
            "vibrojax": vj.__version__,
            "jax": version("jax"),
        }
        print(f"{name}: {time.perf_counter() - began:.0f} s", flush=True)
        text = json.dumps(result, indent=1, allow_nan=True).replace("NaN", "null")
        RESULT.write_text(text + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
