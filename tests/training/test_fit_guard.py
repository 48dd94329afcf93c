"""What becomes of a member that leaves the floating-point range, and that nobody else notices."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from small import small_fit
from toys import quick_jit

from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.training.members import Member, MemberMapping, keys_of, map_members, select
from pgrssnn_jax.training.objective import Loss, Trainable
from pgrssnn_jax.training.optimise import MemberState, MemberStatus, _outcome, build_optimizer
from pgrssnn_jax.training.settings import ROLLBACKS, FitSettings

LOOP = MemberMapping("loop")  # members one after another, so that their number does not matter


def same(a, b) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)


# --- failures as they come: fed-back ReLU networks, a step of 1 and no clipping ---------------------------------------


def wild(guard, seeds):
    settings = FitSettings(
        epochs=20, validate_every=5, chunk_epochs=20, optimizer="adam", learning_rate=1.0, clip_norm=None, guard=guard
    )
    spec = ModelSpec(guided=False, recurrent=False, feedback=True, hidden=4)
    fit, data = small_fit(spec=spec, settings=settings, members=len(seeds), samples=120)
    state = jax.tree.map(lambda *members: np.stack(members), *(drawn(fit, select(data, 0), seed) for seed in seeds))
    return jax.device_get(jax.jit(map_members(fit.advance, LOOP))(state, data))


def drawn(fit, data, seed):
    """A member before its first epoch, its weights drawn here: drawing them in JAX compiles as long as training."""
    shapes = jax.eval_shape(fit.begin, jax.random.key(0), data)
    state = jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), shapes)
    draw = np.random.default_rng(seed)
    network = jax.tree.map(lambda a: 0.5 * draw.normal(size=a.shape).astype(a.dtype), shapes.theta.network)
    theta = state.theta._replace(network=network)
    return state._replace(theta=theta, best=theta, best_loss=np.float32(np.inf))


@pytest.fixture(scope="module")
def unguarded():
    return wild("none", range(6))


def failures(state: MemberState) -> np.ndarray:
    return np.array([MemberStatus(int(o)).failed for o in state.outcome])


def test_without_a_guard_members_fail_and_the_others_train_on(unguarded):
    state, history = unguarded
    failed = failures(state)
    assert 0 < failed.sum() < 6
    assert (state.epoch[failed] < 20).all()
    assert not state.rollbacks.any()
    # frozen: nothing is recorded after the epoch that failed
    for i in np.flatnonzero(failed):
        assert np.isnan(history.train[i].ravel()[state.epoch[i] + 1 :]).all()


@pytest.mark.slow
def test_the_others_are_bit_equal_to_a_program_without_the_failing_members(unguarded):
    state, history = unguarded
    well = [int(i) for i in np.flatnonzero(~failures(state))]
    alone = wild("none", well)
    for k, i in enumerate(well):
        assert same(select(alone, k), select((state, history), i))


@pytest.mark.slow  # bit for bit when compiled as users do; with little optimisation two programs may differ
def test_with_a_guard_nobody_fails_at_once_and_who_never_left_the_range_is_bit_equal(unguarded):
    guarded = wild("rollback", range(6))
    failed = failures(unguarded[0])
    assert (guarded[0].rollbacks[failed] > 0).all()
    assert not failures(guarded[0])[guarded[0].rollbacks < ROLLBACKS].any()
    assert (guarded[0].epoch[~failures(guarded[0])] == guarded[0].epoch.max()).any()
    for i in np.flatnonzero(~failed).tolist():
        assert same(select(guarded, i), select(unguarded, i))


# --- failures that are made: physics parameters alone, which compile quickly ------------------------------------------


@cache
def programs(guard, rate):
    """Three members: their data, how they begin, and a chunk."""
    settings = FitSettings(
        epochs=12, validate_every=2, chunk_epochs=12, optimizer="adam", learning_rate=rate, guard=guard,
        physics_parameters="trained",
    )  # fmt: skip
    fit, data = small_fit(spec=ModelSpec(networks=False), settings=settings)
    return data, *(quick_jit(map_members(one, LOOP)) for one in (fit.begin, fit.advance))


def made(guard, *, train_y=None, validation_y=None, change=lambda state: state, rate=1e-2):
    """3e25 V overflow when squared, while every state stays finite."""
    data, begin, advance = programs(guard, rate)

    def spoilt(record, value):
        y = np.array(record.y)
        y[1] = y[1] if value is None else value
        return record._replace(y=y)

    data = data._replace(train=spoilt(data.train, train_y), validation=spoilt(data.validation, validation_y))
    return jax.device_get(advance(change(begin(keys_of([Member(seed, 0) for seed in range(3)]), data)), data))


def test_an_epoch_that_never_works_is_given_up_after_some_rollbacks():
    state, history = made("rollback", train_y=3e25)
    assert state.outcome[1] == MemberStatus.LOSS_NOT_FINITE
    assert state.rollbacks.tolist() == [0, ROLLBACKS, 0]
    assert state.epoch.tolist() == [12, ROLLBACKS, 12]
    assert np.isinf(history.train[1].ravel()[: ROLLBACKS + 1]).all()


@pytest.mark.parametrize("guard", ["none", "rollback"])
def test_a_validation_that_is_not_finite_counts_like_an_epoch(guard):
    state, history = made(guard, validation_y=3e25)
    assert state.outcome[1] == MemberStatus.LOSS_NOT_FINITE
    assert np.isfinite(history.train[1].ravel()[: state.epoch[1]]).all()
    allowed = ROLLBACKS if guard == "rollback" else 0
    assert (state.rollbacks[1], state.epoch[1]) == (allowed, 2 * (allowed + 1))
    assert state.outcome[0] == MemberStatus.TRAINING


def test_after_a_retreat_a_member_trains_on_from_its_best_with_half_the_step():
    def thrown_out(state):
        theta = jax.tree.map(lambda a: a.at[1].set(jnp.nan), state.theta)
        moments = jax.tree.map(lambda a: a + jnp.ones_like(a), state.optimizer)
        return state._replace(theta=theta, optimizer=moments)

    state, history = made("rollback", change=thrown_out)
    _, expected = made("none", rate=0.5e-2)
    assert state.rollbacks.tolist() == [0, 1, 0]
    assert (state.outcome[1], state.epoch[1]) == (MemberStatus.TRAINING, 12)
    found = history.train[1].ravel()
    assert np.isnan(found[0])
    np.testing.assert_allclose(found[1:], expected.train[1].ravel()[:-1], rtol=1e-5)
    assert found[-1] < found[1]


@pytest.mark.parametrize("optimizer", ["adam", "adamw"])
@pytest.mark.parametrize("rollbacks", [1, 3])
def test_every_retreat_halves_the_whole_step(optimizer, rollbacks):
    theta = Trainable({"w": jnp.array([1.0, -2.0])}, None, None)
    gradient = jax.tree.map(lambda a: 0.3 * a + 0.1, theta)
    settings = FitSettings(optimizer=optimizer, weight_decay=0.5)
    full, less = (build_optimizer(settings, n) for n in (0, rollbacks))
    steps = [o.update(gradient, o.init(theta), theta)[0].network["w"] for o in (full, less)]
    np.testing.assert_array_equal(steps[1], steps[0] * 0.5**rollbacks)


def test_a_gradient_fails_by_its_elements_and_not_by_its_norm():
    loss = Loss(jnp.float32(1.0), jnp.float32(1.0), jnp.bool_(True))
    large = Trainable({"w": jnp.full(3, 1e25)}, None, None)
    assert not np.isfinite(optax.tree.norm(large))
    assert _outcome(loss, large) == MemberStatus.TRAINING
    assert _outcome(loss, large._replace(network={"w": jnp.array([0.0, jnp.inf])})) == MemberStatus.GRADIENT_NOT_FINITE
    assert _outcome(loss._replace(total=jnp.inf), large) == MemberStatus.LOSS_NOT_FINITE
    assert _outcome(loss._replace(total=jnp.nan, finite=jnp.bool_(False)), large) == MemberStatus.STATE_NOT_FINITE
    # clipping makes that gradient a step of zero
    clip = optax.clip_by_global_norm(1.0)
    assert not clip.update(large, clip.init(large))[0].network["w"].any()
