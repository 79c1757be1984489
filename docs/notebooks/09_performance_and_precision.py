# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Performance and precision
# **How fast and how exact is it, and which settings matter?**
#
# Every number below was measured when this notebook was run, on the machine named in the next cell.
# Times on another machine differ; ratios less so. `benchmarks/README.md` has the comparison with
# other programs, made with more care.

# %%
import json
import os
import platform
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import vibrojax as vj

print(platform.machine(), "with", os.cpu_count(), "cores;", "jax", jax.__version__, jax.devices())

# %% tags=["parameters"] small={"points": 4, "most_lanes": 1, "mode_numbers": [5]}
points = 16  # frequencies of the sweeps
most_lanes = 64  # rigs in the largest batch
mode_numbers = [1, 5, 6]


# %%
def rig(gap=0.4e-3, num_modes=5, smoothing=None, law=None):
    beam = vj.Cantilever(
        length=0.2,
        width=0.025,
        thickness=1e-3,
        youngs_modulus=130e9,
        density=8250.0,
        taper=0.5,
        mass_ratio=0.5,
    )
    law = vj.KelvinVoigt(5500.0, 5e-5) if law is None else law
    stop = vj.Stop(position=0.5, gap=gap, law=law, smoothing=smoothing)
    return vj.ImpactingBeam(
        beam, stop, vj.BaseMotion(0.2e-3), damping_ratio=0.018, num_modes=num_modes
    )


ratios = jnp.linspace(0.95, 1.25, points)


def timed(call):
    """Return a result and the seconds it took."""
    begun = time.perf_counter()
    result = jax.block_until_ready(call())
    return result, time.perf_counter() - begun


# %% [markdown]
# ## Compiling and running
# The first call of a kind compiles; other numbers, gaps or tolerances then run the same code.


# %%
def sweep(gap=0.4e-3, **settings):
    own = vj.SweepSettings(refine_jumps=None, **settings)
    return vj.frequency_sweep(rig(gap), frequency_ratio=ratios, settings=own)


_, first = timed(sweep)
_, second = timed(sweep)
_, other = timed(lambda: sweep(gap=0.5e-3))
print(f"first sweep {first:.2f} s, again {second:.2f} s, with another gap {other:.2f} s")

# %% [markdown]
# What makes JAX compile again: another number of modes or stops, another law, another method, and
# often another number of lanes. What does not: any number in the rig, frequencies, tolerances. To
# keep compiled code between processes, set these before starting Python (this run had
# `JAX_COMPILATION_CACHE_DIR` set if the first time above is short):
#
# ```sh
# export JAX_COMPILATION_CACHE_DIR=~/.cache/jax
# export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0.3
# ```
#
# ## Tolerance
# Settled amplitudes against those at a tolerance of 1e-9, for two ways to step. `ExactContact`, the
# default for linear stops, propagates flight and contact exactly and only looks for the times of
# contact. `ExponentialSplitting` takes any law; it kicks the modes by the contact force, and rounds
# its corner over a thousandth of the gap unless `Stop(smoothing=...)` says otherwise.

# %%
reference = sweep(stepper=vj.ExactContact(1e-9), tolerance=1e-9, max_periods=2000)
steppers = {
    "ExactContact": (vj.ExactContact, [1e-2, 1e-3, 1e-4, 1e-6]),
    "ExponentialSplitting": (vj.ExponentialSplitting, [1e-2, 1e-3, 1e-4]),
}
work = {}
for name, (stepper, tolerances) in steppers.items():
    rows = []
    for tolerance in tolerances:
        settings = dict(stepper=stepper(tolerance), tolerance=tolerance)
        sweep(**settings)  # compiles
        curve, seconds = timed(lambda settings=settings: sweep(**settings))
        same = np.sign(curve.contact_force) == np.sign(reference.contact_force)
        error = np.abs(curve.amplitude_ratio / reference.amplitude_ratio - 1)
        rows.append((tolerance, np.max(error[same]), seconds, np.sum(~same)))
        print(f"{name:21s} tolerance {tolerance:.0e}: error {rows[-1][1]:.1e}, {seconds:.2f} s")
    work[name] = np.array(rows)

# %%
figure, axes = plt.subplots(figsize=(7.5, 4.2), dpi=100, layout="constrained")
for (name, rows), style in zip(work.items(), ("o-", "s--"), strict=True):
    axes.loglog(rows[:, 1], rows[:, 2], style, label=name)
    for tolerance, error, seconds, _ in rows:
        axes.annotate(
            f"{tolerance:.0e}", (error, seconds), xytext=(4, 5), textcoords="offset points"
        )
axes.set(
    xlabel="largest relative error of the amplitude",
    ylabel=f"time of {2 * points} settled points (s)",
)
axes.set_title("numbers at the points: the tolerance asked for", loc="left", fontsize=10)
axes.legend()
axes.grid(alpha=0.3, which="both")
plt.show()

# %% [markdown]
# The tolerance is an upper estimate: errors are below it. For `ExactContact` a tight one costs
# little, so there is no reason to go above the default of 1e-4, and 1e-6 is there when it is
# needed. `ExponentialSplitting` pays for every digit with steps.
#
# ## The rounded corner
# A contact law of your own has a corner in its force at touch, which most methods round over
# `smoothing` (m). Rounding moves the jumps. Here are the folds of the same spring with several
# roundings (`Hertz` with exponent 1 is that spring, treated as any law), and of the exact corner.

# %%
exact = vj.continue_response(rig(), frequency_ratio=vj.Range(0.9, 1.31))
gap = 0.4e-3
shares = [0.1, 0.03, 0.01, 1e-3]


def rounded(smoothing):
    return rig(smoothing=smoothing, law=vj.Hertz(5500.0, 1.0))


branches = vj.continue_response(
    rounded, frequency_ratio=vj.Range(0.9, 1.31), smoothing=[share * gap for share in shares]
)
print(f"exact:                  folds {exact.folds.round(5)}")
for share, branch in zip(shares, branches, strict=True):
    moved = np.abs(np.sort(branch.folds)[[0, -1]] - np.sort(exact.folds)[[0, -1]]).max()
    print(f"rounded over {share:.3f} gap: folds {branch.folds.round(5)}, moved by {moved:.1e}")

# %% [markdown]
# ## Is this result fine enough? One call
# `vj.check_resolution` repeats a result with half the rounding, twice the samples and one more
# mode, whatever of that the system has:


# %%
def peaks(system, method):
    curve = vj.frequency_sweep(
        system, frequency_ratio=ratios, settings=vj.SweepSettings(refine_jumps=None)
    )
    return {"amplitude": curve.peak_amplitude_ratio, "force": curve.contact_force.max()}


vj.check_resolution(peaks, rig())

# %% [markdown]
# For `periodic_response` and `continue_response` pass `method=method` on: it holds the samples.
# The stop of this rig keeps its exact corner, and a sweep has no samples, so only the mode counts.
# The number of modes is not a matter of the solver but of the model: how finely the beam can bend
# around the stop.

# %%
for num_modes in mode_numbers:
    peak = peaks(rig(num_modes=num_modes), None)
    print(
        f"{num_modes} modes: largest amplitude ratio {peak['amplitude']:.3f}, "
        f"largest force {peak['force']:.3f} N"
    )

# %% [markdown]
# ## float32
# Importing vibrojax switches JAX to float64. `JAX_ENABLE_X64=0` keeps float32, which is decided
# when a process starts; so this needs a process of its own. What it does to the natural
# frequencies and to the sweep of above:

# %%
program = """
import json, sys
import vibrojax as vj
beam = vj.Cantilever(0.2, 0.025, 1e-3, 130e9, 8250.0, taper=0.5, mass_ratio=0.5)
stop = vj.Stop(0.5, 0.4e-3, vj.KelvinVoigt(5500.0, 5e-5))
rig = vj.ImpactingBeam(beam, stop, vj.BaseMotion(0.2e-3), damping_ratio=0.018, num_modes=5)
ratios = json.loads(sys.argv[1])
settings = vj.SweepSettings(refine_jumps=None)
curve = vj.frequency_sweep(rig, frequency_ratio=ratios, settings=settings)
print(json.dumps([vj.modes(beam, 5).frequency.tolist(), curve.amplitude_ratio.tolist()]))
"""
run = subprocess.run(
    [sys.executable, "-c", program, json.dumps(ratios.tolist())],
    env=os.environ | {"JAX_ENABLE_X64": "0"},
    capture_output=True,
    text=True,
    check=True,
)
frequency, amplitude = (np.array(values) for values in json.loads(run.stdout))
double = np.asarray(vj.modes(rig().beam, 5).frequency)
print("natural frequencies off by", ", ".join(f"{e:.0e}" for e in np.abs(frequency / double - 1)))
off = np.sort(np.abs(amplitude / sweep().amplitude_ratio - 1).ravel())
print(f"amplitudes off by {np.median(off):.0e} (median), {off[-1]:.0e} (largest)")

# %% [markdown]
# A settled sweep of this rig survives float32. Little is gained on a processor, though, and what
# asks for more digits does not come: tight tolerances, exact branches and their folds,
# derivatives. Stay with float64 unless you have measured that float32 is enough for you.

# %% [markdown]
# ## Many rigs at once
# A batch of rigs goes through one compiled loop, in which every lane marches at its own pace. The
# processor's vector units then work on many lanes together:

# %%
lane_numbers = [n for n in (1, 64) if n <= most_lanes]
rates = []
for lanes in lane_numbers:
    gaps = np.linspace(0.3e-3, 0.6e-3, lanes).tolist()

    def batch(gaps=gaps):
        return vj.frequency_sweep(
            rig,
            gap=gaps,
            frequency_ratio=ratios,
            progress=False,
            settings=vj.SweepSettings(refine_jumps=None),
        )

    batch()  # compiles
    curves, seconds = timed(batch)
    rates.append(curves.amplitude_ratio.size / seconds)
    print(f"{lanes:4d} rigs: {seconds:6.2f} s, {rates[-1]:7.0f} settled points per second")

# %%
print(f"{lane_numbers[-1]} rigs at once: {rates[-1] / rates[0]:.0f} times the rate of one")

# %% [markdown]
# So give lists, or use `vj.parameter_map`, in place of a Python loop over rigs. Loops of more than
# 128 lanes are cut into pieces that stay in the cache.
#
# ## Devices
# JAX runs on what `jax.devices()` shows. To choose, set `JAX_PLATFORMS=cpu` (or `cuda`) before
# starting Python, or use a context:

# %%
with jax.default_device(jax.devices("cpu")[0]):
    on_processor = sweep()
print(
    "largest amplitude ratio on the processor:", round(float(on_processor.peak_amplitude_ratio), 4)
)

# %% [markdown]
# **No GPU was measured, here or in the benchmarks.** From how the program is built one would
# expect this: one curve, one branch or one identification is a chain of small steps and gains
# nothing. Only very wide batches, thousands of lanes in a map, a basin or a regime study, can fill
# a GPU, and its float64 must be fast (data-centre GPUs, not those for games). The cut at 128 lanes
# suits a processor's cache and would have to be raised. More processor cores are the surer way: a
# map with `client=` uses all of them.
#
# ## In short
# - Keep the compilation cache. For short runs compiling is what costs.
# - Leave the tolerance at its default, and tighten it where a number matters: with `ExactContact`
#   that is nearly free.
# - Look at the number of modes before anything else: in this rig one more moves the result
#   more than any setting of the solver does at its default.
# - For laws of your own check the rounding with `vj.check_resolution`.
# - Batch.
