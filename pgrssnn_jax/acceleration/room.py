"""Room for compiled programs. A Linux process may map so many pieces of memory, XLA maps hundreds for every discovery,
and LLVM ends the process that asks for more: about the sixtieth discovery of a loop."""

from pathlib import Path

import jax

_MAPS, _MOST = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
_FULL = 0.5  # part of what the system allows: one discovery takes 3 % of 65,530


def make_room() -> bool:
    """Drops all compiled programs where they fill half of the room; they are read from the cache folder or compiled
    again when next called."""
    full = _full()
    if full:
        jax.clear_caches()
    return full


def _full() -> bool:
    """False where the system does not tell."""
    try:
        most = int(_MOST.read_text())
        with _MAPS.open("rb") as lines:
            return sum(1 for _ in lines) > _FULL * most
    except (OSError, ValueError):
        return False
