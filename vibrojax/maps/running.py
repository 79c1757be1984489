"""Running the blocks of a map: here, on every device of this host, or on a cluster."""

import itertools
import os
import pickle
import queue
import threading
import uuid
from collections.abc import Generator
from typing import Any, NamedTuple

import jax

from vibrojax._tools.interrupts import in_threads
from vibrojax.maps.store import MapStore
from vibrojax.maps.store_files import StoreFull, StoreReadOnly
from vibrojax.maps.work import MapSpec, MapWork

AHEAD = 4
"""Blocks that wait at each worker of a cluster."""


class Outcome(NamedTuple):
    """How a block ended."""

    number: int
    failure: str | None
    """What went wrong, twice; None where the block is whole."""


def attempt(work: MapWork, store: MapStore, number: int) -> Outcome:
    """Compute a block and write it; once more where that fails.

    Raises `StoreFull`, `StoreReadOnly`, which trying again would not mend.
    """
    failure = ""
    for _ in range(2):
        try:
            block, values = work.compute(number)
            store.write(block, values, work.rigs(number))
        except (StoreFull, StoreReadOnly):
            raise
        except Exception as error:
            failure = f"{type(error).__name__}: {error}"
        else:
            return Outcome(number, None)
    store.mark_failed(work.spec.chunks.at(number))
    return Outcome(number, failure)


class _Devices:
    """The devices of this host, each lent to one thread at a time."""

    def __init__(self) -> None:
        self.free: queue.SimpleQueue[Any] = queue.SimpleQueue()
        for device in jax.local_devices():
            self.free.put(device)

    def attempt(self, work: MapWork, store: MapStore, number: int) -> Outcome:
        """Run a block on a device that is free."""
        device = self.free.get()
        try:
            with jax.default_device(device):
                return attempt(work, store, number)
        finally:
            self.free.put(device)


def run_here(spec: MapSpec, store: MapStore, numbers: list[int]) -> Generator[Outcome, None, None]:
    """Run blocks in this process, one at a time on each of its devices."""
    work, count = MapWork(spec), len(jax.local_devices())
    run = attempt if count == 1 else _Devices().attempt
    return in_threads(lambda number: run(work, store, number), numbers, count)


_opened: dict[str, tuple[MapWork, MapStore, _Devices]] = {}
_opening = threading.Lock()


def _attempt_there(run: str, pickled: bytes, path: str, number: int) -> Outcome:
    """Run a block on a worker of a cluster, which keeps what it has opened for all of a run."""
    with _opening:
        if run not in _opened:
            _opened.clear()
            spec: MapSpec = pickle.loads(pickled)
            _opened[run] = MapWork(spec), MapStore(path, spec), _Devices()
        work, store, devices = _opened[run]
    return devices.attempt(work, store, number)


def run_on_cluster(
    spec: MapSpec, path: str, numbers: list[int], client: Any, store: MapStore
) -> Generator[Outcome, None, None]:
    """Run blocks as tasks of a `dask.distributed` client; workers write their own regions."""
    import cloudpickle
    from distributed import as_completed as completed

    run = uuid.uuid4().hex
    task = run, cloudpickle.dumps(spec), os.path.abspath(path)
    waiting = iter(numbers)
    workers = max(1, sum(client.nthreads().values()))
    number_of: dict[str, int] = {}

    def submit(number: int) -> Any:
        key = f"vibrojax-map-{run}-{number}"
        number_of[key] = number
        return client.submit(_attempt_there, *task, number, key=key, pure=False)

    first = [submit(n) for n in itertools.islice(waiting, AHEAD * workers)]
    ended = completed(first)
    try:
        for future in ended:
            number, error = number_of.pop(future.key), future.exception()
            if isinstance(error, StoreFull | StoreReadOnly):
                raise error
            if error is None:
                yield future.result()
            else:  # its workers died again and again
                store.mark_failed(spec.chunks.at(number))
                yield Outcome(number, f"{type(error).__name__}: {error}")
            following = next(waiting, None)
            if following is not None:
                ended.add(submit(following))
    finally:
        client.cancel([f for f in ended.futures], force=True)
