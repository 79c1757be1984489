"""A piezoelectric bimorph without stops beside closed forms, and what a stop does to its power.

python experiments/piezo_harvester/run.py            # two to three minutes
python experiments/piezo_harvester/run.py --coarse   # a minute
"""

import argparse
import json
from pathlib import Path

import matplotlib
import numpy as np

import vibrojax as vj

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
LOADS = np.array([1e2, 1e3, 6.7e3, 3.3e4, 1e5, 4.7e5])
"""Load resistances of the linear case, ohm."""
BASE = 50e-6
"""Amplitude of the base, m: 4 m/s2 at resonance."""
BRASS = 9000.0 * 0.14e-3 + 2 * 7800.0 * 0.26e-3
"""Mass per area of the bimorph, kg/m2."""


def make(
    *,
    resistance: float = 1e5,
    gap: float = 1e-3,
    stiffness: float = 5e3,
    damping: float = 0.5,
    report: str = "power",
    with_stop: bool = True,
) -> vj.Harvester:
    """Make the bimorph of Erturk and Inman 2009, its tip mass 12 g, with a stop at the tip."""
    beam, layers = vj.model.bimorph(
        length=50.8e-3,
        width=31.8e-3,
        substrate_thickness=0.14e-3,
        layer_thickness=0.26e-3,
        substrate_modulus=105e9,
        layer_modulus=66e9,
        substrate_density=9000.0,
        layer_density=7800.0,
        piezoelectric_constant=-12.54,
        permittivity=1500 * 8.854e-12,
        connection="series",
        mass_ratio=0.012 / (BRASS * 31.8e-3 * 50.8e-3),
    )
    stop = vj.Stop(1.0, gap, vj.KelvinVoigt(stiffness, damping))
    stops = (stop,) if with_stop else ()
    rig = vj.ImpactingBeam(beam, stops, vj.BaseMotion(BASE), damping_ratio=0.027, num_modes=3)
    return vj.Harvester(rig, layers, resistance=resistance, report=report)


def closed_form(system: vj.Harvester, frequency: np.ndarray) -> np.ndarray:
    """Voltage (complex, V) of the harvester without stops, Erturk and Inman 2009, by its modes."""
    beam = system.rig.equations()
    w = 2 * np.pi * np.asarray(frequency)[:, None]
    natural, mass = np.asarray(beam.angular_frequency), np.asarray(beam.modal_mass)
    theta = np.asarray(system.coupling())
    dynamic = natural**2 - w**2 + 2j * np.asarray(beam.damping_ratio) * natural * w
    source = np.sum(1j * w * theta * np.asarray(beam.input_map) * w**2 * BASE / dynamic, axis=1)
    inner = 1j * w[:, 0] * (system.layers.capacitance + np.sum(theta**2 / mass / dynamic, axis=1))
    return source / (1 / system.resistance + inner)


def linear(coarse: bool) -> dict:
    """Sweeps without stop beside the closed form, and the best load of every frequency."""
    grid = np.linspace(35.0, 60.0, 26 if coarse else 51)
    frequencies, worst, panels = (
        np.linspace(35.0, 60.0, 501),
        0.0,
        plt.subplots(1, 2, figsize=(10, 4)),
    )
    figure, (left, right) = panels
    for k, load in enumerate(LOADS):
        system = make(resistance=load, with_stop=False)
        sweep = vj.frequency_sweep(
            system, frequency=grid, settings=vj.SweepSettings(direction="forward")
        )
        exact = np.abs(closed_form(system, grid)) ** 2 / 2 / load
        worst = max(worst, float(np.max(np.abs(sweep.mean_power[0] / exact - 1))))
        label = f"{load / 1e3:g} kOhm"
        power = np.abs(closed_form(system, frequencies)) ** 2 / 2 / load
        left.semilogy(frequencies, 1e3 * power, color=f"C{k}", label=label)
        left.plot(grid, 1e3 * sweep.mean_power[0], ".", color=f"C{k}", markersize=4)
    left.set(xlabel="Drive frequency (Hz)", ylabel="Mean power (mW)", ylim=(1e-5, None))
    left.set_title("Lines: closed form, dots: sweeps")
    left.legend(fontsize=8, title="Load", loc="lower center", ncols=2)
    some, loads = make(with_stop=False), np.geomspace(1e3, 1e6, 400)
    short = float(some.rig.modes().frequency[0])
    far = make(resistance=1e9, with_stop=False)
    opened = frequencies[np.argmax(np.abs(closed_form(far, frequencies)))]
    off = []
    for k, frequency in enumerate((short, opened, 42.0)):
        power = [
            abs(closed_form(make(resistance=r, with_stop=False), np.array([frequency]))[0]) ** 2
            / 2
            / r
            for r in loads
        ]
        best = float(some.optimal_resistance(frequency))
        off.append(best / loads[int(np.argmax(power))] - 1)
        right.loglog(loads / 1e3, 1e3 * np.array(power), color=f"C{k}", label=f"{frequency:.1f} Hz")
        right.axvline(best / 1e3, color=f"C{k}", linestyle=":")
    right.set(xlabel="Load resistance (kOhm)", ylabel="Mean power (mW)")
    right.set_title("Dotted: optimal_resistance")
    right.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(HERE / "linear.png", dpi=120)
    return {
        "short_circuit_frequency": short,
        "open_circuit_frequency": float(opened),
        "worst_relative_difference_of_power": worst,
        "optimal_load_by_frequency": {
            f"{f:.2f} Hz": float(some.optimal_resistance(f)) for f in (short, opened)
        },
        "largest_distance_from_the_best_of_400_loads": float(np.max(np.abs(off))),
    }


def bandwidth(power: np.ndarray, frequency: np.ndarray) -> float:
    """Width, Hz, of the band in which a sweep has more than half of its largest power."""
    fine = np.linspace(frequency[0], frequency[-1], 4001)
    above = np.interp(fine, frequency, power) >= power.max() / 2
    return float(above.sum() * (fine[1] - fine[0]))


def with_stop(coarse: bool) -> list[dict]:
    """Peak power and bandwidth at half power over gap and load, in both directions."""
    frequency = np.linspace(38.0, 62.0, 49 if coarse else 121)
    gaps = [0.2e-3, 0.3e-3, 0.4e-3, 0.5e-3, 5e-3]
    loads = [1e4, 1e5] if coarse else [1e4, 3e4, 1e5, 3e5]
    maps = vj.parameter_map(make, gap=gaps, resistance=loads, frequency=frequency)
    rows = []
    for gap in gaps:
        for load in loads:
            at = maps.sel(gap=gap, resistance=load)["mean_power"]
            row = {"gap_mm": 1e3 * gap, "load_kohm": load / 1e3}
            for direction in ("forward", "backward"):
                power = at.sel(direction=direction).values
                row[f"peak_{direction}_mW"] = 1e3 * float(np.nanmax(power))
                row[f"bandwidth_{direction}_Hz"] = bandwidth(np.nan_to_num(power), frequency)
            rows.append(row)
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.2))
    names = [f"{1e3 * gap:g}" for gap in gaps[:-1]] + ["none"]
    for k, (gap, name) in enumerate(zip(gaps, names, strict=True)):
        at = maps.sel(gap=gap, resistance=1e5)["mean_power"]
        axes[0].plot(frequency, 1e3 * at.sel(direction="forward"), color=f"C{k}", label=name)
        axes[0].plot(frequency, 1e3 * at.sel(direction="backward"), "--", color=f"C{k}")
    axes[0].set(xlabel="Drive frequency (Hz)", ylabel="Mean power (mW)")
    axes[0].set_title("100 kOhm: swept up solid, down dashed")
    axes[0].legend(fontsize=8, title="Gap (mm)")
    for panel, name, label in (
        (axes[1], "peak", "Peak of the mean power (mW)"),
        (axes[2], "bandwidth", "Bandwidth at half power (Hz)"),
    ):
        unit = "mW" if name == "peak" else "Hz"
        for k, load in enumerate(loads):
            own = [r for r in rows if r["load_kohm"] == load / 1e3]
            up, down = ([r[f"{name}_{d}_{unit}"] for r in own] for d in ("forward", "backward"))
            panel.plot(names, up, "o-", color=f"C{k}", label=f"{load / 1e3:g}")
            panel.plot(names, down, "v--", color=f"C{k}", fillstyle="none")
        panel.set(xlabel="Gap (mm)", ylabel=label)
        panel.set_title("Swept up solid, down dashed")
        panel.legend(fontsize=8, title="Load (kOhm)")
    figure.tight_layout()
    figure.savefig(HERE / "stops.png", dpi=120)
    return rows


def main() -> None:
    """Compute everything and write results and pictures beside this file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--coarse", action="store_true", help="fewer points, in a minute")
    coarse = parser.parse_args().coarse
    found = {"linear": linear(coarse), "stops": with_stop(coarse)}
    (HERE / "results" / "results.json").write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
