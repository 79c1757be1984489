"""The command `vibrojax`: sweeps, motions, maps, modes and fits of a rig, from a terminal."""

import atexit
import gc
import sys
from collections.abc import Sequence

from vibrojax.cli.options import Cache, Fit, Map, Modes, Simulate, Sweep, parsed


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    It is 0, 1 (files, or a map with chunks that failed), 2 (input) or 130 (Ctrl-C). Without `argv`
    this is the process, which ends with it; then SIGTERM is like Ctrl-C, with 143.

    Wrong options, and `--help`, leave by `SystemExit` (2 and 0).
    """
    if argv is None:
        from vibrojax._tools.interrupts import end_on_signals

        # What was imported stays; what is left at the end goes with the process.
        gc.freeze()
        atexit.register(gc.freeze)
        with end_on_signals():
            sys.exit(main(sys.argv[1:]))
    if list(argv) == ["--version"]:
        from importlib.metadata import version

        print(f"vibrojax {version('vibrojax')}")
        return 0
    try:
        return _run(parsed(argv))
    except (ValueError, ImportError) as error:  # such as a format of which the library is missing
        print(f"vibrojax: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        print(f"vibrojax: {error.strerror or error}{where}.", file=sys.stderr)
        return 1
    except KeyboardInterrupt as interrupt:
        print(f"\nvibrojax: {interrupt}" if interrupt.args else "", file=sys.stderr)
        return 130


def _run(options: Sweep | Simulate | Map | Modes | Fit | Cache) -> int:
    """Do what was asked; only what it needs is imported."""
    if isinstance(options, Sweep):
        from vibrojax.cli.sweep import run_sweep

        return run_sweep(options)
    if isinstance(options, Simulate):
        from vibrojax.cli.simulate import run_simulate

        return run_simulate(options)
    if isinstance(options, Map):
        from vibrojax.cli.map import run_map

        return run_map(options)
    if isinstance(options, Modes):
        from vibrojax.cli.sweep import run_modes

        return run_modes(options)
    if isinstance(options, Cache):
        from vibrojax.cli.cache import run_cache

        return run_cache(options)
    from vibrojax.cli.fit import run_fit

    return run_fit(options)


if __name__ == "__main__":
    main()
