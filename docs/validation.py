"""The page "Validation": every number of it is read from a file that a program wrote."""

import csv
import json
from pathlib import Path

ROOT = Path(__file__).parents[1]
EXPERIMENTS = ROOT / "experiments"

REFERENCES = {
    "modes": (
        "First eight modes",
        "`modes.json`: 50-digit power series (mpmath), checked with finite elements. "
        "Held in CI by `pytest tests/model/test_modes.py`.",
    ),
    "modes_12": (
        "First twelve modes",
        "`modes_12.json`: 70-digit power series (mpmath). "
        "Held in CI by `pytest tests/model/test_modes.py`.",
    ),
    "in_contact": (
        "First frequency with the stop in contact, both formulations",
        "`tests/model/finite_element_beam.py`: quintic finite elements in numpy, unreduced, with "
        "the spring of the default rig's stop (5500 N/m at mid-span) fixed to the beam. The "
        "formulation as printed leaves the tip mass out of modal mass and participation. "
        "Modes and these elements are held to each other by `pytest tests/model/test_modes.py`.",
    ),
    "sweeps": (
        "Settled sweeps, default settings",
        "`sweeps.json`: exact event-driven propagation in numpy. Points with a period that are at "
        "least 0.5 % away from a jump, both directions. C is the consistent formulation, P that "
        "of the paper as printed. Of another period: several motions coexist, and the march came "
        "to another one than the reference. "
        "Held by `pytest -m slow tests/sweep/test_frequency_sweep.py`.",
    ),
    "folds": (
        "Jumps as folds of branches",
        "Jumps of `sweeps.json`, refined there by bisection, beside the folds that continuation "
        "finds. Held by `pytest -m slow tests/branches/test_branch_references.py`.",
    ),
    "single_contact": (
        "Steady states and Floquet multipliers",
        "`single_contact.json`: stable motions with one contact per drive period, each solved by "
        "`vj.periodic_response` from the listed state. "
        "Held by `pytest tests/steady/test_periodic_response.py "
        "tests/steady/test_single_contact.py`.",
    ),
    "gradients": (
        "Derivatives of a steady state",
        "`gradients.json`: implicit differentiation in numpy, one rig with six modes. "
        "Held by `pytest -m slow tests/steady/test_periodic_response.py`.",
    ),
    "soft_support": (
        "Releases onto a soft support",
        "`soft_support.json`: exact event-driven propagation in numpy; its peaks are read off a "
        "fine grid and so are never too high. "
        "Held by `pytest -m '' tests/history/test_contacts.py`.",
    ),
    "pendulum": (
        "Elastic pendulum, 17 links",
        "`pendulum.json`: an independent program in numpy and scipy (Radau). "
        "Held by `pytest -m 'not long' tests/model/test_elastic_pendulum.py "
        "tests/stepping/test_linearly_implicit.py`.",
    ),
    "conservation": (
        "Elastic pendulum without damping and limiters",
        "`pendulum.json`; here stepped by `diffrax.Dopri8`. "
        "Held by `pytest -m slow tests/model/test_elastic_pendulum.py`.",
    ),
}
"""Tables of docs/validation.json in the order of the page: title, and where they come from."""

RELATIVE = "largest relative difference of"
SHORT = {
    "modes": {
        f"{RELATIVE} 8 betas": "beta, relative",
        "of 8 shapes at 5 places, over the largest value": "shapes",
    },
    "modes_12": {f"{RELATIVE} 12 betas": "beta, relative"},
    "sweeps": {f"{RELATIVE} amplitude": "amplitude, relative", "of contact force": "force"},
    "folds": {
        "jump up, relative difference": "jump up, relative",
        "jump down, relative difference": "jump down",
    },
    "single_contact": {
        f"{RELATIVE} amplitude": "amplitude, relative",
        "of contact force": "force",
        "largest difference of leading multiplier": "multiplier",
    },
    "gradients": {"relative difference": "relative"},
    "soft_support": {
        "times of the first contact, difference (s)": "contact times (s)",
        "peak force, relative difference": "peak force, relative",
        "peak acceleration, relative difference": "peak acceleration",
    },
    "pendulum": {"largest difference": "trajectory with impacts (rad)"},
    "conservation": {"largest difference over 0.2 s": "angles (rad)"},
}
"""Columns of those tables whose largest entry begins the page, and what they are called there."""

HEAD = """# Validation

Every table and every paper that vibrojax was checked against, beside what vibrojax finds. The
tables are put together from result files when this page is built; none is typed. A command under
each table makes its numbers again.

Disagreements are shown as they are. Where a paper is wrong or leaves a number out, the page of the
experiment says how that was found.
"""


def page() -> str:
    """Return the page as Markdown."""
    parts = [HEAD, *_in_short(), *_papers(), *_references(), *_programs(), *_measured()]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _in_short():
    """Return a table of the largest differences from the references."""
    recorded = json.loads((ROOT / "docs" / "validation.json").read_text())["tables"]
    rows = []
    for name, columns in SHORT.items():
        table = recorded[name]["rows"]
        largest = (
            f"{words} {max(row[column] for row in table if row[column] is not None):.0e}"
            for column, words in columns.items()
        )
        title = REFERENCES[name][0]
        rows.append(
            {
                "reference": f"[{title}](#{_anchor(title)})",
                "cases": len(table),
                "largest difference": "; ".join(largest),
            }
        )
    return ["## In short", _table(rows)]


def _anchor(title):
    return "-".join("".join(c for c in title.lower() if c.isalnum() or c in " -").split())


def _number(value, rough):
    if value is None or value == "":
        return ""
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, int) or (float(value).is_integer() and abs(value) < 1e6):
        return str(int(value))
    return f"{value:.1e}" if rough else f"{value:.9g}"


def _table(rows, columns=None):
    columns = columns or list(rows[0])
    rough = [name.startswith("of ") or "difference" in name for name in columns]
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    for row in rows:
        cells = (_number(row.get(c), r) for c, r in zip(columns, rough, strict=True))
        lines.append("| " + " | ".join(cells).replace("\n", " ") + " |")
    return "\n".join(lines)


def _command(*commands):
    words = " and ".join(f"`{command}`" for command in commands)
    return f"Made again by {words}."


def _markdown(path):
    """Return the tables of a Markdown file that a program wrote."""
    return (EXPERIMENTS / path).read_text()


def _json(path):
    return json.loads((EXPERIMENTS / path).read_text())


def _papers():
    return [
        "## Papers",
        "### Gandhi and Vyas 2017: tapered cantilever with a tip mass",
        "Natural frequencies as beta squared, Table 2. Entries agree when truncation to the "
        "printed digits gives the printed value.",
        _markdown("gandhi_vyas_2017/results/table2.md"),
        "Claims about the response, in both formulations. Rig dimensions are assumed, since the "
        "paper's Table 1 is missing from the text we have: "
        "[what is assumed](../experiments/gandhi_vyas_2017/README.md#what-is-assumed).",
        _verdicts(),
        _command("python experiments/gandhi_vyas_2017/run.py"),
        "Jumps of the sweeps beside folds of the branches, Figs 8 to 10:",
        _markdown("gandhi_vyas_2017/results/branches.md"),
        _command("python experiments/gandhi_vyas_2017/branches.py"),
        "The same trends over 432 rigs at once "
        "([the study](../experiments/parametric_study/README.md)):",
        _markdown("parametric_study/results/trends.md"),
        _command("python experiments/parametric_study/study.py --workers 2"),
        "### Ledezma-Ramirez et al.: cantilever on a soft support",
        _soft_support(),
        _command("python experiments/ledezma_ramirez_soft_support/run.py"),
        "### Litak et al.: inverted elastic pendulum with clearance",
        _markdown("litak_pendulum/results/claims.md"),
        _command("python experiments/litak_pendulum/run.py"),
    ]


def _verdicts():
    with (EXPERIMENTS / "gandhi_vyas_2017/results/claims.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    claims = {}
    for row in rows:
        verdicts = claims.setdefault((row["claim"], row["source"]), {})
        verdicts[row["formulation"]] = row["verdict"]
    return _table(
        [
            {
                "claim": claim,
                "paper": where,
                "consistent": found.get("consistent", found.get("either")),
                "as printed": found.get("as_printed", found.get("either")),
            }
            for (claim, where), found in claims.items()
        ]
    )


def _soft_support():
    found = _json("ledezma_ramirez_soft_support/results.json")
    printed = json.loads((ROOT / "tests" / "data" / "soft_support.json").read_text())["printed"]
    chosen = 7.0  # contact damping, N s/m, which the paper does not print
    released = next(r for r in found["releases"] if abs(r["release_m"] - 10e-3) < 1e-9)
    steady = found["twelve_newtons"]["amplitude"]
    at = steady["damping"].index(chosen)
    free, forced = printed["free_10mm"], printed["forced_12N_16Hz"]
    rows = [
        {"quantity": f"natural frequency {k + 1} (Hz)", "printed": theirs, "vibrojax": ours}
        for k, (theirs, ours) in enumerate(
            zip(
                found["frequencies"]["printed_Hz"], found["frequencies"]["computed_Hz"], strict=True
            )
        )
    ]
    rows += [
        {
            "quantity": "let go from 10 mm: peak acceleration (g)",
            "printed": free["acc_g"],
            "experiment": free["exp_acc_g"],
            "vibrojax": released["peak_acceleration_g"],
        },
        {
            "quantity": "let go from 10 mm: peak force (N)",
            "printed": free["force"],
            "experiment": free["exp_force"],
            "vibrojax": released["peak_force_N"],
        },
        {
            "quantity": "12 N at 16 Hz, steady: acceleration (g)",
            "printed": forced["acc_g"],
            "experiment": forced["exp_acc_g"],
            "vibrojax": steady["steady_acceleration_g"][at],
        },
        {
            "quantity": "12 N at 16 Hz, steady: force (N)",
            "printed": forced["force"],
            "experiment": forced["exp_force"],
            "vibrojax": steady["steady_force_N"][at],
        },
    ]
    for row in rows:
        row["difference from printed"] = f"{row['vibrojax'] / row['printed'] - 1:+.1%}"
    columns = ["quantity", "printed", "experiment", "vibrojax", "difference from printed"]
    return "\n\n".join(
        [
            f"Contact damping is not printed; here {chosen:g} N s/m, chosen so that both peaks of "
            "the release are met. The forced case is not met by any one reading: "
            "[why](../experiments/ledezma_ramirez_soft_support/README.md#6-table-2-beside-ours-"
            "twelve_newtons).",
            _table(rows, columns),
        ]
    )


def _coverage():
    rows = []
    for truth, case in _json("identification/results.json")["coverage"].items():
        if "summary" not in case:
            continue
        for name in ("stiffness", "damping"):
            found = case["summary"][name]
            rows.append(
                {
                    "truth": f"stiffness 5500, {truth}",
                    "of": name,
                    "truth inside the interval": f"{found['inside']} of {case['summary']['draws']}",
                    "mean of estimates minus truth": f"{found['bias']:.3g}",
                    "its standard error": f"{found['bias_deviation']:.3g}",
                    "mean half width": f"{found['mean_half_width']:.3g}",
                }
            )
    return _table(rows)


def _references():
    result = json.loads((ROOT / "docs" / "validation.json").read_text())
    parts = [
        "## References computed independently",
        "All references were made without JAX and without code of vibrojax; "
        "`tests/data/README.md` says how. Numbers of vibrojax are recorded in "
        f"`docs/validation.json` by `{result['command']}`; with the name of a table, as in "
        f"`{result['command']} folds`, it makes that one only.",
    ]
    for name, (title, words) in REFERENCES.items():
        made = result["tables"][name]
        parts += [
            f"### {title}",
            words,
            _table(made["rows"]),
            f"Made again by `{result['command']} {name}` (here vibrojax {made['vibrojax']}, jax "
            f"{made['jax']}).",
        ]
    return parts


def _programs():
    parts = ["## Other programs"]
    for name, title in (
        ("nlvib_example_03", "NLvib 1.3, example 03: two masses, one hits a spring"),
        ("impact_oscillator", "One mass that hits a spring"),
    ):
        rows = _json(f"{name}/results/table.json")["rows"]
        parts += [
            f"### {title}",
            _table(rows, ["quantity", "reference", "computed", "difference"]),
            _command(f"python experiments/{name}/run.py"),
        ]
    linear = _json("piezo_harvester/results/results.json")["linear"]
    parts += [
        "### A piezoelectric bimorph beside the closed form of Erturk and Inman 2009",
        "Without a stop; what a stop does is in "
        "[the experiment](../experiments/piezo_harvester/README.md).",
        _table(
            [
                {
                    "quantity": "mean power, sweeps with six loads",
                    "relative difference": linear["worst_relative_difference_of_power"],
                },
                {
                    "quantity": "best load at three frequencies, from the best of 400",
                    "relative difference": linear["largest_distance_from_the_best_of_400_loads"],
                },
            ]
        ),
        _command("python experiments/piezo_harvester/run.py"),
        "### Contacts that are known, identified again",
        "Curves of a settled sweep with 2 % noise; intervals are of 95 %. "
        "[The experiment](../experiments/identification/README.md)",
        _coverage(),
        _command("python experiments/identification/run.py --only coverage"),
        "### Designs by gradient beside a global search",
        "Curves and processor time: of the search over 16,384 rigs / of `vj.optimise`. "
        "[The experiment](../experiments/design/README.md)",
        _markdown("design/results/table.md"),
        _command("python experiments/design/global_search.py", "python experiments/design/run.py"),
    ]
    return parts


def _measured():
    found = _json("stuttgart_rig/results.json")["frequencies_Hz"]
    rows = [
        {
            "beam": side,
            "measured (Hz)": f"{hertz:.2f}",
            "computed (Hz)": f"{computed:.2f}",
            "off": f"{100 * (computed / hertz - 1):+.1f} %",
        }
        for side in ("left", "right")
        for hertz, computed in zip(found["measured"][side], found["source"][side], strict=True)
    ]
    return [
        "## Rigs that were measured",
        "### Natural frequencies of two cantilevers, Woiwode and Krack 2024",
        "Elements in sections, with the factors on stiffnesses that the source found by trial. "
        "[The experiment](../experiments/stuttgart_rig/README.md)",
        _table(rows),
        _command("python experiments/stuttgart_rig/run.py"),
        "### A cart that hits a pad of foam",
        "Force records, each fitted by itself, with the mass that the impulses say. "
        "[The experiment](../experiments/cart_on_pads/README.md)",
        _table(_of_runs(_json("cart_on_pads/results.json")["alone"]["40 mm"])),
        _command("python experiments/cart_on_pads/run.py --only alone"),
    ]


def _of_runs(runs):
    return [
        {
            "run": name[4:],
            "stiffness (N/m)": f"{run['estimate']['stiffness']:.1f}",
            "damping (N s/m)": f"{run['estimate']['damping']:.2f}",
            "rms misfit (N)": f"{run['rms']['contact_force']:.3f}",
        }
        for name, run in runs.items()
    ]
