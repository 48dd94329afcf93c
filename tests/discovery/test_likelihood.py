"""Predictions of left-out blocks against refits, and covariances against many records of a linear regression."""

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from pgrssnn_jax.discovery.likelihood import Linearisation, covariance, deviations, left_out, noise_of
from pgrssnn_jax.discovery.problem import ALWAYS

SAMPLES = 400


def regressors(seed: int = 0) -> np.ndarray:
    slow = lfilter([1.0], [1.0, -0.9], np.random.default_rng(seed).standard_normal(SAMPLES))
    return np.column_stack([np.ones(SAMPLES), slow, np.sin(np.arange(SAMPLES) / 20)])


def linearised(error: np.ndarray, columns: np.ndarray, precision=None, pull=None) -> Linearisation:
    k = columns.shape[1]
    zero = np.zeros(k)
    measured = np.ones((1, len(error), 1), bool)
    prior = (zero if precision is None else precision, zero if pull is None else pull)
    return Linearisation(error[None, :, None], columns[None, :, None], measured, *prior)


@pytest.mark.parametrize("precision", [0.0, 30.0])
def test_left_out_blocks_are_predicted_as_by_refits(precision):
    """A prior is a further row of every refit; samples that are always fitted or not measured are not scored."""
    rng, columns = np.random.default_rng(1), regressors()
    error, expected = columns @ [1.0, -2.0, 0.5] + rng.standard_normal(SAMPLES), np.array([0.8, -1.0, 0.0])
    fold = np.where(np.arange(SAMPLES) < 32, ALWAYS, np.arange(SAMPLES) // 16 % 5)
    held = np.full(3, precision)
    at = linearised(error, columns, held, held * expected)
    at.measured[0, 100:110] = False
    at = at._replace(error=np.where(at.measured, at.error, 0.0))
    squares, counts = left_out(at, fold[None], 16)
    measured, left = at.measured[0, :, 0], np.zeros(SAMPLES)
    for f in range(5):
        rest = measured & (fold != f)
        rows = np.vstack([columns[rest], np.sqrt(precision) * np.eye(3)])
        found = np.linalg.lstsq(rows, np.append(error[rest], np.sqrt(precision) * expected), rcond=None)[0]
        left[fold == f] = (error - columns @ found)[fold == f]
    scored = measured & (fold >= 0)
    np.testing.assert_array_equal(counts, scored.reshape(-1, 16).sum(1))
    np.testing.assert_allclose(squares, (scored * left**2).reshape(-1, 16).sum(1), rtol=1e-6)


def test_a_number_that_one_fold_alone_tells_stays_where_that_fold_is_predicted():
    """The second limit of a boiler, which a few samples touch: by a line it would go anywhere, and all else be lost."""
    columns, rng = regressors(), np.random.default_rng(2)
    touched = np.zeros(SAMPLES)
    touched[168:172] = 0.01, 0.02, 0.02, 0.01
    touched[300] = 1e-9  # of rounding
    at = linearised(rng.standard_normal(SAMPLES), np.column_stack([columns, touched]))
    fold = np.arange(SAMPLES) // 16 % 5
    squares, _ = left_out(at, fold[None], 16)
    without, _ = left_out(linearised(at.error[0, :, 0], columns), fold[None], 16)
    block = 168 // 16
    assert squares[block] == pytest.approx(without[block], rel=0.05)
    np.testing.assert_allclose(squares.sum(), without.sum(), rtol=0.05)


def errors(kind: str, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    if kind == "larger at times":
        return rng.standard_normal(SAMPLES) * (1.0 + 4.0 * (np.sin(np.arange(SAMPLES) / 20) > 0.5))
    return lfilter([1.0], [1.0, -0.9] if kind == "AR(0.9)" else [1.0], rng.standard_normal(SAMPLES))


@pytest.mark.parametrize(
    ("kind", "off", "covered"),
    [
        pytest.param("white", 0.1, 0.92, marks=pytest.mark.slow),
        ("larger at times", 0.15, 0.91),
        ("AR(0.9)", 0.25, 0.86),
    ],
)
def test_deviations_are_those_of_many_records_and_intervals_cover(kind, off, covered):
    columns, records = regressors(), 300
    found, deviation, inside = np.zeros((records, 3)), np.zeros((records, 3)), np.zeros((records, 3), bool)
    for i in range(records):
        error = errors(kind, i)
        found[i] = np.linalg.lstsq(columns, error, rcond=None)[0]
        at = linearised(error - columns @ found[i], columns)
        cov, freedom = covariance(at, noise_of(at), 1.0)
        deviation[i] = np.sqrt(np.diag(cov))
        inside[i] = np.abs(found[i]) <= stats.t.ppf(0.975, freedom) * deviation[i]
    np.testing.assert_allclose(np.sqrt((deviation**2).mean(0)), found.std(0), rtol=off)
    assert inside.mean() >= covered
    assert inside.mean() <= 0.98


@pytest.mark.parametrize(
    ("kind", "by_colour", "by_both"),
    [
        pytest.param("white", (0.91, 0.98), (0.93, 0.99), marks=pytest.mark.slow),
        ("AR(0.9)", (0.86, 0.96), (0.88, 0.98)),
        ("lags", (0, 0.86), (0.88, 0.98)),
    ],
)
def test_intervals_cover_also_where_no_colour_describes_the_errors(kind, by_colour, by_both):
    """Lags: a disturbance and the inputs pass the same ten, so that errors and sensitivities have the same modes, more
    than an autoregression has poles."""

    def lagged(drive: np.ndarray) -> np.ndarray:
        return lfilter([1.0], np.poly([0.8] * 10), drive)

    draw, records = np.random.default_rng(5), 150
    inside = np.zeros((records, 2, 3), bool)
    for i in range(records):
        columns = lagged(draw.standard_normal((3, SAMPLES))).T if kind == "lags" else regressors()
        error = lagged(np.random.default_rng(i).standard_normal(SAMPLES)) if kind == "lags" else errors(kind, i)
        found = np.linalg.lstsq(columns, error, rcond=None)[0]
        at = linearised(error - columns @ found, columns)
        noise = noise_of(at)
        sandwich, freedom = covariance(at, noise, 1.0)
        deviation = np.stack([np.sqrt(np.diag(sandwich)), deviations(at, noise, 1.0)[0]])
        inside[i] = np.abs(found) <= stats.t.ppf(0.975, freedom) * deviation
    for covered, (least, most) in zip(inside.mean((0, 2)), (by_colour, by_both), strict=True):
        assert least <= covered <= most


def test_the_jackknife_is_silent_where_one_block_says_almost_everything():
    """The third regressor moves in one eighth of the record alone."""
    columns = regressors()
    columns[:, 2] *= np.arange(SAMPLES) // (SAMPLES // 8) == 3
    at = linearised(errors("white", 0), columns)
    sandwich, _ = covariance(at, noise_of(at), 1.0)
    assert deviations(at, noise_of(at), 1.0)[0][2] == pytest.approx(np.sqrt(sandwich[2, 2]))


def test_whole_sequences_are_left_out_where_there_are_enough_of_them():
    """Sixteen sequences, two left out at a time."""
    rng, columns = np.random.default_rng(2), regressors() - [0.0, *regressors()[:, 1:].mean(0)]
    error = rng.standard_normal((16, SAMPLES)) + 0.5 * rng.standard_normal((16, 1))  # sequences differ in their mean
    many = np.broadcast_to(columns, (16, SAMPLES, 3))[:, :, None]
    at = Linearisation(error[..., None], many, np.ones((16, SAMPLES, 1), bool), np.zeros(3), np.zeros(3))
    noise = noise_of(at)
    pairs = error.reshape(8, 2, SAMPLES)
    means = np.array([np.delete(pairs, b, 0).mean() for b in range(8)])
    expected = np.sqrt(7 / 8 * ((means - error.mean()) ** 2).sum())
    freedom = covariance(at, noise, 1.0)[1]
    wider = stats.t.ppf(0.975, 7) / stats.t.ppf(0.975, freedom)
    assert deviations(at, noise, 1.0)[0][0] == pytest.approx(wider * expected, rel=0.1)


def test_a_prior_that_is_much_surer_than_the_data_decides():
    """Its variance is what was said: precision Λ in units of the errors' variance."""
    error, variance = 0.3 * errors("white", 0), 0.09
    at = linearised(error, regressors(), np.full(3, 1e9))
    cov, _ = covariance(at, noise_of(at), variance)
    np.testing.assert_allclose(np.diag(cov), variance / 1e9, rtol=1e-3)


def test_correlated_errors_tell_less():
    columns = regressors()
    free = [covariance(at, noise_of(at), 1.0)[1] for at in (linearised(errors(k, 0), columns) for k in KINDS)]
    assert free[0] == pytest.approx(SAMPLES - 3, rel=0.2)
    assert 3.0 <= free[1] < 0.2 * free[0]


KINDS = ("white", "AR(0.9)")


@pytest.mark.parametrize("kind", KINDS)
def test_the_colour_is_that_of_the_errors_although_the_fit_has_bleached_them(kind):
    """Twelve slow columns take up much of what is slow in the errors."""
    columns = np.column_stack([np.cos(np.pi * k * np.arange(SAMPLES) / SAMPLES) for k in range(12)])
    found = []
    for seed in range(20):
        error = errors(kind, seed)
        at = linearised(error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0], columns)
        found.append(noise_of(at).filters[0, 1])
        assert noise_of(at).innovations.std() == pytest.approx(1.0, rel=0.15)
    assert np.mean(found) == pytest.approx(-0.9 if kind == "AR(0.9)" else 0.0, abs=0.12)


def test_an_output_that_was_never_measured_says_nothing():
    draw = np.random.default_rng(0)
    error, measured = draw.standard_normal((1, 200, 2)), np.ones((1, 200, 2), bool)
    measured[..., 1] = False
    columns = np.ones((1, 200, 2, 1)) * measured[..., None]
    at = Linearisation(np.where(measured, error, 0.0), columns, measured, np.zeros(1), np.zeros(1))
    one = Linearisation(*(a[:, :, :1] for a in (at.error, at.columns, at.measured)), at.precision, at.pull)
    found, alone = (noise_of(each).likelihood(each.measured) for each in (at, one))
    assert found == pytest.approx(alone, rel=1e-6)
