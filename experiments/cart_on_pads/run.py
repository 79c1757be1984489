"""Fits of a cart that hits two pads: each run alone, all together, one left out, five laws.

python experiments/cart_on_pads/run.py                # twenty minutes
python experiments/cart_on_pads/run.py --only alone   # one part: the others stay as they are
"""

import argparse
import json

import matplotlib
import numpy as np
from cart import DEVIATION, GUESS, HERE, MASS, PADS, RUNS, cart, mass_by_impulse, records, with_law

import vibrojax as vj

matplotlib.use("Agg")
import matplotlib.pyplot as plt

RESULTS = HERE / "results.json"
MISFIT = "The model does not explain the data"


def summary(fit) -> dict:
    """Estimates, intervals, misfit and what was warned of."""
    residual = np.concatenate([p.residual.values for p in fit.predictions])
    channel = np.concatenate([p.channel.values for p in fit.predictions])
    rms = {
        name: DEVIATION[name] * float(np.sqrt(np.mean(residual[channel == name] ** 2)))
        for name in DEVIATION
        if name in channel
    }
    return {
        "estimate": fit.estimate,
        "interval": {name: list(bounds) for name, bounds in fit.interval.items()},
        "identifiable": fit.identifiable,
        "rms": rms,
        "reduced_chi_square": fit.chi_square / fit.degrees_of_freedom,
        "misfit_warning": any(MISFIT in text for text in fit.warnings),
        "warnings": list(fit.warnings),
    }


def alone() -> dict:
    """Each run by its force alone, the mass held, and a picture of all."""
    figure, panels = plt.subplots(2, 5, figsize=(13, 6), sharey="row", layout="constrained")
    found = {}
    for row, pad in zip(panels, PADS, strict=True):
        found[f"{pad} mm"] = {}
        for panel, (name, run) in zip(row, records(pad).items(), strict=True):
            fit = vj.identify(cart, run, GUESS, mass=MASS)
            found[f"{pad} mm"][name] = summary(fit)
            draw(panel, fit)
            panel.set_title(f"{pad} mm, {name}", fontsize=10)
        row[0].set_ylabel("contact force (N)")
    for panel in panels[1]:
        panel.set_xlabel("time (s)")
    panels[0, 0].legend(fontsize=8)
    figure.savefig(HERE / "alone.png", dpi=110)
    return found


def draw(panel: plt.Axes, fit) -> None:
    """Draw the force that was measured and the one that was fitted; the sensor turns it."""
    one = fit.predictions[0]
    panel.plot(one.measured_time, -one.measured_value, ".", color="0.3", label="measured")
    panel.plot(one.measured_time, -one.fitted_value, color="#d1590a", lw=1.3, label="fitted")
    panel.grid(alpha=0.3)


def with_velocity() -> dict:
    """Each run on the thick pad by force and velocity, which is on a clock of its own."""
    wanted = GUESS | {"mass": 0.5, "velocity_delay": None}
    runs = records(40, velocity=True)
    return {name: summary(vj.identify(cart, run, wanted)) for name, run in runs.items()}


def without_mass() -> dict:
    """The force alone, the mass fitted too."""
    return summary(vj.identify(cart, records(40)["Run 4"], GUESS | {"mass": 0.5}))


def together() -> dict:
    """All runs on the thick pad, and all but one."""
    runs = records(40)
    kept = {"none": RUNS} | {out: [name for name in RUNS if name != out] for out in RUNS}
    return {
        f"without {out}": summary(
            vj.identify(
                cart, [runs[name] for name in names], GUESS, private=["initial_velocity"], mass=MASS
            )
        )
        for out, names in kept.items()
    }


def laws(pad: int) -> dict:
    """Five laws beside each other on one pad: criteria, and what they foretell of runs left out."""
    compared = vj.compare_laws(
        with_law,
        list(records(pad).values()),
        {"initial_velocity": None},
        private=["initial_velocity"],
        mass=MASS,
    )
    compared.plot().savefig(HERE / f"laws_{pad:02d}mm.png", dpi=90)
    data = compared.to_xarray()
    print(compared)
    rows = {
        str(law): {
            **{name: float(data[name].sel(law=law)) for name in ("akaike", "bayes")},
            "left_out": data["foretold"].sel(law=law).values.tolist(),
            **summary(compared.fits[str(law)]),
        }
        for law in data["law"].values
    }
    return {"best": compared.best, "warnings": list(compared.warnings), "laws": rows}


PARTS = {
    "mass": lambda: {f"{pad} mm": mass_by_impulse(pad) for pad in PADS},
    "alone": alone,
    "with_velocity": with_velocity,
    "without_mass": without_mass,
    "together": together,
    "laws_40mm": lambda: laws(40),
    "laws_04mm": lambda: laws(4),
}


def main() -> None:
    """Compute all parts, or one, and write results and pictures beside this file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=PARTS, help="compute this part only")
    only = parser.parse_args().only
    for name, part in PARTS.items():
        if only in (None, name):
            computed = part()
            found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
            found[name] = computed
            RESULTS.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
