"""Where a free run starts."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small import START, simulated, small_fit
from toys import quick_jit

from pgrssnn_jax.models.initial_state import InitialState, start_state
from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.scaling import model_scaling
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Signal
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.record import cast, crop
from pgrssnn_jax.training.members import select
from pgrssnn_jax.training.objective import Objective, build_objective


@cache
def alone():
    physics = cascaded_tanks()
    model = build_model(ModelSpec(networks=False), physics)
    record = cast(simulated(physics, samples=60, seed=3), np.float32)
    return model, ModelParams({}, physics.params, model_scaling(model, record)), record


@cache
def estimated(n_init: int):
    """(params, record) to the start states that its first samples say."""
    model, initial = alone()[0], InitialState("estimated", n_init=n_init)
    return quick_jit(lambda params, record: start_state(model, params, record, initial))


@cache
def member():
    """A model and the data of one member."""
    fit, data = small_fit(members=1)
    return fit.objective.model, select(data, 0)


def objective_of(kind: str, *, networks: bool = True, **more) -> Objective:
    """Where no run goes on from another one, the physics alone says the same and compiles sooner."""
    return build_objective(member()[0] if networks else alone()[0], InitialState(kind, **more))


def begun(objective: Objective, one):
    return quick_jit(objective.begin)(jax.random.key(0), one)


@cache
def measured(samples: int, noise: float = 0.0):
    return cast(simulated(cascaded_tanks(), samples=samples, seed=3, noise=noise), np.float32)


def test_zero_and_first_output():
    model, params, record = alone()
    assert np.array_equal(start_state(model, params, record, InitialState("zero")), [[0, 0]])
    first = float(record.y[0, 0, 0])
    np.testing.assert_array_equal(start_state(model, params, record, InitialState("first_output")), [[first, first]])


def test_scaled_zero_is_the_states_offset():
    model, params, record = alone()
    start = start_state(model, params, record, InitialState("scaled_zero"))
    np.testing.assert_array_equal(start, np.float32(params.scaling.x.offset)[None])
    np.testing.assert_allclose(params.scaling.x.to_scaled(start), 0.0, atol=1e-6)


def test_a_first_sample_that_was_not_measured_is_passed_over():
    model, params, record = alone()
    hidden = np.ones(record.y.shape, bool)
    hidden[:, :3] = False
    masked = record._replace(mask=hidden, y=np.where(hidden, record.y, 0.0).astype(np.float32))
    start = start_state(model, params, masked, InitialState("first_output"))
    np.testing.assert_array_equal(start, np.full((1, 2), record.y[0, 3, 0]))


def test_a_state_that_resembles_no_output_starts_at_zero():
    model, params, record = alone()
    states = (Signal("upper_level", "V"), model.physics.states[1])
    model = model._replace(physics=model.physics._replace(states=states))
    start = start_state(model, params, record, InitialState("first_output"))
    assert start[0, 0] == 0
    assert start[0, 1] == record.y[0, 0, 0]


def test_the_estimate_finds_the_true_start_of_a_noise_free_record():
    _, params, record = alone()
    found = estimated(30)(params, record)
    np.testing.assert_allclose(found[0], START, atol=0.02)


def test_the_estimate_sees_the_first_samples_alone():
    _, params, record = alone()
    other = record._replace(y=np.where(np.arange(60)[None, :, None] < 12, record.y, 99.0).astype(np.float32))
    np.testing.assert_array_equal(estimated(12)(params, record), estimated(12)(params, other))


def test_masked_samples_do_not_count_in_the_estimate():
    _, params, record = alone()
    hidden = np.ones(record.y.shape, bool)
    hidden[:, 5:9] = False
    wrong = record._replace(y=np.where(hidden, record.y, 50.0).astype(np.float32), mask=hidden)
    np.testing.assert_allclose(estimated(30)(params, wrong)[0], START, atol=0.03)


def test_one_sample_is_enough_to_stay_finite():
    _, params, record = alone()
    found = estimated(1)(params, record)
    assert np.isfinite(found).all()


def test_a_diverging_model_keeps_the_guess():
    model, params, record = alone()
    physics = model.physics._replace(step=lambda p, x, u: x * jnp.nan)
    initial = InitialState("estimated", n_init=5)
    found = quick_jit(lambda p, r: start_state(model._replace(physics=physics), p, r, initial))(params, record)
    np.testing.assert_array_equal(found, start_state(model, params, record, InitialState("first_output")))


@pytest.mark.parametrize("kind", ["first_output", "estimated"])
def test_a_shared_start_is_the_training_records(kind):
    shared, apart = (objective_of(kind, networks=False, n_init=10, shared=s) for s in (True, False))
    one = member()[1]

    @quick_jit
    def starts(one):
        theta = shared.begin(jax.random.key(0), one)
        trained = shared.trained_start(theta, one)
        return trained, *(o.test_state(theta, one.scaling, trained, one.validation) for o in (shared, apart))

    trained, start, own = starts(one)
    np.testing.assert_array_equal(start, trained[None])
    np.testing.assert_allclose(start, np.full((1, 2), one.train.y[0, 0, 0]), rtol=1e-5)
    assert not np.allclose(own, start, atol=1e-3)


def test_training_sequences_have_trained_starts():
    objective, one = objective_of("estimated", networks=False, n_init=10, shared=True), member()[1]
    theta = begun(objective, one)
    assert theta.x0.shape == (1, 2)
    gradient = quick_jit(jax.grad(lambda t: objective.on_train(t, one).total))(theta)
    assert np.all(np.asarray(gradient.x0) != 0)


def test_impossible_settings_are_named():
    with pytest.raises(ValueError, match="n_init: expected at least 1 sample for initial_state=estimated, found 0"):
        InitialState("estimated")
    with pytest.raises(ValueError, match="n_init: expected 0 or more"):
        InitialState("zero", n_init=-1)


def test_a_validation_record_goes_on_from_the_training_record():
    """Cut from one record, its run is the tail of the run over both; from another record its start is estimated."""
    objective, whole = objective_of("estimated", n_init=10, shared=True), measured(80)
    cut = member()[1]._replace(train=crop(whole, 0, 48), validation=crop(whole, 48, 80))
    elsewhere = cut._replace(validation=crop(whole, 47, 79))

    @quick_jit
    def runs(cut, elsewhere):
        theta = objective.begin(jax.random.key(0), cut)
        params = objective.assemble(theta, cut.scaling)
        start = objective.test_state(theta, cut.scaling, objective.trained_start(theta, cut), cut.validation)
        expected = rollout(objective.model, params, whole.u, start)
        return expected, objective.validate(theta, cut), objective.validate(theta, elsewhere)

    expected, found, other = runs(cut, elsewhere)
    np.testing.assert_allclose(found.y, expected.y[:, 48:], rtol=1e-6)
    assert found.first_bad == 32
    assert not np.allclose(other.y[:, 1:], found.y[:, :-1], atol=1e-4)


def test_a_run_that_failed_before_the_validation_record_has_failed_there():
    objective, whole = objective_of("estimated", networks=False, n_init=10), measured(80)
    cut = member()[1]._replace(train=crop(whole, 0, 48), validation=crop(whole, 48, 80))
    theta = begun(objective, cut)
    lost = theta._replace(x0=jnp.full_like(theta.x0, jnp.nan))
    run, loss = quick_jit(lambda theta: (objective.validate(theta, cut), objective.on_validation(theta, cut)))(lost)
    assert run.first_bad == 0
    assert not loss.finite


def test_a_record_of_training_seen_as_a_test_record_starts_from_its_first_samples():
    """What later samples say of the start is unknown of a test record; a shared start is known."""
    whole = measured(60, noise=0.3)
    again = whole._replace(info=replace(whole.info, same_run=True))
    one = member()[1]._replace(train=whole, validation=again)
    for shared in (False, True):
        objective = objective_of("least_squares", networks=False, n_init=8, shared=shared)

        def runs(one, objective=objective):
            theta = objective.begin(jax.random.key(0), one)
            params = objective.assemble(theta, one.scaling)
            start = (
                objective.trained_start(theta, one)[None]
                if objective.initial.shared
                else start_state(objective.model, params, crop(one.train, 0, 8), objective.initial)
            )
            return rollout(objective.model, params, one.train.u, start).y, objective.as_tested(theta, one).y

        expected, found = quick_jit(runs)(one)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)
        assert objective.starts_as_tested(again) is not shared
