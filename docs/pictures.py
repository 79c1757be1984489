"""Make docs/branch_and_sweep.png, docs/map.png, docs/explorer.png and docs/fit.png.

python docs/pictures.py            some minutes, the map most of it
python docs/pictures.py explorer   only these
"""

import sys
from pathlib import Path

import numpy as np

import vibrojax as vj

RANGE = (0.95, 1.30)


def branch_and_sweep():
    """Draw the settled points of both directions over the branch, its folds written beside."""
    rig = vj.default_rig()
    sweep = vj.frequency_sweep(rig, frequency_ratio=np.linspace(*RANGE, 51))
    branch = vj.continue_response(
        rig, frequency_ratio=vj.Range(*RANGE), settings=vj.ContinuationSettings(longest_step=0.04)
    )
    print(sweep)
    print(branch)
    figure = branch.plot(sweep=sweep)
    axes = figure.axes[0]
    for line in axes.lines:
        if line.get_marker() in ("<", ">"):  # tips show on both sides of the branch
            line.set_markersize(9)
    for point in branch.special_points:
        if point.kind == "fold":
            high = point.amplitude_ratio > 20
            axes.annotate(
                f"fold {point.parameter:.4f}",
                (point.parameter, point.amplitude_ratio),
                xytext=(12 if high else -12, 0),
                textcoords="offset points",
                fontsize=11,
                ha="left" if high else "right",
                va="center",
            )
    return figure


def amplitude_map():
    """Draw amplitude over frequency and gap in both directions, with the jumps."""
    maps = vj.parameter_map(
        vj.default_rig,
        gap=np.linspace(0.2e-3, 1.0e-3, 33),
        frequency_ratio=np.linspace(0.95, 1.32, 75),
    )
    print(maps.attrs["summary"])
    return vj.plot_map(maps, "amplitude_ratio", x="frequency_ratio", y="gap")


def explorer():
    """Draw the explorer of the default rig as it is where no kernel is live."""
    view = vj.explore(vj.default_rig, gap=vj.Range(0.1e-3, 1e-3), stiffness=vj.Range(500, 50000))
    return view.figure()


def identification():
    """Draw contact stiffness and damping found from a sweep with 2 % noise (truth: 5500 N/m)."""
    sweep = vj.frequency_sweep(vj.default_rig(), frequency_ratio=np.linspace(0.9, 1.35, 46))
    data = sweep.to_xarray()[["amplitude_ratio"]]
    noise = np.random.default_rng(0).normal(size=data["amplitude_ratio"].shape)
    data["amplitude_ratio"] = data["amplitude_ratio"] * (1 + 0.02 * noise)
    measured = vj.io.read_measured_curve(data)
    fit = vj.identify(vj.default_rig, measured, guess=dict(stiffness=4000.0, damping=1e-2))
    print(fit)
    return fit.plot()


PICTURES = {
    "branch_and_sweep": branch_and_sweep,
    "map": amplitude_map,
    "explorer": explorer,
    "fit": identification,
}

if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]().savefig(Path(__file__).parent / f"{name}.png")
