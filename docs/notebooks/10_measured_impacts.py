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
# # Measured impacts
# **What do measured records of a contact force say about the pad, and what not?**
#
# A cart rolls against a viscoelastic pad, 40 or 4 mm thick, and back, five runs a pad; the force is
# sampled 100 times a second. The files are those of a school experiment
# (`cytronicoder/spongebobs-corpse`, MIT), in `experiments/cart_on_pads/data`. No model made them:
# nobody knows the right answer.

# %%
import dataclasses
from pathlib import Path

import numpy as np

import vibrojax as vj

# %% tags=["parameters"] small={"runs": 2}
runs = 3  # the last of five

# %% [markdown]
# ## The records
# Five runs stand side by side in the file, so five histories come back. Three things have to be
# said, as no file says them: which force it is, that the sensor turns it, and how the cart begins.
# It comes with some 0.82 m/s, which will be fitted. Before it moves the force is an
# offset. `impacts` puts a window around each impact.

# %%
folder = Path(vj.__file__).parents[1] / "experiments" / "cart_on_pads" / "data"  # of a clone


def records(file):
    histories = vj.io.read_measured_history(
        folder / file,
        columns=dict(
            contact_force="Force (N)", displacement=None, velocity=None, acceleration=None
        ),
        gain=dict(contact_force=-1.0),
        deviation=dict(contact_force=0.1),
        initial_displacement=0.0,
        initial_velocity=0.82,
    )
    found = []
    for history in histories:
        offset = dict(contact_force=np.median(history.contact_force[:20]))
        found += dataclasses.replace(history, offset=offset).impacts()
    return sorted(found, key=lambda history: history.label)[-runs:]


thick, thin = records("pad_40mm.csv"), records("pad_04mm.csv")
print(thick[0])

# %% [markdown]
# ## Each run alone
# The model is a free mass that meets a spring and a dashpot, which cannot pull it back. Its mass
# was not measured: the integral of the force over the change of velocity says 0.578 kg.


# %%
def cart(stiffness, damping, mass=0.578):
    pad = vj.KelvinVoigt(stiffness, damping, tension=False)
    return vj.model.Oscillator(mass, stops=(vj.Stop(None, 0.0, pad),))


guess = dict(stiffness=60.0, damping=1.0, initial_velocity=None)


def alone(history):
    fit = vj.identify(cart, history, guess)
    low, high = fit.interval["stiffness"]
    print(
        f"{history.label}: {fit.estimate['stiffness']:.1f} N/m ({low:.1f} to {high:.1f}), "
        f"{fit.estimate['damping']:.2f} N s/m, reduced chi-square "
        f"{fit.chi_square / fit.degrees_of_freedom:.2f}"
    )
    return fit


fits = [alone(history) for history in thick]
fits[-1].plot()

# %% [markdown]
# The stiffnesses agree within some 3 %, the dampings within a factor of two: 100 samples a second
# say little about the first moment of a contact, where the force of a dashpot jumps.
#
# ## The thin pad
# The same model, and it is refused:

# %%
bottomed = alone(thin[-1])
for text in bottomed.warnings:
    print(text)
bottomed.plot()

# %% [markdown]
# This pad bottoms out: one or two samples stand far above the others where the cart is deepest, and
# a spring cannot do that. The numbers are still printed, with intervals. They describe nothing.
#
# ## What the data do not determine
# Let the mass be fitted too. A heavier and slower cart on a stiffer pad makes the very same force:

# %%
free = vj.identify(cart, thick[-1], guess | dict(mass=0.5))
print(free)

# %% [markdown]
# So stiffness and damping are known per kilogram of the cart, and no better than its mass. A scale
# would have been the best sensor here.
#
# Which contact law explains such records, and foretells a run that it has not seen, is asked by
# `vj.compare_laws`; it takes minutes. `experiments/cart_on_pads` has its answer: a linear spring,
# one that relaxes ahead, but whether the pad pulls at the end of a contact remains open.
