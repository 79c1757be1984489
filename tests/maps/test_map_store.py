"""Who may write to the store of a map: one process at a time, and only where it can be written."""

import errno
import json
import os
import shutil
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import pytest
import xarray
from map_program import make_map
from test_map_interrupted import assert_same_store, files_of, start, wait_until

import vibrojax as vj
from vibrojax.maps import lock
from vibrojax.maps.lock import held
from vibrojax.maps.work import MapWork

HOLDER = """
import sys, time
from pathlib import Path
from vibrojax.maps.lock import held
with held(Path(sys.argv[1]), "map"):
    print("held", flush=True)
    time.sleep(3600)  # until it is killed
"""


def small_map(store, **more):
    few = {"measures": ["natural_frequency"], "keep_curves": False, "chunk_lanes": 2}
    return make_map(store, 4, **(few | more))


@pytest.fixture
def computing(monkeypatch):
    """Fails where something is computed."""

    def never(*_):
        raise AssertionError("this was to be noticed before")

    return lambda: monkeypatch.setattr(MapWork, "compute", never)


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the lock of a store."""
    (tmp_path / "map" / "vibrojax").mkdir(parents=True)
    file = tmp_path / "map" / "vibrojax" / "lock"
    process = subprocess.Popen([sys.executable, "-c", HOLDER, str(file)], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"held\n"
    yield process
    process.kill()
    process.communicate()


# ----------------------------------------------------------------------------- two processes


def test_the_second_process_says_who_has_the_store(tmp_path, holder, computing):
    message = (
        rf"map' is being written by process {holder.pid} on \S+, since 20.*repeat the same call"
    )
    with pytest.raises(vj.maps.StoreInUse, match=message) as error:
        small_map(tmp_path / "map")
    assert error.value.__suppress_context__
    assert error.value.errno == errno.EBUSY


def test_a_lock_ends_with_its_process(tmp_path, holder):
    small_map(tmp_path / "whole")
    holder.kill()
    holder.wait()
    assert (tmp_path / "map" / "vibrojax" / "lock").exists()
    small_map(tmp_path / "map")
    assert_same_store(tmp_path / "map", tmp_path / "whole")
    assert not (tmp_path / "map" / "vibrojax" / "lock").exists()


def test_a_lock_left_in_a_complete_store_is_removed(tmp_path):
    small_map(tmp_path / "map")
    before = files_of(tmp_path / "map")
    (tmp_path / "map" / "vibrojax" / "lock").write_text("{")
    small_map(tmp_path / "map")
    assert files_of(tmp_path / "map") == before


@pytest.mark.filterwarnings("ignore:wait. inside")  # events cannot be read
def test_a_second_thread_is_refused_too(tmp_path):
    inside, leave = threading.Event(), threading.Event()

    def wait(curve):
        inside.set()
        leave.wait(60)
        return 1.0

    thread = threading.Thread(target=small_map, args=(tmp_path / "map",), kwargs={"measures": wait})
    thread.start()
    try:
        assert inside.wait(120)
        with pytest.raises(vj.maps.StoreInUse, match=f"process {os.getpid()} on"):
            small_map(tmp_path / "map", measures=wait)
        with xarray.open_zarr(tmp_path / "map") as found:  # reading is for all
            assert (found["lane_status"] == 4).all()
    finally:
        leave.set()
        thread.join()
    small_map(tmp_path / "map", measures=wait)


def test_a_complete_map_is_read_while_another_process_has_the_store(tmp_path, computing):
    first = small_map(tmp_path / "map")
    computing()
    with held(tmp_path / "map" / "vibrojax" / "lock", "map"):
        xarray.testing.assert_identical(first, small_map(tmp_path / "map"))


def test_of_many_that_start_at_once_one_has_it(tmp_path):
    # Again and again: the file of the lock comes and goes meanwhile.
    states = []

    def take():
        for _ in range(50):
            try:
                with held(tmp_path / "lock", "map"):
                    states.append("held")
                    time.sleep(1e-4)
                    states.append("free")
            except vj.maps.StoreInUse:
                pass

    threads = [threading.Thread(target=take) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert states == ["held", "free"] * (len(states) // 2)
    assert len(states) >= 2
    assert not (tmp_path / "lock").exists()


@pytest.mark.slow
def test_two_programs_that_start_one_store(tmp_path):
    environment = dict(os.environ)
    first = start(tmp_path / "map", environment, MAP_PAUSE="60")  # it ends when it is killed
    try:
        assert wait_until((tmp_path / "map" / "vibrojax" / "lock").exists, first)
        second = start(tmp_path / "map", environment)
        _, errors = second.communicate(timeout=240)
    finally:
        first.kill()
        first.communicate()
    assert second.returncode == 1
    assert f"is being written by process {first.pid} on" in errors.rstrip().splitlines()[-1]


class NoLocks:
    """A file system that knows no locks, as some of clusters."""

    LOCK_EX = LOCK_NB = 0

    @staticmethod
    def flock(descriptor, _):
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))


@pytest.mark.parametrize("system", [NoLocks, None])
def test_without_locks_of_the_system_the_file_is_the_lock(tmp_path, monkeypatch, system):
    monkeypatch.setattr(lock, "fcntl", system)
    file = tmp_path / "lock"
    with held(file, "map"):
        message = rf"process {os.getpid()} on .*If it has ended, remove .*lock"
        with pytest.raises(vj.maps.StoreInUse, match=message), held(file, "map"):
            pass
        assert file.exists()
    assert not file.exists()
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    owner = json.loads('{"host": "", "since": "today"}') | {"process": ended.pid}
    file.write_text(json.dumps(owner))
    with pytest.raises(vj.maps.StoreInUse, match="remove"), held(file, "map"):
        pass  # of another host nothing is known
    if system is not None:
        file.write_text(json.dumps(owner | {"host": lock.socket.gethostname()}))
        with held(file, "map"):
            pass


# ----------------------------------------------------------------------- read-only stores


@pytest.fixture
def read_only(monkeypatch):
    """Function that makes a folder one that cannot be written, in one of three ways."""

    def protect(folder, way):
        def refused(path):
            return str(path).startswith(str(folder))

        def error(path):
            number = errno.EACCES if way == "rights" else errno.EROFS
            return OSError(number, os.strerror(number), str(path))

        real = {"open": os.open, "mkdir": os.mkdir, "access": os.access}

        def opened(path, flags, *more, **named):
            if refused(path) and flags & (os.O_WRONLY | os.O_RDWR):
                raise error(path)
            return real["open"](path, flags, *more, **named)

        def made(path, *more, **named):
            if refused(path):
                raise FileExistsError(path) if Path(path).exists() else error(path)
            return real["mkdir"](path, *more, **named)

        if way == "asked":  # such as a folder of somebody else inside
            monkeypatch.setattr(
                os, "access", lambda p, mode: not refused(p) and real["access"](p, mode)
            )
        elif way == "zarr":
            from zarr.storage import _local

            def put(path, *_, **__):
                raise error(path)

            monkeypatch.setattr(_local, "_put", put)
        else:
            monkeypatch.setattr(os, "open", opened)
            monkeypatch.setattr(os, "mkdir", made)

    return protect


WAYS = ["system", "rights", "asked", "zarr"]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("begun", [False, True])
def test_a_store_that_cannot_be_written_is_noticed_before_computing(
    tmp_path, read_only, computing, way, begun
):
    store = tmp_path / "map"
    if begun:
        small_map(store)
        shutil.rmtree(store / "vibrojax" / "chunks")
    computing()
    read_only(store, way)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(vj.maps.StoreReadOnly, match=r"cannot be written \(.*give another path"):
            small_map(store)


@pytest.mark.parametrize("way", WAYS)
def test_a_complete_store_that_cannot_be_written_is_returned(tmp_path, read_only, computing, way):
    first = small_map(tmp_path / "map")
    computing()
    read_only(tmp_path / "map", way)
    xarray.testing.assert_identical(first, small_map(tmp_path / "map"))


def test_a_store_that_can_no_longer_be_written_ends_the_map(tmp_path, read_only, monkeypatch):
    # Not chunk after chunk computed in vain.
    computed = []
    compute = MapWork.compute

    def noted(self, number):
        computed.append(number)
        if number == 1:
            read_only(tmp_path / "map", "zarr")
        return compute(self, number)

    monkeypatch.setattr(MapWork, "compute", noted)
    with pytest.raises(vj.maps.StoreReadOnly, match="cannot be written"):
        make_map(
            tmp_path / "map", 6, measures=["natural_frequency"], keep_curves=False, chunk_lanes=2
        )
    assert computed == [0, 1]


def test_a_store_without_the_right_to_write(tmp_path, computing):
    if os.name == "nt" or os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    small_map(tmp_path / "map")
    shutil.rmtree(tmp_path / "map" / "vibrojax" / "chunks")
    computing()
    (tmp_path / "map" / "lane_status").chmod(0o500)
    with pytest.raises(vj.maps.StoreReadOnly, match=r"lane_status' cannot be written \(Permission"):
        small_map(tmp_path / "map")
    (tmp_path / "map" / "lane_status").chmod(0o700)
