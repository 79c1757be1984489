"""Maps that are interrupted (killed, Ctrl-C, full disk, failing chunks) and continued."""

import errno
import itertools
import json
import logging
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray
import zarr
from map_program import make_in_fork, make_map, oscillator

import vibrojax as vj
from vibrojax.maps.store import MapStore

PROGRAM = Path(__file__).parents[1] / "map_program.py"
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
    datasets = (xarray.open_zarr(path).load() for path in (store, reference))
    xarray.testing.assert_identical(*datasets)


def statuses(store):
    """Words of `lane_status`, lane by lane."""
    found = xarray.open_zarr(store, consolidated=False)["lane_status"]
    words = found.attrs["flag_meanings"].split()
    return [words[value] for value in found.values.ravel()]


@pytest.fixture(scope="session")
def environment():
    """Environment of programs: they share what all have compiled, which makes restarts quick."""
    return os.environ | {"JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1"}


def with_devices(environment, count):
    """Environment with so many devices, compiled for as the reference is, to the last bit."""
    flags = f"{environment.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}"
    return environment | {"XLA_FLAGS": flags.strip()}


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


def wait_until(ripe, process):
    """Wait for a moment while a process runs; False where it ends before."""
    alive = process.is_alive if hasattr(process, "is_alive") else lambda: process.poll() is None
    while not ripe():
        if not alive():
            return False
        time.sleep(1e-3)
    return True


# ------------------------------------------------------------------------------ killed processes


@pytest.fixture(scope="session")
def forked(environment):
    """Function that makes the map in a new process, which takes little: all is imported."""
    # JAX has started nothing yet where it forks: importing vibrojax touches no device.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["map_program"])
    path = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(PROGRAM.parent), path]))

    def begin(store):
        compiled = environment["JAX_COMPILATION_CACHE_DIR"]
        process = context.Process(target=make_in_fork, args=(str(store), LANES, compiled))
        process.start()
        return process

    yield begin
    os.environ.pop("PYTHONPATH")
    if path is not None:
        os.environ["PYTHONPATH"] = path


@pytest.mark.slow
@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.long), 1])
def test_killed_again_and_again_a_map_ends_as_if_nothing_had_been(tmp_path, forked, whole, seed):
    choice = random.Random(seed)
    store = tmp_path / "map.zarr"

    def kill(ripe, delay):
        process = forked(store)
        assert wait_until(ripe, process)
        time.sleep(delay)
        process.kill()
        process.join(60)
        assert process.exitcode == -signal.SIGKILL

    for _ in range(5):  # creating the store takes 0.2 s or so here
        kill(lambda: store.exists(), choice.uniform(0, 0.2))
    for _ in range(6):  # a chunk takes some 40 ms, most of them in writing 14 files
        least = chunks_in(store) + choice.randint(0, 2)
        kill(lambda least=least: chunks_in(store) > least, choice.uniform(0, 0.1))
    assert 6 <= chunks_in(store) < LANES
    last = forked(store)
    last.join(240)
    assert last.exitcode == 0
    assert_same_store(store, whole)


@pytest.mark.slow
@pytest.mark.long  # minutes
def test_ctrl_c_ends_a_map_and_the_same_call_continues_it(tmp_path, environment, whole):
    choice = random.Random(2)
    store = tmp_path / "map.zarr"
    for count in (1, 2):
        least = chunks_in(store) + 2
        # The pause is so that some of it is left, however slow this machine looks.
        process = start(store, with_devices(environment, count), MAP_PAUSE="0.5")
        assert wait_until(lambda least=least: chunks_in(store) > least, process)
        time.sleep(choice.uniform(0, 0.1))
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
        assert process.returncode == -signal.SIGINT
        assert errors.rstrip().endswith("KeyboardInterrupt")
    left = LANES - chunks_in(store)
    assert 0 < left < LANES
    # What was whole is not computed again; one chunk was on its way to be written.
    assert left <= finish(start(store, environment))["0"] <= left + 1
    assert_same_store(store, whole)


# ---------------------------------------------------------------------- many devices and workers


@pytest.mark.slow
@pytest.mark.long
def test_several_devices_share_the_chunks(tmp_path, environment, whole):
    # The second device compiles while the first one runs. The program ends itself if that hangs.
    process = start(tmp_path / "map", with_devices(environment, 2), MAP_PAUSE="0.2")
    used = finish(process)
    assert sum(used.values()) == LANES
    assert sorted(used) == ["0", "1"]
    assert_same_store(tmp_path / "map", whole)


@pytest.fixture
def cluster(monkeypatch, environment, deaths):
    """Two worker processes, which take their time where they are to be killed."""
    distributed = pytest.importorskip("distributed")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("MAP_PAUSE", "0.3" if deaths else "0")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
    ) as cluster:
        yield cluster


@pytest.mark.slow
@pytest.mark.parametrize("deaths", [0, pytest.param(4, marks=pytest.mark.long)])
def test_workers_of_a_cluster_may_be_killed(tmp_path, cluster, whole, deaths):
    from distributed import Client

    choice = random.Random(3)
    store = tmp_path / "map"
    kills = []

    def kill():
        for _ in range(deaths):
            least = chunks_in(store) + choice.randint(0, 2)
            while chunks_in(store) <= least:
                time.sleep(1e-3)
            time.sleep(choice.uniform(0, 1))
            nanny = choice.choice(list(cluster.workers.values()))
            if nanny.pid is not None and chunks_in(store) < LANES:
                os.kill(nanny.pid, signal.SIGKILL)
                kills.append(nanny.pid)

    killer = threading.Thread(target=kill, daemon=True)
    with Client(cluster) as client:
        killer.start()
        make_map(store, LANES, client=client)
    assert len(set(kills)) >= min(deaths, 3)
    assert_same_store(store, whole)


# ------------------------------------------------------- death at every change of the file system


class Death:
    """Ends everything before the n-th change of the files under a folder."""

    def __init__(self, monkeypatch, folder):
        self.folder, self.left, self.counted = str(folder), None, 0
        for name in ("mkdir", "replace", "unlink", "rmdir"):
            monkeypatch.setattr(os, name, self._dying(getattr(os, name)))

    def _dying(self, change):
        def changed(path, *arguments, **named):
            # Relative to an open folder are those of shutil.rmtree.
            if str(path).startswith(self.folder) or named.get("dir_fd") is not None:
                if self.left is not None and self.counted >= self.left:
                    raise Killed
                self.counted += 1
            return change(path, *arguments, **named)

        return changed

    def after(self, changes):
        self.left, self.counted = changes, 0


def small_map(store, lanes=6, **settings):
    """Chunks of two lanes, computed here; of few files unless the settings say otherwise."""
    few = {"measures": ["natural_frequency"], "keep_curves": False, "chunk_lanes": 2}
    return make_map(store, lanes, **(few | settings))


def died(death, changes, store):
    """Whether a map dies before a number of changes; else it is complete."""
    death.after(changes)
    try:
        small_map(store, lanes=4)
    except Killed:
        return True
    finally:
        death.after(None)
    return False


@pytest.fixture
def small(tmp_path):
    """Store of the same map, never interrupted."""
    small_map(tmp_path / "small", lanes=4)
    return tmp_path / "small"


@pytest.mark.parametrize("step", [pytest.param(1, marks=pytest.mark.slow), 11])
def test_death_before_any_change_of_the_files_is_mended_by_the_same_call(
    tmp_path, monkeypatch, small, step
):
    (tmp_path / "here").mkdir()
    death = Death(monkeypatch, tmp_path / "here")
    changes = 0
    while died(death, changes, store := tmp_path / "here" / f"{changes}"):
        small_map(store, lanes=4)
        assert_same_store(store, small)
        changes += step
    # Coordinates, variables and their metadata, their chunks, notes, and the folders of all these.
    assert changes > 40


@pytest.mark.slow
def test_death_while_clearing_away_what_was_half_created_is_mended_too(
    tmp_path, monkeypatch, small
):
    (tmp_path / "here").mkdir()
    death = Death(monkeypatch, tmp_path / "here")
    # A new place each time: in a process that lives on, threads of Zarr still write for a while.
    places = ((n, tmp_path / "here" / f"first_{n}") for n in itertools.count(3, 3))
    for changes, first in places:
        assert died(death, changes, first)
        if (first / "lane_status" / "zarr.json").exists():
            break
    for again in itertools.count():
        store = shutil.copytree(first, tmp_path / "here" / f"{again}")
        assert died(death, again, store)
        cleared = list(files_of(store)) == ["vibrojax/lock"]
        small_map(store, lanes=4)
        assert_same_store(store, small)
        if cleared:
            break
    assert again > 10


def test_death_before_the_last_note_leaves_no_failure_that_is_none(tmp_path, monkeypatch):
    measure = Fragile(tmp_path / "flag")
    store, settings = tmp_path / "map", {"measures": {"fragile": measure}}
    small_map(tmp_path / "whole", **settings)
    measure.flag.touch()
    with pytest.warns(UserWarning, match="chunks failed twice"):
        small_map(store, **settings)
    measure.flag.unlink()

    def die(*_, **__):
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(MapStore, "note", die)
        with pytest.raises(Killed):
            small_map(store, **settings)
    # All is computed now, but the store still names the failure.
    small_map(store, **settings)
    assert_same_store(store, tmp_path / "whole")


# ----------------------------------------------------------------------------------- full disks


@pytest.fixture
def full_disk(monkeypatch):
    """Function that leaves so many bytes of room for stores, or None for any number."""
    from zarr.storage import _local

    put, room = _local._put, [None]

    def put_where_there_is_room(path, value, exclusive=False):
        if room[0] is not None:
            room[0] -= len(value)
            if room[0] < 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return put(path, value, exclusive)

    monkeypatch.setattr(_local, "_put", put_where_there_is_room)
    return lambda left: room.__setitem__(0, left)


def test_a_full_disk_is_said_and_no_harm_wherever_it_happens(tmp_path, full_disk):
    whole = tmp_path / "whole"
    small_map(whole, keep_curves=True)
    size = sum(map(len, files_of(whole).values()))
    for k, part in enumerate((0.0, 0.1, 0.5, 0.7, 0.8, 0.9, 1.0)):
        store = tmp_path / f"{k}"
        # Attributes are written more than once, so that all of this is too little.
        full_disk(int(part * size))
        with pytest.raises(
            vj.maps.StoreFull, match=r"disk of the store is full.*same call"
        ) as raised:
            small_map(store, keep_curves=True)
        assert raised.value.errno == errno.ENOSPC
        assert raised.value.__suppress_context__  # one sentence, not a tale of Zarr's
        full_disk(None)
        if (store / "lane_status" / "zarr.json").exists():
            assert "failed" not in statuses(store)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            small_map(store, keep_curves=True)
        assert_same_store(store, whole)


@pytest.fixture
def small_disk(tmp_path):
    """A real disk of 2 MiB in memory."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(place)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"a small disk needs the right to mount one: {error}")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def free(place):
    found = os.statvfs(place)
    return found.f_bavail * found.f_frsize


def test_a_disk_that_is_really_full(tmp_path, small_disk):
    whole, store, ballast = small_disk / "whole", small_disk / "map", small_disk / "ballast"
    before = free(small_disk)
    small_map(whole, keep_curves=True)
    taken = before - free(small_disk)
    shutil.move(whole, whole := tmp_path / "whole")
    for part in (0.1, 0.6, 0.8):
        ballast.write_bytes(bytes(int(free(small_disk) - part * taken)))
        with pytest.raises(vj.maps.StoreFull, match="disk of the store is full"):
            small_map(store, keep_curves=True)
        ballast.unlink()
        small_map(store, keep_curves=True)
        assert_same_store(store, whole)
        shutil.rmtree(store)


# ------------------------------------------------------------------------------- chunks that fail


class Fragile:
    """A measure that counts its calls, and fails for the lane of 1.6 Hz while a flag is there."""

    def __init__(self, flag):
        self.flag, self.calls = flag, []

    def __call__(self, curve):
        frequency = round(float(curve["natural_frequency"]), 6)
        self.calls.append(frequency)
        if self.flag.exists() and frequency == 1.6:
            raise RuntimeError("no such luck")
        return frequency


def test_a_chunk_that_fails_twice_is_flagged_and_computed_by_the_next_call(tmp_path):
    measure = Fragile(tmp_path / "flag")
    store, settings = tmp_path / "map", {"measures": {"fragile": measure}}
    small_map(tmp_path / "whole", **settings)
    assert measure.calls == [1.0, 1.2, 1.4, 1.6, 1.8, 2.0]

    measure.flag.touch()
    for calls in ([1.0, 1.2, 1.4, 1.6, 1.4, 1.6, 1.8, 2.0], [1.4, 1.6, 1.4, 1.6]):
        measure.calls.clear()
        with pytest.warns(UserWarning, match="1 of 3 chunks failed") as warned:
            found = small_map(store, **settings)
        assert measure.calls == calls
        text = str(warned[0].message)
        assert "Chunk 1 at natural[2:4]: RuntimeError: no such luck" in text
        assert "same call" in text
        assert statuses(store) == ["settled"] * 2 + ["failed"] * 2 + ["settled"] * 2
        np.testing.assert_array_equal(found["fragile"], [1.0, 1.2, np.nan, np.nan, 1.8, 2.0])
        assert json.loads(found.attrs["failures"]) == {"1": "RuntimeError: no such luck"}
        assert found.attrs["summary"] == text

    measure.flag.unlink()
    measure.calls.clear()
    small_map(store, **settings)
    assert measure.calls == [1.4, 1.6]
    assert_same_store(store, tmp_path / "whole")


def test_a_chunk_that_fails_once_is_no_failure(tmp_path):
    measure = Fragile(tmp_path / "flag")
    measure.flag.touch()

    def once(curve):
        try:
            return measure(curve)
        except RuntimeError:
            measure.flag.unlink()
            raise

    found = small_map(tmp_path / "map", measures={"once": once})
    assert measure.calls == [1.0, 1.2, 1.4, 1.6, 1.4, 1.6, 1.8, 2.0]
    np.testing.assert_array_equal(found["once"], np.linspace(1, 2, 6).round(6))
    assert "failed" not in statuses(tmp_path / "map")


def test_a_map_in_memory_keeps_what_did_not_fail(tmp_path):
    measure = Fragile(tmp_path)  # always there
    with pytest.warns(UserWarning, match="Chunk 1 at natural"):
        found = small_map(None, measures={"fragile": measure})
    np.testing.assert_array_equal(found["fragile"], [1.0, 1.2, np.nan, np.nan, 1.8, 2.0])


def test_lanes_already_whole_are_not_computed_again_nor_is_anything_written(tmp_path):
    measure = Fragile(tmp_path / "flag")
    store, settings = tmp_path / "map", {"measures": {"fragile": measure}}
    first = small_map(store, **settings).load()
    written = {p: p.stat().st_mtime_ns for p in store.rglob("*")}
    measure.calls.clear()
    again = small_map(store, **settings)
    assert measure.calls == []
    assert {p: p.stat().st_mtime_ns for p in store.rglob("*")} == written
    xarray.testing.assert_identical(first, again.load())


# ----------------------------------------------------------------------------- stores of others


def rewrite(store, **changed):
    """Change what a store says of the settings it was made with; their copy goes."""
    (Path(store) / "vibrojax" / "map.json").unlink()
    place = Path(store) / "zarr.json"
    whole = json.loads(place.read_text())
    settings = json.loads(whole["attributes"]["vibrojax_map"]) | changed
    whole["attributes"]["vibrojax_map"] = json.dumps(settings)
    place.write_text(json.dumps(whole))


def test_a_store_of_other_settings_is_refused_with_the_difference(tmp_path):
    store = tmp_path / "map"
    small_map(store)
    before = files_of(store)
    other = np.linspace(1.0, 2.0, 6)
    other[2] = 1.5
    refused = [
        ({"natural": other}, r"other settings. axes: natural: value 3 is 1.4 there, 1.5 now"),
        ({"natural": other[:5]}, r"other settings. axes: .*6 values there, 5 now"),
        ({"gap": 2e-3}, r"other settings. fixed: gap: nothing there, '0.002' now"),
        (
            {"frequency_ratio": [0.9, 1.0, 1.2]},
            r"other settings. frequency: values: value 3 is 1.1 there",
        ),
        (
            {"response": "sweep"},
            r"other settings. response: .*forward.* there, .* now",
        ),
        ({"measures": ["peak_frequency"]}, r"other settings. measures"),
        ({"keep_curves": True}, r"other settings. keep curves: False there, True now"),
        ({"gradients": ["natural"]}, r"other settings. gradients: 0 values there, 1 now"),
        ({"chunk_lanes": 3}, r"chunk_lanes = 3 makes chunks of shape \(3,\).*store has \(2,\)"),
    ]
    for settings, message in refused:
        with pytest.raises(ValueError, match=message):
            small_map(store, **settings)
    small_map(store, chunk_lanes=None)  # says nothing about the chunks
    assert files_of(store) == before


def test_a_rig_or_measure_of_the_same_name_that_does_something_else_is_refused(tmp_path):
    def call(gap, lowest):
        def rig(natural):
            return oscillator(natural, gap)

        settings = {"frequency_ratio": [0.9, 1.0, 1.1], "progress": False, "chunk_lanes": 2}
        response = vj.SweepSettings("forward", refine_jumps=None)
        measures = [lowest, "natural_frequency"]
        return vj.parameter_map(
            rig, natural=[1.0, 2.0], store=tmp_path / "map", measures=measures, response=response,
            **settings,
        )  # fmt: skip

    def lowest(curve):
        return curve["amplitude_ratio"].min()

    call(3e-3, lowest)
    with pytest.raises(
        ValueError, match=r"other settings. first rig: .*0.003.* there, .*0.002.* now"
    ):
        call(2e-3, lowest)

    def lowest(curve):
        return curve["peak_ratio"].min()

    with pytest.raises(
        ValueError, match=r"other settings. measures: lowest: .*amplitude.* there, .*peak"
    ):
        call(3e-3, lowest)


@pytest.mark.parametrize("name", ["vibrojax_version", "jax_version"])
def test_a_store_of_another_version_is_refused(tmp_path, name):
    store = tmp_path / "map"
    small_map(store)
    rewrite(store, **{name: "0.0.1"})
    with pytest.raises(
        ValueError, match=f"{name.replace('_', ' ')}: '0.0.1' there, .* Give another"
    ):
        small_map(store)


def test_a_store_of_another_format_is_refused(tmp_path):
    store = tmp_path / "map"
    small_map(store)
    rewrite(store, format=99, vibrojax_version="9.9", axes={})
    with pytest.raises(ValueError, match=r"has format 99 \(vibrojax 9.9\).*writes format 3"):
        small_map(store)


def foreign(kind, place):
    """Put something at a path that is no map."""
    if kind == "file":
        place.write_text("mine")
    elif kind == "folder":
        place.mkdir()
        (place / "notes.txt").write_text("mine")
    elif kind == "broken":
        place.mkdir()
        (place / "zarr.json").write_text("{")
    elif kind == "array":
        zarr.create_array(str(place), shape=3, dtype=float)[...] = 1.0
    else:
        # Xarray and others write groups without attributes.
        attributes = {"title": "mine"} if kind == "group with attributes" else {}
        group = zarr.create_group(str(place), attributes=attributes)
        group.create_array("mine", shape=3, dtype=float)[...] = 1.0


@pytest.mark.parametrize(
    "kind", ["file", "folder", "broken", "array", "group", "group with attributes"]
)
def test_what_is_no_map_is_refused_and_left_alone(tmp_path, kind):
    place = tmp_path / "place"
    foreign(kind, place)
    before = files_of(tmp_path)
    with pytest.raises(ValueError, match="is not a store of a map"):
        small_map(place)
    assert files_of(tmp_path) == before


def test_a_path_in_a_folder_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"the folder '.*nowhere' does not exist"):
        small_map(tmp_path / "nowhere" / "map")
    assert os.listdir(tmp_path) == []


def test_an_empty_folder_becomes_a_store(tmp_path):
    small_map(tmp_path / "whole")
    (tmp_path / "empty").mkdir()
    small_map(tmp_path / "empty")
    assert_same_store(tmp_path / "empty", tmp_path / "whole")
