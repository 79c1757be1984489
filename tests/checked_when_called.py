"""The checker of annotations, made for a function when that is first called.

Making all of them takes each process of pytest three seconds, and a test calls few. Walks along
branches call some a hundred thousand times, of which the first are enough.
"""

from functools import wraps

from beartype import beartype

ENOUGH = 1000
"""Calls of a function that are checked in a process."""


def checked(function):
    """Check the arguments of a function, or the fields of a class, as beartype does."""
    if isinstance(function, type):
        return beartype(function)
    made, calls = None, 0

    @wraps(function)
    def call(*args, **kwargs):
        nonlocal made, calls
        calls += 1
        if calls > ENOUGH:
            return None  # jaxtyping wants no answer
        if made is None:
            made = beartype(function)
        return made(*args, **kwargs)

    return call
