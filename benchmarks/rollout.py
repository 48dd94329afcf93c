"""Speed of rollouts and training epochs: python benchmarks/rollout.py [--json FILE] [--quick].

Fused against split, members by `vmap`, one after another, in sub-batches and over devices, forward throughput in
steps per second, peak memory. Compile time apart; the median of interleaved repetitions, because machines are shared.
"""

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table
from timing import medians

from pgrssnn_jax.acceleration.devices import keep_compiled, use_all_cores
from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.model import build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.scaling import model_scaling
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.record import Channel, RecordInfo, cast, record, windows
from pgrssnn_jax.training.members import Member, MemberMapping, choose_mapping, keys_of, map_members, repeat
from pgrssnn_jax.training.objective import MemberData, build_objective
from pgrssnn_jax.training.optimise import Fit
from pgrssnn_jax.training.settings import FitSettings


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments.add_argument("--quick", action="store_true", help="few repetitions: does it run?")
    chosen = arguments.parse_args()
    use_all_cores()
    keep_compiled()
    repeats = 3 if chosen.quick else 40
    figures = {
        "devices": [str(device) for device in jax.devices()],
        "tanks": tanks_case(repeats),
        "lgssm": lgssm_case(max(3, repeats // 4)),
    }
    in_kilobytes = 1024 if sys.platform == "darwin" else 1  # macOS counts bytes
    figures["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / in_kilobytes / 1024
    show(figures)
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1) + "\n")


def tanks_case(repeats: int) -> dict[str, Any]:
    """768 steps, one sequence, 1 and 10 members."""
    physics = cascaded_tanks()
    data = member_data(physics, time=768, window=None)
    return {
        "shape": "1 sequence of 768 steps",
        "routes": routes(physics, data, repeats),
        "epoch_ms": {
            **epochs(physics, data, 1, [MemberMapping()], repeats),
            **epochs(physics, data, 10, candidates(), repeats),
        },
        "chosen": {
            "1": str(choose_mapping(1, 1, jax.device_count())),
            "10": str(choose_mapping(10, 1, jax.device_count())),
        },
        "steps_per_second": throughput(physics, sequences=1, steps=1024, repeats=repeats),
    }


def lgssm_case(repeats: int) -> dict[str, Any]:
    """31 windows of 64 steps, 50 members."""
    physics = lgssm()
    data = member_data(physics, time=2000, window=64)
    return {
        "shape": "31 sequences of 64 steps",
        "routes": routes(physics, data, repeats),
        "epoch_ms": epochs(physics, data, 50, candidates(), repeats),
        "chosen": {"50": str(choose_mapping(50, 31, jax.device_count()))},
        "steps_per_second": throughput(physics, sequences=50, steps=5000, repeats=repeats),
    }


def candidates() -> list[MemberMapping]:
    devices = sorted({1, jax.device_count()})
    return [
        MemberMapping(how, batch, n) for n in devices for how, batch in (("vmap", None), ("vmap", 5), ("loop", None))
    ]


def member_data(physics: Physics, time: int, window: int | None) -> MemberData:
    """A random record of the system's shape: speed does not depend on the numbers."""
    rng = np.random.default_rng(0)
    info = RecordInfo(
        tuple(Channel(s.name, s.unit) for s in physics.inputs),
        tuple(Channel(s.name, s.unit) for s in physics.outputs),
        physics.dt,
        "simulated",
    )
    whole = cast(record(rng.uniform(1, 4, (time, 1)), rng.uniform(1, 9, (time, 1)), info), np.float32)
    train = windows(whole, window) if window else whole
    scaling = jax.tree.map(np.float32, model_scaling(build_model(ModelSpec(), physics), train))
    return MemberData(train, whole, scaling, np.asarray(10**6, np.int32))


def routes(physics: Physics, data: MemberData, repeats: int) -> dict[str, float]:
    """Value and gradient of one member by both routes, in ms, measured in turn."""
    model = build_model(ModelSpec(), physics)
    calls: dict[str, Callable[[], Any]] = {}
    for route in ("fused", "split"):
        objective = build_objective(model, InitialState(), route=route)
        theta = objective.begin(jax.random.key(0), data)
        gradient = jax.jit(jax.value_and_grad(lambda theta, o=objective: o.on_train(theta, data).total))
        calls[route] = lambda gradient=gradient, theta=theta: gradient(theta)
    found = {f"{name}_ms": ms for name, ms in medians(calls, repeats).items()}
    return {**found, "speedup": found["fused_ms"] / found["split_ms"]}


def epochs(
    physics: Physics, data: MemberData, count: int, mappings: list[MemberMapping], repeats: int
) -> dict[str, dict[str, float]]:
    """One training epoch with its update, all members, in ms, from chunks of 20 epochs with one validation."""
    per_call = 20
    settings = FitSettings(validate_every=per_call, chunk_epochs=per_call, patience=10**6)
    fit = Fit(build_objective(build_model(ModelSpec(), physics), InitialState()), settings)
    members = repeat(data, count)
    calls, seconds = {}, {}
    for mapping in mappings:
        size = f" of {mapping.sub_batch}" if mapping.sub_batch else ""
        name = f"{count} members, {mapping.how}{size}, {mapping.devices} device(s)"
        state = jax.jit(map_members(fit.begin, mapping))(keys_of([Member(i, 0) for i in range(count)]), members)
        started = time.perf_counter()
        advance = jax.jit(map_members(fit.advance, mapping)).lower(state, members).compile()
        seconds[name] = time.perf_counter() - started
        calls[name] = lambda advance=advance, state=state: advance(state, members)
    found = medians(calls, max(3, repeats // 4))
    return {name: {"ms": ms / per_call, "compile_s": seconds[name]} for name, ms in found.items()}


def throughput(physics: Physics, *, sequences: int, steps: int, repeats: int) -> dict[str, float]:
    """Sample-steps per second of a free run without gradients, one member."""
    data = member_data(physics, time=steps, window=None)
    objective = build_objective(build_model(ModelSpec(), physics), InitialState())
    params = objective.assemble(objective.begin(jax.random.key(0), data), data.scaling)
    u = jnp.broadcast_to(jnp.asarray(data.train.u), (sequences, steps, 1))
    x0 = jnp.zeros((sequences, objective.model.n_x))
    calls = {}
    for route in ("fused", "split"):
        run = jax.jit(lambda u, route=route: rollout(objective.model, params, u, x0, route=route).y)
        calls[route] = lambda run=run: run(u)
    return {name: sequences * steps / (ms / 1e3) for name, ms in medians(calls, repeats).items()}


def show(figures: dict[str, Any]) -> None:
    console = Console(width=110)
    for system in ("tanks", "lgssm"):
        found = figures[system]
        table = Table(title=f"{system}: {found['shape']}", title_justify="left")
        for column in ("what", "figure", "unit"):
            table.add_column(column, justify="right" if column == "figure" else "left")
        for name in ("fused", "split"):
            table.add_row(f"value and gradient, {name}", f"{found['routes'][f'{name}_ms']:.2f}", "ms")
        table.add_row("split over fused", f"{found['routes']['speedup']:.2f}", "times faster")
        for name, epoch in found["epoch_ms"].items():
            table.add_row(f"epoch, {name}", f"{epoch['ms']:.2f}", f"ms (compiled in {epoch['compile_s']:.1f} s)")
        for name, rate in found["steps_per_second"].items():
            table.add_row(f"free run, {name}", f"{rate:,.0f}", "sample-steps/s")
        console.print(table)
    console.print(f"devices: {', '.join(figures['devices'])}   peak memory {figures['peak_memory_mb']:.0f} MB")


if __name__ == "__main__":
    main()
