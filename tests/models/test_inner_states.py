"""States that are a physics' own: networks neither see nor correct them."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import quick_jit, spec

from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.scaling import model_scaling
from pgrssnn_jax.physics.base import Signal, discrete
from pgrssnn_jax.records.record import Channel, RecordInfo, record

INFO = RecordInfo((Channel("u"),), (Channel("y"),), 0.1, "simulated")


def physics(*, inner):
    """y follows u; the second state counts samples and is far out of anybody's scale."""
    return discrete(
        "counting",
        lambda p, x, u: jnp.stack([p["a"] * x[0] + u[0], x[1] + 1000.0]),
        lambda p, x, u: x[:1],
        {"a": 0.9},
        states=(Signal("level", like="y"), Signal("count", inner=inner)),
        inputs=(Signal("u"),),
        outputs=(Signal("y"),),
        dt=0.1,
    )


@pytest.mark.parametrize(("name", "route"), [("PG-RSSNN", "fused"), ("PG-RSSNN", "split"), ("PG-RSSNN(fb)", "fused")])
def test_networks_neither_see_nor_correct_an_inner_state(key, name, route):
    draw = np.random.default_rng(0)
    train = record(draw.normal(size=(2, 30, 1)), draw.normal(size=(2, 30, 1)), INFO)
    model = build_model(spec(name), physics(inner=True))
    params = ModelParams(model.init(key), model.physics.params, model_scaling(model, train))
    u = jnp.asarray(train.u, jnp.float32)
    run = quick_jit(partial(rollout, model, route=route))
    found = run(params, u, jnp.zeros((2, 2), jnp.float32))
    np.testing.assert_array_equal(found.x[..., 1], 1000.0 * np.tile(np.arange(1, 31), (2, 1)))
    later = run(params, u, jnp.asarray([[0.0, 5e4]] * 2, jnp.float32))
    np.testing.assert_array_equal(found.y, later.y)
    alone = run(params._replace(network=jax.tree.map(jnp.zeros_like, params.network)), u, found.x[:, 0] * 0)
    assert np.abs(found.y - alone.y).max() > 0.01
    seen = build_model(spec(name), physics(inner=False))
    assert np.shape(params.scaling.x.scale) == (2,)
    sizes = [sum(np.size(w) for w in jax.tree.leaves(m.init(key))) for m in (model, seen)]
    assert sizes[0] < sizes[1]
