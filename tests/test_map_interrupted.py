"""Maps that are interrupted (killed, Ctrl-C, full disk, failing chunks) and continued."""

import errno
import json
import logging
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray
import zarr
from map_program import make_map, oscillator

import vibrojax as vj

PROGRAM = Path(__file__).with_name("map_program.py")
LANES = 36


class Killed(BaseException):
    """Stands for the death of the process: nothing catches it."""


def files_of(store):
    """All files of a store by name; what Zarr had not yet renamed when it was killed is no data."""
    found = {p: p.read_bytes() for p in Path(store).rglob("*") if p.is_file()}
    kept = {p: data for p, data in found.items() if p.suffix != ".partial"}
    return {str(p.relative_to(store)): data for p, data in kept.items()}


def assert_same_store(store, reference):
    """Every file is the same, byte for byte, and so is what is read from them."""
    mine, other = files_of(store), files_of(reference)
    assert sorted(mine) == sorted(other)
    assert [name for name in mine if mine[name] != other[name]] == []
    datasets = (xarray.open_zarr(path, consolidated=False).load() for path in (store, reference))
    xarray.testing.assert_identical(*datasets)


def statuses(store):
    """Words of `lane_status`, lane by lane."""
    found = xarray.open_zarr(store, consolidated=False)["lane_status"]
    words = found.attrs["flag_meanings"].split()
    return [words[value] for value in found.values.ravel()]


@pytest.fixture(scope="session")
def environment(tmp_path_factory):
    """Environment of programs: they share what they have compiled, which makes restarts quick."""
    return os.environ | {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path_factory.mktemp("compiled")),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }


def start(store, environment, **more):
    return subprocess.Popen(
        [sys.executable, str(PROGRAM), str(store), str(LANES)],
        env=environment | more,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process):
    """Wait for a program that is to succeed; returns what it printed."""
    out, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    return json.loads(out)


@pytest.fixture(scope="session")
def whole(tmp_path_factory, environment):
    """Store of the program, never interrupted."""
    path = tmp_path_factory.mktemp("whole") / "map.zarr"
    assert finish(start(path, environment)) == {"0": LANES}
    assert set(statuses(path)) == {"settled"}
    return path


def chunks_in(store):
    """How many chunks have begun to say that they are whole."""
    place = Path(store) / "lane_status" / "c"
    return len(os.listdir(place)) if place.is_dir() else 0


def interrupt(process, how, ripe, delay):
    """Send a signal some time after the moment is ripe; False where the program ended before."""
    while not ripe():
        if process.poll() is not None:
            return False
        time.sleep(1e-3)
    time.sleep(delay)
    process.send_signal(how)
    process.communicate(timeout=60)
    return process.returncode == -how


# ------------------------------------------------------------------------------ killed processes


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_killed_again_and_again_a_map_ends_as_if_nothing_had_been(
    tmp_path, environment, whole, seed
):
    choice = random.Random(seed)
    store = tmp_path / "map.zarr"
    kills = 0
    # Creating the store takes 0.3 s or so here.
    for _ in range(3):
        process = start(store, environment)
        kills += interrupt(process, signal.SIGKILL, store.exists, choice.uniform(0, 0.3))
    # A chunk takes some 40 ms, most of them in writing 14 files.
    for _ in range(8):
        least = chunks_in(store) + choice.randint(0, 2)
        process = start(store, environment)
        written = interrupt(
            process, signal.SIGKILL, lambda least=least: chunks_in(store) > least,
            choice.uniform(0, 0.1),
        )  # fmt: skip
        kills += written
    assert kills == 11
    left = LANES - chunks_in(store)
    assert left > 0
    used = finish(start(store, environment))
    assert used["0"] <= left + 1  # what was whole is not computed again
    assert_same_store(store, whole)


@pytest.mark.slow
def test_ctrl_c_ends_a_map_and_the_same_call_continues_it(tmp_path, environment, whole):
    choice = random.Random(2)
    store = tmp_path / "map.zarr"
    two_devices = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    for more in ({}, {}, two_devices):
        least = chunks_in(store) + 2
        process = start(store, environment, **more)
        started = time.monotonic()
        assert interrupt(
            process, signal.SIGINT, lambda least=least: chunks_in(store) > least,
            choice.uniform(0, 0.1),
        )  # fmt: skip
    finish(start(store, environment))
    assert_same_store(store, whole)
