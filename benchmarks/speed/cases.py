"""The systems whose speed is measured, each at the size at which the paper trains it: records, rollouts, epochs.

Records are random numbers of the right size: speed does not depend on them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.acceleration.native import missing_kernels
from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.model import Model, ModelParams, build_model
from pgrssnn_jax.models.rollout import Route, rollout
from pgrssnn_jax.models.scaling import model_scaling
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.record import Channel, RecordInfo, cast, record, take, windows
from pgrssnn_jax.training.members import Member, MemberMapping, choose_mapping, jit_members, keys_of, repeat
from pgrssnn_jax.training.objective import MemberData, build_objective
from pgrssnn_jax.training.optimise import Fit
from pgrssnn_jax.training.plan import sharing_devices
from pgrssnn_jax.training.settings import FitSettings

ARM_SEQUENCES, ARM_SAMPLES, STAGES = 60, 605, 4  # stages: evaluations of the arm's dynamics per sample (RK4)


class System(NamedTuple):
    """train: sequences and samples of an epoch; run: those of a rollout; stages: evaluations of the physics per sample
    that wait for each other; members: how many an experiment trains at once."""

    name: str
    physics: Callable[..., Physics]
    spec: ModelSpec
    train: tuple[int, int]
    run: tuple[int, int]
    members: int
    stages: int = 1


SYSTEMS = {
    "tanks": System("tanks", cascaded_tanks, ModelSpec(), (1, 768), (1, 1024), 10),
    "lgssm": System("lgssm", lgssm, ModelSpec(), (31, 64), (50, 5000), 50),
    "arm": System("arm", arm, ModelSpec(hidden=64, gru_layers=3), (60, 605), (6, 605), 10, STAGES),
}


def usual_route(dtype: Any) -> Route | None:
    """The route that own data takes: the C++ kernels, where there is a compiler, in single precision."""
    return "native" if np.dtype(dtype) == np.float32 and missing_kernels() is None else None


def training(
    system: System,
    physics: Physics,
    *,
    samples: int | None = None,
    epochs: int = 20,
    dtype: Any = np.float32,
    route: Route | None = None,
    alone: bool = False,
) -> tuple[Fit, MemberData]:
    """One member and a chunk of `epochs` epochs with one validation; alone: devices may share its sequences."""
    sequences, length = system.train
    data = member_data(system, physics, sequences, samples or length, dtype)
    settings = FitSettings(validate_every=epochs, chunk_epochs=epochs, patience=10**6)
    objective = build_objective(build_model(system.spec, physics), InitialState(), route=route)
    if alone and route == "native":
        objective = objective._replace(devices=sharing_devices(system.spec, *data.train.u.shape[:2]))
    return Fit(objective, settings), data


def member_data(system: System, physics: Physics, sequences: int, samples: int, dtype: Any) -> MemberData:
    info = RecordInfo(
        tuple(Channel(s.name, s.unit) for s in physics.inputs),
        tuple(Channel(s.name, s.unit) for s in physics.outputs),
        physics.dt,
        "simulated",
    )
    if system.name == "arm":
        y = np.random.default_rng(1).uniform(-0.5, 0.5, (sequences, samples, len(info.outputs)))
        train = cast(record(torques(sequences, samples), y, info), dtype)
        validation = take(train, np.arange(min(6, sequences)))
    else:  # windows of one long record, which validates as a whole
        rng = np.random.default_rng(0)
        u, y = (rng.uniform(1, high, (sequences * samples, 1)) for high in (4, 9))
        validation = cast(record(u, y, info), dtype)
        train = windows(validation, samples) if sequences > 1 else validation
    scaling = jax.tree.map(dtype, model_scaling(build_model(system.spec, physics), train))
    return MemberData(train, validation, scaling, np.asarray(10**6, np.int32))


def torques(sequences: int, samples: int) -> np.ndarray:
    """Random motor torques of the measured size, Nm: they swing slowly, so that the arm moves within its limits."""
    rng = np.random.default_rng(0)
    wave = np.cumsum(rng.standard_normal((sequences, samples, 6)), axis=1)
    wave -= np.linspace(0, 1, samples)[:, None] * wave[:, -1:]
    return wave / wave.std() * [2.8, 3.5, 3.6, 1.0, 1.4, 1.4]


def training_call(fit: Fit, data: MemberData, count: int, mapping: MemberMapping | None = None) -> tuple[Any, ...]:
    """A jitted chunk of epochs of `count` members, and its arguments; mapping: None takes that of `choose_mapping`."""
    native = fit.objective.route == "native"
    mapping = mapping or choose_mapping(count, data.train.u.shape[0], jax.device_count(), native=native)
    members = repeat(data, count)
    state = jit_members(fit.begin, mapping)(keys_of([Member(i, 0) for i in range(count)]), members)
    return jit_members(fit.advance, mapping), in_precision(state, data.train.u.dtype), members


def in_precision(tree: Any, dtype: Any) -> Any:
    """The tree with its floating-point numbers in this precision: weights are always drawn in float32."""

    def one(a: jax.Array) -> jax.Array:
        return a.astype(dtype) if jnp.issubdtype(a.dtype, jnp.floating) else a

    return jax.tree.map(one, tree)


def model_and_params(
    system: System, physics: Physics, *, samples: int = 64, dtype: Any = np.float32
) -> tuple[Model, ModelParams]:
    """An untrained member."""
    data = member_data(system, physics, 1, samples, dtype)
    objective = build_objective(build_model(system.spec, physics), InitialState())
    params = objective.assemble(objective.begin(jax.random.key(0), data), data.scaling)
    return objective.model, in_precision(params, dtype)


def inputs(system: System, sequences: int, samples: int, dtype: Any) -> tuple[jax.Array, jax.Array]:
    """u `[seq, time, u]` and x_0 = 0 `[seq, x]`, in physical units."""
    if system.name == "arm":
        u, n_x = torques(sequences, samples), 12
    else:
        u, n_x = np.random.default_rng(0).uniform(1, 4, (sequences, samples, 1)), 2
    return jnp.asarray(u, dtype), jnp.zeros((sequences, n_x), dtype)


def rollout_call(
    model: Model, params: ModelParams, u: jax.Array, x0: jax.Array, *, route: Any = None, chunk: Any = "auto"
) -> tuple[Any, ...]:
    """A jitted rollout of one member that returns y, and its arguments; several sequences are shared by all devices."""
    devices = min(len(u), jax.device_count())

    def run(params: ModelParams, u: jax.Array, x0: jax.Array) -> jax.Array:
        return rollout(model, params, u, x0, route=route, chunk=chunk, devices=devices).y

    return jax.jit(run), params, u, x0
