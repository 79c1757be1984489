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
# # A contact law of your own
# **How do I bring my own contact law?**
#
# With a class of a few lines. Here it is a felt pad: a spring whose damping grows with how deep it
# is pressed. We run it, and ask whether a plain spring and dashpot with the same loss of energy
# would have done as well.

# %%
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import vibrojax as vj

# %% tags=["parameters"] small={"points": 13, "periods": 30}
points = 61
periods = 60

# %% [markdown]
# ## The law
# `force` gets the penetration (m) and its rate (m/s) and returns the force in N. It is not called
# out of contact, and knows nothing of the gap. Use `jax.numpy`, so that it can be batched and
# differentiated. Its numbers are fields.


# %%
class Felt(vj.model.AbstractContactLaw):
    """A spring with damping that grows with depth; it pushes and never pulls."""

    stiffness: float  # N/m
    dissipation: float  # s/m

    def force(self, penetration, rate):
        return jnp.maximum(self.stiffness * penetration * (1.0 + self.dissipation * rate), 0.0)


def rig(law):
    plain = vj.default_rig()
    stop = vj.Stop(position=0.5, gap=0.4e-3, law=law)
    return vj.ImpactingBeam(
        plain.beam, stops=(stop,), drive=plain.drive, damping_ratio=0.018, num_modes=3
    )


felt = Felt(stiffness=5500.0, dissipation=4.0)

# %% [markdown]
# ## In a history
# The law goes where `KelvinVoigt` would. From rest, at a ratio of 1.05 to the first natural
# frequency, until it has settled.


# %%
def run(law):
    return vj.simulate(rig(law), frequency_ratio=1.05, periods=periods, samples_per_period=256)


def lost_per_period(history, last=10):
    """Energy that the stop took in the last drive periods, J per period."""
    loss = np.asarray(history.energy().contact_loss)[:, 0]
    return (loss[-1] - loss[-1 - 256 * last]) / last


in_felt = run(felt)
lost = lost_per_period(in_felt)
print(f"The felt takes {1e6 * lost:.2f} microjoules in every period.")

# %% [markdown]
# ## The dashpot that takes as much
# A `KelvinVoigt` stop of the same stiffness: its loss over its damping, and the damping at which
# the two agree.

# %%
dampings = np.geomspace(0.05, 2.0, 7)
losses = [lost_per_period(run(vj.KelvinVoigt(5500.0, damping))) for damping in dampings]
equal = float(np.exp(np.interp(np.log(lost), np.log(losses), np.log(dampings))))
dashpot = vj.KelvinVoigt(5500.0, equal)
in_dashpot = run(dashpot)
print(
    f"With {equal:.3f} N s/m the dashpot takes {1e6 * lost_per_period(in_dashpot):.2f} microjoules."
)

# %%
figure, (over_time, loop) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
last = slice(-257, None)
for history, name, color, style in (
    (in_felt, "felt", "#0060a8", "-"),
    (in_dashpot, "spring and dashpot", "#d1590a", "--"),
):
    force = np.asarray(history.contact_force)[last, 0]
    depth = 1e3 * (np.asarray(history.displacement(0.5))[last] - 0.4e-3)
    over_time.plot(np.linspace(0, 1, 257), force, color=color, linestyle=style, label=name)
    touching = depth > -0.01
    loop.plot(np.where(touching, depth, np.nan), force, color=color, linestyle=style)
over_time.set(xlabel="time (drive periods)", ylabel="contact force (N)")
loop.set(xlabel="penetration (mm)", ylabel="contact force (N)")
over_time.legend(loc="upper right")
for axes in (over_time, loop):
    axes.grid(alpha=0.4)

# %% [markdown]
# The areas of the loops are equal. At touch the dashpot's force jumps and at departure it pulls,
# while that of the felt begins and ends at zero.
#
# ## In a sweep
# Any law can be swept, up and down. `frequency_sweep` chooses a stepper that suits it, and says
# which one in `attributes`.

# %%
ratios = np.linspace(0.9, 1.3, points)
curves = {
    "felt": vj.frequency_sweep(rig(felt), frequency_ratio=ratios),
    "spring and dashpot": vj.frequency_sweep(rig(dashpot), frequency_ratio=ratios),
}
for name, curve in curves.items():
    print(
        f"{name}: {curve.attributes['stepper']}, jumps at {float(curve.jump_up):.4f} and "
        f"{float(curve.jump_down):.4f}, peak {float(curve.peak_amplitude_ratio):.2f}"
    )

# %%
figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
looks = ("#0060a8", 3.5), ("#d1590a", 1.5)
for (name, curve), (color, width) in zip(curves.items(), looks, strict=True):
    for way, (marker, style) in enumerate(((">", "-"), ("<", "--"))):
        direction = curve.directions[way]
        axes.plot(
            ratios,
            curve.amplitude_ratio[way],
            color=color,
            linestyle=style,
            marker=marker,
            markevery=4,
            markersize=5,
            linewidth=width,
            label=f"{name}, {direction}",
        )
axes.set(xlabel="drive frequency over first natural frequency", ylabel="tip amplitude over drive")
axes.legend()
axes.grid(alpha=0.4)

# %%
difference = float(curves["felt"].jump_down) / float(curves["spring and dashpot"].jump_down) - 1
print(f"The forward jumps differ by {difference:+.2%}.")

# %% [markdown]
# The two agree where their losses were made equal. At the top of the curve speeds and depths are
# larger, and there a loss that grows with depth is not the same as one that does not.
#
# ## What you have seen
# - A law is a class with its numbers as fields and a method `force(penetration, rate)`.
# - It then works in `simulate`, `frequency_sweep`, `parameter_map`, `periodic_response` and
#   `continue_response`. Closed forms need a linear law (`vj.model.AbstractLinearLaw`).
# - Laws that remember (rubber, putty) derive from `vj.model.AbstractMemoryLaw`.
