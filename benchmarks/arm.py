"""Speed of the arm's dynamics and of training on it: python benchmarks/arm.py [--json FILE] [--quick].

Microseconds per evaluation of the forward dynamics for both backends, compiled into the free run they are meant for (60
sequences, 605 samples, RK4: 145 200 evaluations), with value and gradient; Pinocchio alone; one PG-RSSNN epoch on 60 x
605 samples. One device, one thread; compile time apart; the median of interleaved repetitions.
"""

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false"
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])  # one core, or the threads would not be comparable

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.table import Table
from timing import medians

from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.model import build_model
from pgrssnn_jax.models.scaling import model_scaling
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.arms.tables import described, pinocchio_model
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, cast, record, take
from pgrssnn_jax.training.objective import MemberData, build_objective
from pgrssnn_jax.training.optimise import Fit
from pgrssnn_jax.training.settings import FitSettings

SEQUENCES, SAMPLES, JOINTS, STAGES = 60, 605, 6, 4


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments.add_argument("--quick", action="store_true", help="few repetitions: does it run?")
    chosen = arguments.parse_args()
    samples = 20 if chosen.quick else SAMPLES
    repeats = 2 if chosen.quick else 7
    free = {**free_runs(samples, repeats), **pinocchio_alone(repeats)}
    figures = {"free_run": free, "epoch": epochs(samples, repeats)}
    show(figures, samples)
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1) + "\n")


def torques(samples: int) -> np.ndarray:
    """Random motor torques of the measured size, Nm: they swing slowly, so that the arm moves within its limits."""
    rng = np.random.default_rng(0)
    wave = np.cumsum(rng.standard_normal((SEQUENCES, samples, JOINTS)), axis=1)
    wave -= np.linspace(0, 1, samples)[:, None] * wave[:, -1:]
    return wave / wave.std() * [2.8, 3.5, 3.6, 1.0, 1.4, 1.4]


def free_runs(samples: int, repeats: int) -> dict[str, dict[str, float]]:
    """µs per evaluation and seconds to compile, forward and with the gradient with respect to torques."""
    calls, compiled = {}, {}
    cases = [("jax", np.float32), ("jax", np.float64), ("pinocchio", np.float32), ("pinocchio", np.float64)]
    for backend, dtype in cases:
        with jax.enable_x64(dtype == np.float64):
            run, gradient, u = free_run(arm(backend=backend), torques(samples).astype(dtype))
            for what, function in (("forward", run), ("value and gradient", gradient)):
                name = f"{backend} {np.dtype(dtype).name}, {what}"
                started = time.perf_counter()
                call = function.lower(u).compile()
                compiled[name] = time.perf_counter() - started
                calls[name] = lambda call=call, u=u: call(u)
    evaluations = SEQUENCES * samples * STAGES
    found = medians(calls, repeats)
    return {name: {"us": 1e3 * ms / evaluations, "compile_s": compiled[name]} for name, ms in found.items()}


def free_run(physics: Physics, u: np.ndarray) -> tuple[Any, Any, jax.Array]:
    params = jax.tree.map(lambda p: jnp.asarray(p, u.dtype), physics.params)
    x0 = jnp.zeros((len(u), len(physics.states)), u.dtype)

    def simulate(u: jax.Array) -> jax.Array:
        def body(x: jax.Array, u_t: jax.Array) -> tuple[jax.Array, jax.Array]:
            x = jax.vmap(physics.step, (None, 0, 0))(params, x, u_t)
            return x, x

        return jax.lax.scan(body, x0, u)[1]

    squares = jax.value_and_grad(lambda u: jnp.sum(simulate(u)[..., :JOINTS] ** 2))
    return jax.jit(simulate), jax.jit(squares), jnp.asarray(u.swapaxes(0, 1))


def pinocchio_alone(repeats: int) -> dict[str, dict[str, float]]:
    """The C++ algorithm without JAX, at the same batch."""
    model = pinocchio_model(described("kuka_kr300"))
    pool = pin.ModelPool(model, 1)
    arrays = np.random.default_rng(0).uniform(-1, 1, (3, JOINTS, SEQUENCES))
    q, v, tau = (np.asfortranarray(a) for a in arrays)
    found = medians({"alone": lambda: [pin.abaInParallel(1, pool, q, v, tau) for _ in range(200)]}, repeats)
    return {"Pinocchio's C++ alone, forward": {"us": 1e3 * found["alone"] / 200 / SEQUENCES, "compile_s": 0.0}}


def epochs(samples: int, repeats: int) -> dict[str, dict[str, float]]:
    """Seconds per training epoch of one member on 60 sequences, from chunks of five epochs with one validation."""
    calls, compiled = {}, {}
    per_call = 5
    for gradient in ("stopped", "full"):
        fit, data = training(arm(physics_gradient=gradient), samples, per_call)
        state = jax.jit(fit.begin)(jax.random.key(0), data)
        started = time.perf_counter()
        call = jax.jit(fit.advance).lower(state, data).compile()
        compiled[gradient] = time.perf_counter() - started
        calls[gradient] = lambda call=call, state=state, data=data: call(state, data)
    found = medians(calls, max(2, repeats // 2))
    return {name: {"s": ms / 1e3 / per_call, "compile_s": compiled[name]} for name, ms in found.items()}


def training(physics: Physics, samples: int, per_call: int) -> tuple[Fit, MemberData]:
    """The published networks (64 units, three layers) on a random record of the system's shape."""
    spec = ModelSpec(hidden=64, gru_layers=3)
    model = build_model(spec, physics)
    train = robot_record(physics, samples)
    scaling = jax.tree.map(np.float32, model_scaling(model, train))
    data = MemberData(train, take(train, np.arange(6)), scaling, np.asarray(10**6, np.int32))
    settings = FitSettings(validate_every=per_call, chunk_epochs=per_call, patience=10**6)
    return Fit(build_objective(model, InitialState()), settings), data


def robot_record(physics: Physics, samples: int) -> Record:
    info = RecordInfo(
        tuple(Channel(s.name, s.unit) for s in physics.inputs),
        tuple(Channel(s.name, s.unit) for s in physics.outputs),
        physics.dt,
        "simulated",
    )
    y = np.random.default_rng(1).uniform(-0.5, 0.5, (SEQUENCES, samples, JOINTS))
    return cast(record(torques(samples), y, info), np.float32)


def show(figures: dict[str, Any], samples: int) -> None:
    console = Console(width=110)
    table = Table(title=f"arm: {SEQUENCES} sequences of {samples} samples, RK4, one core", title_justify="left")
    for column in ("what", "figure", "unit"):
        table.add_column(column, justify="right" if column == "figure" else "left")
    for name, found in figures["free_run"].items():
        compiled = f" (compiled in {found['compile_s']:.1f} s)" if found["compile_s"] else ""
        table.add_row(name, f"{found['us']:.2f}", f"µs per evaluation{compiled}")
    for name, found in figures["epoch"].items():
        compiled = f"s (compiled in {found['compile_s']:.1f} s)"
        table.add_row(f"PG-RSSNN epoch, gradient {name}", f"{found['s']:.3f}", compiled)
    console.print(table)


if __name__ == "__main__":
    main()
