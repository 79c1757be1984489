"""Workers on this machine, one core each, and what they took."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def local_client(workers: int) -> Iterator[Any]:
    """Give a client with so many worker processes, each held to one core; None for one worker."""
    if workers == 1:
        yield None
        return
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        client.wait_for_workers(workers)
        client.run(_one_core)
        yield client


def _one_core(dask_worker: Any = None) -> None:
    # XLA would otherwise take all cores for every worker.
    cores = sorted(os.sched_getaffinity(0))
    number = int(str(dask_worker.name)) if str(dask_worker.name).isdecimal() else 0
    os.sched_setaffinity(0, {cores[number % len(cores)]})


def peak_bytes() -> int:
    """Most memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def processor_seconds() -> float:
    """Processor time of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def taken(client: Any) -> dict[str, Any]:
    """Peak memory and processor time of this process and of each worker."""
    there = client.run(lambda: (peak_bytes(), processor_seconds())) if client else {}
    return {
        "peak_megabytes_here": round(peak_bytes() / 1e6),
        "peak_megabytes_of_workers": [round(size / 1e6) for size, _ in there.values()],
        "processor_seconds_here": round(processor_seconds(), 1),
        "processor_seconds_of_workers": [round(seconds, 1) for _, seconds in there.values()],
    }
