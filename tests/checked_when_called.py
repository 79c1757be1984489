"""The checker of annotations, made for a function when that is first called.

Making all of them takes each process of pytest three seconds, and a test calls few. Walks along
branches call some a hundred thousand times, of which the first are enough.
"""

import sys
from functools import wraps
from inspect import getattr_static
from typing import no_type_check

from beartype import beartype

ENOUGH = 300
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
            if calls == ENOUGH + 1:
                leave_alone(function.__module__, function.__qualname__)
            return None  # jaxtyping wants no answer
        if made is None:
            made = beartype(function)
        return made(*args, **kwargs)

    return call


def leave_alone(module, name):
    """Let jaxtyping call a function without looking at what it is called with."""
    found = sys.modules[module]
    for part in name.split("."):
        found = getattr_static(found, part, None)
        for inner in ("fget", "func", "__func__", "method"):  # of descriptors
            found = getattr(found, inner, found)
    while found is not None:
        if callable(found) and not isinstance(found, type):
            no_type_check(found)
        found = getattr(found, "__wrapped__", None)
