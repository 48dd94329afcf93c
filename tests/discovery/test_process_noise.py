"""A disturbance of the dynamics under white noise: its likelihood by dense matrices, and what it is told from."""

import numpy as np
import pytest
from discovery.test_null import linearised
from scipy import stats

from pgrssnn_jax.discovery.likelihood import Linearisation, noise_of
from pgrssnn_jax.discovery.process_noise import (
    Plant,
    ProcessNoise,
    _answered,
    _filters,
    _through,
    disturbances,
    process_noise,
)

SAMPLES = 60
RAMP = np.column_stack([np.ones(400), np.linspace(-1.0, 1.0, 400)])  # of another start
WHITE = np.array([0.3, 0.7])


def plant(after: bool, measured: np.ndarray | None = None) -> Plant:
    """Two states, two outputs, one place at which a disturbance enters; nothing stays as it is from sample to
    sample."""
    rng = np.random.default_rng(0)
    a = np.array([[0.9, 0.2], [-0.1, 0.8]]) + 0.1 * rng.standard_normal((1, SAMPLES, 2, 2))
    c = rng.standard_normal((1, SAMPLES, 2, 2))
    there = np.ones((1, SAMPLES, 2), bool) if measured is None else measured
    return Plant(a, c, there, rng.standard_normal((1, 1, SAMPLES, 2)), after)


def gaps() -> np.ndarray:
    measured = np.random.default_rng(1).random((1, SAMPLES, 2)) > 0.3
    measured[0, 20:25] = False
    return measured


def dense_covariance(where: Plant) -> np.ndarray:
    """Of all readings `[time y, time y]`: every disturbance followed by itself."""
    n_y = where.c.shape[2]
    answers = np.zeros((SAMPLES, SAMPLES, n_y))  # disturbance, time, output
    for k in range(SAMPLES):
        x = np.zeros(2)
        for t in range(k, SAMPLES):
            old = x
            x = where.a[0, t] @ x + (where.entering[0, 0, t] if t == k else 0.0)
            answers[k, t] = where.c[0, t] @ (x if where.after else old)
    h = answers.reshape(SAMPLES, -1)
    return h.T @ h + np.diag(np.tile(WHITE, SAMPLES))


@pytest.mark.parametrize("after", [True, False])
@pytest.mark.parametrize("missing", [True, False])
def test_innovations_have_the_likelihood_of_the_dense_covariance(after, missing):
    where = plant(after, gaps() if missing else None)
    there = where.measured.ravel()
    covariance = dense_covariance(where)[np.ix_(there, there)]
    error = np.zeros(2 * SAMPLES)
    error[there] = np.random.default_rng(2).multivariate_normal(np.zeros(there.sum()), covariance)
    chosen = _filters(where, where.entering, WHITE, SAMPLES)
    innovations = _through(where, chosen, error.reshape(1, SAMPLES, 2, 1), whiten=True)[..., 0]
    found = stats.norm.logpdf(innovations, scale=chosen.variance[0] ** 0.5)[where.measured].sum()
    expected = stats.multivariate_normal.logpdf(error[there], np.zeros(there.sum()), covariance)
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("after", [True, False])
def test_errors_of_innovations_have_these_innovations(after):
    where = plant(after, gaps())
    chosen = _filters(where, where.entering, WHITE, SAMPLES)
    drawn = np.where(where.measured, np.random.default_rng(3).standard_normal((1, SAMPLES, 2)), 0.0)[..., None]
    errors = _through(where, chosen, drawn, whiten=False)
    np.testing.assert_allclose(_through(where, chosen, errors, whiten=True), drawn, atol=1e-12)
    assert np.abs(errors - drawn).max() > 0.1


def likeliest(where: Plant, at: Linearisation) -> ProcessNoise:
    tried = disturbances(where, at)
    assert tried is not None
    return process_noise(tried, at)


def axis(samples: int) -> Plant:
    """Position and speed, of which the position is read; disturbances may move the one or the other."""
    a = np.tile([[1.0, 0.1], [0.0, 0.98]], (1, samples, 1, 1))
    c = np.tile([[1.0, 0.0]], (1, samples, 1, 1))
    entering = np.broadcast_to(np.eye(2)[:, None, None], (2, 1, samples, 2))
    return Plant(a, c, np.ones((1, samples, 1), bool), entering, after=True)


def disturbed(size: float, rng: np.random.Generator, samples: int = 400) -> np.ndarray:
    """Errors in the position: white ones, and those of a disturbance of the speed."""
    x, found = np.zeros(2), np.zeros(samples)
    for t in range(samples):
        x = np.array([[1.0, 0.1], [0.0, 0.98]]) @ x + [0.0, size * rng.standard_normal()]
        found[t] = x[0] + rng.standard_normal()
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_disturbance_of_the_speed_is_told_from_coloured_noise(seed):
    at = linearised(disturbed(0.1, np.random.default_rng(seed)), np.ones((400, 1)))
    found = likeliest(axis(400), at)
    assert found.likelihood > noise_of(at).likelihood(at.measured) + 5.0
    white = found.innovations[0, :, 0] / found.filters.variance[0, 0, :, 0] ** 0.5
    assert np.abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.12


def test_the_place_where_a_disturbance_enters_is_mostly_told():
    found = [likeliest(axis(400), linearised(disturbed(0.1, np.random.default_rng(k)), RAMP)) for k in range(8)]
    assert sum(one.place == 1 for one in found) >= 6


@pytest.mark.parametrize("seed", range(4))
def test_coloured_noise_of_the_sensor_is_likelier_as_what_it_is(seed):
    rng, error = np.random.default_rng(seed), np.zeros(400)
    for t in range(1, 400):  # which changes its sign from sample to sample: no disturbance passes an axis so
        error[t] = -0.8 * error[t - 1] + rng.standard_normal()
    at = linearised(error, np.ones((400, 1)))
    found = likeliest(axis(400), at)
    assert found.likelihood < noise_of(at).likelihood(at.measured)


def test_no_disturbance_is_found_where_none_reaches_an_output():
    where = axis(50)
    at = linearised(np.random.default_rng(0).standard_normal(50), np.ones((50, 1)))
    assert disturbances(where._replace(c=0.0 * where.c), at) is None


def test_draws_have_the_size_and_the_slowness_of_the_errors():
    rng = np.random.default_rng(5)
    at = linearised(disturbed(0.1, rng), np.ones((400, 1)))
    found = likeliest(axis(400), at)
    drawn = found.recoloured(200, rng)[:, 0, :, 0]
    grown = drawn.var(0)
    assert grown[-100:].mean() > 3.0 * grown[:100].mean()  # for ever larger, as those of an axis are
    steps = np.diff(drawn, axis=1).var(), np.diff(disturbed(0.1, rng)).var()
    assert steps[0] == pytest.approx(steps[1], rel=0.2)


def test_a_long_record_is_judged_by_its_first_part(monkeypatch):
    at = linearised(disturbed(0.1, np.random.default_rng(6)), np.ones((400, 1)))
    whole = likeliest(axis(400), at)
    monkeypatch.setattr("pgrssnn_jax.discovery.process_noise._ENOUGH", 300)
    part = likeliest(axis(400), at)
    assert part.innovations.shape == whole.innovations.shape
    assert part.likelihood == pytest.approx(whole.likelihood, abs=3.0)


@pytest.mark.parametrize("after", [True, False])
def test_what_innovations_do_to_columns_is_the_transpose_of_what_they_do_to_errors(after):
    where, rng = plant(after, gaps()), np.random.default_rng(4)
    chosen = _filters(where, where.entering, WHITE, SAMPLES)
    drawn, columns = (np.where(where.measured[..., None], rng.standard_normal((1, SAMPLES, 2, 3)), 0.0) for _ in "ab")
    errors = _through(where, chosen, drawn, whiten=False)
    answered = np.where(where.measured[..., None], _answered(where, chosen, columns), 0.0)
    np.testing.assert_allclose((errors * columns).sum((0, 1, 2)), (drawn * answered).sum((0, 1, 2)), rtol=1e-10)


def test_the_sandwich_of_a_disturbance_has_the_spread_of_estimates():
    """A slope fitted to 200 records of a disturbed axis."""
    estimates, deviations = [], []
    for seed in range(200):
        error = disturbed(0.1, np.random.default_rng(seed))
        estimates.append(np.linalg.lstsq(RAMP, error, rcond=None)[0][1])
        if seed < 20:
            at = linearised(error, RAMP)
            deviations.append(likeliest(axis(400), at).covariance(at, 1.0)[1, 1] ** 0.5)
    assert np.median(deviations) == pytest.approx(np.std(estimates), rel=0.3)
