"""The notebooks run on small grids, and their stored outputs are those of their sources."""

import sys
from pathlib import Path

import nbformat
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "notebooks"))

import execute

SOURCES = execute.sources()
MOST_BYTES = 600_000
LONG = {"10_measured_impacts", "11_design"}
"""Notebooks that take minutes on small grids too, most of it compiling or fits."""


def by_name(path):
    return path.stem


@pytest.mark.slow
@pytest.mark.parametrize(
    "source",
    [pytest.param(s, marks=pytest.mark.long) if s.stem in LONG else s for s in SOURCES],
    ids=by_name,
)
def test_runs_on_small_grids(source):
    notebook = execute.execute(execute.with_small_grids(execute.read(source)))
    assert execute.complaints(notebook) == []
    assert execute.pictures(notebook) >= 1


@pytest.mark.parametrize("source", SOURCES, ids=by_name)
def test_stored_outputs_belong_to_the_source(source):
    stored = nbformat.read(source.with_suffix(".ipynb"), as_version=4)
    written = execute.read(source)
    assert [(cell.cell_type, cell.source) for cell in stored.cells] == [
        (cell.cell_type, cell.source) for cell in written.cells
    ], f"{source.stem} changed: run python docs/notebooks/execute.py {source.stem}"
    assert all(cell.execution_count for cell in stored.cells if cell.cell_type == "code")
    assert execute.complaints(stored) == []
    assert execute.pictures(stored) >= 1
    assert source.with_suffix(".ipynb").stat().st_size < MOST_BYTES


@pytest.mark.parametrize("source", SOURCES, ids=by_name)
def test_opens_with_a_question_and_has_small_grids(source):
    notebook = execute.read(source)
    opening = notebook.cells[0]
    assert opening.cell_type == "markdown"
    assert opening.source.startswith("# ")
    assert "?" in opening.source
    assert notebook.metadata.jupytext.formats == "ipynb,py:percent"
    assert len(execute.with_small_grids(notebook).cells) > len(notebook.cells)


def test_small_values_take_the_place_of_full_ones():
    cell = nbformat.v4.new_code_cell("points = 121", metadata={"small": {"points": 3}})
    shown = nbformat.v4.new_code_cell("print(points)")
    small = execute.with_small_grids(nbformat.v4.new_notebook(cells=[cell, shown]))
    values = {}
    exec("\n".join(cell.source for cell in small.cells), values)
    assert values["points"] == 3
    cell.metadata["small"] = {"pionts": 3}
    with pytest.raises(ValueError, match="pionts"):
        execute.with_small_grids(nbformat.v4.new_notebook(cells=[cell, shown]))


def test_complaints_are_found():
    cell = nbformat.v4.new_code_cell("x")
    cell.outputs = [
        nbformat.v4.new_output("stream", name="stdout", text="fine\n"),
        nbformat.v4.new_output("stream", name="stderr", text="0%|"),
        nbformat.v4.new_output("stream", name="stdout", text="a.py:1: UserWarning: slow\n"),
    ]
    assert execute.complaints(nbformat.v4.new_notebook(cells=[cell])) == [
        "0%|",
        "a.py:1: UserWarning: slow",
    ]
