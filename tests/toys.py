"""Small systems and models that several tests share, beside their equations in plain NumPy."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pgrssnn_jax.acceleration.compiler import optimised
from pgrssnn_jax.models.model import Model, ModelParams, build_model
from pgrssnn_jax.models.rollout import Route, rollout
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Physics, Signal, discrete
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, record
from pgrssnn_jax.records.scaling import Affine, Scaling

_FC = {"recurrent": False, "feedback": True}
_BLACK_BOX = {
    "RSSNN": {},
    "RSSNN(fb)": {"feedback": True},
    "RSSNN-sgm": {"activation": "sigmoid"},
    "FCSSNN": _FC,
    "FCSSNN-sgm": {**_FC, "activation": "sigmoid"},
}

#: the ten published variants by their published names, as fields of `ModelSpec`
PUBLISHED: dict[str, dict[str, Any]] = {
    **{name: {"guided": False, **fields} for name, fields in _BLACK_BOX.items()},
    **{f"PG-{name}": {"guided": True, **fields} for name, fields in _BLACK_BOX.items()},
}
WITHOUT_FEEDBACK = [name for name, fields in PUBLISHED.items() if not fields.get("feedback")]
GUIDED = [name for name, fields in PUBLISHED.items() if fields["guided"]]


def in_parts(names: Iterable[str]) -> list[Any]:
    """Published variants as parameters of a test: of those with another activation one is enough for the fast part."""
    return [
        pytest.param(name, marks=pytest.mark.compiles) if name.endswith("-sgm") and name != "PG-RSSNN-sgm" else name
        for name in names
    ]


def spec(name: str, **more: Any) -> ModelSpec:
    """A published variant, small."""
    return ModelSpec(**{"hidden": 4, **PUBLISHED[name], **more})


#: compiles in two thirds of the time; for tests of values that no optimisation should change
quick_jit = partial(jax.jit, compiler_options=optimised(0))

# --- a system in which every channel count differs and every argument matters -----------------------------------------

TOY_PARAMS = {"gain": 0.3, "mix": np.array([0.8, 0.7, 0.5])}


def toy_step(p: Any, x: Any, u: Any, xp: Any = np) -> Any:
    coupling = xp.stack([0.3 * xp.sin(x[1]) + 0.2 * u[0], 0.1 * u[1] * x[2], p["gain"] * u[0] - 0.2 * x[0]])
    return p["mix"] * x + coupling


def toy_measure(p: Any, x: Any, u: Any, xp: Any = np) -> Any:
    return xp.stack([x[0] + 0.1 * u[1], x[1] * x[2] + p["gain"]])


def toy_physics(output_timing: str = "after_step") -> Physics:
    """Three states, two inputs, two outputs; non-linear; the measurement depends on the input."""

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return toy_step({**p, "mix": jnp.asarray(p["mix"], x.dtype)}, x, u, jnp)

    return discrete(
        "toy",
        step,
        lambda p, x, u: toy_measure(p, x, u, jnp),
        TOY_PARAMS,
        states=(Signal("a", like="p"), Signal("b"), Signal("c")),
        inputs=(Signal("f"), Signal("g")),
        outputs=(Signal("p"), Signal("q")),
        dt=0.5,
        output_timing=output_timing,
    )


TOY_SCALING = Scaling(
    u=Affine(np.array([0.2, -0.3]), np.array([1.5, 0.7])),
    x=Affine(np.array([0.1, 0.0, -0.4]), np.array([0.9, 1.3, 0.6])),
    y=Affine(np.array([0.25, -0.5]), np.array([1.2, 0.8])),
)


def toy_model(fields: ModelSpec, *, output_timing: str = "after_step") -> Model:
    return build_model(fields, toy_physics(output_timing))


def toy_params(model: Model, key: jax.Array, dtype: Any = jnp.float32, scaling: Scaling = TOY_SCALING) -> ModelParams:
    """One member's parameters, all numbers in `dtype`."""
    tree = ModelParams(model.init(key), model.physics.params, scaling)
    return jax.tree.map(lambda a: jnp.asarray(a, dtype), tree)


def toy_signals(n_seq: int = 3, n_time: int = 7, dtype: Any = jnp.float32) -> tuple[jax.Array, jax.Array]:
    """u `[seq, time, 2]` and x_0 `[seq, 3]`."""
    draw = np.random.default_rng(7)
    u, x0 = draw.normal(size=(n_seq, n_time, 2)), draw.normal(size=(n_seq, 3))
    return jnp.asarray(u, dtype), jnp.asarray(x0, dtype)


def compiled_rollout(model: Model, route: Route | None = None) -> Any:
    return quick_jit(lambda params, u, x0: rollout(model, params, u, x0, route=route))


def small_record(u: Any, y: Any, **more: Any) -> Record:
    """A record with channels u0, u1, ... and y0, y1, ...; u and y `[(seq,) time, channel]`."""
    info = RecordInfo(
        inputs=tuple(Channel(f"u{i}") for i in range(np.shape(u)[-1])),
        outputs=tuple(Channel(f"y{i}") for i in range(np.shape(y)[-1])),
        dt=0.5,
        source="simulated",
    )
    return record(np.asarray(u), np.asarray(y), info, **more)
