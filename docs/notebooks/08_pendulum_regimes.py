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
# # Regimes of a pendulum
# **Which motions does the elastic pendulum between two limiters fall into?**
#
# Litak and others propose an inverted elastic pendulum as an energy harvester: a beam on a free
# hinge falls over to one of two limiters, and the moving base throws it from one to the other. Some
# drive frequencies make a motion that repeats, others do not. Which do which, how sure is that, and
# does it depend on the start? The whole replication is in `experiments/litak_pendulum`.

# %%
import numpy as np

import vibrojax as vj

# %% tags=["parameters"] small={"transient": 80, "periods": 48, "values": 3, "cells": 4}
transient = 80  # drive periods that are left out
periods = 60  # drive periods that are looked at
values = 9  # amplitudes of the bifurcation diagram
cells = 16  # starts on each side of the basin map

# %% [markdown]
# ## The model
# `vj.default_pendulum()` has 17 rigid links. Its small motions about the vertical in six modes,
# `.linearised(6)`, find the same regimes in a tenth of the time. Lengths, masses and stiffness are
# printed in the paper. Limiter height, base amplitude and damping are not: they are inferred, and
# the regimes depend on them.


# %%
def pendulum(base_amplitude=6.33e-3):
    return vj.default_pendulum(base_amplitude=base_amplitude).linearised(6)


print("modes of the free pendulum (Hz):", vj.default_pendulum().natural_frequencies()[:4].round(2))

# %% [markdown]
# The negative frequency is the fall: the upright position is not stable.
#
# ## Four drive frequencies
# Two random starts each. A motion has period 3 when its states return after three drive periods.
# Where no period is found, the largest Lyapunov exponent says whether neighbouring motions part
# (chaotic) or not.

# %%
frequencies = [3.1, 5.7, 6.7, 8.8]  # Hz
found = vj.regimes(
    pendulum(),
    frequency=frequencies,
    starts=2,
    settings=vj.RegimeSettings(transient=transient, periods=periods),
)
print(found)
for k, frequency in enumerate(frequencies):
    kinds = ", ".join(vj.Regime(kind).word for kind in found.regime[:, k])
    print(f"{frequency} Hz: {kinds}; periods {found.period[:, k].tolist()} (0: none)")

# %%
found.plot(start=0)

# %% [markdown]
# As in the paper: period 3 at 5.7 and 6.7 Hz, no period at 3.1 and 8.8 Hz. The exponent of a
# periodic motion is below zero: neighbours come together. Above zero they part by a factor of $e$
# in one over the exponent (`vj.lyapunov_exponent` gives it for one motion):

# %%
exponent = float(found.lyapunov_exponent[0, -1])
error = float(found.lyapunov_standard_error[0, -1])
print(f"8.8 Hz: {exponent:.1f} +- {error:.1f} 1/s, a factor of e in {1 / exponent:.2f} s")

# %% [markdown]
# So the waveform of a chaotic motion cannot be predicted, nor compared with another program, for
# longer than a few seconds. What can be compared are kinds, periods and averages. A gradient
# through such a motion is just as meaningless.
#
# ## One Poincaré section
# Position and velocity once in every drive period. A motion of period 3 is three points, a chaotic
# one a cloud.

# %%
found.poincare(start=0)

# %% [markdown]
# ## Along the amplitude
# The motion is carried from amplitude to amplitude, upwards and downwards, at 5.7 Hz.

# %%
amplitudes = np.linspace(5.5e-3, 7.0e-3, values)
diagram = vj.bifurcation_diagram(
    pendulum,
    base_amplitude=amplitudes,
    frequency=5.7,
    settings=vj.RegimeSettings(
        transient=transient, periods=periods, max_period=16, samples_per_period=32, spectrum=False
    ),
)
diagram.plot()

# %%
for direction, row in zip(("upwards", "downwards"), diagram.period, strict=True):
    three = 1e3 * amplitudes[row == 3]
    print(f"{direction}: period 3 at {len(three)} of {values} amplitudes", end="")
    print(f", from {three.min():.2f} to {three.max():.2f} mm" if len(three) else "")

# %% [markdown]
# Where the points stand in three groups, the motion still takes three drive periods a round, but
# it may have doubled its period, or be chaotic within the groups (an exponent above zero). At both
# ends the groups dissolve. So the regimes depend on the base amplitude, which is not printed.
#
# ## From where
# Starts with the pendulum straight, leaning by an angle and turning at a rate.

# %%
straight = pendulum().modal_coordinates(np.ones(17))


def start(angle, rate):
    return angle * straight, rate * straight


basins = vj.basins(
    pendulum(),
    frequency=5.7,
    start=start,
    angle=np.linspace(-0.15, 0.15, cells),
    rate=np.linspace(-4.0, 4.0, cells),
    units={"angle": "rad", "rate": "rad/s"},
)
print(basins)
basins.plot()

# %%
share = float(basins.boundary_share)
print(f"{share:.0%} of the starts have a neighbour on the grid that ends in another motion")

# %% [markdown]
# Motions of period 3 come in two mirror images, which count as two here, whatever their shift in
# time. Which of them a start ends in cannot be said from the start: the basins are as fine as the
# grid. That the motion has period 3 is certain, its side is not.
