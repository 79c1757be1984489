"""What users call, on a GPU: maps, their derivatives, regimes, basins and a branch.

    python benchmarks/gpu_studies.py                       # all, one after the other
    python benchmarks/gpu_studies.py --only map regimes    # these

Each study runs twice on what JAX finds, the second time without compiling, and once more on the
processor with few of the rigs (a process of its own). Printed are the seconds, how many whole
numbers differ, and the largest difference of the others over the largest of their kind.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr

import vibrojax as vj

RATIOS = np.linspace(0.95, 1.3, 12)
SWEEP = vj.SweepSettings(refine_jumps=None)
GAPS, STIFFNESSES = np.linspace(0.2e-3, 1e-3, 32), np.linspace(1e3, 1e4, 32)
FEW = 16
"""On the processor: of so many gaps and stiffnesses one each."""
STARTS = 4096
OWN = {
    *("steps", "lane_steps", "periods_marched", "residual", "return_error"),
    *("share", "share_low", "share_high", "standard_error", "diverged_share"),
    *("floquet_multiplier_real", "floquet_multiplier_imaginary"),
}
"""What is counted on the way, is round-off, depends on the number of starts, or comes in another
order where moduli are equal."""


def of_sweeps(every: int, **more: Any) -> xr.Dataset:
    return vj.parameter_map(
        vj.default_rig,
        frequency_ratio=RATIOS,
        response=SWEEP,
        keep_curves=True,
        progress=False,
        gap=GAPS[::every],
        stiffness=STIFFNESSES[::every],
        **more,
    )


def a_map(every: int) -> xr.Dataset:
    return of_sweeps(every, taper=np.linspace(0, 0.75, 4))


def gradients(every: int) -> xr.Dataset:
    names = ["gap", "stiffness"]
    return of_sweeps(every, measures=["peak_amplitude_ratio"], gradients=names)


def regimes(every: int) -> xr.Dataset:
    return vj.regimes(
        vj.default_rig,
        frequency_ratio=RATIOS,
        progress=False,
        gap=GAPS[::every],
        stiffness=STIFFNESSES[::every],
    ).to_xarray()


def basins(every: int) -> xr.Dataset:
    return vj.basins(
        vj.default_rig(), frequency_ratio=1.15, starts=STARTS // every, progress=False
    ).to_xarray()


def branch(every: int) -> xr.Dataset:
    return vj.continue_response(vj.default_rig(), frequency_ratio=vj.Range(0.9, 1.3)).to_xarray()


STUDIES = {"map": a_map, "gradients": gradients, "regimes": regimes, "basins": basins}
STUDIES |= {"branch": branch}


def on_the_processor(name: str) -> xr.Dataset:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "few.nc"
        command = [sys.executable, __file__, "--only", name, "--few", str(path)]
        subprocess.run(command, check=True, env=os.environ | {"JAX_PLATFORMS": "cpu"})
        with xr.load_dataset(path, engine="h5netcdf") as few:
            return few


def compared(found: xr.Dataset, few: xr.Dataset) -> str:
    """Say how two datasets differ where they have the same rigs."""
    common = {n: few[n].values for n in ("gap", "stiffness") if n in few.dims}
    found = found.sel(common)
    whole, others = 0, 0.0
    for name, own in few.data_vars.items():
        other = found[name]
        if name in OWN or "start" in own.dims or own.dtype.kind not in "fiub":
            continue
        if own.dtype.kind == "f":
            size = np.nanmax(np.abs(own.values), initial=0.0)
            away = np.nanmax(np.abs(other.values - own.values), initial=0.0)
            others = max(others, away / size if size > 0 else away)
        else:
            whole += int((own.values != other.values).sum())
    return f"{whole} | {others:.0e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=STUDIES, default=list(STUDIES))
    parser.add_argument("--few", help="keep what few rigs give in this file, and say nothing")
    options = parser.parse_args()
    if options.few:
        STUDIES[options.only[0]](FEW).to_netcdf(options.few, engine="h5netcdf")
        return
    print(f"{jax.devices()[0].device_kind}, jax {jax.__version__}")
    for name in options.only:
        seconds = []
        for _ in range(2):
            started = time.perf_counter()
            found = STUDIES[name](1)
            seconds.append(time.perf_counter() - started)
        first, second = seconds
        print(
            f"| {name} | {first:.0f} | {second:.2f} | {compared(found, on_the_processor(name))} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
