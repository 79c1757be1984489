"""The page that reports a fit: what was measured, what was found, and the files to repeat it."""

import io
import os
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from xml.etree.ElementTree import Element

import numpy as np

from vibrojax._tools.described import in_short
from vibrojax._tools.files import path_of
from vibrojax.identification.fit import Fit
from vibrojax.identification.problem import label_of
from vibrojax.identification.record_numbers import record_numbers_in, unit_of
from vibrojax.identification.run_again import SCRIPT, RunAgain, run_again
from vibrojax.results.page import download, element, embedded, listed, page, table
from vibrojax.results.saving import whole_files
from vibrojax.results.variables import PLAIN, axis_unit

ENDINGS = (".html", ".htm")
PACKAGES = ("vibrojax", "jax", "jaxlib", "equinox", "optimistix", "numpy", "scipy")


def write_report(
    fit: Fit,
    path: str | os.PathLike[str],
    source: str | None = None,
    files: Mapping[str, str] | None = None,
) -> None:
    """Write the page of a fit, whole or not at all.

    `source` and `files` are as for `run_again`. Raises `ValueError` for a path that is not of a
    page, `OSError` where writing fails.
    """
    if path_of("path", path).suffix.lower() not in ENDINGS:
        raise ValueError(f"path must end in .html, got {os.fspath(path)!r}.")
    with whole_files(path) as (part,):
        assert part is not None
        text = report_page(fit, run_again(fit, source, files))
        part.write_text(text, encoding="utf-8")


def report_page(fit: Fit, again: RunAgain) -> str:
    """Return the page as text."""
    labels = [label_of(m, k) for k, m in enumerate(fit.measured)]
    named = [m.label for m in fit.measured if m.label]
    of = f" from {', '.join(named)}" if named else ""
    title = f"Fit of {', '.join(fit.names)}{of}"
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    about = f"Written by vibrojax {version('vibrojax')} on {now}."
    parts = [element("h1", title), element("p", about, kind="faint")]
    parts += [element("p", f"Warning: {sentence}", kind="warning") for sentence in fit.warnings]
    parts += _estimates(fit)
    parts.append(element("h2", "Measured and fitted"))
    for k, label in enumerate(labels):
        parts += _measurement(fit, k, label, again)
    parts += [*_rig(fit, labels), *_again(again), *_versions()]
    return page(title, *parts)


def _estimates(fit: Fit) -> list[Element]:
    percent = f"{100 * fit.confidence:g} % interval"
    head = ["number", "estimate", percent, "standard deviation", "unit", "the data say"]
    head += ["guess", "bounds", "moved in"]
    of_records = record_numbers_in(fit.problem.make, [c.argument for c in fit.problem.coordinates])
    rows = []
    for c in fit.problem.coordinates:
        low, high = fit.interval[c.name]
        unit = unit_of(c.argument) if c.argument in of_records else axis_unit(c.argument)
        ends = f"{c.low:.4g} to {c.high:.4g}" if np.isfinite([c.low, c.high]).any() else "none"
        rows.append(
            [
                c.name,
                f"{fit.estimate[c.name]:.6g}",
                f"{low:.5g} to {high:.5g}",
                f"{fit.standard_deviation[c.name]:.3g}",
                "as the argument" if unit in PLAIN and c.argument not in of_records else unit,
                fit.identifiability[c.name],
                f"{c.guess:.4g}",
                ends,
                c.kind,
            ]
        )
    misfit = (
        f"Reduced chi-square {fit.reduced_chi_square:.4g} (chi-square {fit.chi_square:.5g}, "
        f"{fit.degrees_of_freedom} degrees of freedom): about 1 where model and deviations are "
        f"right. Objective: {fit.problem.objective}. {fit.evaluations} evaluations of the model."
    )
    parts = [element("h2", "Estimates"), table(head, rows), element("p", misfit)]
    if len(fit.names) > 1:
        rows = [
            [name, *(f"{value:.3f}" for value in row)]
            for name, row in zip(fit.names, fit.correlation, strict=True)
        ]
        parts += [element("h3", "Correlation"), table(["", *fit.names], rows)]
    if fit.alternatives:
        rows = [
            [*(f"{value:.5g}" for value in a.estimate.values()), f"{a.reduced_chi_square:.4g}"]
            for a in fit.alternatives
        ]
        head = [*fit.names, "reduced chi-square"]
        parts += [element("h3", "Other minima"), table(head, rows)]
    if fit.problem.held:
        rows = [[name, in_short(value)] for name, value in fit.problem.held.items()]
        parts += [element("h3", "Held fixed"), table([], rows)]
    if fit.notes:
        parts += [element("h3", "What was assumed"), listed(fit.notes)]
    return parts


def _measurement(fit: Fit, k: int, label: str, again: RunAgain) -> list[Element]:
    """Draw a measurement, say what it is, as it shows itself, and give its columns as CSV."""
    measured, residual = fit.measured[k], fit.residuals(measurement=k)
    title = f"Measurement {label}"
    spread = (
        f"Residuals over their standard deviations: root mean square "
        f"{np.sqrt(np.mean(residual**2)):.3g}, largest {np.max(np.abs(residual)):.3g}, "
        f"{np.sum(np.abs(residual) > 2)} of {residual.size} beyond 2."
    )
    ways = f"measurement_{k + 1}.", f"measurement_{k + 1}_"
    own = [name for name in again.files if name.startswith(ways)]
    links = [download(name, again.files[name].encode(), "text/csv") for name in own]
    return [
        element("h3", title),
        element("img", src=_picture(fit, k), alt=f"{title}, the fitted rig and the residuals"),
        element("p", spread),
        element("pre", repr(measured)),
        element("p", measured.noise().sentence or "All standard deviations were given."),
        element("p", "Its numbers: ", *(part for link in links for part in (link, " "))),
    ]


def _picture(fit: Fit, k: int) -> str:
    from vibrojax.plot.identification import plot_identification

    content = io.BytesIO()
    figure = plot_identification(fit.predictions[k], None, "")
    figure.savefig(content, format="png", dpi=130)
    return embedded(content.getvalue(), "image/png")


def _rig(fit: Fit, labels: list[str]) -> list[Element]:
    """Show the rig of every measurement, those that look alike once."""
    shown: dict[str, list[str]] = {}
    for k, label in enumerate(labels):
        shown.setdefault(repr(fit.system(k)), []).append(label)
    parts = [element("h2", "The fitted rig")]
    for text, own in shown.items():
        if len(shown) > 1:
            parts.append(element("h3", f"For measurement {', '.join(own)}"))
        parts.append(element("pre", text))
    return parts


def _again(again: RunAgain) -> list[Element]:
    parts = [element("h2", "To run it again")]
    link = download("run_again.zip", again.zipped(), "application/zip")
    parts.append(
        element("p", "Save and unpack ", link, f", then run python {SCRIPT} in its folder.")
    )
    if again.missing:
        words = "It does not run as it is; put in its place what is missing."
        parts += [element("p", words, kind="warning"), listed(again.missing)]
    return [*parts, element("pre", again.files[SCRIPT])]


def _versions() -> list[Element]:
    rows = [[name, version(name)] for name in PACKAGES]
    rows += [["Python", platform.python_version()], ["machine", platform.platform()]]
    return [element("h2", "Versions"), table([], rows)]
