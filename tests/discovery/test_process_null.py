"""p-values of an axis that a disturbance moves: of effects that are not there, and of one that is."""

import numpy as np
import pytest
from discovery.test_null import gained, linearised
from discovery.test_process_noise import SAMPLES, A, axis, disturbed

from pgrssnn_jax.discovery.kalman import Models
from pgrssnn_jax.discovery.likelihood import Linearisation, noise_of
from pgrssnn_jax.discovery.null import null_distribution
from pgrssnn_jax.discovery.process_null import Fitted, against_process_noise
from pgrssnn_jax.discovery.settings import Criteria

TESTS = 40
CRITERIA = Criteria(draws=199)


def forced(force: np.ndarray) -> np.ndarray:
    """Position of the axis under a force."""
    x, found = np.zeros(2), np.zeros(len(force))
    for t, one in enumerate(force):
        x = A @ x + [0.0, one]
        found[t] = x[0]
    return found


def p_values(seed: int, size: float, hidden: float = 0.0) -> tuple[float, float]:
    """Least p-values of six constant or switching forces, by coloured noise and against a disturbance. hidden: size of
    the first of them."""
    rng = np.random.default_rng(seed)
    force = np.sign(np.sin(2 * np.pi * np.arange(SAMPLES) * np.arange(6)[:, None] / SAMPLES + 0.5))
    catalogue = [(f"force {k}", forced(one)[:, None]) for k, one in enumerate(force)]
    columns = np.column_stack([np.ones(SAMPLES), forced(np.eye(1, SAMPLES)[0])])  # position and speed at the start
    error = disturbed(size, rng) + hidden * catalogue[0][1][:, 0]
    at = linearised(error, columns)
    null = null_distribution(at, noise_of(at).recoloured, catalogue, 199, 100, rng)
    fits = [
        Fitted(name, gained(error, columns, own), lambda own=own: (linearised(error, np.hstack([columns, own])), None))
        for name, own in catalogue
    ]
    other = against_process_noise(null, at, catalogue, fits, axis, CRITERIA, rng)
    return tuple(min(one.p_value(fit.name, fit.gain) for fit in fits) for one in (null, other))


def test_what_a_disturbance_does_is_no_effect():
    """By an autoregression of the errors more than a tenth of these disturbances are one, at the 1 % level."""
    coloured, found = np.array([p_values(seed, 0.1) for seed in range(TESTS)]).T
    assert (coloured <= 0.01).mean() > 0.1
    assert (found <= 0.01).mean() <= 0.025


def test_what_is_there_is_found_beside_a_disturbance():
    found = np.array([p_values(seed, 0.03, hidden=0.03)[1] for seed in range(8)])
    assert (found <= 0.01).all()


@pytest.mark.parametrize("seed", range(3))
def test_without_a_disturbance_the_null_of_coloured_noise_stays(seed):
    coloured, found = p_values(seed, 0.0)
    assert found == coloured


def in_sequences(at: Linearisation, count: int) -> Linearisation:
    error, columns, measured = (a.reshape(count, -1, *a.shape[2:]) for a in (at.error, at.columns, at.measured))
    return at._replace(error=error, columns=columns, measured=measured)


@pytest.mark.parametrize("sequences", [1, 20])
def test_what_is_far_likelier_in_noise_of_almost_any_kind_needs_no_disturbance(sequences):
    rng = np.random.default_rng(0)
    push = forced(np.sign(np.sin(0.05 * np.arange(SAMPLES))))[:, None]
    columns = np.column_stack([np.ones(SAMPLES), forced(np.eye(1, SAMPLES)[0])])
    error = disturbed(0.03, rng) + 0.5 * push[:, 0]
    at, beside = linearised(error, columns), linearised(error, np.hstack([columns, push]))
    at, beside = in_sequences(at, sequences), in_sequences(beside, sequences)
    null = null_distribution(at, noise_of(beside).recoloured, [("push", push)], 199, 100, rng)
    fit = Fitted("push", gained(error, columns, push), lambda: (beside, None))
    assert null.p_value("push", fit.gain) <= 0.01

    def unused() -> Models:
        raise AssertionError("no disturbance is tried")

    assert against_process_noise(null, at, [("push", push)], [fit], unused, CRITERIA, rng) is null
