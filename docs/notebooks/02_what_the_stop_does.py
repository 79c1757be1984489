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
# # What the stop does
# **What do gap, position and stiffness of the stop change?**
#
# We take the rig of `01_first_response` and move one number of its stop at a time. Branches are
# drawn in place of sweeps, so that the unstable parts show too.

# %%
import matplotlib.pyplot as plt
import numpy as np

import vibrojax as vj

# %% [markdown]
# How many stiffnesses to follow further down, and how finely to draw the last picture.

# %% tags=["parameters"] small={"stiffnesses": 6, "frequencies": 41}
stiffnesses = 24
frequencies = 161

# %% [markdown]
# `vj.default_rig` is that rig, with all its numbers as named arguments. Here are those of the stop.


# %%
def rig(gap=0.4e-3, position=0.5, stiffness=5500.0):
    return vj.default_rig(gap=gap, position=position, stiffness=stiffness)


limits = vj.Range(0.85, 1.6)

# %% [markdown]
# ## The gap
# A list of values gives one branch each.

# %%
by_gap = vj.continue_response(rig, frequency_ratio=limits, gap=[0.2e-3, 0.4e-3, 0.8e-3])
by_gap.plot()


# %%
def summarise(branches, name, unit, scale):
    """Print touch, jumps and peak of each branch."""
    for branch in branches:
        value = scale * branch.labels[name]
        if len(branch.folds) < 2:
            print(f"{name} {value:g} {unit}: touches at {branch.grazings[0]:.4f}, no jump")
            continue
        print(
            f"{name} {value:g} {unit}: touches at {branch.grazings[0]:.4f}, hysteresis from "
            f"{branch.folds.min():.4f} to {branch.folds.max():.4f}, "
            f"peak {branch.amplitude_ratio.max():.1f}"
        )


summarise(by_gap, "gap", "mm", 1e3)

# %% [markdown]
# A small gap is reached early and is closed for a longer part of each period, so the resonance
# moves further up. A wide gap bends only the top of the resonance. The hysteresis is widest in
# between: with no gap at all the motion would just scale with the drive, and nothing could bend.
#
# Circles are folds, where a sweep jumps. Triangles are where the motion begins to waver
# (Neimark-Sacker): some of them are in the small motions next to a touch.
#
# ## The position
# The same gap nearer to the root or to the tip. The beam moves little near its root, so there the
# stop is reached late, and what it does to the tip is small. Further out it meets more motion.

# %%
by_position = vj.continue_response(rig, frequency_ratio=limits, position=[0.35, 0.5, 0.65])
by_position.plot()

# %%
summarise(by_position, "position", "of the length", 1.0)

# %% [markdown]
# ## The stiffness
# All three stops touch at the same frequency, because the motion before the first touch does not
# know them. What follows the touch is theirs.

# %%
by_stiffness = vj.continue_response(rig, frequency_ratio=limits, stiffness=[500.0, 2000.0, 8000.0])
by_stiffness.plot()

# %%
summarise(by_stiffness, "stiffness", "N/m", 1.0)

# %% [markdown]
# The soft stop has no jump at all. More branches show where the jumps begin: their two folds over
# the stiffness, with the hysteresis between them. (Stiffer stops than these fold several times near
# the top, where impacts multiply.)

# %%
values = np.geomspace(400.0, 10000.0, stiffnesses)
many = vj.continue_response(rig, frequency_ratio=limits, stiffness=values)
folded = [branch for branch in many if len(branch.folds) >= 2]
stiffness = [branch.labels["stiffness"] for branch in folded]
upper = [branch.folds.max() for branch in folded]
lower = [branch.folds[branch.folds.argmax() + 1] for branch in folded]  # the next on the branch

figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
axes.fill_between(stiffness, lower, upper, color="#0060a8", alpha=0.15, label="two motions")
axes.plot(stiffness, upper, color="#0060a8", marker=">", label="jump of the forward sweep")
axes.plot(
    stiffness, lower, color="#d1590a", marker="<", linestyle="--", label="of the backward sweep"
)
axes.set(xscale="log", xlabel="stiffness of the stop (N/m)", xlim=(values[0], values[-1]))
axes.set_ylabel("drive frequency over\nfirst natural frequency")
axes.legend(loc="upper left")
axes.grid(alpha=0.4)
print(
    f"Of {len(values)} stiffnesses {len(folded)} have folds, from {stiffness[0]:.0f} N/m on.\n"
    f"The upper fold moves from {upper[0]:.4f} to {upper[-1]:.4f}, "
    f"the lower one only from {lower[0]:.4f} to {lower[-1]:.4f}."
)

# %% [markdown]
# The backward jump hardly depends on the stiffness: it happens where the small motion reaches the
# stop, and that motion does not know how stiff the stop is. The forward jump is what a measurement
# of the stiffness has to look at (`04_identification` does). It levels off, since a stop that is
# much stiffer than the beam cannot get stiffer for it.
#
# ## Every gap at once
# With one contact per period the motion has a closed form. `single_contact_response` evaluates it
# on a grid of contact times and frequencies; its level sets are the responses for every gap. Only
# the ratio of gap to drive amplitude counts: twice the gap at twice the drive is the same picture.

# %%
every = vj.single_contact_response(
    rig(), frequency_ratio=np.linspace(limits.low, limits.high, frequencies)
)
every

# %%
every.plot()

# %% [markdown]
# The dotted line is where all responses fold. Lines are broken where the motion has more than one
# contact per period, which the closed form leaves out and `continue_response` follows.
#
# ## What you have seen
# - The gap, over the drive amplitude, decides where the response leaves the linear one.
# - The position decides how much of the motion the stop meets.
# - The stiffness decides whether there is a jump, and where the forward one is.
#
# `vj.fold_curves` follows single folds exactly in one number, and `03_maps` varies two numbers.

# %% [markdown]
# ## Try it
# With sliders, where the notebook runs: the response follows the numbers, and the mouse picks the
# orbit. In a stored notebook this is a still picture.

# %%
vj.explore(
    rig,
    gap=vj.Range(0.2e-3, 1e-3),
    position=vj.Range(0.3, 0.9),
    stiffness=vj.Range(500, 50000),
    frequency_ratio=vj.Range(0.85, 1.4),
)
