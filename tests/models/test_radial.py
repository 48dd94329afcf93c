"""Radial basis functions, the baseline that is built on them, and its weighted regularisation."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from small import small_fit
from toys import TOY_PARAMS, quick_jit, toy_measure, toy_model, toy_params, toy_signals, toy_step

from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.model import build_model
from pgrssnn_jax.models.radial import Radial, gaussians, scarcity, surrogate_points
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.training.members import select
from pgrssnn_jax.training.objective import Objective, Trainable, build_objective
from pgrssnn_jax.training.settings import FitSettings

W_PGNN = partial(ModelSpec, recurrent=False, feedback=True, features="radial", hidden=5)


def by_hand(z, centres, width):
    square = ((z[..., None, :] - centres) ** 2).sum(-1)
    return np.exp(-0.5 * square / width**2)


@pytest.fixture
def case():
    draw = np.random.default_rng(3)
    return draw.normal(size=(2, 4, 3)), draw.normal(size=(5, 3)), draw.uniform(0.5, 2.0, 5)


def test_the_features_are_gaussians(case):
    z, centres, width = case
    found = quick_jit(gaussians)(*(jnp.asarray(a, jnp.float32) for a in case))
    np.testing.assert_allclose(found, by_hand(z, centres, width), rtol=1e-5)
    at_centres = quick_jit(gaussians)(*(jnp.asarray(a, jnp.float32) for a in (centres, centres, width)))
    np.testing.assert_allclose(np.diag(at_centres), 1.0, rtol=1e-6)


def test_far_away_they_vanish_with_all_their_slopes():
    def total(z, centres, width):
        return gaussians(z, centres, width).sum()

    both = quick_jit(jax.value_and_grad(total, (0, 1, 2)))
    for far in (30.0, 1e6, 1e15):
        value, slopes = both(np.full((1, 2), far, np.float32), np.zeros((3, 2), np.float32), np.ones(3, np.float32))
        assert value == 0
        assert not any(np.asarray(slope).any() for slope in slopes)


def test_centres_start_in_the_range_of_scaled_signals_and_widths_stay_positive(key):
    layer = Radial(6, 500, rngs=nnx.Rngs(params=key))
    centres = np.asarray(layer.centres[...])
    assert 1.95 < np.abs(centres).max() <= 2.0
    assert np.abs(centres.mean(0)).max() < 0.2
    np.testing.assert_allclose(jnp.exp(layer.log_width[...]), 6**0.5, rtol=1e-6)
    # typical points are neighbours of some centres, whatever the number of signals
    phi = np.asarray(layer(jax.random.normal(key, (50, 6))))
    assert (phi.max(-1) > 0.3).all()


# --- the model --------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("correction", [1.0, 0.1])
def test_rollout_equals_the_equations_of_the_baseline(key, correction):
    """x_t = f_phy + s_x W_x φ([u_t, x_{t-1}]), y_t = g_phy + s_y W_y φ([u_t, x_t])."""
    model = toy_model(W_PGNN(correction=correction))
    params, (u, x0) = toy_params(model, key, jnp.float64), toy_signals(1, 6, jnp.float64)
    found = quick_jit(lambda *a: rollout(model, *a))(params, u, x0)
    numbers = jax.tree.map(lambda a: np.asarray(a, np.float64), params)
    weights, scaling = nnx.to_pure_dict(numbers.network), numbers.scaling

    def network(features, head, u_t, x):
        z = np.concatenate([(s - a.offset) / a.scale for s, a in ((u_t, scaling.u), (x, scaling.x))])
        part = weights[features]
        return by_hand(z, part["centres"], np.exp(part["log_width"])) @ weights[head]["kernel"]

    x = np.asarray(x0[0])
    for t, u_t in enumerate(np.asarray(u[0])):
        correct = correction * scaling.x.scale * network("features_u", "head_x", u_t, x)
        x = toy_step(TOY_PARAMS, x, u_t) + correct
        y = toy_measure(TOY_PARAMS, x, u_t) + scaling.y.scale * network("features_x", "head_y", u_t, x)
        np.testing.assert_allclose(found.x[0, t], x, rtol=1e-10)
        np.testing.assert_allclose(found.y[0, t], y, rtol=1e-10)


def test_without_feedback_both_routes_agree(key):
    model = toy_model(W_PGNN(feedback=False))
    params, (u, x0) = toy_params(model, key), toy_signals()
    fused, split = (quick_jit(partial(rollout, model, route=route))(params, u, x0) for route in ("fused", "split"))
    for a, b in zip(fused, split, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=2e-6)


def test_start_from_physics_is_the_physics_and_learns(key):
    model, alone = (toy_model(spec) for spec in (W_PGNN(start_from_physics=True), ModelSpec(networks=False)))
    u, x0 = toy_signals()
    params = toy_params(model, key)
    expected = quick_jit(partial(rollout, alone))(toy_params(alone, key), u, x0)
    found = quick_jit(partial(rollout, model))(params, u, x0)
    np.testing.assert_allclose(found.y, expected.y, rtol=1e-5, atol=1e-6)
    slope = quick_jit(jax.grad(lambda w: jnp.sum(rollout(model, params._replace(network=w), u, x0).y ** 2)))(
        params.network
    )
    assert all(np.asarray(slope[head]["kernel"]).any() for head in ("head_x", "head_y"))


def test_number_of_weights(key):
    weights = jax.tree.leaves(toy_model(W_PGNN()).init(key))
    n_u, n_x, n_y, h = 2, 3, 2, 5
    assert sum(a.size for a in weights) == 2 * h * (n_u + n_x + 1) + h * (n_x + n_y)


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"features": "radial"}, "recurrent: expected false with features=radial.*found true"),
        ({"regularisation": -1.0}, "regularisation: expected 0 or more, found -1.0"),
        ({"regularisation": float("nan")}, "regularisation: expected 0 or more, found nan"),
        ({"regularisation": 1.0}, "regularisation: expected 0 but for feedback=true and recurrent=false.*found 1.0"),
        ({"regularisation": 1.0, "recurrent": False}, "regularisation: expected 0 but for feedback=true"),
    ],
)
def test_what_does_not_fit_together_is_named(fields, problem):
    with pytest.raises(ValueError, match=f"model: {problem}"):
        build_model(ModelSpec(**fields), cascaded_tanks())


# --- the weighted regularisation --------------------------------------------------------------------------------------


def test_a_point_without_samples_weighs_one_and_one_among_many_next_to_nothing():
    points, weigh = jnp.array([[0.0, 0.0], [8.0, 0.0]]), quick_jit(scarcity)
    weight = weigh(points, jnp.zeros((100, 2)), jnp.ones(100, bool))
    np.testing.assert_allclose(weight, [1 / 101, 1.0], rtol=1e-5)
    # padding is no sample
    weight = weigh(points, jnp.zeros((100, 2)), jnp.arange(100) < 9)
    np.testing.assert_allclose(weight, [1 / 10, 1.0], rtol=1e-5)


def test_of_a_long_record_every_n_th_sample_stands_for_n():
    samples = jnp.zeros((5000, 2))
    np.testing.assert_allclose(quick_jit(scarcity)(samples[:1], samples, jnp.ones(5000, bool)), 1 / 5001, rtol=1e-3)


def test_surrogate_points_are_always_the_same_and_reach_beyond_the_signals():
    points = surrogate_points(4)
    np.testing.assert_array_equal(points, surrogate_points(4))
    assert points.shape == (256, 4)
    assert 2.9 < np.abs(points).max() < 3.0
    np.testing.assert_allclose(np.abs(points).mean(), 1.5, atol=0.1)


@pytest.fixture(scope="module")
def one():
    """The data of one member."""
    return select(small_fit(settings=FitSettings(epochs=1), members=1)[1], 0)


def objective_of(spec: ModelSpec) -> Objective:
    return build_objective(build_model(spec, cascaded_tanks()), InitialState("first_output"))


def test_the_penalty_is_the_weighted_mean_square_of_both_corrections(key, one):
    """Of the same member with and without regularisation."""
    plain, objective = (objective_of(W_PGNN(regularisation=weight)) for weight in (0.0, 0.7))
    scaling, x0 = one.scaling, jnp.full((1, 2), one.train.y[0, 0, 0])

    @quick_jit
    def all_of_it(key, one):
        theta = objective.begin(key, one)
        losses = [(o.on_train(theta, one), o.on_validation(theta, one)) for o in (plain, objective)]
        return (
            theta,
            *zip(*losses, strict=True),
            rollout(objective.model, objective.assemble(theta, scaling), one.train.u, x0).x,
        )

    theta, losses, validation, x = all_of_it(key, one)
    z = np.concatenate([scaling.u.to_scaled(one.train.u)[0], scaling.x.to_scaled(np.asarray(x))[0]], -1)
    points, width = surrogate_points(3), 3**0.5 / 2
    weight = 1 / (1 + by_hand(points, z, width).sum(-1))
    w = jax.tree.map(np.asarray, nnx.to_pure_dict(theta.network))
    squares = sum(
        (by_hand(points, w[f]["centres"], np.exp(w[f]["log_width"])) @ w[head]["kernel"]) ** 2 @ np.ones(n)
        for f, head, n in (("features_u", "head_x", 2), ("features_x", "head_y", 1))
    )
    expected = 0.7 * 48 * np.mean(weight * squares)
    assert expected > 0.01
    np.testing.assert_allclose(losses[1].total - losses[0].total, expected, rtol=1e-3)
    # errors are reported without it
    np.testing.assert_allclose(losses[1].mean, losses[0].mean, rtol=1e-6)
    assert validation[0] == validation[1]


def test_the_physics_is_not_penalised_and_a_black_box_never_is(key, one):
    zero = objective_of(W_PGNN(regularisation=1e3, start_from_physics=True))
    black, alone = (objective_of(W_PGNN(regularisation=weight, guided=False)) for weight in (1e3, 0.0))
    physics = objective_of(ModelSpec(networks=False))

    @quick_jit
    def losses(key, one):
        theta, start = black.begin(key, one), zero.begin(key, one)
        by = (black, theta), (alone, theta), (zero, start), (physics, Trainable({}, None, None))
        return [objective.on_train(numbers, one) for objective, numbers in by]

    *totals, loss, bare = losses(key, one)
    assert totals[0].total == totals[1].total
    np.testing.assert_allclose(loss.total, 48 * loss.mean, rtol=1e-5)
    np.testing.assert_allclose(loss.mean, bare.mean, rtol=1e-5)
