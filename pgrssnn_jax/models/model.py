"""A state-space model of physics and networks.

    x_t = f_phy(x_{t-1}, u_t) + s_x f_nn(u_t; h_{t-1})         y_t = g_phy(x_t, u_t) + s_y g_nn(x_t, u_t)

States and outputs stay in physical units; the networks work in scaled units and their outputs are multiplied by the
scales s_x, s_y, which is the published model written without a change of variables inside the recurrence. A black box
has f_phy = 0 and g_phy = mean of y, and its states are the networks' own.
Source: Li, Seth, Kok, IFAC 2026, equations 5 to 9.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from pgrssnn_jax.models.networks import ACTIVATIONS, Networks
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.scaling import Scaling


class ModelParams(NamedTuple):
    """Every number a rollout needs, for one member: network weights, physics parameters, scaling."""

    network: Any
    physics: Any
    scaling: Scaling


class Model(NamedTuple):
    """What does not change while training: spec, physics and the networks' graph definition."""

    spec: ModelSpec
    physics: Physics
    graph: nnx.GraphDef[Any] | None
    init: Callable[[jax.Array], Any]

    @property
    def n_x(self) -> int:
        return len(self.physics.states)

    @property
    def seen(self) -> tuple[int, ...]:
        """Places of the states that networks see and correct: all but those that are `inner`."""
        return tuple(i for i, state in enumerate(self.physics.states) if not state.inner)

    def seen_of(self, x: jax.Array) -> jax.Array:
        """`[..., seen]` of `[..., x]`."""
        return x if len(self.seen) == self.n_x else x[..., np.array(self.seen)]

    def whole(self, correction: jax.Array) -> jax.Array:
        """`[..., x]` of `[..., seen]`, zero for the other states."""
        if len(self.seen) == self.n_x:
            return correction
        none = jnp.zeros((*correction.shape[:-1], self.n_x), correction.dtype)
        return none.at[..., np.array(self.seen)].set(correction)

    def networks(self, params: ModelParams) -> Networks | None:
        """The networks with the weights of `params`; None where the physics stands alone."""
        return None if self.graph is None else nnx.merge(self.graph, params.network)


def build_model(spec: ModelSpec, physics: Physics) -> Model:
    """Splits the Flax networks once into graph definition and weights; `init(key)` gives one member's weights.

    Raises `ValueError` for a spec that describes no model.
    """
    if not (spec.guided or spec.networks):
        raise ValueError("model: guided and networks: expected at least one of them to be true, found both false")
    if spec.activation not in ACTIVATIONS:
        raise ValueError(f"model: activation: expected one of {sorted(ACTIVATIONS)}, found {spec.activation!r}")
    if spec.hidden < 1 or spec.gru_layers < 1:
        raise ValueError(
            f"model: hidden and gru_layers: expected at least 1, found {spec.hidden} and {spec.gru_layers}"
        )
    if spec.features == "radial" and spec.recurrent:
        raise ValueError("model: recurrent: expected false with features=radial, which has no GRU, found true")
    if not np.isfinite(spec.correction):
        raise ValueError(f"model: correction: expected a finite number, found {spec.correction}")
    if not 0 <= spec.regularisation < np.inf:
        raise ValueError(f"model: regularisation: expected 0 or more, found {spec.regularisation}")
    if spec.regularisation and (spec.recurrent or not spec.feedback):
        raise ValueError(
            "model: regularisation: expected 0 but for feedback=true and recurrent=false, whose corrections are "
            f"functions of input and state alone, found {spec.regularisation}"
        )
    if not spec.networks:
        return Model(spec, physics, None, lambda key: {})
    n_x = sum(not state.inner for state in physics.states)
    sizes = {"n_u": len(physics.inputs), "n_x": n_x, "n_y": len(physics.outputs)}

    def create(key: jax.Array) -> Networks:
        return Networks(spec, **sizes, rngs=nnx.Rngs(params=key))

    graph = nnx.graphdef(nnx.eval_shape(lambda: create(jax.random.key(0))))
    return Model(spec, physics, graph, lambda key: nnx.state(create(key), nnx.Param))
