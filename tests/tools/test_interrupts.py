"""Ctrl-C, SIGTERM: at once, without a crash, and what is done is kept."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray
from map_program import make_map

from vibrojax._tools import interrupts
from vibrojax._tools.interrupts import in_threads, stoppable
from vibrojax.maps.work import MapWork

TESTS = Path(__file__).parents[1]
LIMIT = 5.0
"""Seconds after which a program has to have ended."""


@pytest.fixture
def interrupt():
    """Function that sends Ctrl-C to the main thread, now or after some seconds."""

    def send(after=0.0):
        main = threading.main_thread().ident
        timer = threading.Timer(after, signal.pthread_kill, (main, signal.SIGINT))
        timer.start()

    return send


# ----------------------------------------------------------------------- in a process that lives on


@pytest.mark.parametrize("count", [1, 3])
def test_every_item_is_computed_in_a_thread(count):
    def square(number):
        assert threading.current_thread() is not threading.main_thread()
        return number**2

    assert sorted(in_threads(square, range(7), count)) == [0, 1, 4, 9, 16, 25, 36]
    assert not interrupts._left


def test_what_a_thread_raises_is_raised_and_the_others_stop():
    begun = []

    def fail(number):
        begun.append(number)
        if number == 1:
            raise ZeroDivisionError("the second")
        return number

    results = in_threads(fail, range(100))
    assert next(results) == 0
    with pytest.raises(ZeroDivisionError, match="the second"):
        list(results)
    assert begun == [0, 1]


def test_threads_that_end_are_not_interrupted(monkeypatch):
    def fail(_):
        raise ZeroDivisionError

    lost, switch = [], sys.getswitchinterval()
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    monkeypatch.setattr(threading, "excepthook", lost.append)
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(200):
            with pytest.raises(ZeroDivisionError):
                list(in_threads(fail, range(2), 2))
    finally:
        sys.setswitchinterval(switch)
    assert lost == []


def test_settings_of_the_caller_hold_in_its_threads():
    def settings():
        return jax.config.jax_debug_nans, jax.config.jax_disable_jit, np.geterr()["over"]

    before = settings()
    with jax.debug_nans(True), jax.disable_jit(), np.errstate(over="raise"):
        assert stoppable(settings) == (True, True, "raise")
    assert stoppable(settings) == before == (False, False, "warn")


def test_an_interrupt_frees_the_caller_and_stops_the_thread(interrupt):
    ended = threading.Event()

    def endless():
        try:
            while True:
                time.sleep(1e-3)
        finally:
            ended.set()

    interrupt(0.1)
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        stoppable(endless)
    assert time.monotonic() - started < 1.0
    assert ended.is_set()
    assert not interrupts._left


def test_who_cannot_be_stopped_is_left_and_the_next_call_waits_for_it(interrupt, monkeypatch):
    monkeypatch.setattr(interrupts, "PATIENCE", 0.1)
    order = []

    def compile_program():  # Python does not see the interrupt before this is over
        time.sleep(1.0)

    def work():
        try:
            compile_program()
            order.append("goes on")
        finally:
            order.append("over")

    interrupt(0.1)
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        stoppable(work)
    assert time.monotonic() - started < 0.8
    assert stoppable(order.copy) == ["over"]


def test_items_that_are_left_are_not_begun_after_the_iterator_was_closed():
    begun = []

    def work(number):
        begun.append(number)
        time.sleep(1e-3)

    with closing(in_threads(work, range(10_000))) as results:
        next(results)
    seen = len(begun)
    time.sleep(0.05)
    assert len(begun) == seen < 10_000


@pytest.mark.slow  # it compiles
def test_an_interrupted_map_keeps_what_is_done_and_the_same_call_goes_on(
    tmp_path, interrupt, monkeypatch
):
    compute, begun = MapWork.compute, []

    def third_interrupted(work, number):
        begun.append(number)
        if len(begun) == 3:
            interrupt()
            while True:
                time.sleep(1e-3)
        return compute(work, number)

    monkeypatch.setattr(MapWork, "compute", third_interrupted)
    store = tmp_path / "map.zarr"
    with pytest.raises(KeyboardInterrupt):
        make_map(store, 5)
    status = xarray.open_zarr(store, consolidated=False)["lane_status"].values
    assert (status[:2] == 0).all()
    assert (status[2:] != 0).all()
    whole = make_map(store, 5)
    assert begun == [0, 1, 2, 2, 3, 4]
    assert (whole["lane_status"] == 0).all()


# --------------------------------------------------------------------- programs that end, or do not


def program_of(folder, *command, **environment):
    """A program with nothing compiled before, that says on its error stream what it compiles."""
    known = {k: v for k, v in os.environ.items() if not k.startswith("JAX_COMPILATION_CACHE")}
    return subprocess.Popen(
        [sys.executable, *command],
        cwd=folder,
        env=known | {"JAX_LOG_COMPILES": "1", "PYTHONFAULTHANDLER": "1"} | environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def end_while_compiling(process, number):
    """Send a signal while the march is compiled, which takes long.

    Returns what is said then, and the seconds until the end.
    """
    with process:
        assert process.stderr is not None
        assert any("Compiling" in line and "march_some" in line for line in process.stderr)
        time.sleep(0.3)
        assert process.poll() is None
        process.send_signal(number)
        started = time.monotonic()
        printed = process.stderr.read()
    return printed, time.monotonic() - started


@pytest.mark.slow
def test_a_command_that_compiles_ends(tmp_path):
    process = program_of(tmp_path, "-m", "vibrojax.cli.command", "sweep")
    printed, took = end_while_compiling(process, signal.SIGTERM)
    assert process.returncode == 128 + signal.SIGTERM
    assert took < LIMIT
    assert "Traceback" not in printed
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_map_that_compiles_ends_and_says_what_stays(tmp_path):
    axis = ("--axis", "gap=2e-4:1e-3:4", "--frequency-ratio", "0.9", "1.3", "9")
    process = program_of(tmp_path, "-m", "vibrojax.cli.command", "map", *axis)
    printed, took = end_while_compiling(process, signal.SIGINT)
    assert process.returncode == 128 + signal.SIGINT
    assert took < LIMIT
    assert printed.endswith(
        "vibrojax: interrupted. Whole chunks are in map.zarr: the same command continues.\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["map.zarr"]


@pytest.mark.slow
def test_a_program_that_makes_a_map_ends(tmp_path):
    devices = "--xla_force_host_platform_device_count=2"
    command = (str(TESTS / "map_program.py"), "map.zarr", "8")
    process = program_of(tmp_path, *command, XLA_FLAGS=devices)
    printed, took = end_while_compiling(process, signal.SIGINT)
    assert process.returncode == -signal.SIGINT, printed
    assert took < LIMIT
    assert printed.rstrip().endswith("KeyboardInterrupt")
    assert xarray.open_zarr(tmp_path / "map.zarr", consolidated=False)["lane_status"].size == 8


@pytest.mark.slow
def test_a_program_that_runs_a_study_does_not_crash(tmp_path):
    study = "vj.frequency_sweep(vj.default_rig(num_modes=1), frequency_ratio=[0.9, 1.0])"
    process = program_of(tmp_path, "-c", f"import vibrojax as vj\n{study}")
    printed, _ = end_while_compiling(process, signal.SIGINT)
    assert process.returncode == -signal.SIGINT, printed
    # What compiles in the background may still say that it has ended.
    assert "KeyboardInterrupt" in printed.splitlines()


SECOND = """
import signal, threading, time
from vibrojax._tools.interrupts import end_on_signals, stoppable
main = threading.main_thread().ident
for delay in (0.1, 0.4):
    threading.Timer(delay, signal.pthread_kill, (main, signal.SIGINT)).start()
with end_on_signals():
    try:
        time.sleep(60)
    finally:
        time.sleep(60)
"""
LOST = """
import gc, time
import vibrojax
lose = [True]
def callback(phase, info):
    if lose and phase == "stop":
        lose.clear()
        raise KeyboardInterrupt
gc.callbacks.append(callback)
gc.collect()
time.sleep(60)
"""


@pytest.mark.slow  # seconds, to import JAX
@pytest.mark.parametrize(
    ("program", "code"),
    [(SECOND, 128 + signal.SIGINT), (LOST, -signal.SIGINT)],
    ids=["a second one", "one that a callback swallows"],
)
def test_an_interrupt_ends_a_program_for_certain(program, code):
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=50, check=False
    )
    assert ended.returncode == code
    assert "ignored" not in ended.stderr
