"""Program: makes one map in the store named on its command line, with so many lanes.

Prints which device computed how many of them, as JSON.
"""

import faulthandler
import json
import os
import sys
import time
from collections import Counter

import jax
import numpy as np

import vibrojax as vj
from vibrojax.maps import rig_maker


def oscillator(natural, gap=3e-3):
    """One mass (1 kg) on a spring (natural frequency in Hz) with a stop: quick to compile."""
    return vj.MatrixSystem(
        mass=[[1.0]],
        damping=[[1.0]],
        stiffness=[[(2 * np.pi * natural) ** 2]],
        stops=(vj.Stop(None, gap, vj.KelvinVoigt(50.0, 0.5)),),
        stop_map=[[1.0]],
        drive=vj.BaseMotion(1e-3),
        input_map=[1.0],
        response_map=[1.0],
        proportional=True,
    )


def slowly(curve):
    """Measure that takes as long as the environment says, to be interrupted in."""
    time.sleep(float(os.environ.get("MAP_PAUSE", "0")))
    return curve["amplitude_ratio"].max()


def make_map(store, lanes, **settings):
    """Make a map whose lanes are chunks, with 14 files or more to write for each."""
    chosen = {
        "natural": np.linspace(1.0, 2.0, lanes),
        "frequency_ratio": [0.9, 1.0, 1.1],
        "response": vj.SweepSettings("forward", refine_jumps=None),
        "measures": [slowly, "natural_frequency"],
        "keep_curves": True,
        "chunk_lanes": 1,
        "progress": False,
    }
    return vj.parameter_map(oscillator, store=store, **(chosen | settings))


def make_in_fork(store, lanes, compiled):
    """Make the map in a process that was forked with everything imported."""
    jax.config.update("jax_compilation_cache_dir", compiled)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    make_map(store, lanes)


def main():
    # A hang ends, and says where.
    faulthandler.dump_traceback_later(120, exit=True)
    used = Counter()
    prepare = rig_maker.prepare

    def noted(*arguments):
        prepared = prepare(*arguments)
        used.update(d.id for d in prepared.first_frequency.devices())
        return prepared

    rig_maker.prepare = noted
    make_map(sys.argv[1], int(sys.argv[2]))
    print(json.dumps(used))


if __name__ == "__main__":
    main()
