"""The type checker of the tests."""

from collections.abc import Callable

from beartype import beartype


def checked(function: Callable) -> Callable:
    """Beartype's, but for functions that are made inside of others: it would prepare them each time that they are made,
    which took a third of the time of all fast tests. The arrays they pass on are checked by their callers."""
    return function if "<locals>" in function.__qualname__ else beartype(function)
