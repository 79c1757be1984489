"""Options of the command `vibrojax`, with what its help says of them.

Nothing heavy is imported here: help and wrong options are answered at once.
"""

import dataclasses
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
$ vibrojax simulate --drive record.csv   the motion under a measured base acceleration
$ vibrojax map map.toml      sweeps over any numbers of the rig (examples/map.toml)
$ vibrojax modes rig.toml    its natural frequencies
$ vibrojax fit curve.csv     contact stiffness and damping from a measured curve
$ vibrojax cache             compiled programs that are kept
$ vibrojax sweep --help      every option of a command
$ vibrojax --version         the version"""

_RIG = "the default rig"
_RIG_HELP = (
    "rig file in TOML, explained line by line in examples/uniform_beam.toml; the default is a "
    "tapered cantilever 0.2 m long that hits one stop at mid-span"
)
_FILE = "[sweep] of the rig file, else"


def _said(metavar: str, default: str, **more: Any) -> Any:
    """Return what the help shows of an option, beside the comment above it."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})", **more)


_Flag = Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(help_behavior_hint="")]
_Groups = tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]]
_Range = tuple[float, float, int] | None
_Texts = tuple[str, ...]
_Rig = Annotated[Path | None, tyro.conf.Positional, _said("[RIG.toml]", _RIG, help=_RIG_HELP)]
_Direction = Literal["both", "forward", "backward"] | None
_WAYS = "{both,forward,backward}"


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Sweep the drive frequency up and down; print the peak and jumps, write data and a picture.

    Try:
    $ vibrojax sweep
    $ vibrojax sweep rig.toml --frequency 8 13 201
    $ vibrojax sweep --frequency-ratio 1.0 1.3 61 --direction forward --picture none
    """

    rig: _Rig = None
    # drive frequencies over the first natural frequency of the beam without stops, evenly spaced
    frequency_ratio: Annotated[_Range, _said("START END POINTS", f"{_FILE} 0.8 1.4 121")] = None
    # the same in Hz; give one of the two
    frequency: Annotated[_Range, _said("START END POINTS", "not used")] = None
    # forward: frequency rising, backward: falling; the motion is carried from point to point
    direction: Annotated[_Direction, _said(_WAYS, f"{_FILE} both")] = None
    # relative error to aim at in amplitudes and forces
    tolerance: Annotated[float | None, _said("FRACTION", f"{_FILE} 1e-4")] = None
    # steps per drive period
    steps_per_period: Annotated[
        int | None, _said("COUNT", f"{_FILE} chosen from contact and tolerance")
    ] = None
    # NetCDF file (.nc) for all results, or none
    output: Annotated[Path, _said("FILE", "sweep.nc")] = Path("sweep.nc")
    # picture of the response (.png, .svg, .pdf), or none
    picture: Annotated[Path, _said("FILE", "sweep.png")] = Path("sweep.png")
    # print neither the table nor progress
    quiet: _Flag = False


@dataclasses.dataclass(frozen=True)
class Simulate:
    """Simulate one motion from rest; print what happened, write data and a picture.

    The drive is a measured record (acceleration of the base, or force, as the rig's [drive] says)
    or harmonic.

    Try:
    $ vibrojax simulate rig.toml --drive record.csv
    $ vibrojax simulate rig.toml --drive record.csv --units acceleration=g --quantity acceleration
    $ vibrojax simulate --frequency-ratio 1.1 --periods 40
    """

    rig: _Rig = None
    # measured drive: text with a header (.csv, .txt), Excel, MAT, HDF5, NetCDF, TDMS, UFF; columns
    # like time [s], acceleration [m/s2], or force [N] where a force drives the rig; straight
    # between samples
    drive: Annotated[Path | None, _said("RECORD.csv", "none")] = None
    # frequency of a harmonic drive instead, Hz
    frequency: Annotated[float | None, _said("HERTZ", "none")] = None
    # the same over the first natural frequency
    frequency_ratio: Annotated[float | None, _said("RATIO", "none")] = None
    # tip displacement from which the beam is let go, m
    release: Annotated[float | None, _said("METRES", "from rest")] = None
    # how long, s
    duration: Annotated[float | None, _said("SECONDS", "the record, or 100 periods")] = None
    # how long, in drive periods
    periods: Annotated[float | None, _said("COUNT", "100 without a record")] = None
    # intervals over the whole time
    samples: Annotated[int | None, _said("COUNT", "those of the record, or 128 a period")] = None
    # samples per second instead
    sampling_rate: Annotated[float | None, _said("HERTZ", "not used")] = None
    # what the picture shows above the contact force: displacement, velocity, acceleration, ...
    quantity: Annotated[str, _said("NAME", "displacement")] = "displacement"
    # place x/L at which it is shown
    position: Annotated[float | None, _said("X/L", "the tip")] = None
    # columns of the record, by name or position from 0, as time=0 acceleration=2
    columns: Annotated[_Texts, _said("NAME=COLUMN ...", "recognised by their names")] = ()
    # units where its header has none, as time=ms acceleration=g
    units: Annotated[_Texts, _said("NAME=UNIT ...", "those of the header")] = ()
    # where in a file of several tables: sheet, path of a struct or group, number of a record
    at: Annotated[str | None, _said("PLACE", "the only one")] = None
    # which run of a table that has several side by side
    run: Annotated[str | None, _said("NAME", "the only one")] = None
    # decimal sign of the record
    decimal: Annotated[
        Literal[".", ","] | None, _said("{.,,}", "read off its numbers, if they can")
    ] = None
    # NetCDF file (.nc) for the motion, or none
    output: Annotated[Path, _said("FILE", "simulate.nc")] = Path("simulate.nc")
    # picture of it (.png, .svg, .pdf), or none
    picture: Annotated[Path, _said("FILE", "simulate.png")] = Path("simulate.png")
    # print nothing
    quiet: _Flag = False


@dataclasses.dataclass(frozen=True)
class Map:
    """Sweep every combination of numbers of a rig; print their range, write data and pictures.

    Options override the table [map] of the rig file (explained in examples/map.toml), axes by
    their names. The same command again continues a map that was interrupted. Exit code 1: chunks
    of the map failed, or files could not be written.

    Try:
    $ vibrojax map --axis gap=0.2e-3:1e-3:20 taper=0,0.25,0.5 --frequency-ratio 0.9 1.4 51
    $ vibrojax map rig.toml --axis gap=1e-4:1e-2:30:log --frequency 9.5 --response periodic
    $ vibrojax map rig.toml --zipped taper=0,0.5 width=0.02,0.03 --axis gap=2e-4:1e-3:9 --dry-run
    """

    rig: _Rig = None
    # numbers to vary, crossed with each other: evenly from LOW to HIGH, with :log at even ratios,
    # or value by value. Names are keys of [beam], of the first [[stop]], damping_ratio, or
    # amplitude of the drive; units are SI
    axis: Annotated[
        _Groups,
        _said("NAME=LOW:HIGH:COUNT[:log] | NAME=VALUE,VALUE ...", "[map.axes] of the rig file"),
    ] = ()
    # numbers that go along one axis together, value by value (two or more; once for each such
    # group)
    zipped: Annotated[
        _Groups, _said("NAME=... NAME=... [NAME=...]", "[[map.zipped]] of the rig file")
    ] = ()
    # drive frequencies over the first natural frequency, or one
    frequency_ratio: Annotated[
        tuple[float, ...],
        _said("START END POINTS | VALUE", "[map], else [sweep] of the rig file, else 0.8 1.4 61"),
    ] = ()
    # the same in Hz; give one of the two
    frequency: Annotated[tuple[float, ...], _said("START END POINTS | VALUE", "not used")] = ()
    # sweep: settled, as of the command sweep; periodic: solved at every frequency, from rest;
    # continuation: branches through their folds
    response: Annotated[
        Literal["sweep", "periodic", "continuation"] | None,
        _said("{sweep,periodic,continuation}", "[map] of the rig file, else sweep"),
    ] = None
    # of a sweep
    direction: Annotated[_Direction, _said(_WAYS, "[map], else [sweep], else both")] = None
    # relative error to aim at
    tolerance: Annotated[float | None, _said("FRACTION", "[map], else [sweep], else 1e-4")] = None
    # what to keep of every curve, such as peak_amplitude_ratio or jump_up (the others are listed
    # when a name is wrong)
    measures: Annotated[_Texts, _said("NAME ...", "[map], else all, and the curves")] = ()
    # keep whole curves (large), even where measures are named
    keep_curves: _Flag = False
    # keep measures only, even where none are named
    no_curves: _Flag = False
    # differentiate by these numbers too
    gradients: Annotated[_Texts, _said("NAME ...", "[map] of the rig file, else no")] = ()
    # Zarr store (a folder) for the map, or none; one that is there is continued. Opens with
    # xarray.open_zarr(FOLDER)
    store: Annotated[Path, _said("FOLDER", "map.zarr")] = Path("map.zarr")
    # picture of the map (.png, .svg, .pdf), or none
    picture: Annotated[Path, _said("FILE", "map.png")] = Path("map.png")
    # picture of all measures, or none
    summary: Annotated[Path, _said("FILE", "map_summary.png")] = Path("map_summary.png")
    # most lanes computed at once
    chunk_lanes: Annotated[int | None, _said("COUNT", "chosen from memory and cache")] = None
    # compute a few lanes only, print what the map will take, write nothing
    dry_run: _Flag = False
    # print neither the table nor progress
    quiet: _Flag = False


@dataclasses.dataclass(frozen=True)
class Modes:
    """Print the natural frequencies of the beam without its stops, modal masses, participation.

    Try:
    $ vibrojax modes
    $ vibrojax modes rig.toml --num-modes 8 --picture modes.png --output modes.csv
    """

    rig: _Rig = None
    # how many modes
    num_modes: Annotated[int | None, _said("COUNT", "as many as the rig keeps, 5")] = None
    # file for the table (.csv)
    output: Annotated[Path | None, _said("FILE", "not written")] = None
    # picture of the shapes (.png, .svg, .pdf)
    picture: Annotated[Path | None, _said("FILE", "not drawn")] = None


@dataclasses.dataclass(frozen=True)
class Fit:
    """Fit numbers of a rig to a measured curve; print what is known of them, write both files.

    Try:
    $ vibrojax fit curve.csv --rig rig.toml
    $ vibrojax fit curve.csv --rig rig.toml --fit stiffness gap --guess stiffness=3000
    $ vibrojax fit curve.csv --rig rig.toml --report report.html
    $ vibrojax fit curve.csv --columns frequency=f amplitude=tip --units frequency=Hz amplitude=mm
    """

    # measured frequency response: text with a header (.csv, .txt), Excel, MAT, HDF5, NetCDF, TDMS,
    # UFF
    curve: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(metavar="CURVE.csv", help_behavior_hint="(required)"),
    ]
    rig: Annotated[Path | None, _said("RIG.toml", _RIG, help=_RIG_HELP)] = None
    # numbers to fit: keys of the first [[stop]] (stiffness, damping, gap, position), of [beam],
    # damping_ratio, or amplitude of the drive; the others stay as the rig has them
    fit: Annotated[_Texts, _said("NAME ...", "stiffness damping")] = ("stiffness", "damping")
    # first values, SI
    guess: Annotated[_Texts, _said("NAME=VALUE ...", "those of the rig")] = ()
    # bounds, SI
    bounds: Annotated[_Texts, _said("NAME=LOW:HIGH ...", "none but of what is no rig")] = ()
    # distance: of every point from the whole response curve; for comparison pointwise: at equal
    # frequencies, or folds: with the jumps on the folds
    objective: Annotated[
        Literal["distance", "pointwise", "folds"], _said("{distance,pointwise,folds}", "distance")
    ] = "distance"
    # how many searches, from as many starts
    searches: Annotated[int, _said("COUNT", "1")] = 1
    # columns of the file, by name or position from 0 (none: leave out), as frequency=f_Hz
    # amplitude=2; also deviation, contact_force, drive, phase, direction, real, imaginary
    columns: Annotated[_Texts, _said("NAME=COLUMN ...", "recognised by their names")] = ()
    # units where the header has none, as frequency=Hz amplitude=mm (or ratio)
    units: Annotated[_Texts, _said("NAME=UNIT ...", "those of the header")] = ()
    # where in a file of several tables: sheet, path of a struct or group, number of a record
    at: Annotated[str | None, _said("PLACE", "the only one")] = None
    # which run of a table that has several side by side
    run: Annotated[str | None, _said("NAME", "the only one")] = None
    # decimal sign of the file
    decimal: Annotated[
        Literal[".", ","] | None, _said("{.,,}", "read off its numbers, if they can")
    ] = None
    # what of the signal was measured; amplitude is (max - min)/2
    quantity: Annotated[
        Literal["amplitude", "peak", "peak_to_peak", "rms", "first_harmonic"] | None,
        _said(
            "{amplitude,peak,peak_to_peak,rms,first_harmonic}",
            "read off the header, else amplitude",
        ),
    ] = None
    # to the moving base, or not
    frame: Annotated[
        Literal["relative", "absolute"] | None, _said("{relative,absolute}", "relative")
    ] = None
    # name of the numbers (.json) and the picture (.png)
    output: Annotated[Path, _said("FILE", "fit")] = Path("fit")
    # page for a colleague, with the data and a script that repeats the fit (.html)
    report: Annotated[Path | None, _said("FILE", "not written")] = None


@dataclasses.dataclass(frozen=True)
class Cache:
    """Print where compiled programs are kept for the next process, how many, their size; or clear.

    Try:
    $ vibrojax cache
    $ vibrojax cache --clear
    """

    # delete them all, those of other versions too
    clear: _Flag = False


COMMANDS = {
    "sweep": Sweep,
    "simulate": Simulate,
    "map": Map,
    "modes": Modes,
    "fit": Fit,
    "cache": Cache,
}


def parsed(arguments: Sequence[str]) -> Sweep | Simulate | Map | Modes | Fit | Cache:
    """Return the options of a command. Wrong ones, and `--help`, leave by `SystemExit`."""
    arguments = list(arguments) or ["--help"]
    return tyro.extras.subcommand_cli_from_dict(
        COMMANDS, prog="vibrojax", description=DESCRIPTION, args=arguments
    )
