"""Members, horizons, precisions, routes and mappings of a system, one after another."""

from typing import Any

import jax
import numpy as np

from pgrssnn_jax.training.members import MemberMapping

from .cases import SYSTEMS, usual_route
from .goals import XLA
from .measure import Figures, epoch_case, measured, rollout_case

MEMBERS, HORIZONS = (1, 10, 50, 200), (64, 605, 1024, 5000, 100_000)
_MOST_MB = 2500.0  # a program of the whole record that needs more is left to the one in chunks


def grid_part(name: str, dtype: Any, *, quick: bool) -> Figures:
    """Epochs by members and rollouts by horizon, in one precision; the arm trains one member."""
    system = SYSTEMS[name]
    repeats = 2 if quick else 5
    with jax.enable_x64(dtype == np.float64):
        physics = system.physics()
        found: Figures = {}
        for members in MEMBERS[:1] if quick or name == "arm" else MEMBERS:
            epochs = max(1, (20 if name != "arm" else 2) // members)
            case = epoch_case(system, physics, members, epochs=epochs, dtype=dtype)
            found |= measured({f"epoch, members {members}": case}, max(2, repeats // (1 + members // 20)))
        sequences = system.run[0]
        for horizon in HORIZONS[:2] if quick else HORIZONS:
            cases = {
                f"rollout, {sequences} x {horizon}{how}": rollout_case(
                    system, physics, sequences, horizon, dtype=dtype, chunk=chunk
                )
                for how, chunk in {"": "auto", ", all samples at once": None}.items()
            }
            kept = {key: one for key, one in cases.items() if one.program and one.program.memory_mb < _MOST_MB}
            found |= measured(kept, repeats if horizon < HORIZONS[-1] else 2)
            for key in cases.keys() - kept.keys():
                program = cases[key].program
                found[key] = {"memory_mb": program.memory_mb if program else None}
    return found


def mappings_part(*, quick: bool) -> Figures:
    """The routes of a rollout, and members mapped in every way, by XLA and by the C++ kernels."""
    found: Figures = {}
    for name in ("tanks", "lgssm"):
        system, size = SYSTEMS[name], SYSTEMS[name].run
        size = (size[0], size[1] // 20) if quick else size
        physics = system.physics()
        routes = {
            f"{name} rollout, {route}": rollout_case(system, physics, *size, route=route)
            for route in ("fused", "split", usual_route(np.float32))
            if route
        }
        found |= measured(routes, 2 if quick else 9)
        mappings = {
            f"{name} epoch, {system.members} members, {how}{f' of {batch}' if batch else ''}, {n} device(s){form}": (
                MemberMapping(how, batch, n),
                route,
            )
            for form, route in {XLA: None, "": usual_route(np.float32)}.items()
            for n in sorted({1, jax.device_count()})
            for how, batch in (("vmap", None), ("vmap", 5), ("loop", None))
        }
        epochs = {
            key: epoch_case(system, physics, system.members, mapping=mapping, route=route)
            for key, (mapping, route) in list(mappings.items())[: 1 if quick else None]
        }
        found |= measured(epochs, 2 if quick else 5)
    return found
