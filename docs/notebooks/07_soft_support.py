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
# # A soft support
# **What does a soft support do to a cantilever that is released or shaken?**
#
# Ledezma-Ramírez, Rustighi and Tapia González put a rubber support 4 mm below the tip of an
# aluminium cantilever, to take energy out of its vibration. Here the beam is let go from a bent
# position, and then shaken by a force near its root. The whole replication, with what is assumed
# about numbers that are not printed, is in `experiments/ledezma_ramirez_soft_support`.

# %%
import matplotlib.pyplot as plt
import numpy as np

import vibrojax as vj

# %% tags=["parameters"] small={"seconds": 4.0, "duration": 0.7, "points": 6}
duration = 2.0  # s, of the releases
seconds = 14.0  # of the runs at one frequency
points = 41  # frequencies of the sweep

# %% [markdown]
# ## The rig
# The beam has the natural frequencies that the paper prints: 15.4, 96.6, 270.6, 530.3, 876.6 Hz.
# The support has 22 kN/m. Its damping is not printed; 7 N s/m gives the printed peaks of the
# release from 10 mm. `side=-1` puts it below.

# %%
GRAVITY = 9.80665  # m/s2
GAP = 4e-3  # m


def support(force=0.0, damping=7.0, gap=GAP):
    beam = vj.Cantilever(
        length=0.4, width=0.038, thickness=0.003, youngs_modulus=70e9, density=2700.0
    )
    stop = vj.Stop(position=1.0, gap=gap, law=vj.KelvinVoigt(22e3, damping), side=-1)
    drive = vj.PointForce(force, position=0.175) if force else vj.NoDrive()
    return vj.ImpactingBeam(beam, stop, drive, damping_ratio=0.01, num_modes=5)


print(vj.modes(support().beam, num_modes=5).frequency.round(1), "Hz")

# %% [markdown]
# ## Let go
# `release=` bends the beam as a load at the tip would and lets go. A list of releases runs side by
# side. Samples are exact however few there are; 8192 per second show the contacts well.

# %%
releases = [4e-3, 7e-3, 10e-3]
released = vj.simulate(support, release=releases, duration=duration, sampling_rate=8192)
figure, panels = plt.subplots(3, 1, figsize=(9, 7.5), dpi=100, sharex=True, layout="constrained")
looks = (("#0060a8", ":"), ("#d1590a", "--"), ("#2a7f3f", "-"))
for height, (colour, style) in zip(releases, looks, strict=True):
    history = released.at(release=height)
    shown = history.time < 0.3
    time = np.asarray(history.time)[shown]
    for panel, values in zip(
        panels,
        (
            1e3 * history.displacement(),
            history.acceleration() / GRAVITY,
            history.contact_force[:, 0],
        ),
        strict=True,
    ):
        panel.plot(time, np.asarray(values)[shown], style, color=colour, lw=1.2)
    panels[0].plot([], [], style, color=colour, label=f"from {1e3 * height:g} mm")
panels[0].axhline(-1e3 * GAP, color="0.4", lw=1)
panels[0].text(0.3, -1e3 * GAP - 0.3, "support", color="0.3", ha="right", va="top")
panels[0].set(ylabel="tip (mm)", ylim=(-6.5, 12.5))
panels[0].legend(ncols=3, loc="upper right")
panels[1].set(ylabel="acceleration of the tip (g)")
panels[2].set(ylabel="contact force (N)", xlabel="time (s)")
for panel in panels:
    panel.grid(alpha=0.3)
plt.show()

# %% [markdown]
# From 4 mm the tip does not reach the support. From higher up it rests on it for some milliseconds,
# swing after swing. At the end of a contact the force dips below zero: a spring and a dashpot side
# by side pull as the tip leaves fast. `vj.KelvinVoigt(..., tension=False)` would let go.
#
# Contacts are found in the continuous motion, not in the samples:

# %%
free = released.at(release=10e-3)
free.contacts()

# %%
peak = free.peak("acceleration", start=0.015)
for height in releases:
    one = released.at(release=height)
    contacts = one.contacts()
    print(f"released from {1e3 * height:g} mm: {len(contacts)} contacts", end=", ")
    print(f"largest force {max(contacts.peak_force, default=0.0):.2f} N")
print(
    f"peak acceleration from 10 mm: {abs(peak.value) / GRAVITY:.1f} g at {1e3 * peak.time:.2f} ms"
)

# %% [markdown]
# The paper prints 107 g and 10 N for the release from 10 mm. The force is met. So is the
# acceleration, but only with the five modes of the paper: the force of a dashpot jumps at touch,
# and every further mode answers that jump. The experiment shows it for 3 to 20 modes and other
# laws.

# %% [markdown]
# ## Where the energy goes
# The same release without the support, for comparison, is a gap that is never reached.

# %%
without = vj.simulate(
    support(gap=20e-3), release=10e-3, duration=duration, sampling_rate=8192
).energy()
energy = free.energy()
print(energy)

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), dpi=100, layout="constrained")
for name, flow, style in (("with the support", energy, "-"), ("without", without, "--")):
    left.semilogy(flow.time, 1e3 * flow.total, style, label=name)
left.set(xlabel="time (s)", ylabel="energy left (mJ)", ylim=(1e-2, 20))
left.legend()
parts = [("in contact", energy.contact_loss.sum(axis=1), without.contact_loss.sum(axis=1))]
parts += [(f"mode {m + 1}", energy.beam_loss[:, m], without.beam_loss[:, m]) for m in range(3)]
place = np.arange(len(parts))
right.bar(place - 0.2, [1e3 * p[1][-1] for p in parts], 0.4, label="with the support")
right.bar(place + 0.2, [1e3 * p[2][-1] for p in parts], 0.4, hatch="//", label="without")
right.set_xticks(place, [p[0] for p in parts])
right.set(ylabel=f"energy lost in {duration:g} s (mJ)")
right.legend()
for panel in (left, right):
    panel.grid(alpha=0.3)
plt.show()

# %%
lost = energy.contact_loss.sum(axis=1)[-1]
higher = energy.beam_loss[-1, 1:].sum()
total = lost + energy.beam_loss[-1].sum()
half, half_without = (
    flow.time[np.argmax(flow.total < flow.total[0] / 2)] for flow in (energy, without)
)
print(f"lost in contact {lost / total:.0%}, in modes 2 to 5 {higher / total:.0%} of the loss")
without_support = without.beam_loss[-1, 1:].sum() / without.beam_loss[-1].sum()
print(f"lost in modes 2 to 5 without the support: {without_support:.0%}")
print(f"half of the energy is gone after {half:.3f} s, without the support {half_without:.3f} s")
print(f"the balance of energy closes to {np.abs(energy.balance).max() / energy.total[0]:.0e}")

# %% [markdown]
# So a support does two things: it takes energy itself, and it moves energy into higher modes, which
# lose it faster. Once the tip no longer reaches the support, the decay is that of the beam alone.

# %% [markdown]
# ## Spectra
# What an analyser would show of the release, and the names of its lines. There is no window: a
# window would fade out the beginning, where the contacts are.

# %%
spectrum = free.spectrum("acceleration", units="g", window="boxcar")
spectrum.plot(span=500)

# %% [markdown]
# ## Shaken
# Now a force at 70 mm from the root, at 16 Hz, with three amplitudes. The runs start from rest; the
# spectrum leaves out the first half.

# %%
forces = [2.0, 6.0, 12.0]
shaken = vj.simulate(support, force=forces, frequency=16.0, duration=seconds, sampling_rate=4096)
loudest = shaken.at(force=12.0)
lines = loudest.spectrum("acceleration", start=seconds / 2, segment=1.0, units="g")
lines.plot(span=400)

# %%
for line in lines.peaks(6):
    print(line)

# %% [markdown]
# The motion repeats with the drive, so all its lines are multiples of 16 Hz. The tall ones are
# those that fall near a mode: the sixth, 96 Hz, is the second mode.

# %% [markdown]
# ## Receptance
# Displacement over force, both rms, as a swept test gives it. A linear beam would have one curve
# for all forces.

# %%
frequencies = np.linspace(12.0, 22.0, points)
swept = vj.frequency_sweep(
    support,
    force=[0.1, *forces],
    frequency=frequencies,
    settings=vj.SweepSettings(refine_jumps=None, max_periods=300),
)
swept.plot("receptance")

# %%
print(swept)
for force, up, down in zip(swept.axes["force"], *np.moveaxis(swept.receptance, 1, 0), strict=True):
    at_up, at_down = frequencies[np.argmax(up)], frequencies[np.argmax(down)]
    print(
        f"{force:4g} N: peak {1e3 * up.max():.2f} mm/N at {at_up:.2f} Hz upwards, "
        f"{1e3 * down.max():.2f} mm/N at {at_down:.2f} Hz downwards"
    )

# %% [markdown]
# The support lowers the resonance and broadens it, and moves it to higher frequencies, the more the
# stronger the force. Between the two directions there is hysteresis: from the jump up to the jump
# down the response depends on where the sweep came from. Hollow points have no period up to eight
# drive periods; their rms is that of the motion that was found, and they stay in the result, marked
# by their `status`.
