"""Where a free run starts."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small import START, simulated, small_fit

from pgrssnn_jax.models.initial_state import InitialState, start_state
from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.scaling import model_scaling
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Signal
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.record import cast, crop
from pgrssnn_jax.training.members import select
from pgrssnn_jax.training.objective import build_objective


def alone(samples: int = 60):
    physics = cascaded_tanks()
    model = build_model(ModelSpec(networks=False), physics)
    record = cast(simulated(physics, samples=samples, seed=3), np.float32)
    return model, ModelParams({}, physics.params, model_scaling(model, record)), record


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
    model, params, record = alone()
    found = start_state(model, params, record, InitialState("estimated", n_init=30))
    np.testing.assert_allclose(found[0], START, atol=0.02)


def test_the_estimate_sees_the_first_samples_alone():
    model, params, record = alone()
    initial = InitialState("estimated", n_init=12)
    other = record._replace(y=np.where(np.arange(60)[None, :, None] < 12, record.y, 99.0).astype(np.float32))
    np.testing.assert_array_equal(
        start_state(model, params, record, initial), start_state(model, params, other, initial)
    )


def test_masked_samples_do_not_count_in_the_estimate():
    model, params, record = alone()
    initial = InitialState("estimated", n_init=30)
    hidden = np.ones(record.y.shape, bool)
    hidden[:, 5:9] = False
    wrong = record._replace(y=np.where(hidden, record.y, 50.0).astype(np.float32), mask=hidden)
    np.testing.assert_allclose(start_state(model, params, wrong, initial)[0], START, atol=0.03)


def test_one_sample_is_enough_to_stay_finite():
    model, params, record = alone()
    found = start_state(model, params, record, InitialState("estimated", n_init=1))
    assert np.isfinite(found).all()


def test_a_diverging_model_keeps_the_guess():
    model, params, record = alone()
    physics = model.physics._replace(step=lambda p, x, u: x * jnp.nan)
    found = start_state(model._replace(physics=physics), params, record, InitialState("estimated", n_init=5))
    np.testing.assert_array_equal(found, start_state(model, params, record, InitialState("first_output")))


@pytest.mark.parametrize("kind", ["first_output", "estimated"])
def test_a_shared_start_is_the_training_records(kind):
    initial = InitialState(kind, n_init=10, shared=True)
    fit, data = small_fit(initial=initial, members=1)
    one = select(data, 0)
    theta = fit.objective.begin(jax.random.key(0), one)
    test = one.validation
    trained = fit.objective.trained_start(theta, one)
    start = fit.objective.test_state(theta, one.scaling, trained, test)
    np.testing.assert_array_equal(start, trained[None])
    np.testing.assert_allclose(start, np.full((1, 2), one.train.y[0, 0, 0]), rtol=1e-5)
    own = build_objective(fit.objective.model, InitialState(kind, n_init=10)).test_state(
        theta, one.scaling, trained, test
    )
    assert not np.allclose(own, start, atol=1e-3)


def test_training_sequences_have_trained_starts():
    fit, data = small_fit(initial=InitialState("estimated", n_init=10, shared=True), members=1)
    one = select(data, 0)
    theta = fit.objective.begin(jax.random.key(0), one)
    assert theta.x0.shape == (1, 2)
    gradient = jax.grad(lambda t: fit.objective.on_train(t, one).total)(theta)
    assert np.all(np.asarray(gradient.x0) != 0)


def test_impossible_settings_are_named():
    with pytest.raises(ValueError, match="n_init: expected at least 1 sample for initial_state=estimated, found 0"):
        InitialState("estimated")
    with pytest.raises(ValueError, match="n_init: expected 0 or more"):
        InitialState("zero", n_init=-1)


def test_a_validation_record_goes_on_from_the_training_record():
    """Cut from one record, its run is the tail of the run over both; from another record its start is estimated."""
    initial = InitialState("estimated", n_init=10, shared=True)
    fit, data = small_fit(initial=initial, members=1)
    one = select(data, 0)
    whole = cast(simulated(cascaded_tanks(), samples=80, seed=3), np.float32)
    cut = one._replace(train=crop(whole, 0, 48), validation=crop(whole, 48, 80))
    theta = fit.objective.begin(jax.random.key(0), cut)
    params = fit.objective.assemble(theta, cut.scaling)
    start = fit.objective.test_state(theta, cut.scaling, fit.objective.trained_start(theta, cut), cut.validation)
    expected = rollout(fit.objective.model, params, whole.u, start)
    found = fit.objective.validate(theta, cut)
    np.testing.assert_allclose(found.y, expected.y[:, 48:], rtol=1e-6)
    assert found.first_bad == 32
    elsewhere = cut._replace(validation=crop(whole, 47, 79))
    assert not np.allclose(fit.objective.validate(theta, elsewhere).y[:, 1:], found.y[:, :-1], atol=1e-4)


def test_a_run_that_failed_before_the_validation_record_has_failed_there():
    fit, data = small_fit(initial=InitialState("estimated", n_init=10), members=1)
    whole = cast(simulated(cascaded_tanks(), samples=80, seed=3), np.float32)
    cut = select(data, 0)._replace(train=crop(whole, 0, 48), validation=crop(whole, 48, 80))
    theta = fit.objective.begin(jax.random.key(0), cut)
    lost = theta._replace(x0=jnp.full_like(theta.x0, jnp.nan))
    assert fit.objective.validate(lost, cut).first_bad == 0
    assert not fit.objective.on_validation(lost, cut).finite


def test_a_record_of_training_seen_as_a_test_record_starts_from_its_first_samples():
    """What later samples say of the start is unknown of a test record; a shared start is known."""
    whole = cast(simulated(cascaded_tanks(), samples=60, seed=3, noise=0.3), np.float32)
    again = whole._replace(info=replace(whole.info, same_run=True))
    for shared in (False, True):
        initial = InitialState("least_squares", n_init=8, shared=shared)
        fit, data = small_fit(initial=initial, members=1)
        one = select(data, 0)._replace(train=whole, validation=again)
        theta = fit.objective.begin(jax.random.key(0), one)
        params = fit.objective.assemble(theta, one.scaling)
        first = whole if shared else crop(whole, 0, 8)
        start = (
            fit.objective.trained_start(theta, one)[None]
            if shared
            else start_state(fit.objective.model, params, first, initial)
        )
        expected = rollout(fit.objective.model, params, whole.u, start)
        np.testing.assert_allclose(fit.objective.as_tested(theta, one).y, expected.y, rtol=1e-4, atol=1e-4)
        assert fit.objective.starts_as_tested(again) is not shared
