"""The command `vibrojax`: sweeps, maps, modes and fits of a rig, from a terminal.

Nothing heavy is imported before a command runs.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

# Lines that begin with a sign keep their breaks in the help of tyro.
DESCRIPTION = """\
Frequency responses of vibrating beams that hit stops.

Try:
$ vibrojax sweep             the default rig: a table, sweep.nc and sweep.png
$ vibrojax sweep rig.toml    your rig (its file explained: examples/uniform_beam.toml)
$ vibrojax map map.toml      sweeps over any numbers of the rig (examples/map.toml)
$ vibrojax modes rig.toml    its natural frequencies
$ vibrojax fit curve.csv     contact stiffness and damping from a measured curve
$ vibrojax sweep --help      every option of a command
$ vibrojax --version         the version"""


def _option(text: str, metavar: str, default: str) -> Any:
    return tyro.conf.arg(help=text, metavar=metavar, help_behavior_hint=f"(default: {default})")


def _flag(text: str) -> Any:
    return tyro.conf.arg(help=text, help_behavior_hint="")


_RIG_HELP = (
    "rig file in TOML, explained line by line in examples/uniform_beam.toml; the default is "
    "a tapered cantilever 0.2 m long that hits one stop at mid-span"
)
_Rig = Annotated[
    Path | None, tyro.conf.Positional, _option(_RIG_HELP, "[RIG.toml]", "the default rig")
]
_Range = tuple[float, float, int] | None
_Groups = tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]]
_Flag = tyro.conf.FlagCreatePairsOff[bool]


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
    quiet: Annotated[_Flag, _flag("print neither the table nor progress")] = False,
) -> int:
    """Sweep the drive frequency up and down; print the peak and jumps, write data and a picture.

    Try:
    $ vibrojax sweep
    $ vibrojax sweep rig.toml --frequency 8 13 201
    $ vibrojax sweep --frequency-ratio 1.0 1.3 61 --direction forward --picture none
    """
    asked = locals()
    from vibrojax.cli import sweep as cli_sweep

    return cli_sweep.run_sweep(cli_sweep.SweepOptions(**asked))


def map_numbers(
    rig: _Rig = None,
    axis: Annotated[
        _Groups,
        _option(
            "numbers to vary, crossed with each other: evenly from LOW to HIGH, with :log at even "
            "ratios, or value by value. Names are keys of [beam], of the first [[stop]], "
            "damping_ratio, or amplitude of the drive; units are SI",
            "NAME=LOW:HIGH:COUNT[:log] | NAME=VALUE,VALUE ...",
            "[map.axes] of the rig file",
        ),
    ] = (),
    zipped: Annotated[
        _Groups,
        _option(
            "numbers that go along one axis together, value by value (two or more; once for "
            "each such group)",
            "NAME=... NAME=... [NAME=...]",
            "[[map.zipped]] of the rig file",
        ),
    ] = (),
    frequency_ratio: Annotated[
        tuple[float, ...],
        _option(
            "drive frequencies over the first natural frequency, or one",
            "START END POINTS | VALUE",
            "[map], else [sweep] of the rig file, else 0.8 1.4 61",
        ),
    ] = (),
    frequency: Annotated[
        tuple[float, ...],
        _option("the same in Hz; give one of the two", "START END POINTS | VALUE", "not used"),
    ] = (),
    response: Annotated[
        Literal["sweep", "periodic", "continuation"] | None,
        _option(
            "sweep: settled, as of the command sweep; periodic: solved at every frequency, from "
            "rest; continuation: branches through their folds",
            "{sweep,periodic,continuation}",
            "[map] of the rig file, else sweep",
        ),
    ] = None,
    direction: Annotated[
        Literal["both", "forward", "backward"] | None,
        _option("of a sweep", "{both,forward,backward}", "[map], else [sweep], else both"),
    ] = None,
    tolerance: Annotated[
        float | None,
        _option("relative error to aim at", "FRACTION", "[map], else [sweep], else 1e-4"),
    ] = None,
    measures: Annotated[
        tuple[str, ...],
        _option(
            "what to keep of every curve, such as peak_amplitude_ratio or jump_up (the others are "
            "listed when a name is wrong)",
            "NAME ...",
            "[map], else all, and the curves",
        ),
    ] = (),
    keep_curves: Annotated[
        _Flag, _flag("keep whole curves (large), even where measures are named")
    ] = False,
    no_curves: Annotated[_Flag, _flag("keep measures only, even where none are named")] = False,
    gradients: Annotated[
        tuple[str, ...],
        _option("differentiate by these numbers too", "NAME ...", "[map] of the rig file, else no"),
    ] = (),
    store: Annotated[
        Path,
        _option(
            "Zarr store (a folder) for the map, or none; one that is there is continued. Opens "
            "with xarray.open_zarr(FOLDER)",
            "FOLDER",
            "map.zarr",
        ),
    ] = Path("map.zarr"),
    picture: Annotated[
        Path,
        _option("picture of the map (.png, .svg, .pdf), or none", "FILE", "map.png"),
    ] = Path("map.png"),
    summary: Annotated[
        Path,
        _option("picture of all measures, or none", "FILE", "map_summary.png"),
    ] = Path("map_summary.png"),
    chunk_lanes: Annotated[
        int | None,
        _option("most lanes computed at once", "COUNT", "chosen from memory and cache"),
    ] = None,
    dry_run: Annotated[
        _Flag, _flag("compute a few lanes only, print what the map will take, write nothing")
    ] = False,
    quiet: Annotated[_Flag, _flag("print neither the table nor progress")] = False,
) -> int:
    """Sweep every combination of numbers of a rig; print their range, write data and pictures.

    Options override the table [map] of the rig file (explained in examples/map.toml), axes by
    their names. The same command again continues a map that was interrupted. Exit code 1: chunks
    of the map failed, or files could not be written.

    Try:
    $ vibrojax map --axis gap=0.2e-3:1e-3:20 taper=0,0.25,0.5 --frequency-ratio 0.9 1.4 51
    $ vibrojax map rig.toml --axis gap=1e-4:1e-2:30:log --frequency 9.5 --response periodic
    $ vibrojax map rig.toml --zipped taper=0,0.5 width=0.02,0.03 --axis gap=2e-4:1e-3:9 --dry-run
    """
    asked = locals()
    from vibrojax.cli import map as cli_map

    return cli_map.run(cli_map.MapOptions(**asked))


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
    from vibrojax.cli import sweep as cli_sweep

    return cli_sweep.run_modes(rig, num_modes, output, picture)


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
            "frequency=f_Hz amplitude=2; also deviation, contact_force, direction, real, imaginary",
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
    decimal: Annotated[
        Literal[".", ","] | None,
        _option("decimal sign of the file", "{.,,}", "read off its numbers, if they can"),
    ] = None,
    quantity: Annotated[
        Literal["amplitude", "peak", "peak_to_peak", "rms", "first_harmonic"] | None,
        _option(
            "what of the signal was measured; amplitude is (max - min)/2",
            "{amplitude,peak,peak_to_peak,rms,first_harmonic}",
            "read off the header, else amplitude",
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
    from vibrojax.cli.files import check_driven, read, target, watch_compilation

    if output.suffix.lower() not in ("", ".json", ".png"):
        raise ValueError(f"--output must be a name without ending, or .json, got {str(output)!r}.")
    if not output.name:
        raise ValueError(f"--output must be the name of a file, got {str(output)!r}.")
    data, picture = output.with_suffix(".json"), output.with_suffix(".png")
    target("--output", data, (".json",))
    target("--output", picture, (".png",))
    from vibrojax._tools.interrupts import stoppable
    from vibrojax.cli import fit as cli_fit
    from vibrojax.identification.identify import identify

    if not fit or len(set(fit)) < len(fit):
        raise ValueError("--fit must name at least one number, and each of them once.")
    system, _ = read(rig)
    check_driven(rig, system, "fit")
    make = cli_fit.rig_function(system, fit)
    first = cli_fit.guesses(system, fit, guess)
    within = cli_fit.bounds(fit, bounds)
    measured = cli_fit.read_curve(curve, columns, units, quantity, frame, decimal)
    compiling = watch_compilation()
    found = stoppable(identify, make, measured, first, within, objective=objective, starts=starts)
    fitted = time.perf_counter()
    found.save(data)
    whose = "the default rig (dimensions assumed)" if rig is None else str(rig)
    print(f"Fit of {whose} to {curve}")
    print("\n".join(f"  {line}" for line in repr(found).splitlines()))
    print(f"  time     {fitted - started:.1f} s (compiling {sum(compiling):.1f} s)")
    print(f"  written  {data}, {picture}")
    return 0


COMMANDS = {"sweep": sweep, "map": map_numbers, "modes": modes, "fit": fit}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    It is 0, 1 (files, or a map with chunks that failed), 2 (input) or 130 (Ctrl-C). Without `argv`
    this is the process, which ends with it; then SIGTERM is like Ctrl-C, with 143.

    Wrong options, and `--help`, leave by `SystemExit` (2 and 0).
    """
    if argv is None:
        from vibrojax._tools.interrupts import end_on_signals

        with end_on_signals():
            sys.exit(main(sys.argv[1:]))
    arguments = list(argv)
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
        where = f": {error.filename}" if error.filename else ""
        print(f"vibrojax: {error.strerror or error}{where}.", file=sys.stderr)
        return 1
    except KeyboardInterrupt as interrupt:
        print(f"\nvibrojax: {interrupt}" if interrupt.args else "", file=sys.stderr)
        return 130


if __name__ == "__main__":
    main()
