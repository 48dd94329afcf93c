"""The arm's forward dynamics by both backends, and Pinocchio without JAX."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin

from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.arms.tables import described, pinocchio_model
from pgrssnn_jax.physics.base import Physics

from .cases import ARM_SEQUENCES, STAGES, torques
from .goals import PINOCCHIO
from .timing import Program, compiled

_CALLS = 200  # of Pinocchio's algorithm per measurement: a single one is too short
BACKENDS = [
    ("native", np.float32),
    ("jax", np.float32),
    ("jax", np.float64),
    ("pinocchio", np.float32),
    ("pinocchio", np.float64),
]


def free_runs(samples: int, backends: list[Any], *, gradients: bool) -> dict[str, Program]:
    """Free runs of 60 sequences, forward and with the gradient with respect to torques."""
    programs = {}
    for backend, dtype in backends:
        with jax.enable_x64(dtype == np.float64):
            run, gradient, u = free_run(arm(backend=backend), torques(ARM_SEQUENCES, samples).astype(dtype))
            name = f"{backend} {np.dtype(dtype).name}"
            programs[f"{name}, forward"] = compiled(run, u)
            if gradients:
                programs[f"{name}, value and gradient"] = compiled(gradient, u)
    return programs


def evaluations(samples: int) -> int:
    """Of the forward dynamics in a free run, or in an epoch."""
    return ARM_SEQUENCES * samples * STAGES


def free_run(physics: Physics, u: np.ndarray) -> tuple[Any, Any, jax.Array]:
    n = len(physics.outputs)
    params = jax.tree.map(lambda p: jnp.asarray(p, u.dtype), physics.params)
    x0 = jnp.zeros((len(u), len(physics.states)), u.dtype)

    def simulate(u: jax.Array) -> jax.Array:
        def body(x: jax.Array, u_t: jax.Array) -> tuple[jax.Array, jax.Array]:
            x = jax.vmap(physics.step, (None, 0, 0))(params, x, u_t)
            return x, x

        return jax.lax.scan(body, x0, u)[1]

    squares = jax.value_and_grad(lambda u: jnp.sum(simulate(u)[..., :n] ** 2))
    return jax.jit(simulate), jax.jit(squares), jnp.asarray(u.swapaxes(0, 1))


def pinocchio_calls() -> dict[str, Any]:
    """Calls of 12 000 evaluations: of the C++ algorithm at the batch of an epoch, and one by one from Python."""
    model = pinocchio_model(described("kuka_kr300"))
    pool, data = pin.ModelPool(model, 1), model.createData()
    arrays = np.random.default_rng(0).uniform(-1, 1, (3, model.nv, ARM_SEQUENCES))
    q, v, tau = (np.asfortranarray(a) for a in arrays)
    columns = [[a[:, i] for a in (q, v, tau)] for i in range(ARM_SEQUENCES)]
    return {
        PINOCCHIO: lambda: [pin.abaInParallel(1, pool, q, v, tau) for _ in range(_CALLS)],
        "Pinocchio called from Python, forward": lambda: [
            pin.aba(model, data, *column) for _ in range(_CALLS) for column in columns
        ],
    }


EVALUATIONS_PER_CALL = _CALLS * ARM_SEQUENCES
