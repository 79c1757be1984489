"""The checker of annotations, made for a function when that is first called.

Making all of them takes each process of pytest three seconds, and a test calls few.
"""

from functools import wraps

from beartype import beartype


def checked(function):
    """Check the arguments of a function, or the fields of a class, as beartype does."""
    if isinstance(function, type):
        return beartype(function)
    made = None

    @wraps(function)
    def call(*args, **kwargs):
        nonlocal made
        if made is None:
            made = beartype(function)
        return made(*args, **kwargs)

    return call
