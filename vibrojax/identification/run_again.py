"""The files that repeat a fit: a Python script, and the measurements as CSV."""

import dataclasses
import io
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
import pandas as pd

from vibrojax.identification.fit import Fit
from vibrojax.identification.problem import Measurement
from vibrojax.identification.rig_source import Source, is_default, kind_of

SCRIPT = "run_again.py"
_PATH = "from pathlib import Path"
_READ = '''HERE = Path(__file__).parent


def columns_of(name):
    """Columns of a file."""
    table = numpy.genfromtxt(HERE / name, delimiter=",", names=True)
    return {name: numpy.atleast_1d(table[name]) for name in table.dtype.names}'''
_OWN = ("Path", "HERE", "columns_of", "measured", "fit")
"""Names of the script."""


class RunAgain(NamedTuple):
    """What repeats a fit."""

    files: dict[str, str]
    """Text by name: `run_again.py`, then what it reads."""
    missing: tuple[str, ...]
    """Why the script does not run as it is, in sentences; empty where it was tried and does."""

    def zipped(self) -> bytes:
        """Return the files as a zip archive."""
        content = io.BytesIO()
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in self.files.items():
                archive.writestr(name, text)
        return content.getvalue()


def run_again(
    fit: Fit, source: str | None = None, files: Mapping[str, str] | None = None
) -> RunAgain:
    """Write the files that repeat a fit.

    `source` is Python text that defines `rig`, the function of the rig; None: it is read off the
    function. `files` are those that it reads beside itself, by name. The text is run to see whether
    it makes the rig that was fitted. Raises `ValueError` where a `source` that was given does not.
    """
    written, content = Source(_OWN), dict(files or {})
    name = "rig" if source is not None else written.add_function(fit.problem.make)
    rig = source.strip() if source is not None else written.text
    if not written.missing:
        parts = _imported(written), _READ, rig
        wrong = _tried("\n\n".join(parts), name, content, fit)
        if wrong and source is not None:
            raise ValueError(f"source must make the rig that was fitted, as rig(...): {wrong}.")
        if wrong:
            written.lack(f"The text of the rig was tried: {wrong}")
    measured = [_measurement(written, m, k, content) for k, m in enumerate(fit.measured, 1)]
    arguments = [name, "measured"]
    for argument, value in fit.call.items():
        if value is not None:
            arguments.append(_argument(written, argument, value))
    about = f"Repeats a fit of vibrojax {version('vibrojax')} with the files beside it."
    script = [
        f'"""{about}"""\n\n{_imported(written)}',
        _READ,
        rig,
        f"measured = {_listed(measured, '[]')}",
        f"fit = vibrojax.identify{_listed(arguments, '()')}",
        'if __name__ == "__main__":\n    print(fit)\n',
    ]
    return RunAgain({SCRIPT: "\n\n\n".join(script)} | content, tuple(written.missing))


def _imported(written: Source) -> str:
    others = {"import numpy", "import vibrojax", *written.imports}
    lines = sorted(others - {_PATH}, key=lambda line: line.split()[1])
    return "\n".join([_PATH, "", *lines])


def _listed(entries: Sequence[str], ends: str) -> str:
    return f"{ends[0]}\n" + "".join(f"    {entry},\n" for entry in entries) + ends[1]


def _measurement(written: Source, measured: Measurement, number: int, files: dict[str, str]) -> str:
    """Write the columns of a measurement to files; returns the text that makes it of them."""
    columns: dict[str, np.ndarray] = {}
    facts = []
    for field in dataclasses.fields(measured):
        value = getattr(measured, field.name)
        empty = isinstance(value, dict | tuple) and not value
        if empty or is_default(value, field.default):
            continue
        if isinstance(value, np.ndarray) and value.shape == (measured.size,):
            columns[field.name] = value
        elif isinstance(value, eqx.Module):  # a drive on a clock of its own
            name = f"measurement_{number}_{field.name}.csv"
            parts = {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.init}
            arrays = {n: np.asarray(v) for n, v in parts.items() if isinstance(v, jax.Array)}
            files[name] = _csv(arrays)
            kind = type(value)
            written.imports[f"from {kind.__module__} import {kind.__name__}"] = None
            facts.append(f'{field.name}={kind.__name__}(**columns_of("{name}"))')
        else:
            facts.append(_argument(written, field.name, value))
    name = f"measurement_{number}.csv"
    files[name] = _csv(columns)
    inside = ",\n        ".join([f'**columns_of("{name}")', *facts])
    return f"vibrojax.io.{type(measured).__name__}(\n        {inside},\n    )"


def _argument(written: Source, name: str, value: Any) -> str:
    text = written.value(value)
    if text is None:
        written.lack(f"{name}, {kind_of(value)}, cannot be written as text")
    return f"{name}={text}"


def _csv(columns: Mapping[str, np.ndarray]) -> str:
    # As Python writes numbers: numpy may have been set to write fewer digits.
    return pd.DataFrame(dict(columns)).astype(object).to_csv(index=False)


def _tried(text: str, name: str, files: Mapping[str, str], fit: Fit) -> str | None:
    """Run the text of a rig; say what is wrong unless it makes the rig that was fitted."""
    estimate = [*fit.estimate.values()]
    numbers = fit.problem.arguments(estimate, 0, fit.measured[0])
    with tempfile.TemporaryDirectory() as folder:
        for file, content in files.items():
            (Path(folder) / file).write_text(content, "utf-8")
        names: dict[str, Any] = {"__file__": str(Path(folder) / SCRIPT), "__name__": "run_again"}
        try:
            exec(compile(text, SCRIPT, "exec"), names)
            if name not in names:
                return f"it defines no {name}"
            made = names[name](**numbers)
        except Exception as error:  # whatever a function of the user's raises
            return f"it does not run, {type(error).__name__}: {error}"
    found, wanted = (jax.tree.leaves(rig) for rig in (made, fit.system()))
    if len(found) != len(wanted) or not all(map(np.array_equal, found, wanted)):
        return "it makes another rig than the one fitted"
    return None
