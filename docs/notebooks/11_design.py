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
# # Designs
# **Which gap and stiffness of a stop make the resonance widest, at a force that the stop bears?**
#
# A stop bends the resonance over and makes it broad, as a harvester likes it, and the beam hits
# hard for it. Here the gap and the stiffness are sought that give the widest band, by derivatives
# of what the rig does.

# %%
import scipy.stats

import vibrojax as vj

# %% tags=["parameters"] small={"screened": 4, "starts": 1, "samples": 8, "points": 3}
screened = 16  # designs that are looked at first
starts = 3  # searches from the best of them
samples = 32  # rigs of the scatter
points = 5  # of the front


# %%
def rig(gap, stiffness, damping=1.0):
    return vj.default_rig(gap=gap, stiffness=stiffness, damping=damping, num_modes=2)


band = vj.Range(0.9, 1.35)

# %% [markdown]
# ## One rig, and what would change it
# A *response* is the whole branch of a rig, to be asked for numbers.

# %%
response = vj.design.respond(rig, gap=4e-4, stiffness=2e3, frequency_ratio=band)
response

# %%
response.branch.plot()

# %% [markdown]
# Every number comes with its derivatives by the numbers of the rig. They are exact: of the solution
# itself, not by differences. Here each is shown as the change by one percent of gap or stiffness.

# %%
measures = {
    "half-power band": lambda r: r.half_power_bandwidth(),
    "hysteresis width": lambda r: r.hysteresis_width(),
    "highest fold": lambda r: r.fold_frequency(-1),
    "peak": lambda r: r.peak(),
    "contact force (N)": lambda r: r.peak("contact_force"),
}
print(f"{'':18}{'is':>10}{'gap + 1 %':>12}{'stiffness + 1 %':>18}")
for name, function in measures.items():
    value, slopes = response.slopes(function)
    by_gap, by_stiffness = 0.01 * 4e-4 * slopes["gap"], 0.01 * 2e3 * slopes["stiffness"]
    print(f"{name:18}{value:10.4f}{by_gap:+12.5f}{by_stiffness:+18.5f}")

# %% [markdown]
# ## The widest band at 1 N
# The half-power band is where the amplitude is above the peak over the root of two. The contact
# force may reach 1 N. `optimise` looks at designs spread over the bounds, and searches on from the
# best of them, all side by side.


# %%
def half_power_band(response):
    return response.half_power_bandwidth()


def contact_force(response):
    return response.peak("contact_force")


best = vj.optimise(
    rig,
    half_power_band,
    maximise=True,
    variables={"gap": (1e-4, 2e-3), "stiffness": (500.0, 8e3)},
    constraints=[vj.design.Constraint(contact_force, most=1.0)],
    frequency_ratio=band,
    settings=vj.design.OptimiseSettings(starts=starts, screened=screened),
)
print(best)

# %%
best.plot()

# %% [markdown]
# On top every design that was tried, hollow where the force is above 1 N, then the ways of the
# searches, then the neighbours of the best design, and the branches of the first rig and of the
# best one. The neighbours with a wider band miss the constraint: the force holds the design.
#
# ## How sure is it?
# No stop is made to the last digit. Here the gap may be off by 0.02 mm and the stiffness by 20 %.
# What that may make of the curve, to first order:

# %%
tolerances = {
    "gap": vj.design.Tolerance(2e-5),
    "stiffness": vj.design.Tolerance(0.2, relative=True),
}
shaded = vj.design.band(rig, tolerances, frequency_ratio=band, **best.numbers)
best.response.branch.plot(band=shaded)

# %% [markdown]
# And what it makes of the two measures, where the gap is normally and the stiffness evenly
# distributed:

# %%
gap, stiffness = best.numbers["gap"], best.numbers["stiffness"]
scatter = vj.propagate(
    rig,
    {
        "gap": scipy.stats.norm(gap, 2e-5),
        "stiffness": scipy.stats.uniform(0.8 * stiffness, 0.4 * stiffness),
    },
    {"half_power_band": half_power_band, "contact_force": contact_force},
    frequency_ratio=band,
    settings=vj.design.PropagationSettings(samples=samples),
)
print(scatter)

# %%
scatter.plot()

# %% [markdown]
# The bars are rigs drawn from the distributions, the line is what derivatives say. About half of
# the rigs are above 1 N, as the design lies at the bound. `robust=` of `optimise` keeps the worst
# of them below it, at the price of some width.
#
# ## Width against force
# What does another newton buy? A front holds the designs of which none is wider without a larger
# force.

# %%
front = vj.design.pareto(
    rig,
    {"half_power_band": half_power_band, "contact_force": contact_force},
    variables={"gap": (8e-4, 1.2e-3), "stiffness": (500.0, 4e3)},
    maximise=["half_power_band"],
    points=points,
    frequency_ratio=band,
    settings=vj.design.OptimiseSettings(starts=2, screened=screened),
)
print(front)

# %%
front.plot()

# %% [markdown]
# ## What you have seen
# - `vj.design.respond` gives one rig's measures with their derivatives.
# - `vj.optimise` finds the best design within bounds and constraints, `vj.design.pareto` all that
#   trade one objective for another.
# - `vj.propagate` says how far the measures scatter, and which number is to blame.
#
# Tolerances within the search, statuses, and what happens where folds appear: the guide to designs.
