"""Small motions of the elastic pendulum about the vertical, in its modes."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from vibrojax._tools.checks import check_count, check_positive
from vibrojax._tools.signatures import validated
from vibrojax.model.drives import AbstractDrive
from vibrojax.model.equations import AbstractGauge, LinearEquations
from vibrojax.model.pendulum_equations import PendulumEquations, pendulum_observables
from vibrojax.model.states import Displacement, check_coordinates
from vibrojax.model.systems import AbstractSystem


class PendulumGauge(AbstractGauge):
    """Reads angles off modal coordinates, and off the angles what a pendulum shows."""

    shapes: Float[Array, "links modes"]
    """Angles by modal coordinate, rad."""
    stiffness: Float[Array, "links links"]
    """Of the joints, N m/rad."""
    link_length: Float[Array, ""]
    """m."""

    def __call__(self, q: Float[Array, " modes"]) -> dict[str, Float[Array, ""]]:
        """Return bearing angle (rad), chord reduction (m) and the energy in the joints (J)."""
        angles = self.shapes @ q
        seen = pendulum_observables(angles, self.link_length)
        return {
            "bearing_angle": seen["bearing_angle"],
            "chord_reduction": seen["chord_reduction"],
            "strain_energy": angles @ (self.stiffness @ angles) / 2,
        }


@validated
class LinearisedPendulum(AbstractSystem):
    """An `ElasticPendulum` for small angles, reduced to modes of the free pendulum.

    The lowest mode falls away from the vertical. Coordinates are modal, with modal masses of 1;
    `angles` and `modal_coordinates` go to angles and back. It is stepped by `LinearlyImplicit`: its
    limiters, whose damping stops the pendulum within microseconds, are too stiff for
    `ExactContact`. Source: Litak et al., eqs. 1 to 6.

    Raises `ValueError` for fewer than 1 mode, more modes than links, or a gravity of 0, at which
    the lowest mode has no stiffness.
    """

    pendulum: AbstractSystem
    """The pendulum whose numbers count."""
    num_modes: int = eqx.field(static=True, default=6)
    """How many modes are kept."""

    def __check_init__(self) -> None:
        """Refuse what is no number of modes of this pendulum."""
        check_count("num_modes", self.num_modes, most=1000)
        links = getattr(self.pendulum, "num_links", None)
        if links is None:
            raise ValueError(f"pendulum must be an ElasticPendulum, got {self.pendulum!r}.")
        if self.num_modes > links:
            raise ValueError(
                f"num_modes must be at most {links}, the number of links, got {self.num_modes}."
            )
        gravity = getattr(self.pendulum, "gravity", None)
        check_positive("gravity", gravity, "m/s2", "Without it the lowest mode has no stiffness.")

    @property
    def drive(self) -> AbstractDrive:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What drives the pendulum."""
        return self.pendulum.drive

    def _equations(self) -> PendulumEquations:
        equations = self.pendulum.equations()
        assert isinstance(equations, PendulumEquations)
        return equations

    def shapes(self) -> Float[Array, "links modes"]:
        """Return the angles of the links, rad, by modal coordinate; the tip moves towards +x."""
        return _modes(self._equations())[1][:, : self.num_modes]

    @validated(traceable=True)
    def angles(self, q: ArrayLike) -> Float[Array, " links"]:
        """Return the angles (rad, or rates) of modal coordinates, shape (modes,).

        `q` are modal coordinates, or their rates. Raises `TypeError` for another shape.
        """
        return self.shapes() @ jnp.asarray(q)

    def modal_coordinates(self, displacement: Displacement) -> Float[Array, " modes"]:
        """Return the modal coordinates of angles of the links (or rates), shape (links,).

        `displacement` are the angles, rad, or rad/s. Raises `ValueError` for another shape.
        """
        full = self._equations()
        angles = check_coordinates("displacement", displacement, full.size, "an angle per link")
        return self.shapes().T @ (full.inertia @ angles)

    def equations(self) -> LinearEquations:
        """Linearise about the vertical and reduce to the modes, the damping matrix whole."""
        full = self._equations()
        square, shapes = _modes(full)
        square, shapes = square[: self.num_modes], shapes[:, : self.num_modes]
        frequency = jnp.sqrt(jnp.abs(square))
        damping = shapes.T @ full.damping @ shapes
        rest = jnp.zeros(full.size)
        stop_map = jax.jacfwd(full.penetration)(rest) @ shapes
        diagonal = jnp.diagonal(damping)
        return LinearEquations(
            stops=full.stops,
            angular_frequency=frequency,
            damping_ratio=diagonal / (2 * frequency),
            input_map=shapes.T @ full.input(rest),
            stop_map=stop_map,
            force_map=stop_map.T,
            response_map=full.link_length * jnp.sum(shapes, axis=0),
            modal_mass=jnp.ones_like(frequency),
            damping_coupling=damping - jnp.diag(diagonal),
            stiffness_sign=jnp.sign(square),
            gauge=PendulumGauge(shapes, full.stiffness, full.link_length),
        )


def _modes(
    equations: PendulumEquations,
) -> tuple[Float[Array, " links"], Float[Array, "links links"]]:
    """Squared angular frequencies about the vertical, and shapes of unit modal mass."""
    stiffness = equations.stiffness - jnp.diag(equations.gravity * equations.moment)
    lower = jnp.linalg.cholesky(equations.inertia)
    square, vectors = jnp.linalg.eigh(_reduced(lower, stiffness))
    shapes = jax.scipy.linalg.solve_triangular(lower.T, vectors, lower=False)
    return square, shapes * jnp.sign(jnp.sum(shapes, axis=0))


def _reduced(lower, matrix):
    half = jax.scipy.linalg.solve_triangular(lower, matrix, lower=True)
    return jax.scipy.linalg.solve_triangular(lower, half.T, lower=True)


def natural_frequencies(
    equations: PendulumEquations, root_stiffness: Float[Array, ""], propped: bool
) -> Float[Array, " modes"]:
    """Return natural frequencies about the vertical, Hz, below 0 for modes that fall away.

    `root_stiffness` (N m/rad) holds the lowest link; `propped` holds the height of the limiters.
    """
    stiffness = equations.stiffness - jnp.diag(equations.gravity * equations.moment)
    stiffness = stiffness.at[0, 0].add(root_stiffness)
    mass = equations.inertia
    if propped:
        held = jax.jacfwd(equations.penetration)(jnp.zeros(equations.size))[0]
        # The columns of Q beyond the first are all motions that the prop allows.
        allowed = jnp.linalg.qr(held[:, None], mode="complete")[0][:, 1:]
        mass, stiffness = allowed.T @ mass @ allowed, allowed.T @ stiffness @ allowed
    square = jnp.linalg.eigvalsh(_reduced(jnp.linalg.cholesky(mass), stiffness))
    return jnp.sign(square) * jnp.sqrt(jnp.abs(square)) / (2 * jnp.pi)
