"""Filters of two models that change from sample to sample, against dense matrices."""

import numpy as np
import pytest
from scipy import stats

from pgrssnn_jax.discovery.kalman import (
    Filters,
    Models,
    answers,
    filters,
    innovations,
    unmeasured_variance,
)

SAMPLES = 60
WHITE, SIZE = np.array([0.3, 0.7]), np.array([0.8, 1.7])
BOTH = np.arange(2)


def models(after: bool, missing: bool) -> Models:
    """Two states, two outputs, and two ways in which a disturbance enters."""
    rng = np.random.default_rng(0)
    a = np.array([[0.9, 0.2], [-0.1, 0.8]]) + 0.1 * rng.standard_normal((2, 1, SAMPLES, 2, 2))
    measured = np.ones((1, SAMPLES, 2), bool)
    if missing:
        measured = rng.random((1, SAMPLES, 2)) > 0.3
        measured[0, 20:25] = False
    g, c = rng.standard_normal((2, 1, SAMPLES, 2)), rng.standard_normal((1, SAMPLES, 2, 2))
    return Models(a, g, c, measured, after)


def dense_covariance(where: Models, k: int) -> np.ndarray:
    """C P Cᵀ of all readings `[time y, time y]` by a disturbance of size 1: every push followed by itself."""
    answered = np.zeros((SAMPLES, SAMPLES, 2))  # push, time, output
    for push in range(SAMPLES):
        x = np.zeros(2)
        for t in range(push, SAMPLES):
            old = x
            x = where.a[k, 0, t] @ x + (where.g[k, 0, t] if t == push else 0.0)
            answered[push, t] = where.c[0, t] @ (x if where.after else old)
    h = answered.reshape(SAMPLES, -1)
    return h.T @ h


@pytest.fixture(params=[(True, False), (False, False), (True, True), (False, True)])
def where(request: pytest.FixtureRequest) -> Models:
    return models(*request.param)


def known(where: Models) -> Filters:
    return filters(where, BOTH, SIZE, WHITE)


def test_innovations_have_the_likelihood_of_the_dense_covariance(where):
    there, both = where.measured.ravel(), known(where)
    error = np.where(there, np.random.default_rng(2).standard_normal(2 * SAMPLES), 0.0)
    by_both = innovations(where, both, error.reshape(1, SAMPLES, 2, 1))
    for k in BOTH:
        covariance = SIZE[k] ** 2 * dense_covariance(where, k) + np.diag(np.tile(WHITE, SAMPLES))
        expected = stats.multivariate_normal.logpdf(
            error[there], np.zeros(there.sum()), covariance[np.ix_(there, there)]
        )
        one = both.some(np.array([k]))
        (found,) = innovations(where, one, error.reshape(1, SAMPLES, 2, 1))[..., 0]
        each = stats.norm.logpdf(found, scale=one.variance[0] ** 0.5)[where.measured]
        assert each.sum() == pytest.approx(expected, rel=1e-9)
        np.testing.assert_allclose(by_both[k, ..., 0], found, atol=1e-13)


def test_without_measurements_a_reading_varies_as_the_dense_covariance_says(where):
    found = unmeasured_variance(where)
    for k in BOTH:
        np.testing.assert_allclose(found[k, 0].ravel(), np.diag(dense_covariance(where, k)), rtol=1e-10, atol=1e-14)


def test_answers_are_the_transpose_of_errors_by_innovations(where):
    """W⁻ᵀ v · W e = v · e"""
    rng, one = np.random.default_rng(4), known(where).some(np.array([1]))
    there = where.measured[..., None]
    errors, columns = (np.where(there, rng.standard_normal((1, SAMPLES, 2, 3)), 0.0) for _ in "ab")
    products = (innovations(where, one, errors)[0] * answers(where, one, columns)).sum((0, 1, 2))
    np.testing.assert_allclose(products, (errors * columns).sum((0, 1, 2)), rtol=1e-10)


def test_filters_of_a_part_are_the_first_part_of_all(where):
    whole, part = known(where), filters(where.first(25), BOTH, SIZE, WHITE)
    np.testing.assert_array_equal(part.gains, whole.gains[:, :, :25])
    np.testing.assert_array_equal(part.variance, whole.variance[:, :, :25])


@pytest.mark.parametrize(("samples", "shape"), [(50, (2, 20)), (30, (1, 20)), (7, (1, 7)), (1000, (3, 20))])
def test_the_first_samples_are_those_of_whole_sequences(samples, shape):
    a, g = np.zeros((2, 3, 20, 2, 2)), np.zeros((2, 3, 20, 2))
    part = Models(a, g, np.zeros((3, 20, 1, 2)), np.ones((3, 20, 1), bool), True).first(samples)
    assert part.a.shape[1:3] == part.g.shape[1:3] == part.c.shape[:2] == part.measured.shape[:2] == shape
