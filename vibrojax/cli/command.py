"""The command `vibrojax`: sweeps, motions, maps, modes and fits of a rig, from a terminal."""

import atexit
import gc
import sys
from collections.abc import Sequence
from pkgutil import resolve_name

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
        options = parsed(argv)
        return resolve_name(RUN_BY[type(options)])(options)
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


RUN_BY = {
    Sweep: "vibrojax.cli.sweep:run_sweep",
    Simulate: "vibrojax.cli.simulate:run_simulate",
    Map: "vibrojax.cli.map:run_map",
    Modes: "vibrojax.cli.sweep:run_modes",
    Fit: "vibrojax.cli.fit:run_fit",
    Cache: "vibrojax.cli.cache:run_cache",
}
"""What does what was asked, by its options; only what is needed is imported."""


if __name__ == "__main__":
    main()
