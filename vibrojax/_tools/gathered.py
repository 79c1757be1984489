"""Functions that ask, each in a thread of its own: what all of them ask for is answered at once."""

import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from vibrojax._tools.interrupts import next_of

Request = TypeVar("Request")
Answer = TypeVar("Answer")
Result = TypeVar("Result")


class Stopped(Exception):
    """What a function hears that asks after the caller was interrupted, or an answer failed."""


def gathered(
    functions: Sequence[Callable[[Callable[[Request], Answer]], Result]],
    answer: Callable[[dict[int, Request]], dict[int, Answer]],
) -> "list[Future[Result]]":
    """Run functions that take a function to ask with; return their futures when all have ended.

    A function stops wherever it asks. When all that have not ended ask, the thread of the caller
    answers them together: `answer` takes what they ask for by their number and returns the answers.
    Where it raises, or an interrupt comes, the functions learn of it by `Stopped`, and it is raised
    when they have ended.
    """
    asked: queue.SimpleQueue[tuple[int, Any] | None] = queue.SimpleQueue()
    answers: list[queue.SimpleQueue[Any]] = [queue.SimpleQueue() for _ in functions]
    over = threading.Event()

    def run(k: int) -> Result:
        def ask(request: Request) -> Answer:
            if over.is_set():
                raise Stopped
            asked.put((k, request))
            kind, found = answers[k].get()
            if kind is Stopped:
                raise Stopped
            return found

        return functions[k](ask)

    with ThreadPoolExecutor(max(len(functions), 1)) as pool:
        futures: list[Future[Result]] = []
        try:
            for k in range(len(functions)):
                futures.append(pool.submit(run, k))
                futures[k].add_done_callback(lambda _: asked.put(None))
            running, waiting = len(futures), {}
            while running:
                message = next_of(asked)
                if message is None:
                    running -= 1
                else:
                    waiting[message[0]] = message[1]
                if waiting and len(waiting) == running:
                    given, waiting = waiting, {}
                    for k, found in answer(given).items():
                        answers[k].put((None, found))
        finally:
            over.set()
            for each in answers:
                each.put((Stopped, None))
    return futures
