"""The command `vibrojax`: sweeps, modes and fits of a rig, from a terminal.

Nothing heavy is imported before a command runs.
"""

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import tyro

if TYPE_CHECKING:
    from vibrojax.modes import Modes
    from vibrojax.results.frequency_response import FrequencyResponse
    from vibrojax.systems.impacting_beam import ImpactingBeam

PICTURES = (".png", ".svg", ".pdf")
DEFAULT_RANGE = (0.8, 1.4, 121)

# Lines that begin with a sign keep their breaks in the help of tyro.
DESCRIPTION = """\
Frequency responses of vibrating beams that hit stops.

Try:
$ vibrojax sweep             the default rig: a table, sweep.nc and sweep.png
$ vibrojax sweep rig.toml    your rig (its file explained: examples/uniform_beam.toml)
$ vibrojax modes rig.toml    its natural frequencies
$ vibrojax fit curve.csv     contact stiffness and damping from a measured curve
$ vibrojax sweep --help      every option of a command
$ vibrojax --version         the version"""


def _option(text: str, metavar: str, default: str) -> Any:
    return tyro.conf.arg(help=text, metavar=metavar, help_behavior_hint=f"(default: {default})")


_RIG_HELP = (
    "rig file in TOML, explained line by line in examples/uniform_beam.toml; the default is "
    "a tapered cantilever 0.2 m long that hits one stop at mid-span"
)
_Rig = Annotated[
    Path | None, tyro.conf.Positional, _option(_RIG_HELP, "[RIG.toml]", "the default rig")
]
_Range = tuple[float, float, int] | None


def sweep(
    rig: _Rig = None,
    frequency_ratio: Annotated[
        _Range,
        _option(
            "drive frequencies over the first natural frequency of the beam without stops, "
            "evenly spaced",
            "START END POINTS",
            "[sweep] of the rig file, else 0.8 1.4 121",
        ),
    ] = None,
    frequency: Annotated[
        _Range,
        _option("the same in Hz; give one of the two", "START END POINTS", "not used"),
    ] = None,
    direction: Annotated[
        Literal["both", "forward", "backward"] | None,
        _option(
            "forward: frequency rising, backward: falling; the motion is carried from point to "
            "point",
            "{both,forward,backward}",
            "[sweep] of the rig file, else both",
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        _option(
            "relative error to aim at in amplitudes and forces",
            "FRACTION",
            "[sweep] of the rig file, else 1e-4",
        ),
    ] = None,
    steps_per_period: Annotated[
        int | None,
        _option(
            "steps per drive period",
            "COUNT",
            "[sweep] of the rig file, else chosen from contact and tolerance",
        ),
    ] = None,
    output: Annotated[
        Path,
        _option("NetCDF file (.nc) for all results, or none", "FILE", "sweep.nc"),
    ] = Path("sweep.nc"),
    picture: Annotated[
        Path,
        _option("picture of the response (.png, .svg, .pdf), or none", "FILE", "sweep.png"),
    ] = Path("sweep.png"),
    quiet: Annotated[
        bool,
        tyro.conf.FlagCreatePairsOff,
        tyro.conf.arg(help="print neither the table nor progress", help_behavior_hint=""),
    ] = False,
) -> int:
    """Sweep the drive frequency up and down; print the peak and jumps, write data and a picture.

    Try:
    $ vibrojax sweep
    $ vibrojax sweep rig.toml --frequency 8 13 201
    $ vibrojax sweep --frequency-ratio 1.0 1.3 61 --direction forward --picture none
    """
    started = time.perf_counter()
    data = _target("--output", output, (".nc",))
    drawing = _target("--picture", picture, PICTURES)
    if frequency is not None and frequency_ratio is not None:
        raise ValueError("give --frequency or --frequency-ratio, one of the two.")
    from vibrojax.rig_file import frequency_range
    from vibrojax.studies.frequency_sweep import frequency_sweep

    system, settings = _read(rig)
    _check_driven(rig, system, "sweep")
    for name, given in (("frequency", frequency), ("frequency_ratio", frequency_ratio)):
        if given is not None:
            settings.pop("frequency", None)
            settings.pop("frequency_ratio", None)
            settings[name] = frequency_range(f"--{name.replace('_', '-')}", given)
    if not {"frequency", "frequency_ratio"} & settings.keys():
        settings["frequency_ratio"] = frequency_range("--frequency-ratio", DEFAULT_RANGE)
    told = {"direction": direction, "tolerance": tolerance, "steps_per_period": steps_per_period}
    settings |= {name: value for name, value in told.items() if value is not None}
    compiling = _watch_compilation()
    response = frequency_sweep(system, progress=False if quiet else None, **settings)
    swept = time.perf_counter()
    with _Files(data, drawing) as (data_part, drawing_part):
        if data_part is not None:
            response.save(data_part)
        if drawing_part is not None and drawing is not None:
            response.plot().savefig(drawing_part, format=drawing.suffix[1:])
    if not quiet:
        times = (swept - started, sum(compiling), time.perf_counter() - swept)
        print(_sweep_table(_title("Frequency sweep", rig), response, times, (data, drawing)))
    return 0


def modes(
    rig: _Rig = None,
    num_modes: Annotated[
        int | None, _option("how many modes", "COUNT", "as many as the rig keeps, 5")
    ] = None,
    output: Annotated[
        Path | None, _option("file for the table (.csv)", "FILE", "not written")
    ] = None,
    picture: Annotated[
        Path | None, _option("picture of the shapes (.png, .svg, .pdf)", "FILE", "not drawn")
    ] = None,
) -> int:
    """Print the natural frequencies of the beam without its stops, modal masses, participation.

    Try:
    $ vibrojax modes
    $ vibrojax modes rig.toml --num-modes 8 --picture modes.png --output modes.csv
    """
    table = _target("--output", output, (".csv",))
    drawing = _target("--picture", picture, PICTURES)
    from vibrojax.modes import modes as solve

    system, _ = _read(rig)
    count = system.num_modes if num_modes is None else num_modes
    found = solve(system.beam, count, system.formulation)
    with _Files(table, drawing) as (table_part, drawing_part):
        if table_part is not None:
            table_part.write_text(_modes_csv(found))
        if drawing_part is not None and drawing is not None:
            found.plot().savefig(drawing_part, format=drawing.suffix[1:])
    print(_modes_table(_title("Modes", rig), found))
    for path in (table, drawing):
        if path is not None:
            print(f"  written  {path}")
    return 0


def fit(
    curve: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(
            help="measured frequency response: text with a header (.csv, .txt) or NetCDF",
            metavar="CURVE.csv",
            help_behavior_hint="(required)",
        ),
    ],
    rig: Annotated[Path | None, _option(_RIG_HELP, "RIG.toml", "the default rig")] = None,
    fit: Annotated[
        tuple[str, ...],
        _option(
            "numbers to fit: keys of the first [[stop]] (stiffness, damping, gap, position), of "
            "[beam], damping_ratio, or amplitude of the drive; the others stay as the rig has them",
            "NAME ...",
            "stiffness damping",
        ),
    ] = ("stiffness", "damping"),
    guess: Annotated[
        tuple[str, ...],
        _option("first values, SI", "NAME=VALUE ...", "those of the rig"),
    ] = (),
    bounds: Annotated[
        tuple[str, ...],
        _option("bounds, SI", "NAME=LOW:HIGH ...", "none but of what is no rig"),
    ] = (),
    objective: Annotated[
        Literal["distance", "pointwise", "folds"],
        _option(
            "distance: of every point from the whole response curve; for comparison pointwise: at "
            "equal frequencies, or folds: with the jumps on the folds",
            "{distance,pointwise,folds}",
            "distance",
        ),
    ] = "distance",
    starts: Annotated[int, _option("how many starts to search from", "COUNT", "1")] = 1,
    columns: Annotated[
        tuple[str, ...],
        _option(
            "columns of the file, by name or position from 0 (none: leave out), as "
            "frequency=f_Hz amplitude=2; also deviation, contact_force, direction",
            "NAME=COLUMN ...",
            "recognised by their names",
        ),
    ] = (),
    units: Annotated[
        tuple[str, ...],
        _option(
            "units where the header has none, as frequency=Hz amplitude=mm (or ratio)",
            "NAME=UNIT ...",
            "those of the header",
        ),
    ] = (),
    quantity: Annotated[
        Literal["amplitude", "peak", "peak_to_peak", "rms", "first_harmonic"] | None,
        _option(
            "what of the signal was measured; amplitude is (max - min)/2",
            "{amplitude,peak,peak_to_peak,rms,first_harmonic}",
            "told by the header, else amplitude",
        ),
    ] = None,
    frame: Annotated[
        Literal["relative", "absolute"] | None,
        _option("to the moving base, or not", "{relative,absolute}", "relative"),
    ] = None,
    output: Annotated[
        Path,
        _option("name of the report (.json) and the picture (.png)", "FILE", "fit"),
    ] = Path("fit"),
) -> int:
    """Fit numbers of a rig to a measured curve; print what is known of them, write both files.

    Try:
    $ vibrojax fit curve.csv --rig rig.toml
    $ vibrojax fit curve.csv --rig rig.toml --fit stiffness gap --guess stiffness=3000
    $ vibrojax fit curve.csv --columns frequency=f amplitude=tip --units frequency=Hz amplitude=mm
    """
    started = time.perf_counter()
    if output.suffix.lower() not in ("", ".json", ".png"):
        raise ValueError(f"--output must be a name without ending, or .json, got {str(output)!r}.")
    if not output.name:
        raise ValueError(f"--output must be the name of a file, got {str(output)!r}.")
    data, picture = output.with_suffix(".json"), output.with_suffix(".png")
    _target("--output", data, (".json",))
    _target("--output", picture, (".png",))
    from vibrojax import cli_fit
    from vibrojax.studies.identify import identify

    if not fit or len(set(fit)) < len(fit):
        raise ValueError("--fit must name at least one number, and each of them once.")
    system, _ = _read(rig)
    _check_driven(rig, system, "fit")
    make = cli_fit.rig_function(system, fit)
    first = cli_fit.guesses(system, fit, guess)
    within = cli_fit.bounds(fit, bounds)
    measured = cli_fit.read_curve(curve, columns, units, quantity, frame)
    compiling = _watch_compilation()
    found = identify(make, measured, first, within, objective=objective, starts=starts)
    fitted = time.perf_counter()
    cli_fit.save(found, data, picture)
    whose = "the default rig (dimensions assumed)" if rig is None else str(rig)
    print(f"Fit of {whose} to {curve}")
    print("\n".join(f"  {line}" for line in repr(found).splitlines()))
    print(f"  time     {fitted - started:.1f} s (compiling {sum(compiling):.1f} s)")
    print(f"  written  {data}, {picture}")
    return 0


COMMANDS = {"sweep": sweep, "modes": modes, "fit": fit}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, 1 (files), 2 (input), 130 (Ctrl-C).

    Wrong options, and `--help`, leave by `SystemExit` (2 and 0).
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments == ["--version"]:
        from importlib.metadata import version

        print(f"vibrojax {version('vibrojax')}")
        return 0
    try:
        return tyro.extras.subcommand_cli_from_dict(
            COMMANDS, prog="vibrojax", description=DESCRIPTION, args=arguments or ["--help"]
        )
    except ValueError as error:
        print(f"vibrojax: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"vibrojax: {error.strerror or error}: {error.filename}.", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(file=sys.stderr)
        return 130


def run() -> NoReturn:
    """Run the command line as a process."""
    sys.exit(main())


def _read(rig: Path | None) -> tuple["ImpactingBeam", dict[str, Any]]:
    if rig is None:
        from vibrojax.rigs import default_rig

        return default_rig(), {}
    from vibrojax.rig_file import read_rig

    return read_rig(rig)


def _check_driven(rig: Path | None, system: "ImpactingBeam", command: str) -> None:
    from vibrojax.drive import NoDrive

    if isinstance(system.drive, NoDrive):
        raise ValueError(f"Rig file {str(rig)!r}: a {command} needs the table [drive].")


def _target(option: str, path: Path | None, suffixes: tuple[str, ...]) -> Path | None:
    """Refuse a file that could not be written, before anything is computed."""
    if path is None or str(path).lower() == "none":
        return None
    if path.suffix.lower() not in suffixes:
        allowed = " or ".join(
            [", ".join(suffixes[:-1]), suffixes[-1]] if suffixes[1:] else suffixes
        )
        raise ValueError(f"{option} must end in {allowed}, got {str(path)!r}.")
    if path.is_dir():
        raise ValueError(f"{option}: {str(path)!r} is a folder.")
    if not path.parent.is_dir():
        raise ValueError(f"{option}: the folder {str(path.parent)!r} does not exist.")
    if not os.access(path.parent, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise ValueError(f"{option}: {str(path)!r} cannot be written, for lack of permission.")
    return path


class _Files:
    """Temporary names for the files of a command: all take their places, or none."""

    def __init__(self, *targets: Path | None):
        self.targets = targets
        self.parts = [
            None if path is None else path.with_name(f".{path.name}.{os.getpid()}.part")
            for path in targets
        ]

    def __enter__(self) -> list[Path | None]:
        return self.parts

    def __exit__(self, kind: Any, *_: Any) -> None:
        for part, target in zip(self.parts, self.targets, strict=True):
            if part is None or target is None:
                continue
            if kind is None:
                os.replace(part, target)
            else:
                part.unlink(missing_ok=True)


def _watch_compilation() -> list[float]:
    """Return a list that fills with the seconds of every compilation."""
    import jax.monitoring

    seconds: list[float] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.endswith(("backend_compile_duration", "jaxpr_to_mlir_module_duration")):
            seconds.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    return seconds


def _title(what: str, rig: Path | None) -> str:
    return f"{what} of {'the default rig (dimensions assumed)' if rig is None else rig}"


def _sweep_table(
    title: str,
    response: "FrequencyResponse",
    times: tuple[float, float, float],
    files: tuple[Path | None, ...],
) -> str:
    import numpy as np

    from vibrojax.results.status import Status

    natural = float(response.natural_frequency)
    hertz = 1.0 if response.axis == "frequency" else natural  # of one unit of the axis
    unit = "" if response.ratio_units == "1" else f" {response.ratio_units}"
    rows: list[tuple[str, str, str]] = [("", "ratio", "Hz")]

    def at(label: str, where: float) -> None:
        there = np.isfinite(where)
        ratio = f"{where * hertz / natural:.5f}" if there else "none"
        rows.append((label, ratio, f"{where * hertz:.4f}" if there else ""))

    at("first natural frequency", natural / hertz)
    peak = np.nan
    finite = bool(np.isfinite(response.amplitude_ratio).any())
    if finite:
        highest = np.nanmax(response.amplitude_ratio)
        peak = float(response.frequencies[np.argwhere(response.amplitude_ratio == highest)[0, -1]])
        at(f"peak, amplitude ratio {highest:.5g}{unit}", peak)
    at("jump up", float(response.jump_up))
    at("jump down", float(response.jump_down))
    at("hysteresis width", float(response.hysteresis_width))
    wide = max(len(row[0]) for row in rows)
    lines = [title, *(f"  {a:{wide}}  {b:>9}  {c:>10}".rstrip() for a, b, c in rows)]

    def say(label: str, text: str) -> None:
        lines.append(f"  {label:{wide}}  {text}")

    if finite:
        if len(response.directions) == 2:
            of = "ratio x Hz" if response.axis == "frequency" else "ratio x ratio"
            say("hysteresis area", f"{float(response.hysteresis_area):9.5g}  {of}")
        say("resonance shift", f"{100 * (peak * hertz / natural - 1):+9.2f}  %")
        say("largest contact force", f"{np.nanmax(response.contact_force):9.5g}  N")
    status, period = np.asarray(response.status), np.asarray(response.period)
    counts = {s: int((status == s.value).sum()) for s in Status}
    longer = int((period > 1).sum())
    inside = f" ({longer} of period 2 or longer)" if longer else ""
    points = f"{counts[Status.settled]} settled{inside}, {counts[Status.aperiodic]} aperiodic"
    say(f"points, {status.size}", f"{points}, {counts[Status.diverged]} diverged")
    total, compiling, writing = times
    say("time", f"{total:.1f} s (compiling {compiling:.1f} s), writing {writing:.1f} s")
    written = [str(path) for path in files if path is not None]
    if written:
        say("written", ", ".join(written))
    return "\n".join(lines)


def _columns(found: "Modes") -> list[tuple[float, ...]]:
    import numpy as np

    columns = (found.frequency, found.beta, found.modal_mass, found.participation)
    return [tuple(map(float, row)) for row in zip(*map(np.asarray, columns), strict=True)]


def _modes_table(title: str, found: "Modes") -> str:
    head = f"  {'mode':>4}  {'frequency, Hz':>13}  {'beta':>10}  {'modal mass, kg':>14}"
    lines = [f"{title}, {found.formulation} formulation", f"{head}  {'participation':>13}"]
    for i, (frequency, beta, mass, participation) in enumerate(_columns(found), 1):
        row = f"  {i:4d}  {frequency:13.6g}  {beta:10.6f}  {mass:14.6g}  {participation:13.6f}"
        lines.append(row)
    return "\n".join(lines)


def _modes_csv(found: "Modes") -> str:
    lines = ["mode,frequency_hz,beta,modal_mass_kg,participation"]
    lines += [",".join([str(i), *map(repr, row)]) for i, row in enumerate(_columns(found), 1)]
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    run()
