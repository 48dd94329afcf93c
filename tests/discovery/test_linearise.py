"""What of an effect the free numbers of a physics cannot take up."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.likelihood import Linearisation
from pgrssnn_jax.discovery.linearise import visible


def test_an_effect_is_redundant_if_each_of_its_numbers_is():
    """Two outputs whose common gain is a number of the physics."""
    first, second = np.zeros((2, 1, 50, 2))
    first[..., 0], second[..., 1] = np.random.default_rng(0).standard_normal((2, 1, 50))
    both = (first + second)[..., None]
    zero = np.zeros(1)
    at = Linearisation(np.zeros(first.shape), both, np.ones(first.shape, bool), zero, zero)
    together, one, other = (a.reshape(-1) for a in (both, first, second))
    effects = [("common", np.stack([together, together], 1)), ("of each", np.stack([together, one, other], 1))]
    found = visible(at, effects)
    energy = (together**2).sum()
    assert found["common"] == (pytest.approx(energy), pytest.approx(0.0, abs=1e-20 * energy))
    moved, left = found["of each"]
    assert moved == pytest.approx(energy)
    shares = [(a**2).sum() / energy for a in (one, other)]
    assert left == pytest.approx(energy * (1.0 - min(shares)))  # of a gain that the common one does not contain
