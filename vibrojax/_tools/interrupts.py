"""Computing that Ctrl-C stops within seconds and without harm, whatever XLA is doing.

Inside JAX an interrupt may be lost (in its callback of the garbage collector), has to wait for a
program that runs, or leaves XLA compiling behind it, where an interpreter that ends crashes.
So what takes long is computed in threads of its own, to which no interrupt comes. The main thread
waits, which an interrupt ends at once; then the threads are stopped.
"""

import _thread
import atexit
import contextvars
import ctypes
import logging
import math
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from typing import Any, NoReturn, TypeVar

_hook_before = sys.unraisablehook


def _repeat_lost(lost: Any) -> None:
    """Interrupt again where a `KeyboardInterrupt` fell into a callback that can raise nothing."""
    if lost.exc_type is not KeyboardInterrupt:
        _hook_before(lost)
    elif threading.current_thread() is threading.main_thread():
        # A little later, so that it does not fall into the same callback.
        if hasattr(signal, "pthread_kill"):  # which wakes what sleeps
            again = partial(signal.pthread_kill, threading.get_ident(), signal.SIGINT)
        else:
            again = _thread.interrupt_main
        threading.Timer(0.05, again).start()


sys.unraisablehook = _repeat_lost

import jax  # noqa: E402  (long enough to be interrupted in)

Item = TypeVar("Item")
Result = TypeVar("Result")

PATIENCE = 2.0
"""Seconds that an interrupted call gives its threads to end, before it leaves them behind."""
GRACE = 0.02
"""Seconds that a thread gets to end by itself before it is interrupted at all."""
AGAIN = 0.5
"""Seconds after which a thread that has not ended is interrupted again."""
SETTINGS = (
    "default_device",
    "default_matmul_precision",
    "debug_nans",
    "debug_infs",
    "disable_jit",
    "log_compiles",
    "numpy_dtype_promotion",
    "numpy_rank_promotion",
)
"""Of JAX, which a `with` sets for one thread: those of the caller hold in its threads too."""


class _Worker(threading.Thread):
    """A thread that is interrupted in its work only, not while it begins or ends.

    It runs in the context of its caller.
    """

    def __init__(self, work: Callable[[], None]):
        context = contextvars.copy_context()
        super().__init__(target=context.run, args=(work,), daemon=True)
        self._lock, self._works = threading.Lock(), False

    def run(self) -> None:
        try:  # `suppress` would run lines of its own, in which the next one may come
            self._works = True
            super().run()
        except KeyboardInterrupt:
            pass
        try:
            with self._lock:
                self._works = False
            time.sleep(0)  # one that is on its way comes here
        except KeyboardInterrupt:
            self._works = False

    def interrupt(self) -> None:
        """Raise `KeyboardInterrupt` in its work; Python sees it when XLA returns."""
        with self._lock:
            if self._works:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    ctypes.c_ulong(self.ident or 0), ctypes.py_object(KeyboardInterrupt)
                )


_left: list[_Worker] = []
"""Threads of calls that were interrupted, until XLA lets go of them."""
_background: list[threading.Thread] = []
"""Threads that work in the background, and some that have ended."""
_cores = threading.Semaphore(os.cpu_count() or 1)
"""How many of them work at a time."""


def in_threads(
    function: Callable[[Item], Result], items: Iterable[Item], count: int = 1
) -> Generator[Result, None, None]:
    """Call a function for every item in so many threads; yield the results as they come.

    What the function raises is raised here. Close the iterator where it may be left early:
    `contextlib.closing`.
    """
    _stop(_left)  # two threads that compile take longer than one after the other
    waiting: queue.SimpleQueue[Item] = queue.SimpleQueue()
    for item in items:
        waiting.put(item)
    total = waiting.qsize()
    ended: queue.SimpleQueue[tuple[Any, BaseException | None]] = queue.SimpleQueue()
    over = threading.Event()
    settings = {name: getattr(jax.config, f"jax_{name}") for name in SETTINGS}

    def work() -> None:
        # An interrupt may come while the one before is being dealt with.
        with suppress(KeyboardInterrupt), ExitStack() as held:
            for name, value in settings.items():
                if getattr(jax.config, f"jax_{name}") != value:
                    held.enter_context(getattr(jax, name)(value))
            while not over.is_set():
                try:
                    item = waiting.get_nowait()
                except queue.Empty:
                    return
                try:
                    ended.put((function(item), None))
                except BaseException as error:
                    over.set()
                    ended.put((None, error))

    threads = [_Worker(work) for _ in range(min(count, total))]
    try:
        for thread in threads:
            thread.start()
        for _ in range(total):
            result, error = next_of(ended)
            if error is not None:
                raise error
            yield result
        for thread in threads:
            thread.join()
    finally:
        over.set()
        _left.extend(threads)
        _stop(_left, PATIENCE)


def in_background(function: Callable[[], Result]) -> "Future[Result]":
    """Call a function in the background, as many at once as there are cores; return its future."""
    future: Future[Result] = Future()

    def work() -> None:
        with _cores:
            try:
                future.set_result(function())
            except BaseException as error:
                future.set_exception(error)

    thread = _Worker(work)
    _background[:] = [*(other for other in _background if other.is_alive()), thread]
    thread.start()
    return future


def stoppable(function: Callable[..., Result], *arguments: Any, **keywords: Any) -> Result:
    """Call a function in a thread of its own, from which Ctrl-C frees the caller at once."""
    with closing(in_threads(lambda _: function(*arguments, **keywords), (None,))) as results:
        (result,) = results
    return result


def next_of(items: "queue.SimpleQueue[Result]") -> Result:
    """Wait for the next item of a queue, so that an interrupt can end it."""
    while True:
        # Not without end: on Windows nothing interrupts that.
        with suppress(queue.Empty):
            return items.get(timeout=0.2)


def _stop(threads: list[_Worker], patience: float = math.inf) -> None:
    """Interrupt threads until they have ended, and drop those that have from the list."""
    for thread in threads:
        thread.join(GRACE)
    until = time.monotonic() + patience
    while time.monotonic() < until:
        threads[:] = [thread for thread in threads if thread.is_alive()]
        if not threads:
            return
        for thread in threads:
            thread.interrupt()  # where it is lost, the next one is not
        threads[0].join(min(AGAIN, patience))


@atexit.register  # after those of JAX, so that it runs before them
def _let_xla_end() -> None:
    """End without the crash of an interpreter that goes while XLA compiles or computes.

    A program that an interrupt ends does so at once, any other one waits for XLA.
    """
    interrupted = getattr(sys, "last_type", None) is KeyboardInterrupt and not hasattr(sys, "ps1")
    if interrupted and (_left or _is_busy()):
        end_now(-signal.SIGINT)
    try:
        _stop(_left)
        for thread in _background:
            thread.join()
    except KeyboardInterrupt:
        end_now(-signal.SIGINT)


@contextmanager
def end_on_signals() -> Iterator[None]:
    """End this process within seconds of Ctrl-C or SIGTERM, with the exit codes of a shell.

    The block hears of it by `KeyboardInterrupt`, and ends the process when it ends. A second signal
    ends it at once.
    """
    codes: queue.SimpleQueue[int] = queue.SimpleQueue()
    called = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) != signal.SIG_IGN]

    def stop(number: int, frame: Any) -> NoReturn:
        if not codes.empty():
            end_now(128 + number)
        codes.put(128 + number)
        raise KeyboardInterrupt

    def insist() -> None:
        code = codes.get()
        codes.put(code)
        time.sleep(PATIENCE + 1)
        os._exit(code)

    threading.Thread(target=insist, daemon=True).start()
    for number in called:
        signal.signal(number, stop)
    try:
        yield
    finally:
        if not codes.empty():
            end_now(codes.get())


def end_now(code: int) -> NoReturn:
    """End the process with an exit code, or minus a signal's number: by that signal."""
    with suppress(Exception):
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
    if code < 0:
        signal.signal(-code, signal.SIG_DFL)
        signal.raise_signal(-code)
    os._exit(abs(code))


def _is_busy() -> bool:
    """Whether threads compute; XLA compiles in its own, also for one that was interrupted."""
    window, used = 0.05, time.process_time()
    time.sleep(window)
    return time.process_time() - used > 0.2 * window
