"""Matrices of a finite-element beam, written in each format and read; files that are none."""

import sys

import numpy as np
import pytest
from beam_elements import BEAM, matrices
from scipy.io import mmwrite

import vibrojax as vj

STIFFNESS, MASS, LABELS = matrices(12)


def write_abaqus(path, matrix, triangle=None, order=None):
    matrix = matrix.tocoo()
    rows, columns = matrix.coords
    kept = {None: rows == rows, "lower": rows >= columns, "upper": rows <= columns}[triangle]
    lines = [
        f"{LABELS[i, 0]},{LABELS[i, 1]}, {LABELS[j, 0]},{LABELS[j, 1]},  {v:.17e}"
        for i, j, v in zip(rows[kept], columns[kept], matrix.data[kept], strict=True)
    ]
    if order is not None:
        lines = [lines[k] for k in order.permutation(len(lines))]
    path.write_text("\n".join(lines) + "\n")


def write_punch(path, **given):
    """DMIG entries of wide fields, one triangle: symmetric (form 6), real double (type 2)."""
    lines = []
    for name, matrix in given.items():
        lines.append(f"DMIG    {name:8s}{0:8d}{6:8d}{2:8d}{0:8d}")
        dense = matrix.toarray()
        for j, (node, dof) in enumerate(LABELS):
            lines.append(f"DMIG*   {name:8s}        {node:16d}{dof:16d}")
            for i in range(j, len(LABELS)):
                if dense[i, j]:
                    value = f"{dense[i, j]:.9E}".replace("E", "D")
                    lines.append(f"*       {LABELS[i, 0]:16d}{LABELS[i, 1]:16d}{value:>16s}")
    path.write_text("\n".join(lines) + "\n")


def check(elements, rtol=1e-15):
    """The matrices, and with them the natural frequencies of the beam."""
    for ours, wanted in ((elements.stiffness, STIFFNESS), (elements.mass, MASS)):
        np.testing.assert_allclose(ours.toarray(), wanted.toarray(), rtol=rtol)
    tip = np.eye(24)[-2]
    system = vj.MatrixSystem(
        elements.mass, 0 * elements.mass, elements.stiffness, response_map=tip, num_modes=3
    )
    found = np.asarray(system.modes().angular_frequency) / (2 * np.pi)
    np.testing.assert_allclose(found, np.asarray(vj.modes(BEAM, 3).frequency), rtol=2e-4)


@pytest.mark.parametrize("triangle", [None, "lower", "upper"])
def test_abaqus(tmp_path, triangle):
    for name, matrix in (("K", STIFFNESS), ("M", MASS)):
        write_abaqus(tmp_path / f"{name}.mtx", matrix, triangle, np.random.default_rng(1))
    found = vj.io.read_matrices(stiffness=tmp_path / "K.mtx", mass=str(tmp_path / "M.mtx"))
    np.testing.assert_array_equal(found.degrees_of_freedom, LABELS)
    check(found)


def test_abaqus_with_comments_and_a_diagonal_mass(tmp_path):
    write_abaqus(tmp_path / "K.mtx", STIFFNESS)
    lines = (tmp_path / "K.mtx").read_text()
    (tmp_path / "K.mtx").write_text("** STIFFNESS MATRIX\n*MATRIX INPUT, NAME=K\n" + lines)
    masses = "".join(f"{node},{dof}, {node},{dof}, 2.0\n" for node, dof in LABELS if dof == 3)
    (tmp_path / "M.mtx").write_text(masses)
    found = vj.io.read_matrices(stiffness=tmp_path / "K.mtx", mass=tmp_path / "M.mtx")
    np.testing.assert_array_equal(found.mass.diagonal(), np.tile([2.0, 0.0], 12))


def test_matrix_market_and_memory(tmp_path):
    mmwrite(tmp_path / "K.mtx", STIFFNESS, symmetry="symmetric", precision=17)
    mmwrite(tmp_path / "M.mtx", MASS, precision=17)
    found = vj.io.read_matrices(
        stiffness=tmp_path / "K.mtx",
        mass=tmp_path / "M.mtx",
        damping=1e-5 * STIFFNESS,
        degrees_of_freedom=LABELS,
    )
    check(found)
    np.testing.assert_array_equal(found.damping.toarray(), 1e-5 * STIFFNESS.toarray())
    plain = vj.io.read_matrices(stiffness=STIFFNESS, mass=MASS)
    assert np.flatnonzero(plain.row(node=5)).tolist() == [4]


def test_nastran_punch(tmp_path):
    pytest.importorskip("pyyeti")
    path = tmp_path / "model.pch"
    write_punch(path, KAAX=STIFFNESS, MAAX=MASS)
    found = vj.io.read_matrices(stiffness=path, mass=(path, "MAAX"))
    np.testing.assert_array_equal(found.degrees_of_freedom, LABELS)
    check(found, rtol=1e-9)
    with pytest.raises(ValueError, match=r"it holds KAAX, MAAX: say which by \('model\.pch', name"):
        vj.io.read_matrices(stiffness=path, mass=path, damping=path)
    with pytest.raises(ValueError, match="it has no matrix 'K2' but KAAX, MAAX"):
        vj.io.read_matrices(stiffness=(path, "K2"), mass=path)


def test_reading_nastran_leaves_how_numpy_prints(tmp_path, monkeypatch):
    pytest.importorskip("pyyeti")
    for name in [name for name in sys.modules if name.startswith("pyyeti")]:
        monkeypatch.delitem(sys.modules, name)
    path = tmp_path / "model.pch"
    write_punch(path, KAAX=STIFFNESS, MAAX=MASS)
    with np.printoptions(legacy=False):
        vj.io.read_matrices(stiffness=path, mass=(path, "MAAX"))
        assert np.get_printoptions()["legacy"] is False


def test_nastran_op4(tmp_path):
    op4 = pytest.importorskip("pyyeti.nastran.op4")
    path = tmp_path / "model.op4"
    op4.write(str(path), {"KAA": STIFFNESS.toarray(), "MAA": MASS.tocoo()})
    check(vj.io.read_matrices(stiffness=path, mass=path, degrees_of_freedom=LABELS))
    path.write_text("not an op4 file at all, whatever its name says\n" * 9)
    with pytest.raises(ValueError, match=r"^stiffness must be a file of matrices, got"):
        vj.io.read_matrices(stiffness=path, mass=path)


def test_without_pyyeti_it_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "K.op4").write_text("")
    for name in [name for name in sys.modules if name.startswith("pyyeti")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyyeti", None)
    with pytest.raises(ImportError, match=r'needs pyyeti.* pip install "vibrojax\[nastran\]"'):
        vj.io.read_matrices(stiffness=tmp_path / "K.op4", mass=MASS)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "input contained no data"),
        ("1,3, 1,3, 2.0\n1,3, 1,5\n", "the number of columns changed"),
        ("1 1 1 1 2.0\n", "could not convert string"),
        ("1,3,2.0\n", "a line has 3 numbers in place of 5"),
        ("1,3, 1.5,3, 2.0\n", "entry 1 has a node or degree of freedom that is not whole"),
        ("%%MatrixMarket matrix coordinate real general\n3 3 2\n1 1 1.0\n", ""),
        ("PK\x03\x04 something else", "could not convert string"),
    ],
)
def test_a_file_that_is_not_what_it_says(tmp_path, text, sentence):
    path = tmp_path / "K.mtx"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"^stiffness must be a file of matrices.*{sentence}"):
        vj.io.read_matrices(stiffness=path, mass=MASS)


def test_what_does_not_belong_together(tmp_path):
    write_abaqus(tmp_path / "K.mtx", STIFFNESS)
    calls = (
        ({"mass": MASS}, "mass must name its degrees of freedom as stiffness does"),
        (
            {"mass": tmp_path / "K.mtx", "degrees_of_freedom": LABELS},
            "degrees_of_freedom must be None where the files name them",
        ),
        ({"mass": tmp_path / "M.mtx"}, "mass must be a file that is there, got"),
        ({"mass": 3.0}, r"mass must be a path, \(path, name of a matrix\) or a sparse matrix"),
    )
    for changes, sentence in calls:
        with pytest.raises(ValueError, match=f"^{sentence}"):
            vj.io.read_matrices(stiffness=tmp_path / "K.mtx", **changes)
