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
# # Maps
# **How do amplitude, force and hysteresis depend on two numbers at once?**
#
# A map is a frequency sweep, in both directions, for every combination of the numbers of a rig. All
# of them run side by side, and the result is one dataset with named axes.

# %%
import time

import matplotlib.pyplot as plt
import numpy as np

import vibrojax as vj

# %% tags=["parameters"] small={"gaps": 3, "stiffnesses": 2, "points": 7}
gaps = 7
stiffnesses = 4
points = 25


# %%
def rig(gap=0.4e-3, stiffness=5500.0):
    return vj.default_rig(gap=gap, stiffness=stiffness)


axes = dict(
    stiffness=np.geomspace(500.0, 8000.0, stiffnesses),
    gap=np.linspace(0.3e-3, 1.5e-3, gaps),
    frequency_ratio=np.linspace(0.9, 1.35, points),
)

# %% [markdown]
# ## How long will it take?
# `dry_run` runs a few combinations and says.

# %%
vj.parameter_map(rig, **axes, dry_run=True)

# %% [markdown]
# ## The map
# With `store` the map is written to a folder, chunk by chunk. Had the computer stopped halfway, the
# same call would continue. When everything is there it only reads.

# %%
start = time.perf_counter()
maps = vj.parameter_map(rig, **axes, store="stop_map.zarr")
between = time.perf_counter()
vj.parameter_map(rig, **axes, store="stop_map.zarr")
end = time.perf_counter()
print(f"The first call took {between - start:.1f} s, the second {end - between:.2f} s.")

# %%
maps

# %% [markdown]
# The store is an ordinary Zarr folder: `xarray.open_zarr("stop_map.zarr")`
# opens it anywhere, also without vibrojax.
#
# ## One page
# What was found, what depends on what most, and whether all lanes settled.

# %%
vj.plot_map_summary(maps)

# %% [markdown]
# ## Amplitude over frequency and gap
# Both directions, at one stiffness. Where the two panels differ there is hysteresis.

# %%
vj.plot_map(maps, "amplitude_ratio", x="frequency_ratio", y="gap", stiffness=5500.0)

# %% [markdown]
# ## Hysteresis over gap and stiffness

# %%
vj.plot_map(maps, "hysteresis_width", x="gap", y="stiffness")

# %%
widest = maps.hysteresis_width.fillna(0.0)
place = widest.argmax(("stiffness", "gap"))
best = widest.isel(place)
print(
    f"The hysteresis is widest, {float(best):.3f} of the natural frequency, at a gap of "
    f"{1e3 * float(best.gap):.2f} mm and {float(best.stiffness):.0f} N/m. "
    f"{int((widest == 0).sum())} of {widest.size} combinations have none."
)

# %% [markdown]
# ## Any other question
# The dataset has names, so xarray answers it. Here: the largest contact force that a slow sweep
# upwards meets anywhere.

# %%
force = maps.contact_force.sel(direction="forward").max("frequency_ratio")
figure, ax = plt.subplots(figsize=(9, 4.2), layout="constrained")
styles = ("-", "--", "-.", ":")
for number, stiffness in enumerate(maps.stiffness.values[:: max(1, stiffnesses // 3)]):
    ax.plot(
        1e3 * maps.gap,
        force.sel(stiffness=stiffness),
        linestyle=styles[number % 4],
        marker="o",
        markersize=4,
        color=plt.cm.viridis(0.28 * number),
        label=f"{stiffness:.0f} N/m",
    )
ax.set(xlabel="gap (mm)", ylabel="largest contact force (N)")
ax.legend(title="stiffness")
ax.grid(alpha=0.4)
top = force.where(force == force.max(), drop=True)
print(
    f"The largest force of all, {float(force.max()):.2f} N, is met at a gap of "
    f"{1e3 * float(top.gap[0]):.2f} mm on the stop of {float(top.stiffness[0]):.0f} N/m."
)

# %% [markdown]
# ## What you have seen
# - `parameter_map` sweeps every combination and continues what was interrupted.
# - `plot_map` and `plot_map_summary` draw it, xarray selects from it.
# - For large maps, `measures=[...]` keeps numbers in place of whole curves, and `gradients=[...]`
#   gives their derivatives.
#
# Many cores and clusters: the guide to large maps. Other responses than sweeps: `response=`.
