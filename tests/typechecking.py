"""The type checker of the tests: beartype, once for each signature.

jaxtyping gives the checker an empty function with the signature of the one to be checked, and does so again whenever a
function inside of another is made. Effects and physics consist of such functions: without the memory below, half of
the time of some tests goes into writing the same checks again.
"""

from collections.abc import Callable, Hashable
from typing import Any

from beartype import beartype

_known: dict[Hashable, Any] = {}


def checked(empty: Callable) -> Callable:
    """Beartype's checks of this signature. Code objects are equal where names, kinds and order of parameters are."""
    defaults = (empty.__defaults__ or (), empty.__kwdefaults__ or {})
    signature = (
        empty.__module__, empty.__qualname__, empty.__code__, tuple(empty.__annotations__.items()), *map(len, defaults),
    )  # fmt: skip
    try:
        hash(signature)
    except TypeError:  # an annotation without one
        return beartype(empty)
    if signature not in _known:
        _known[signature] = beartype(empty)
    return _known[signature]
