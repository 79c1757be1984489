"""Run the notebooks and write them with their outputs.

Each notebook is a pair: NN_name.py is the source, which is read and reviewed, and NN_name.ipynb is
the same with its outputs, which this program writes.

python docs/notebooks/execute.py                     all of them, on their full grids
python docs/notebooks/execute.py 01 identification   those whose names contain one of these
python docs/notebooks/execute.py --small 01          on the small grids of CI; writes nothing

A cell tagged "parameters" holds plain assignments; the small values that CI takes in their place
stand in the cell's header:

# %% tags=["parameters"] small={"points": 21}
points = 121
"""

import argparse
import base64
import io
import re
import resource
import tempfile
import time
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image

FOLDER = Path(__file__).parent
MOST_SECONDS = 900
"""For one cell, before it is taken for stuck."""
WIDGET = "application/vnd.jupyter.widget-view+json"
COLORS = 128
"""In a picture as it is stored: a third of the bytes, and no difference to the eye."""


def sources() -> list[Path]:
    """Return the notebooks' sources in their order."""
    return sorted(FOLDER.glob("[0-9][0-9]_*.py"))


def read(source: Path) -> NotebookNode:
    """Return the notebook that a source describes, with cell names that stay the same."""
    notebook = jupytext.read(source)
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number:02d}"
    return notebook


def with_small_grids(notebook: NotebookNode) -> NotebookNode:
    """Return the notebook with the small values assigned after each cell of parameters.

    Raises `ValueError` for a small value whose name the cell does not assign.
    """
    small, cells = notebook.copy(), []
    for cell in notebook.cells:
        cells.append(cell)
        for name, value in cell.metadata.get("small", {}).items():
            if f"{name} = " not in cell.source:
                raise ValueError(
                    f"small names {name!r}, which its cell does not assign:\n{cell.source}"
                )
            cells.append(nbformat.v4.new_code_cell(f"{name} = {value!r}"))
    small.cells = cells
    return small


def execute(notebook: NotebookNode) -> NotebookNode:
    """Run a notebook in a kernel of its own and in an empty folder; return it with outputs.

    The kernel inherits the environment, so JAX_COMPILATION_CACHE_DIR lets kernels share what they
    compiled. Raises `nbclient.exceptions.CellExecutionError` when a cell fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        done = NotebookClient(
            notebook,
            timeout=MOST_SECONDS,
            kernel_name="python3",
            record_timing=False,
            resources={"metadata": {"path": folder}},
        ).execute()
    return without_waits(done)


def without_waits(notebook: NotebookNode) -> NotebookNode:
    """Take out what is said while something compiles: a filled cache has nothing to say."""
    for cell in notebook.cells:
        cell["outputs"] = [
            output
            for output in cell.get("outputs", ())
            if not re.fullmatch(r"(compiling, once: .*\n?)+", str(output.get("text", "")))
        ]
    return notebook


def complaints(notebook: NotebookNode) -> list[str]:
    """Return what an executed notebook wrote to stderr, and every line that names a warning."""
    found = []
    for output in (output for cell in notebook.cells for output in cell.get("outputs", ())):
        text = output.get("text", "") or output.get("data", {}).get("text/plain", "")
        if output.get("name") == "stderr" or output.output_type == "error":
            found.append(text or output.get("evalue", ""))
        else:
            found += [line for line in text.splitlines() if "Warning" in line]
    return found


def pictures(notebook: NotebookNode) -> int:
    """Return how many pictures an executed notebook shows."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    return sum("image/png" in output.get("data", {}) for output in outputs)


def write(notebook: NotebookNode, target: Path) -> None:
    """Write an executed notebook with smaller pictures and nothing that changes by itself.

    Widgets are left out: without their kernel they show nothing, and would hide the still picture.
    """
    for output in (output for cell in notebook.cells for output in cell.get("outputs", ())):
        data = output.get("data", {})
        data.pop(WIDGET, None)
        if "image/png" in data:
            data["image/png"] = _fewer_colors(data["image/png"])
    for name in ("language_info", "widgets"):
        notebook.metadata.pop(name, None)
    nbformat.write(notebook, target)


def _fewer_colors(picture: str) -> str:
    before = base64.b64decode(picture)
    stream = io.BytesIO()
    image = Image.open(io.BytesIO(before)).convert("RGB")
    image.quantize(COLORS, dither=Image.Dither.NONE).save(stream, "png", optimize=True)
    return base64.b64encode(min(before, stream.getvalue(), key=len)).decode()


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Run the notebooks named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("names", nargs="*", help="parts of the names; all notebooks without any")
    parser.add_argument("--small", action="store_true", help="small grids, and nothing is written")
    options = parser.parse_args()
    for source in sources():
        if options.names and not any(name in source.stem for name in options.names):
            continue
        notebook = read(source)
        before, start = _processor_seconds(), time.perf_counter()
        notebook = execute(with_small_grids(notebook) if options.small else notebook)
        took, used = time.perf_counter() - start, _processor_seconds() - before
        print(f"{source.stem}: {took:.0f} s, {used:.0f} s of processor time", flush=True)
        for complaint in complaints(notebook):
            print(f"  COMPLAINT: {complaint}")
        if not options.small:
            write(notebook, source.with_suffix(".ipynb"))
            size = source.with_suffix(".ipynb").stat().st_size
            print(f"  {pictures(notebook)} pictures, {size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
