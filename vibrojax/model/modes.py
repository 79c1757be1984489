"""Natural frequencies and mode shapes of a cantilever, differentiable in every number of it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_choice, check_count, check_range, concrete
from vibrojax._tools.compiled import compiled
from vibrojax._tools.signatures import validated
from vibrojax.model.beam import Cantilever
from vibrojax.model.dtm import Shapes, add_masses, evaluate, solve
from vibrojax.results.variables import described_as

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

FORMULATIONS = ("consistent", "as_printed")


class Modes(eqx.Module):
    """The first modes of a cantilever, in order of frequency.

    Shapes are mass-normalised whatever the formulation, int u phi^2 ds + Mr phi(1)^2 +
    sum m phi(s_m)^2 = 1, with phi(1) > 0; the sum is over the point masses m/(rho A0 L) at s_m.
    Made by `modes`; a result, not a recipe: a changed beam needs a new call.
    """

    beta: Float[Array, " modes"]
    """Dimensionless frequency parameter, beta^4 = rho A0 L^4 omega^2/(E I0)."""
    angular_frequency: Float[Array, " modes"]
    """Natural angular frequency, rad/s."""
    modal_mass: Float[Array, " modes"]
    """rho A0 L m_i, kg."""
    participation: Float[Array, " modes"]
    """Gamma_i, dimensionless: the modal force of a base acceleration a is -Gamma_i a."""
    knots: Float[Array, " knots"]
    """Ends of the segments on which the shapes are power series, in s."""
    coefficients: Float[Array, "modes segments terms"]
    """Coefficients of those series, in powers of (s - knot)/(length of the segment)."""
    formulation: str = eqx.field(static=True)
    """`consistent` or `as_printed`."""

    @property
    def num_modes(self) -> int:
        """How many modes there are."""
        return self.beta.shape[-1]

    @property
    def frequency(self) -> Float[Array, " modes"]:
        """Natural frequency, Hz."""
        return self.angular_frequency / (2 * np.pi)

    @validated(traceable=True)
    def shape(
        self, s: ArrayLike | Sequence[float], *, derivative: int = 0
    ) -> Float[Array, "*points modes"]:
        """Mode shapes, or a derivative of them with respect to s, at the places s = x/L.

        A scalar gives shape (modes,), points of shape (points,) give (points, modes). `derivative`
        is 0 to 3; the third jumps at a point mass and is that just beyond it, at the tip that
        just before it. Raises `ValueError` for another derivative or for s outside [0, 1].
        """
        if isinstance(derivative, bool) or derivative not in range(4):
            raise ValueError(f"derivative must be 0, 1, 2 or 3, got {derivative!r}.")
        points = jnp.asarray(s, dtype=self.beta.dtype)
        given = points if isinstance(s, list | tuple) else s
        check_range(
            "s", given, 0.0, 1.0, allowed="from 0 (root) to 1 (tip)", advice="s is x/length."
        )
        return evaluate(self.knots, self.coefficients, points, int(derivative))

    def plot(self) -> "Figure":
        """Draw the shapes, each scaled to a largest displacement of 1; one beam at a time.

        Raises `ValueError` for a batch of beams.
        """
        dataset = modes_dataset(self, 401)
        from vibrojax.plot.modes import plot_modes

        return plot_modes(dataset)

    @validated
    def to_xarray(self, points: int = 201) -> "xarray.Dataset":
        """Return a dataset over `mode`, and of the shapes over `place`, with units.

        `points` is the number of places x/L at equal distances from root to tip. Raises
        `ValueError` for a batch of beams, or fewer than 2 points.
        """

        check_count("points", points, least=2)
        return modes_dataset(self, points)

    def __repr__(self) -> str:
        head = f"Modes(num_modes={self.num_modes}, formulation={self.formulation!r})"
        if concrete(self.beta) is None:
            return head
        if self.beta.ndim != 1:
            return f"{head}, batch {self.beta.shape[:-1]}"
        columns = (self.frequency, self.beta, self.participation, self.modal_mass)
        rows = zip(*(np.asarray(c) for c in columns), strict=True)
        lines = [
            f"{i:4d}  {f:13.6g}  {b:9.6f}  {g:13.6f}  {m:14.6g}"
            for i, (f, b, g, m) in enumerate(rows, 1)
        ]
        return "\n".join(
            [head, "mode  frequency[Hz]       beta  participation  modal mass[kg]", *lines]
        )


def _scalar(name: str, value) -> Float[Array, ""]:
    # A strong dtype keeps one compiled version for Python floats and arrays alike.
    array = jnp.asarray(value, dtype=jnp.result_type(float))
    if array.ndim:
        raise ValueError(
            f"{name} must be one number here, got an array of shape {array.shape}. "
            "Map over beams with jax.vmap."
        )
    return array


# Apart from `solve`, which is then compiled once for both formulations.
@compiled
def _finish(
    solved: Shapes,
    scale: Float[Array, ""],
    reference_mass: Float[Array, ""],
    formulation: str,
) -> Modes:
    mass, load = solved.area_integral_of_square, solved.area_integral
    if formulation == "consistent":
        mass = add_masses(mass, solved.masses, solved.at_knots**2)
        load = add_masses(load, solved.masses, solved.at_knots)
    return Modes(
        beta=solved.beta,
        angular_frequency=scale * solved.beta**2,
        modal_mass=reference_mass * mass,
        participation=load / mass,
        knots=solved.knots,
        coefficients=solved.coefficients,
        formulation=formulation,
    )


@validated(traceable=True)
def modes(beam: Cantilever, num_modes: int = 5, formulation: str = "consistent") -> Modes:
    """Solve for the first `num_modes` natural frequencies (Hz) and mode shapes of the beam.

    `consistent` counts the tip mass in the modal mass, m_i = int u phi^2 + Mr phi(1)^2, and in the
    participation, Gamma_i = (int u phi + Mr phi(1))/m_i, as the orthogonality of the modes asks;
    a point mass adds to both in the same way, at its place. `as_printed` leaves every mass out of
    both, which Gandhi and Vyas 2017 do with the tip mass (sec. 2.3): to replicate their numbers
    only, since with a mass it is wrong at any number of modes.

    Works under jit, vmap, forward and reverse differentiation in every number of the beam, taper
    and places of the point masses included. A mode for which no root is found is NaN. Accurate
    for taper up to 0.99 (at 0.999 to fewer digits) and 20 modes. Sources: Gandhi and Vyas 2017,
    eqs. 13 to 17, and `vibrojax.model.dtm` for the expansion in several segments and the point
    masses.

    Raises `ValueError` when num_modes is not a whole number of at least 1, the formulation is
    unknown, a number of the beam is an array, or `beam` is no `Cantilever`.
    """
    check_count("num_modes", num_modes, most=1000)
    check_choice("formulation", formulation, FORMULATIONS)
    taper, mass_ratio = _scalar("taper", beam.taper), _scalar("mass_ratio", beam.mass_ratio)
    scale = _scalar("frequency_scale", beam.frequency_scale)
    reference_mass = _scalar("reference_mass", beam.reference_mass)
    masses = [_scalar("mass of a point mass", point.mass) for point in beam.point_masses]
    places = [_scalar("position of a point mass", point.position) for point in beam.point_masses]
    point_masses = jnp.asarray(masses, taper.dtype) / reference_mass
    positions = jnp.asarray(places, taper.dtype)
    solved = solve(taper, mass_ratio, point_masses, positions, int(num_modes))
    return _finish(solved, scale, reference_mass, formulation)


def modes_dataset(modes: "Modes", points: int) -> "xarray.Dataset":
    """Return the numbers of the modes, and their shapes at so many places.

    Raises `ValueError` for a batch of modes: pick one beam.
    """
    import xarray

    if modes.beta.ndim != 1:
        raise ValueError(
            f"Modes of a batch of beams, {modes.beta.shape[:-1]}, are no dataset: pick one, such "
            "as jax.tree.map(lambda a: a[0], modes)."
        )
    names = ("frequency", "beta", "modal_mass", "participation")
    data: dict[str, Any] = {
        name: ("mode", np.asarray(getattr(modes, name)), described_as(name)) for name in names
    }
    data["frequency"][2]["long_name"] = "Natural frequency"
    place = np.linspace(0.0, 1.0, points)
    data["shape"] = (("place", "mode"), np.asarray(modes.shape(place)), described_as("shape"))
    coordinates = {
        "mode": ("mode", np.arange(1, modes.num_modes + 1), described_as("mode")),
        "place": ("place", place, described_as("place")),
    }
    attributes = {"title": "vibrojax modes", "formulation": modes.formulation}
    return xarray.Dataset(data, coordinates, attrs=attributes)
