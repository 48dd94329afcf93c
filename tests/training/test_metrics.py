import jax.numpy as jnp
import nonlinear_benchmarks.error_metrics as published
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pgrssnn_jax.training.metrics import correlation, fit_percent, nrmse, rmse

ALL = [rmse, nrmse, fit_percent, correlation]
MEASURED = np.random.default_rng(0).normal([1.0, -5.0], [2.0, 0.3], size=(3, 20, 2))
PREDICTED = MEASURED + np.random.default_rng(1).normal(0.2, 0.5, size=MEASURED.shape)

values = st.floats(-100.0, 100.0).map(lambda a: round(a, 3))
shapes = hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=6)
pairs = shapes.flatmap(
    lambda s: st.tuples(hnp.arrays(float, s, elements=values), hnp.arrays(float, s, elements=values))
)
quick = settings(deadline=None, max_examples=60, derandomize=True)


def varies(a):
    return (a.std((0, 1)) > 1e-3).all()


@pytest.mark.parametrize("n_init", [0, 1, 7])
def test_one_sequence_equals_the_benchmarks_own_metrics(n_init):
    y, y_hat = MEASURED[0], PREDICTED[0]
    for ours, theirs in [
        (rmse, published.RMSE),
        (nrmse, published.NRMSE),
        (fit_percent, published.fit_index),
    ]:
        found = ours(measured=y[None], predicted=y_hat[None], n_init=n_init)
        np.testing.assert_allclose(found, theirs(y, y_hat, n_init=n_init), rtol=1e-12, err_msg=ours.__name__)
    found = correlation(measured=y[None], predicted=y_hat[None], n_init=n_init)
    for j in range(2):
        np.testing.assert_allclose(found[j], np.corrcoef(y[n_init:, j], y_hat[n_init:, j])[0, 1], rtol=1e-12)


@pytest.mark.parametrize("figure", ALL)
def test_sequences_count_as_one_long_one_without_their_first_samples(figure):
    y, y_hat = (a[:, 4:].reshape(1, -1, 2) for a in (MEASURED, PREDICTED))
    np.testing.assert_allclose(
        figure(measured=MEASURED, predicted=PREDICTED, n_init=4),
        figure(measured=y, predicted=y_hat, n_init=0),
        rtol=1e-12,
    )


@pytest.mark.parametrize("figure", ALL)
def test_masked_samples_do_not_count(figure):
    mask = np.random.default_rng(2).random(MEASURED.shape) > 0.3
    spoilt = np.where(mask, PREDICTED, 1e9)
    found = figure(measured=np.where(mask, MEASURED, -7e8), predicted=spoilt, n_init=2, mask=mask)
    for j in range(2):
        keep = mask[:, 2:, j]
        y, y_hat = (a[:, 2:, j][keep].reshape(1, -1, 1) for a in (MEASURED, PREDICTED))
        np.testing.assert_allclose(found[j], figure(measured=y, predicted=y_hat, n_init=0)[0], rtol=1e-9)


@pytest.mark.parametrize("figure", ALL)
def test_a_mask_that_is_all_true_changes_nothing_and_one_that_is_all_false_leaves_no_number(figure):
    given_all = figure(measured=MEASURED, predicted=PREDICTED, n_init=0, mask=np.ones(MEASURED.shape, bool))
    np.testing.assert_array_equal(given_all, figure(measured=MEASURED, predicted=PREDICTED, n_init=0))
    mask = np.ones(MEASURED.shape, bool)
    mask[..., 1] = False
    found = figure(measured=MEASURED, predicted=PREDICTED, n_init=0, mask=mask)
    assert np.isfinite(found[0])
    assert np.isnan(found[1])


@quick
@given(pairs)
def test_rmse_is_the_root_of_the_mean_square(pair):
    y, y_hat = pair
    expected = np.sqrt(np.mean((y - y_hat) ** 2, axis=(0, 1)))
    np.testing.assert_allclose(rmse(measured=y, predicted=y_hat, n_init=0), expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(
        rmse(measured=y, predicted=y_hat, n_init=0), rmse(measured=y_hat, predicted=y, n_init=0)
    )


@quick
@given(pairs, st.floats(0.01, 100.0), st.floats(-100.0, 100.0))
def test_units_do_not_matter_to_nrmse_fit_and_cc(pair, scale, offset):
    y, y_hat = pair
    assume(varies(y))
    assume(varies(y_hat))
    for figure in (nrmse, fit_percent, correlation):
        np.testing.assert_allclose(
            figure(measured=offset + scale * y, predicted=offset + scale * y_hat, n_init=0),
            figure(measured=y, predicted=y_hat, n_init=0),
            rtol=1e-6,
            atol=1e-6,
        )


@quick
@given(pairs)
def test_fit_says_what_nrmse_says_and_cc_stays_in_its_bounds(pair):
    y, y_hat = pair
    assume(varies(y))
    share = nrmse(measured=y, predicted=y_hat, n_init=0)
    np.testing.assert_allclose(
        fit_percent(measured=y, predicted=y_hat, n_init=0), 100 * (1 - share), rtol=1e-12, atol=1e-9
    )
    cc = correlation(measured=y, predicted=y_hat, n_init=0)
    assert (np.isnan(cc) | (np.abs(cc) <= 1 + 1e-12)).all()


def test_perfect_mean_and_mirrored_predictions():
    y = MEASURED
    mean = np.broadcast_to(y.mean((0, 1)), y.shape)
    for predicted, expected in [
        (y, {rmse: 0.0, nrmse: 0.0, fit_percent: 100.0, correlation: 1.0}),
        (mean, {rmse: y.std((0, 1)), nrmse: 1.0, fit_percent: 0.0}),
        (-y, {correlation: -1.0}),
        (3 * y - 8, {correlation: 1.0}),
    ]:
        for figure, value in expected.items():
            found = figure(measured=y, predicted=predicted, n_init=0)
            np.testing.assert_allclose(found, np.broadcast_to(value, 2), atol=1e-9)


def test_nrmse_is_not_symmetric():
    """Which of the two gives the deviation matters: hence keywords only."""
    a = nrmse(measured=MEASURED, predicted=PREDICTED, n_init=0)
    b = nrmse(measured=PREDICTED, predicted=MEASURED, n_init=0)
    assert (np.abs(a - b) > 1e-3).any()


@pytest.mark.parametrize("figure", ALL)
def test_arguments_are_keywords_and_n_init_is_said(figure):
    with pytest.raises(TypeError):
        figure(MEASURED, PREDICTED, n_init=0)
    with pytest.raises(TypeError):
        figure(measured=MEASURED, predicted=PREDICTED)


@pytest.mark.parametrize("value", [0.0, 2.0, -2.0])
def test_a_constant_output_has_no_nrmse_fit_or_cc(value):
    constant, mask = np.full(MEASURED.shape, value), np.ones(MEASURED.shape, bool)
    mask[:, 1] = False
    for figure in (nrmse, fit_percent, correlation):
        for counted in (None, mask):
            assert np.isnan(figure(measured=constant, predicted=PREDICTED, n_init=0, mask=counted)).all()
    assert np.isnan(correlation(measured=MEASURED, predicted=constant, n_init=0)).all()
    assert np.isfinite(nrmse(measured=MEASURED, predicted=constant, n_init=0)).all()


@pytest.mark.parametrize("figure", [nrmse, fit_percent, correlation])
def test_a_constant_output_whose_mean_is_rounded_has_none_either(figure):
    constant = np.full((1, 7, 1), 0.1)
    assert constant.std() > 0  # rounding alone
    assert np.isnan(figure(measured=constant, predicted=MEASURED[:1, :7, :1], n_init=0)).all()


@pytest.mark.parametrize("figure", ALL)
def test_a_prediction_that_is_not_a_number_spoils_its_own_output_alone(figure):
    spoilt = PREDICTED.copy()
    spoilt[1, 3, 0] = np.nan
    found = figure(measured=MEASURED, predicted=spoilt, n_init=0)
    assert np.isnan(found[0])
    np.testing.assert_array_equal(found[1], figure(measured=MEASURED, predicted=PREDICTED, n_init=0)[1])


@pytest.mark.parametrize(("figure", "expected"), [(rmse, np.inf), (nrmse, np.inf), (fit_percent, -np.inf)])
def test_an_infinite_prediction_has_an_infinite_error(figure, expected):
    spoilt = PREDICTED.copy()
    spoilt[1, 3, 0], spoilt[1, 4, 0] = np.inf, -np.inf
    found = figure(measured=MEASURED, predicted=spoilt, n_init=0)
    assert found[0] == expected
    assert np.isfinite(found[1])


def test_an_infinite_prediction_has_no_correlation():
    spoilt = PREDICTED.copy()
    spoilt[1, 3, 0], spoilt[1, 4, 0] = np.inf, -np.inf
    assert np.isnan(correlation(measured=MEASURED, predicted=spoilt, n_init=0)[0])


@pytest.mark.parametrize("figure", ALL)
def test_figures_are_double_precision_whatever_comes(figure):
    y, y_hat = jnp.asarray(MEASURED, jnp.float32), jnp.asarray(PREDICTED, jnp.float32)
    found = figure(measured=y, predicted=y_hat, n_init=0)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(
        found, figure(measured=np.asarray(y, float), predicted=np.asarray(y_hat, float), n_init=0)
    )


@pytest.mark.parametrize("figure", ALL)
def test_bad_shapes_are_named(figure):
    with pytest.raises(ValueError, match=r"predicted: expected shape \(3, 20, 2\), found \(3, 19, 2\)"):
        figure(measured=MEASURED, predicted=PREDICTED[:, 1:], n_init=0)
    for n_init in (-1, 20, 21):
        with pytest.raises(ValueError, match=rf"n_init: expected 0 to 19, found {n_init}"):
            figure(measured=MEASURED, predicted=PREDICTED, n_init=n_init)


def test_a_missing_sequence_axis_is_named():
    with pytest.raises(ValueError, match="measured: expected"):
        rmse(measured=MEASURED[0], predicted=PREDICTED[0], n_init=0)
