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
# # First frequency response
# **What does the frequency response of a beam that hits a stop look like?**
#
# A cantilever stands on a shaker. Halfway along it, a little to one side, is an elastic stop,
# screwed to the same base. We shake the base at one frequency after another, upwards and then
# downwards, and note how far the tip moves once the motion has settled.

# %%
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import vibrojax as vj

# %% [markdown]
# How many frequencies to sweep. Everything else below follows from the rig.

# %% tags=["parameters"] small={"points": 15}
points = 121

# %% [markdown]
# ## The rig
# A rig is a plain function from named numbers to a system. All numbers are in SI units. The beam
# gets narrower towards its tip (`taper`), and carries a tip mass (`mass_ratio`, over the mass of an
# untapered beam). The stop is `gap` metres from the beam at rest.


# %%
def rig(gap=0.4e-3, stiffness=5500.0, damping=5e-5):
    beam = vj.Cantilever(
        length=0.2,
        width=0.025,
        thickness=1e-3,
        youngs_modulus=130e9,
        density=8250.0,
        taper=0.5,
        mass_ratio=0.5,
    )
    stop = vj.Stop(position=0.5, gap=gap, law=vj.KelvinVoigt(stiffness, damping))
    return vj.ImpactingBeam(
        beam, stops=(stop,), drive=vj.BaseMotion(amplitude=0.2e-3), damping_ratio=0.018, num_modes=5
    )


modes = vj.modes(rig().beam, num_modes=5)
modes

# %% [markdown]
# Between contacts the beam moves in these five modes. Frequencies below are given as
# `frequency_ratio`, over the first of them.

# %%
modes.plot()

# %% [markdown]
# ## Up and down
# `frequency_sweep` marches the motion at every frequency until it repeats, and starts from where
# the frequency before ended, as a slow sweep on a shaker does. The same beam with the stop too far
# away to be reached shows what the stop changes.

# %%
ratios = jnp.linspace(0.85, 1.31, points)
curve = vj.frequency_sweep(rig(), frequency_ratio=ratios)
linear = vj.frequency_sweep(rig(gap=10e-3), frequency_ratio=ratios)
curve

# %%
figure = curve.plot()
axes = figure.axes[0]
axes.plot(linear.frequencies, linear.amplitude_ratio[0], color="0.6", zorder=0, label="no stop")
axes.legend(handles=axes.lines[-1:], loc="upper left", fontsize=11)
figure

# %%
print(
    f"Without the stop the tip moves {float(linear.peak_amplitude_ratio):.1f} times as far as the "
    f"base, at ratio {float(linear.peak_frequency):.3f}.\n"
    f"With it, {float(curve.peak_amplitude_ratio):.1f} times, "
    f"at {float(curve.peak_frequency):.3f}.\n"
    f"Upwards the motion falls at {float(curve.jump_down):.4f}, "
    f"downwards it rises at {float(curve.jump_up):.4f}."
)

# %% [markdown]
# The stop makes the beam stiffer for a part of each period, so the resonance leans to higher
# frequencies. Between the two jumps there are two settled motions, and which one the beam is in
# depends on where it came from: that is the hysteresis.
#
# Everything is in a dataset with names, units and the rig, ready for NetCDF.

# %%
curve.to_xarray()

# %% [markdown]
# ## The whole branch
# A sweep sees stable motions only. `continue_response` follows the periodic motion itself, round
# its folds and along the unstable part between them, and solves every point exactly.

# %%
branch = vj.continue_response(rig(), frequency_ratio=vj.Range(0.85, 1.31))
branch

# %%
branch.plot(sweep=curve)

# %%
distance = max(
    abs(float(curve.jump_down) - branch.folds.max()), abs(float(curve.jump_up) - branch.folds.min())
)
print(
    f"The sweep's two jumps lie within {distance:.1e} of the two folds.\n"
    f"The beam first touches the stop at {branch.grazings[0]:.4f}, where the curve has a corner."
)

# %% [markdown]
# The jumps are the folds: there the motion that the sweep followed ceases to exist. The dashed part
# between them is a motion as well, but the smallest disturbance grows.
#
# ## Three motions at one frequency
# `resample` solves for every crossing of a frequency. At 1.15 there are three, and the largest
# Floquet multiplier says how a disturbance has changed after one period: below 1 it dies out.

# %%
crossings = branch.resample([1.15]).sel(frequency_ratio=1.15)
crossings[["amplitude_ratio", "contact_force", "leading_multiplier", "stable"]].to_dataframe()

# %% [markdown]
# Each crossing knows the state that its motion starts from. `simulate` takes it from there; one
# period of its history is the orbit.


# %%
def run_from(state, periods=40, samples=256):
    history = vj.simulate(
        rig(),
        frequency_ratio=1.15,
        periods=periods,
        samples_per_period=samples,
        initial_state=tuple(np.split(state, 2)),
    )
    return history, np.arange(history.time.size) / samples


names = ("large, stable", "unstable", "small, stable")
styles = ("#0060a8", "-"), ("#d1590a", "--"), ("#555555", ":")
states = crossings.initial_state.values
period = slice(0, 257)

figure, (portrait, pushing) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
for state, name, (color, style) in zip(states, names, styles, strict=True):
    history, time = run_from(state)
    look = dict(color=color, linestyle=style, linewidth=2, label=name)
    place, speed = 1e3 * history.displacement(0.5), 1e3 * history.velocity(0.5)
    portrait.plot(place[period], speed[period], **look)
    pushing.plot(time[period], history.contact_force[period], **look)
portrait.axvline(0.4, color="0.6", linewidth=6, zorder=0)
portrait.annotate("stop", (0.4, portrait.get_ylim()[0]), xytext=(8, 6), textcoords="offset points")
portrait.set(xlabel="displacement at the stop (mm)", ylabel="velocity at the stop (mm/s)")
pushing.set(xlabel="time (drive periods)", ylabel="contact force (N)")
portrait.legend(loc="upper left")
for axes in (portrait, pushing):
    axes.grid(alpha=0.4)

# %% [markdown]
# The large motion presses into the stop once in every period. The waves in its portrait and in its
# force are the second mode, which every impact sets ringing: at 77.8 Hz it swings 7.3 times in a
# drive period. The small motion never reaches the stop. The unstable one lies between them.
#
# Which side of it the beam starts on decides where it ends: two starts, 2 % off to either side.

# %%
figure, axes = plt.subplots(figsize=(10, 3.6), layout="constrained")
for factor, (color, style) in zip((1.02, 0.98), (styles[0], styles[2]), strict=True):
    history, time = run_from(factor * states[1])
    highest = 1e3 * history.displacement()[:-1].reshape(40, -1).max(axis=1)
    axes.plot(range(1, 41), highest, color=color, linestyle=style, marker=".", label=factor)
    print(f"from {factor} times the unstable state: {highest[-1]:.2f} mm after 40 periods")
axes.set(xlabel="drive periods", ylabel="highest tip displacement\nin the period (mm)")
axes.legend(title="start over unstable motion")
axes.grid(alpha=0.4)

# %% [markdown]
# ## What you have seen
# - A stop bends the resonance to higher frequencies and makes it jump.
# - `frequency_sweep` gives what a shaker test would show, in both directions.
# - `continue_response` gives what is behind it: folds, first touch, unstable motions.
# - `simulate` gives the motion in time. (`periodic_response` solves for one steady motion directly,
#   with gradients; `07` and the identification build on it.)
#
# Next: what the stop's gap, place and stiffness change, in `02_what_the_stop_does`.
