"""Mass, damping and stiffness matrices, read from files of finite-element programs."""

import importlib
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Int

from vibrojax._tools.described import in_short
from vibrojax._tools.signatures import validated
from vibrojax.model.finite_elements import FiniteElements

Source = Any
"""Path of a file, (path, name of a matrix in it), or a matrix in memory."""
NASTRAN = (".op4", ".pch", ".dmig", ".bdf", ".dat")
INITIALS = {"mass": "m", "stiffness": "k", "damping": "b"}
"""With which letter Nastran's names of matrices begin: KAAX, MAAX, BAAX."""
ADVICE = (
    "Known are Matrix Market (.mtx, .mtx.gz), Abaqus (.mtx: node, dof, node, dof, value) and "
    "Nastran (.op4, .pch)."
)


class Labelled(NamedTuple):
    """A matrix, and what its rows are where the file says so."""

    matrix: Any
    labels: Int[np.ndarray, "coordinates 2"] | None


@validated
def read_matrices(
    *,
    stiffness: Source,
    mass: Source,
    damping: Source = None,
    degrees_of_freedom: ArrayLike | Sequence[Any] | None = None,
) -> FiniteElements:
    """Read the matrices of a finite-element model, in SI units, with the supports held.

    What a file holds is seen by its first line, or for Nastran by its ending:

    - Matrix Market, by scipy.
    - Abaqus, *MATRIX OUTPUT: lines of node, degree of freedom, node, degree of freedom, value; the
      whole of a symmetric matrix, or one triangle of it.
    - Nastran: DMIG of a punch file (.pch) or bulk data, and output4 (.op4), by pyyeti
      (`pip install "vibrojax[nastran]"`).

    Parameters:
        stiffness: K, N/m: a path, (path, name) for a file that holds several matrices, or a sparse
            matrix of scipy or array. Without a name a matrix whose name begins with K is taken.
        mass: M, kg, likewise (M).
        damping: C, N s/m, likewise (B); None for none.
        degrees_of_freedom: node and degree of freedom of every coordinate, shape (n, 2), for
            matrices that do not say so themselves; see `vibrojax.model.FiniteElements`.

    Matrices whose files have labels are brought into one order, by node and degree of freedom.
    Raises `ValueError` for a file that is not there, is not what it says or does not name its
    matrix, labels that do not belong together, and matrices that are none of a structure (see
    `FiniteElements`); `ImportError` where pyyeti is missing.
    """
    given = {"stiffness": stiffness, "mass": mass, "damping": damping}
    read = {name: _read(name, source) for name, source in given.items() if source is not None}
    own = {name: one.labels for name, one in read.items() if one.labels is not None}
    if not own:
        matrices = {name: one.matrix for name, one in read.items()}
        return FiniteElements(**matrices, degrees_of_freedom=degrees_of_freedom)
    bare = [name for name in read if name not in own]
    if bare:
        raise ValueError(
            f"{bare[0]} must name its degrees of freedom as {next(iter(own))} does, got a matrix "
            "without. Read all from files of one kind."
        )
    if degrees_of_freedom is not None:
        raise ValueError(
            "degrees_of_freedom must be None where the files name them, got an array of shape "
            f"{np.shape(degrees_of_freedom)}."
        )
    return _in_one_order(read)


def _in_one_order(read: dict[str, Labelled]) -> FiniteElements:
    """Bring matrices with labels into the order of all labels."""
    from scipy.sparse import coo_array

    found = [one.labels for one in read.values() if one.labels is not None]
    every = np.unique(np.concatenate(found), axis=0)
    matrices = {}
    for (name, one), labels in zip(read.items(), found, strict=True):
        _, place = np.unique(np.concatenate([every, labels]), axis=0, return_inverse=True)
        place = place.reshape(-1)[len(every) :]
        matrix = coo_array(one.matrix)
        row, column = (place[index] for index in matrix.coords)
        matrices[name] = coo_array((matrix.data, (row, column)), shape=(len(every),) * 2)
    return FiniteElements(**matrices, degrees_of_freedom=every)


def _read(name: str, source: Source) -> Labelled:
    wanted = None
    if isinstance(source, tuple) and len(source) == 2 and isinstance(source[1], str):
        source, wanted = source
    if not isinstance(source, str | os.PathLike):
        if hasattr(source, "ndim") or isinstance(source, list):
            return Labelled(source, None)
        raise ValueError(
            f"{name} must be a path, (path, name of a matrix) or a sparse matrix of scipy, got "
            f"{in_short(source)}."
        )
    path = Path(source)
    if not path.is_file():
        raise ValueError(f"{name} must be a file that is there, got {str(path)!r}.")
    try:
        if path.suffix.lower() in NASTRAN:
            return _nastran(name, path, wanted)
        with path.open("rb") as file:
            start = file.read(14)
        if start == b"%%MatrixMarket" or path.suffix in (".gz", ".bz2"):
            from scipy.io import mmread

            return Labelled(mmread(path), None)
        return _abaqus(path)
    except ImportError:
        raise
    except Exception as error:  # pyyeti and scipy raise of all kinds where a file is damaged
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(
            f"{name} must be a file of matrices, got {str(path)!r}: {reason.rstrip('.')}. {ADVICE}"
        ) from None


def _abaqus(path: Path) -> Labelled:
    """Read lines of node, dof, node, dof, value; a triangle alone is completed."""
    from scipy.sparse import coo_array

    with warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy only warns of an empty file
        table = np.loadtxt(path, delimiter=",", comments="*", ndmin=2)
    whole = table[:, :-1]
    if table.shape[1] != 5:
        raise ValueError(f"a line has {table.shape[1]} numbers in place of 5")
    if not np.array_equal(whole, np.round(whole)):
        line = int(np.argmax(np.any(whole != np.round(whole), axis=1)))
        raise ValueError(f"entry {line + 1} has a node or degree of freedom that is not whole")
    pairs = whole.astype(int).reshape(-1, 2)
    # One number for a pair sorts 20 times faster than rows do.
    low = pairs.min(axis=0)
    span = pairs[:, 1].max() - low[1] + 1
    keys, place = np.unique(
        (pairs[:, 0] - low[0]) * span + pairs[:, 1] - low[1], return_inverse=True
    )
    labels = np.stack([keys // span + low[0], keys % span + low[1]], axis=1)
    row, column = place.reshape(-1, 2).T
    value, n = table[:, -1], len(keys)
    both = np.intersect1d(row * n + column, (column * n + row)[row != column])
    if not both.size:
        away = row != column
        row, column = np.append(row, column[away]), np.append(column, row[away])
        value = np.append(value, value[away])
    return Labelled(coo_array((value, (row, column)), shape=(n, n)), labels)


def _nastran(name: str, path: Path, wanted: str | None) -> Labelled:
    op4 = path.suffix.lower() == ".op4"
    try:
        with np.printoptions():  # which pyyeti changes for the whole process
            reader = importlib.import_module("pyyeti.nastran." + ("op4" if op4 else "bulk"))
    except ImportError as error:
        raise ImportError(
            f"{name}: reading {path.name!r} needs pyyeti, which is not installed. Install it by "
            'pip install "vibrojax[nastran]".'
        ) from error
    if op4:
        names, matrices, *_ = reader.load(str(path), into="list", sparse=True)
        held = dict(zip((n.lower() for n in names), matrices, strict=True))
    else:
        held = reader.rddmig(str(path), square=True)
    known = ", ".join(n.upper() for n in held) or "none"
    if wanted is not None and wanted.lower() not in held:
        raise ValueError(f"it has no matrix {wanted!r} but {known}")
    fitting = [n for n in held if n.startswith(INITIALS[name])]
    chosen = [wanted.lower()] if wanted is not None else list(held) if len(held) == 1 else fitting
    if len(chosen) != 1:
        raise ValueError(f"it holds {known}: say which by ({path.name!r}, name)")
    matrix = held[chosen[0]]
    if op4:
        return Labelled(matrix, None)
    labels = np.array([tuple(label) for label in matrix.index], int)
    return Labelled(matrix.to_numpy(), labels)
