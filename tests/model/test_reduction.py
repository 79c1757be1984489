"""Finite-element models reduced: against the full matrices, the beam, and the estimated errors."""

import re

import numpy as np
import pytest
from beam_elements import BEAM, matrices, model
from scipy import sparse
from scipy.linalg import eigh

import vibrojax as vj

STOP = vj.Stop(None, 5e-4, vj.KelvinVoigt(5e3, 1.0))


def rows(elements):
    """Deflections of the tip and three quarters along the beam."""
    last = int(elements.degrees_of_freedom[-1, 0])
    return elements.row(node=last, dof=3), elements.row(node=1 + 3 * (last - 1) // 4, dof=3)


def reduced(elements, **changes):
    tip, middle = rows(elements)
    given = {
        "highest_frequency": 400.0,
        "stop_map": [middle],
        "response_map": tip,
        "input_map": elements.base_load(dof=3),
    }
    return vj.model.reduce(elements, **given | changes)


@pytest.mark.parametrize("method", ["craig_bampton", "modal"])
def test_reduced_models_agree_with_the_full_one_to_the_estimated_errors(method):
    elements = model()
    found = reduced(elements, method=method)
    assert 6 <= found.angular_frequency.size <= 9
    stiffness, mass = elements.stiffness.toarray(), elements.mass.toarray()
    squares = eigh(stiffness, mass, eigvals_only=True)
    count = found.frequency_error.size
    assert count == np.sum(squares < (2 * np.pi * 400.0) ** 2)
    off = found.angular_frequency[:count] / np.sqrt(squares[:count]) - 1
    assert np.all(off < found.frequency_error + 1e-9)
    assert np.max(found.frequency_error) < (1e-2 if method == "craig_bampton" else 1e-8)
    assert np.max(np.abs(found.shapes.T @ mass @ found.shapes - np.eye(len(found.shapes.T)))) < 1e-9

    places = np.vstack(rows(elements)[::-1])
    maps = np.vstack([found.stop_map, found.response_map])
    static = places @ np.linalg.solve(stiffness, places.T)
    np.testing.assert_allclose((maps / found.angular_frequency**2) @ maps.T, static, rtol=1e-8)
    for w in 2 * np.pi * np.array([60.0, 200.0, 300.0]):
        whole = places @ np.linalg.solve(stiffness - w**2 * mass, places.T)
        ours = (maps / (found.angular_frequency**2 - w**2)) @ maps.T
        away = np.linalg.norm(ours - whole) / np.linalg.norm(static)
        assert away < 5 * found.flexibility_error + 1e-9
    assert 1e-9 < found.flexibility_error < 1e-2
    assert "40 degrees of freedom to" in repr(found)


def test_many_modes_are_found_where_few_were_looked_for():
    elements = model(200)
    found = reduced(elements, highest_frequency=1e4, method="modal")
    # cos b cosh b = -1, whose roots are at these to 1e-6 from the sixth on.
    wanted = (np.arange(5.5, 12) * np.pi) ** 2 * BEAM.frequency_scale
    np.testing.assert_allclose(found.angular_frequency[5:12], wanted, rtol=1e-6)
    assert found.frequency_error.size > 12


@pytest.mark.slow
def test_a_reduced_beam_moves_as_the_beam_and_as_the_matrices():
    elements = model(8, damping=1e-4)
    tip, middle = rows(elements)
    found = reduced(elements)
    drive = vj.BaseMotion(1.0)
    system = found.system(stops=STOP, drive=drive)
    whole = vj.MatrixSystem(
        elements.mass,
        elements.damping,
        elements.stiffness,
        stops=STOP,
        stop_map=[middle],
        drive=drive,
        input_map=elements.base_load(dof=3),
        response_map=tip,
    )
    ours, wanted = (vj.periodic_response(s, frequency_ratio=1.1) for s in (system, whole))
    assert float(wanted.contact_force) > 1.0
    assert float(ours.amplitude_ratio) == pytest.approx(float(wanted.amplitude_ratio), rel=1e-4)
    assert float(ours.contact_force) == pytest.approx(float(wanted.contact_force), rel=2e-2)


def test_damping_ratios_and_no_stops():
    elements = model()
    tip = elements.row(node=21, dof=3)
    found = vj.model.reduce(elements, highest_frequency=100.0, response_map=tip, input_map=tip)
    equations = found.system(drive=vj.PointForce(1.0), damping_ratio=0.02).equations()
    np.testing.assert_allclose(equations.damping_ratio, 0.02, rtol=1e-9)
    assert equations.damping_coupling is None
    np.testing.assert_allclose(equations.angular_frequency, found.angular_frequency, rtol=1e-10)
    with pytest.raises(ValueError, match=r"^damping_ratio must be at least 0"):
        found.system(damping_ratio=-0.1)


def test_small_sparse_matrices_are_a_system_and_large_ones_are_asked_to_be_reduced():
    stiffness, mass, _ = matrices(4)
    tip = np.eye(8)[-2]
    ours, wanted = (
        vj.MatrixSystem(m, 0 * k, k, response_map=tip).equations().angular_frequency
        for m, k in ((mass, stiffness), (mass.toarray(), stiffness.toarray()))
    )
    np.testing.assert_array_equal(ours, wanted)
    large = sparse.eye_array(20000, format="csr")
    with pytest.raises(ValueError, match=r"^mass must have at most 3000 .* got 20000\. .*reduce"):
        vj.MatrixSystem(large, large, large, response_map=np.ones(20000))


STIFFNESS, MASS, LABELS = matrices(4)


def changed(matrix, i, j, value):
    matrix = matrix.tolil()
    matrix[i, j] = matrix[j, i] = value
    return matrix.tocsc()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"mass": MASS[:4]}, r"mass must be of the shape of stiffness, shape \(8, 8\), got \(4, 8"),
        ({"stiffness": STIFFNESS[:4]}, r"stiffness must be a square matrix, shape \(4, 4\), got"),
        ({"mass": "heavy"}, "mass must be a sparse matrix of scipy or an array, got 'heavy'"),
        ({"mass": changed(MASS, 0, 0, np.nan)}, "mass must be finite, got nan"),
        ({"stiffness": sparse.triu(STIFFNESS)}, r"stiffness must be symmetric, got .* at index"),
        ({"mass": changed(MASS, 1, 1, -1.0)}, "mass must be positive on its diagonal, got -1 at n"),
        ({"stiffness": changed(STIFFNESS, 2, 2, 0.0)}, "stiffness must be positive on its diagona"),
        (
            {"mass": sparse.diags_array(np.array([1.0, 0, 1, 1, 0, 0, 1, 1]))},
            "mass must be above 0 at every node, got none at node 4",
        ),
        ({"degrees_of_freedom": LABELS[:4]}, r"degrees_of_freedom must be 8 different pairs"),
        ({"degrees_of_freedom": 0 * LABELS}, r"degrees_of_freedom must be 8 different pairs"),
    ],
)
def test_what_is_no_model_is_refused(changes, sentence):
    given = {"stiffness": STIFFNESS, "mass": MASS, "degrees_of_freedom": LABELS}
    with pytest.raises(ValueError, match=f"^{sentence}"):
        vj.model.FiniteElements(**given | changes)


LOOSE = np.array([[1.0, -1.0], [-1.0, 1.0]])


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"stop_map": [[1.0, 0.0]]},
            r"stop_map must have one number per .* shape \(stops",
        ),
        ({"response_map": np.ones(3)}, r"response_map must have one number .* shape \(40,\), got"),
        ({"response_map": np.zeros(40)}, "response_map must be finite and not 0 everywhere"),
        ({"highest_frequency": 1e9}, "highest_frequency must be so low that most modes can be"),
        ({"highest_frequency": 0.0}, "highest_frequency must be above 0 Hz"),
        ({"method": "guyan"}, "method must be "),
    ],
)
def test_what_cannot_be_reduced_is_refused(changes, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        reduced(model(), **changes)


@pytest.mark.parametrize(
    ("stiffness", "sentence"),
    [
        (np.kron(np.eye(3), LOOSE), "stiffness must be positive definite, got a singular one"),
        (
            np.kron(np.eye(3), LOOSE + np.array([[0.0, 0.0], [0.0, -0.5]])),
            "stiffness must be positive definite, got 3 negative eigenvalues: the structure is uns",
        ),
    ],
)
def test_loose_and_unstable_structures_are_refused(stiffness, sentence):
    elements = vj.model.FiniteElements(mass=np.eye(6), stiffness=stiffness)
    with pytest.raises(ValueError, match=f"^{sentence}"):
        vj.model.reduce(elements, highest_frequency=1.0, response_map=np.eye(6)[0])


def test_rows_and_held_nodes():
    elements = model(4)
    row = elements.row(node=3, dof=5)
    assert np.flatnonzero(row).tolist() == [3]
    load = elements.base_load(dof=3)
    h = BEAM.length / 4
    assert load[0] == pytest.approx(BEAM.density * BEAM.root_area * h)
    held = elements.held(nodes=[5])
    assert held.mass.shape == (6, 6)
    assert repr(held).startswith("FiniteElements(6 degrees of freedom at 3 nodes")
    for call, sentence in (
        (lambda: elements.row(node=3, dof=1), "node 3 must have a degree of freedom 1 among the 8"),
        (lambda: elements.row(node=9, dof=3), "node 9 must have .* No such node"),
        (lambda: elements.base_load(dof=2), "dof must be a direction in which a node moves, got 2"),
        (lambda: elements.base_load(dof=5), re.escape("dof must be 1, 2 or 3 (along x, y or z)")),
        (lambda: elements.held(nodes=[1]), "nodes must be of the model, got 1, which it has not"),
    ):
        with pytest.raises(ValueError, match=f"^{sentence}"):
            call()
