"""Static correction: exact static flexibility, better dynamic flexibility, orthogonal shapes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beam_elements import matrices
from scipy.linalg import eigh

import vibrojax as vj
from vibrojax.model.residual_shapes import static_deflection
from vibrojax.model.systems import as_arrays, equations_of

LAW = vj.KelvinVoigt(1e5)
STOPS = (vj.Stop(0.6, 1e-3, LAW), vj.Stop(0.6, 1e-3, LAW, side=-1), vj.Stop(0.9, 1e-3, LAW))


def beam(taper=0.4, **changes):
    return vj.ImpactingBeam(
        vj.Cantilever(
            length=0.5,
            width=0.03,
            thickness=0.003,
            youngs_modulus=2.1e11,
            density=7800.0,
            taper=taper,
            mass_ratio=0.2,
            point_masses=vj.PointMass(0.05, 0.4),
        ),
        **{"stops": STOPS, "drive": vj.BaseMotion(1.0), "num_modes": 3} | changes,
    )


def flexibility(system, w=0.0):
    """Displacement at all stops by unit forces at all of them, undamped, at w rad/s."""
    e = equations_of(as_arrays(system))
    stops = np.asarray(e.stop_map)
    return (stops / (np.asarray(e.angular_frequency) ** 2 - w**2)) @ np.asarray(e.force_map)


@pytest.mark.parametrize("taper", [0.0, 1e-7, 0.4, 0.99])
def test_static_deflection_is_the_double_integral(taper):
    places, forces = np.array([0.1, 0.5, 0.8, 1.0]), np.array([0.5, 0.9])
    found = static_deflection(jnp.asarray(taper), jnp.asarray(places), jnp.asarray(forces))
    from scipy.integrate import quad

    for i, s in enumerate(places):
        for j, f in enumerate(forces):
            wanted, _ = quad(
                lambda t, s=s, f=f: (s - t) * (f - t) / (1 - taper * t), 0, min(s, f), epsabs=1e-14
            )
            assert float(found[i, j]) == pytest.approx(wanted, rel=1e-11)


@pytest.mark.slow
@pytest.mark.long
def test_static_flexibility_of_a_beam_is_exact_and_shapes_are_orthogonal():
    system = beam(static_correction=True)
    places = [0.6, 0.6, 0.9]
    whole = [system.beam.static_flexibility(place) for place in places]
    np.testing.assert_allclose(np.diagonal(flexibility(system)), whole, rtol=1e-10)
    lacking = np.array(beam().flexibility_left_out())
    assert np.all(lacking / whole > 1e-5)
    assert np.all(np.abs(system.flexibility_left_out()) < 1e-9 * np.array(whole))
    # Two stops at one place: three shapes more, one of which is none.
    e = equations_of(as_arrays(system))
    assert e.size == 6
    assert np.sum(np.abs(np.asarray(e.stop_map)).max(axis=0) > 1e-9) == 5
    one_of_beam = beam().modes().modal_mass[0]
    np.testing.assert_allclose(e.modal_mass, one_of_beam, rtol=1e-12)
    coordinates = system.modal_coordinates(lambda s: system.shape_at(s) @ jnp.arange(1.0, 7.0))
    used = np.abs(np.asarray(system.shape_at(0.77))) > 1e-9
    np.testing.assert_allclose(coordinates[used], np.arange(1.0, 7.0)[used], rtol=1e-6)


@pytest.mark.slow
def test_three_corrected_modes_come_closer_to_thirty_than_three_do():
    three, many = beam(static_correction=True), beam(num_modes=30)
    between = np.sqrt(np.prod(np.asarray(many.modes().angular_frequency[1:3])))
    wanted = flexibility(many, between)
    size = np.linalg.norm(wanted)
    plain = np.linalg.norm(flexibility(beam(), between) - wanted) / size
    corrected = np.linalg.norm(flexibility(three, between) - wanted) / size
    assert plain > 1e-3
    assert corrected < plain / 30
    # Mass that the base moves with it, by the modes.
    mass = [
        float(jnp.sum(e.modal_mass * e.input_map**2))
        for e in (equations_of(as_arrays(s)) for s in (beam(), three, many))
    ]
    assert mass[0] < mass[1] < mass[2]


def test_matrices_with_few_modes_have_the_static_flexibility_of_all():
    stiffness, mass, _ = matrices(6)
    stiffness, mass = stiffness.toarray(), mass.toarray()
    rows = np.eye(12)[[6, 6, 10]]

    def system(**changes):
        stops = tuple(vj.Stop(None, 1e-3, LAW, side=s.side) for s in STOPS)
        return vj.MatrixSystem(
            mass,
            1e-5 * stiffness,
            stiffness,
            stops=stops,
            stop_map=rows,
            response_map=rows[2],
            **changes,
        )

    corrected = system(num_modes=3, static_correction=True)
    sides = np.array([1.0, -1.0, 1.0])
    whole = sides[:, None] * (rows @ np.linalg.solve(stiffness, rows.T)) * sides
    np.testing.assert_allclose(flexibility(corrected), whole, rtol=1e-9, atol=1e-9 * whole.max())
    np.testing.assert_allclose(corrected.flexibility_left_out(), 0.0, atol=1e-9 * whole.max())
    assert min(system(num_modes=3).flexibility_left_out()) > 1e-4 * whole.max()
    assert corrected.proportional
    shapes = np.asarray(corrected.modes().shapes)
    used = np.abs(shapes).max(axis=0) > 0
    assert used.sum() == 5
    products = (shapes.T @ mass @ shapes)[used][:, used]
    np.testing.assert_allclose(products, np.eye(5), atol=1e-9)
    # With all modes kept there is nothing to correct.
    full = equations_of(as_arrays(system(static_correction=True)))
    np.testing.assert_allclose(
        full.angular_frequency**2, eigh(stiffness, mass, eigvals_only=True), rtol=1e-6
    )


@pytest.mark.slow
def test_derivatives_pass_with_stops_at_one_place():
    def last(taper, position):
        system = beam(taper, static_correction=True)
        system = eqx.tree_at(lambda b: b.stops[2].position, system, position)
        e = system.equations()
        return jnp.sum(e.stop_map[:, -3:] ** 2) + 1e-9 * jnp.sum(e.angular_frequency[3:5] ** 2)

    value = jax.jit(last)
    found = jax.jit(jax.grad(last, argnums=(0, 1)))(0.4, 0.9)
    for k, slope in enumerate(found):
        step = 1e-5 * np.eye(2)[k]
        wanted = (value(0.4 + step[0], 0.9 + step[1]) - value(0.4 - step[0], 0.9 - step[1])) / 2e-5
        assert float(slope) == pytest.approx(float(wanted), rel=1e-5)


def test_modes_as_printed_are_not_corrected():
    with pytest.raises(ValueError, match=r"^static_correction must be False with formulation="):
        beam(formulation="as_printed", static_correction=True)


def test_check_resolution_recommends_it():
    def study(system, method):
        return {"first": system.equations().angular_frequency[0]}

    stiffness = np.array([[3.0, -1.0], [-1.0, 2.0]])
    stops = vj.Stop(None, 1.0, vj.KelvinVoigt(10.0))
    given = {"stops": stops, "stop_map": [[1.0, 0.0]], "response_map": [1.0, 0.0], "num_modes": 1}
    system = vj.MatrixSystem(np.eye(2), 0 * stiffness, stiffness, **given)
    checked = vj.check_resolution(study, system)
    assert "static_correction=True" in checked.advice
    assert checked.advice in repr(checked)
    system = vj.MatrixSystem(np.eye(2), 0 * stiffness, stiffness, **given, static_correction=True)
    assert vj.check_resolution(study, system).advice == ""
