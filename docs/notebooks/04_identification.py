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
# # Identification
# **Which contact stiffness and damping explain a measured curve?**
#
# And how well does the curve determine them? We play both sides. A "measurement" is made from a
# rig whose contact is hidden from the fit, written to a CSV file with noise, read back and fitted.

# %%
import matplotlib.pyplot as plt
import numpy as np

import vibrojax as vj

# %% tags=["parameters"] small={"points": 20}
points = 50

# %% [markdown]
# ## The measurement
# The numbers are **synthetic**: the settled sweep of a model with six modes, with 2 % noise on
# every amplitude from a fixed seed. The fit below uses five modes and never marches, so it is not
# handed its own arithmetic back. Real data would begin at the CSV.

# %%
hidden = dict(stiffness=6300.0, damping=1.5)
ratio = np.linspace(0.88, 1.3, points)
swept = vj.frequency_sweep(vj.default_rig(**hidden, num_modes=6), frequency_ratio=ratio)

chance = np.random.default_rng(20)
with open("measured.csv", "w") as file:
    print("frequency [Hz], tip amplitude [mm], sweep, sd [mm]", file=file)
    for direction, amplitudes in zip(("forward", "backward"), swept.amplitude_ratio, strict=True):
        order = slice(None) if direction == "forward" else slice(None, None, -1)
        for place, amplitude in zip(ratio[order], np.asarray(amplitudes)[order], strict=True):
            tip = 0.2 * amplitude
            noisy = tip * (1 + 0.02 * chance.standard_normal())
            hertz = place * float(swept.natural_frequency)
            print(f"{hertz:.5f}, {noisy:.5f}, {direction}, {0.02 * tip:.5f}", file=file)

measured = vj.io.read_measured_curve("measured.csv")
measured

# %% [markdown]
# ## The fit
# `identify` takes a function from numbers to a rig, the curve, and a guess. Every measured point is
# compared with the nearest point of the curve of the rig, which is followed through its folds. So a
# sweep that jumped early, as real ones do, does not pull the numbers away.


# %%
def rig(stiffness=3000.0, damping=0.1):
    return vj.default_rig(stiffness=stiffness, damping=damping, num_modes=5)


fit = vj.identify(rig, measured, guess=dict(stiffness=3000.0, damping=0.1))
fit

# %%
fit.plot()

# %%
for name, value in hidden.items():
    low, high = fit.interval[name]
    print(
        f"{name}: {fit.estimate[name]:.4g}, 95 % interval {low:.4g} to {high:.4g}, "
        f"hidden value {value:g} {'inside' if low <= value <= high else 'OUTSIDE'}"
    )
print(f"Reduced chi-square {fit.reduced_chi_square:.2f}: about 1 where model and noise are right.")

# %% [markdown]
# An interval of 95 % misses once in twenty draws of the noise, so being inside is no proof by
# itself. The repository's `experiments/identification` repeats the exercise for 80 draws.
#
# ## Are the residuals only noise?
# The lower panel above shows them: distances from the fitted curve over their standard deviations.
# If the model is right they have no pattern, and their distribution is the normal one.

# %%
residuals = {way: fit.residuals(way) for way in ("forward", "backward")}
figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
edges = np.linspace(-4, 4, 17)
colors = ("#0060a8", "#f0a060")
axes.hist(list(residuals.values()), edges, stacked=True, color=colors, label=list(residuals))
x = np.linspace(-4, 4, 101)
total = sum(len(values) for values in residuals.values())
axes.plot(x, total * 0.5 * np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), "k--", label="normal")
axes.set(xlabel="residual (standard deviations)", ylabel="points")
axes.legend()
for way, values in residuals.items():
    print(
        f"{way}: mean {np.mean(values):+.2f}, deviation {np.std(values):.2f}, "
        f"{np.mean(np.abs(values) <= 1):.0%} between -1 and 1 (normal: 68 %)"
    )

# %% [markdown]
# ## What each number rests on
# The verdict on each number, and what happens to the other one when it is wrong: a correlation near
# 1 or -1 would mean that only a combination of the two is known.

# %%
for name, verdict in fit.identifiability.items():
    print(f"{name}: {verdict}")
print(f"correlation {fit.correlation[0, 1]:.2f}")

# %% [markdown]
# Which further points would sharpen the damping most?

# %%
fit.what_next("damping")

# %% [markdown]
# The list gives the most informative frequencies first: just below the forward jump, where the
# motion is largest and loses most in the stop.
#
# ## What this cannot determine
# - **A wrong model fits too.** Five modes, a linear stop and the printed beam were assumed. If the
#   chi-square is far above 1, or the residuals have a pattern, the numbers are not to be believed
#   however narrow the interval.
# - **The interval covers the noise only.** An error of 1 % in the gap or in the amplitude of the
#   shaker is not in it. Fit the gap too, or measure at several gaps and give the curves as a list.
# - **A small damping is only bounded from above.** The verdict says so where it is the case.
# - `fit.profile(name)` draws the misfit over one number, and `fit.sample()` the posterior, where
#   intervals from the curvature are in doubt.
