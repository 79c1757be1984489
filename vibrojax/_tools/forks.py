"""Forked processes: JAX hangs there where the parent had started it, so they are refused."""

import os
import threading

import jax
import jax.monitoring

from vibrojax._tools.compiled import forget

_running = threading.Event()
"""Whether JAX has computed in this process."""
_hanging = threading.Event()
"""Whether it had in the process that this one was forked from: its threads are missing here."""


def _listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
    # Tracing comes before every compilation.
    if event.endswith("jaxpr_trace_duration") and _hanging.is_set():
        raise RuntimeError(
            "JAX cannot compute in a process that was forked after its parent had computed: its "
            'threads are missing here. Start processes with multiprocessing.get_context("spawn") '
            "(mp_context= of ProcessPoolExecutor), or give parameter_map a client= of "
            "dask.distributed."
        )
    if event.endswith("backend_compile_duration"):
        _running.set()


def _mark() -> None:
    if _running.is_set():
        _hanging.set()
        # So that what was compiled is traced again, and refused.
        forget()


jax.monitoring.register_event_duration_secs_listener(_listen)
if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_mark)
