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
# # Your own system
# **How do I study a system that is not one of the built-in ones?**
#
# Two ways, both shown here on a steel strip that is clamped at *both* ends, which
# `vj.Cantilever` cannot be:
#
# 1. Linear but for its stops: hand over the matrices $M$, $C$, $K$ of your finite-element or
#    lumped model as a `vj.MatrixSystem`. Everything in vibrojax then works.
# 2. Nonlinear by itself, too: write its equations as a class of your own. Marching, sweeps,
#    periodic responses and regimes work; continuation and what builds on it does not.

# %%
from dataclasses import replace

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import vibrojax as vj

# %% tags=["parameters"] small={"points": 11, "stretching_points": 5}
points = 61  # frequencies of the sweeps
stretching_points = 31  # frequencies of the sweeps of the nonlinear strip

# %% [markdown]
# ## The matrices
# Bernoulli beam elements with two coordinates per node, displacement and slope. A sensor of 10 g
# sits at three tenths of the length. Any program that writes $M$ and $K$ will do in place of this
# cell.

# %%
length, width, thickness = 0.3, 0.02, 1e-3  # m
youngs_modulus, density = 210e9, 7850.0  # Pa, kg/m3
area, inertia = width * thickness, width * thickness**3 / 12
elements, sensor_mass, sensor_node = 10, 0.01, 3


def beam_matrices(elements, sensor_mass=0.0):
    """Mass, stiffness and slope matrices of a strip that is clamped at both ends."""
    h = length / elements
    mass_of_one = np.array(
        [
            [156, 22 * h, 54, -13 * h],
            [22 * h, 4 * h**2, 13 * h, -3 * h**2],
            [54, 13 * h, 156, -22 * h],
            [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
        ]
    ) * (density * area * h / 420)
    stiffness_of_one = np.array(
        [
            [12, 6 * h, -12, 6 * h],
            [6 * h, 4 * h**2, -6 * h, 2 * h**2],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, 2 * h**2, -6 * h, 4 * h**2],
        ]
    ) * (youngs_modulus * inertia / h**3)
    slopes_of_one = np.array(
        [
            [36, 3 * h, -36, 3 * h],
            [3 * h, 4 * h**2, -3 * h, -(h**2)],
            [-36, -3 * h, 36, -3 * h],
            [3 * h, -(h**2), -3 * h, 4 * h**2],
        ]
    ) / (30 * h)
    size = 2 * (elements + 1)
    whole = np.zeros((3, size, size))
    for e in range(elements):
        own = slice(2 * e, 2 * e + 4)
        whole[:, own, own] += mass_of_one, stiffness_of_one, slopes_of_one
    whole[0, 2 * sensor_node, 2 * sensor_node] += sensor_mass
    return whole[:, 2:-2, 2:-2]  # both ends are clamped


def coordinate(node):
    """Unit vector of the displacement of a node."""
    vector = np.zeros(2 * (elements - 1))
    vector[2 * (node - 1)] = 1.0
    return vector


# %% [markdown]
# ## A `MatrixSystem`
# Displacements are relative to the clamps, which shake. So the input is $M$ times the influence
# vector (1 for displacements, 0 for slopes). The stop faces the middle. `stop_map` says by which
# coordinates its contact point moves, `response_map` what the curves report.
#
# The strip is a function of named numbers, as everywhere in vibrojax, and the damping is
# proportional to the mass and the stiffness: 1 % in the first mode and the third.

# %%
mass, stiffness, slopes = beam_matrices(elements, sensor_mass)
middle = coordinate(elements // 2)
influence = np.tile([1.0, 0.0], elements - 1)
undamped = vj.MatrixSystem(mass, 0 * mass, stiffness, response_map=middle, num_modes=5)
natural = np.asarray(undamped.modes().angular_frequency)
first, third = natural[0], natural[2]
damping = 2 * 0.01 * (first * third * mass + stiffness) / (first + third)


def strip(gap=0.3e-3, contact_stiffness=20e3, amplitude=10e-6):
    return vj.MatrixSystem(
        mass,
        damping,
        stiffness,
        stops=vj.Stop(None, gap, vj.KelvinVoigt(contact_stiffness, 1.0)),
        stop_map=[middle],
        drive=vj.BaseMotion(amplitude),
        input_map=mass @ influence,
        response_map=middle,
        num_modes=5,
    )


bare = vj.MatrixSystem(*beam_matrices(elements)[[0, 0, 1]], response_map=middle, num_modes=5)
closed_form = (
    np.array([4.730041, 7.853205, 10.995608, 14.137165, 17.278760]) ** 2
    * np.sqrt(youngs_modulus * inertia / (density * area * length**4))
    / (2 * np.pi)
)
computed = np.asarray(bare.modes().angular_frequency) / (2 * np.pi)
print("natural frequencies without the sensor (Hz):", computed.round(2))
print("the strip in closed form (Hz):              ", closed_form.round(2))
print("with the sensor (Hz):                       ", (natural / (2 * np.pi)).round(2))

# %%
place = np.linspace(0, length, elements + 1)
shapes = np.zeros((elements + 1, 5))
shapes[1:-1] = np.asarray(undamped.modes().shapes)[::2]
figure, axes = plt.subplots(figsize=(8, 3.6), dpi=100, layout="constrained")
for k, (style, marker) in enumerate(zip(("-", "--", ":"), "os^", strict=True)):
    shape = shapes[:, k] / np.abs(shapes[:, k]).max()
    label = f"mode {k + 1}, {natural[k] / (2 * np.pi):.1f} Hz"
    axes.plot(1e3 * place, shape, style, marker=marker, label=label)
axes.axvline(1e3 * place[sensor_node], color="0.5", lw=1)
axes.text(1e3 * place[sensor_node] + 2, -0.95, "sensor", color="0.3")
axes.axvline(150, color="0.5", lw=1, ls="--")
axes.text(152, -0.95, "stop", color="0.3")
axes.set(xlabel="place along the strip (mm)", ylabel="shape (largest node 1)")
axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
axes.grid(alpha=0.3)
plt.show()

# %% [markdown]
# ## Its response, with everything that a built-in system has
# A settled sweep in both directions, and the branch with its unstable part.

# %%
ratios = jnp.linspace(0.8, 1.7, points)
curve = vj.frequency_sweep(strip(), frequency_ratio=ratios)
branch = vj.continue_response(strip(), frequency_ratio=vj.Range(0.8, 1.7))
print(curve)
print(branch)

# %%
branch.plot(sweep=curve)

# %% [markdown]
# "Tip" in the labels stands for what `response_map` reports, here the middle. The sweep sits on the
# stable parts of the branch. Its jump down is the upper fold. The lower fold is where the strip
# first touches again, and there a step in frequency is enough of a disturbance to jump early:

# %%
print(f"jump down at {curve.jump_down:.4f}, upper fold at {branch.folds.max():.4f}")
print(f"jump up at   {curve.jump_up:.4f}, lower fold at {branch.folds.min():.4f}")

# %% [markdown]
# Axes, maps, gradients and identification take the function `strip` just as they take a beam. Three
# gaps, for example, as branches:

# %%
gaps = vj.continue_response(strip, frequency_ratio=vj.Range(0.8, 1.7), gap=[0.2e-3, 0.3e-3, 0.4e-3])
gaps.plot()

# %% [markdown]
# ## A nonlinear system of your own
# A strip between two clamps is stretched when it bends. The tension grows with the square of the
# displacement,
#
# $$N = \frac{E A}{2 L} \int w'^2\,dx, \quad f = -N\,G\,q, \quad
# G_{ij} = \int \phi_i'\,\phi_j'\,dx,$$
#
# and a `MatrixSystem` knows nothing of it. Two classes are needed. The *equations* say what every
# term of
#
# $$M(q)\,\ddot q + C\,\dot q + K\,q = f(q, \dot q) + B(q)\,a(t) - \sum J^T F$$
#
# is. Here all but $f$ are taken from the linear strip. The *system* holds the numbers and makes the
# equations. The stops, the drive and all methods come with them.
#
# Do not subclass `vj.model.LinearEquations` for this: what is one of those is taken to be linear,
# and the exact methods would leave $f$ out.


# %%
class StretchingEquations(vj.model.AbstractEquations):
    """A body that is linear but for its stops and for the tension that bending puts into it."""

    linear: vj.model.LinearEquations
    slopes: jnp.ndarray  # integral of the products of the slopes of the modes, 1/m
    tension: jnp.ndarray  # E A / 2 L, N/m
    stops: tuple[vj.Stop, ...]

    @property
    def size(self):
        return self.linear.size

    def mass(self, q):
        return self.linear.mass(q)

    def linear_force(self, q, rate):
        return self.linear.linear_force(q, rate)

    def smooth_force(self, q, rate):
        return -self.tension * (q @ self.slopes @ q) * (self.slopes @ q)

    def input(self, q):
        return self.linear.input(q)

    def penetration(self, q):
        return self.linear.penetration(q)

    def response(self, q):
        return self.linear.response(q)


class StretchingStrip(vj.model.AbstractSystem):
    """The strip of above, with the tension that its clamps hold; tension=0 leaves it out."""

    strip: vj.MatrixSystem
    drive: vj.model.AbstractDrive
    tension: float  # N/m

    def equations(self):
        linear = self.strip.equations()
        shapes = self.strip.modes().shapes
        reduced = shapes.T @ jnp.asarray(slopes) @ shapes
        return StretchingEquations(linear, reduced, jnp.asarray(self.tension), linear.stops)


def stretching(tension=youngs_modulus * area / (2 * length), gap=0.3e-3):
    own = replace(strip(gap), num_modes=3)
    return StretchingStrip(own, own.drive, tension)


# %% [markdown]
# Sweeps are in Hz now: a nonlinear system has no natural frequency to be a ratio of. They are
# stepped by `vj.LinearlyImplicit`, the default for such systems, which takes the linear terms
# implicitly. A check comes first: without the tension the classes must give what the matrices give.

# %%
natural_frequency = float(first / (2 * np.pi))
frequencies = natural_frequency * np.linspace(0.94, 1.3, stretching_points)
settings = dict(frequency=frequencies, settings=vj.SweepSettings(tolerance=1e-3, refine_jumps=None))
full = stretching().tension
both = vj.frequency_sweep(stretching, tension=[0.0, full], **settings)
matrices = vj.frequency_sweep(replace(strip(), num_modes=3), **settings)
difference = np.abs(both.amplitude_ratio[0] / matrices.amplitude_ratio - 1)
print(f"largest difference without tension, relative: {difference.max():.1e}")

# %%
figure, axes = plt.subplots(figsize=(8, 4.6), dpi=100, layout="constrained")
for k, (name, colour) in enumerate((("matrices only", "#0060a8"), ("with tension", "#d1590a"))):
    for d, (style, marker) in enumerate((("-", ">"), ("--", "<"))):
        axes.plot(
            frequencies,
            1e3 * 10e-6 * both.amplitude_ratio[k, d],
            style,
            marker=marker,
            color=colour,
            markersize=5,
            label=f"{name}, {both.directions[d]}",
        )
axes.axhline(0.3, color="0.5", lw=1)
axes.text(frequencies[-1], 0.305, "gap", color="0.3", ha="right")
axes.set(xlabel="drive frequency (Hz)", ylabel="amplitude of the middle (mm)")
axes.legend()
axes.grid(alpha=0.3)
plt.show()

# %% [markdown]
# The amplitude is a third of the thickness, and the tension matters already. It stiffens the strip,
# which therefore reaches the stop at a higher frequency and stays on it up to a higher one.

# %%
for k, name in enumerate(("matrices only", "with tension")):
    amplitude = 1e3 * 10e-6 * both.amplitude_ratio[k, 0]
    at = int(amplitude.argmax())
    print(f"{name}: largest amplitude {amplitude[at]:.3f} mm at {frequencies[at]:.1f} Hz (upwards)")

# %% [markdown]
# One steady state, by Newton's method on the period map. It is exact to the steps of the solver,
# has Floquet multipliers, and can be differentiated by every number of the system:

# %%
vj.periodic_response(stretching(), frequency=1.02 * natural_frequency)

# %% [markdown]
# ## What works for which system
# | | `MatrixSystem` | equations of your own |
# |---|---|---|
# | `simulate`, `frequency_sweep`, `parameter_map` | exact steps | `LinearlyImplicit` |
# | `simulate` with any diffrax solver | yes | yes |
# | `periodic_response`, gradients of it | exact | by shooting |
# | `regimes`, `bifurcation_diagram`, `basins`, `lyapunov_exponent` | yes | yes |
# | `frequency_ratio`, energy by mode | yes | no: frequencies in Hz |
# | `continue_response`, `fold_curves`, `identify` from curves | yes | no, refused with a sentence |
#
# Asked for what it cannot do, vibrojax says so:

# %%
try:
    vj.continue_response(stretching(), frequency=vj.Range(50.0, 60.0))
except ValueError as refused:
    print(refused)
