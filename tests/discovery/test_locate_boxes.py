"""Boxes, intervals and maps that say where a correction is."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.locate import box, clear, intervals, signal_map
from pgrssnn_jax.physics.base import Signal

SIGNALS = (Signal("level", "V"), Signal("flow"), Signal("pump", "V"))


def values(count: int = 4000) -> np.ndarray:
    return np.random.default_rng(2).uniform(0.0, 10.0, (count, 3))


def test_a_box_of_one_signal_is_found():
    v = values()
    found = box((v[:, 0] > 7.5) * 1.0 + 1e-3, v, SIGNALS)
    assert list(found.region) == ["level"]
    low, high = found.region["level"]
    assert low == pytest.approx(7.5, abs=0.1)
    assert high == np.inf
    assert found.share_of_error > 0.95
    assert found.share_of_samples == pytest.approx(0.25, abs=0.02)
    assert found.rule.startswith(f"level above {low:.3g} V: ")


def test_a_box_of_two_signals_is_found():
    v = values()
    found = box((v[:, 0] > 6.0) * (v[:, 2] <= 3.0) * 1.0, v, SIGNALS)
    assert found.region["level"] == (pytest.approx(6.0, abs=0.5), np.inf)
    assert found.region["pump"] == (-np.inf, pytest.approx(3.0, abs=0.5))
    assert set(found.region) == {"level", "pump"}
    assert found.share_of_error > 0.9
    assert " and " in found.rule


def test_shares_are_those_of_the_region():
    v = values()
    energy = np.random.default_rng(0).exponential(size=len(v)) * (1.0 + 8.0 * (v[:, 1] <= 4.0))
    found = box(energy, v, SIGNALS)
    inside = np.ones(len(v), bool)
    for name, (low, high) in found.region.items():
        signal = v[:, [s.name for s in SIGNALS].index(name)]
        inside &= (signal > low) & (signal <= high)
    assert found.share_of_error == pytest.approx(energy[inside].sum() / energy.sum())
    assert found.share_of_samples == pytest.approx(inside.mean())
    assert f"{100 * found.share_of_error:.0f} % of the error in {100 * found.share_of_samples:.0f} %" in found.rule


@pytest.mark.parametrize("energy", [np.ones(4000), np.zeros(4000)])
def test_what_is_everywhere_has_no_box(energy):
    found = box(energy, values(), SIGNALS)
    assert found.region == {}
    assert found.rule.startswith("everywhere: ")
    assert found.share_of_samples == 1.0


def on(*samples: int, count: int = 40) -> np.ndarray:
    active = np.zeros(count, bool)
    active[list(samples)] = True
    return active


def test_intervals_close_small_gaps_and_drop_single_samples():
    assert intervals(on(5, 6, 7), 2.0) == [(10.0, 16.0)]
    assert intervals(on(5, 6, 10, 11), 1.0) == [(5.0, 12.0)], "a gap of three samples"
    assert intervals(on(5, 6, 11, 12), 1.0) == [(5.0, 7.0), (11.0, 13.0)], "a gap of four"
    assert intervals(on(5, 20, 30, 31), 1.0) == [(30.0, 32.0)]
    assert intervals(on(), 1.0) == []
    assert intervals(on(*range(40)), 0.5) == [(0.0, 20.0)]
    assert intervals(on(5, 6, 8, 9), 1.0, longest_gap=0) == [(5.0, 7.0), (8.0, 10.0)]


def test_clear_is_two_deviations():
    found = clear(np.array([1.9, 2.1, -2.1, 0.0]), np.ones(4))
    np.testing.assert_array_equal(found, [False, True, True, False])


def test_a_map_shows_means_and_leaves_cells_with_few_samples_empty():
    a = np.concatenate([np.full(50, 0.0), np.full(5, 5.0), np.full(60, 10.0)])[None]
    b = np.concatenate([np.full(50, 1.0), np.full(5, 1.0), np.full(60, 3.0)])[None]
    correction = np.where(a == 0.0, 0.5, -2.0)
    found = signal_map(correction, a, b, ("level", "pump"), np.ones(a.shape, bool))
    assert (found.a, found.b) == ("level", "pump")
    assert found.samples.sum() == 115
    assert (found.mean[0, 0], found.samples[0, 0]) == (0.5, 50)
    assert (found.mean[-1, -1], found.samples[-1, -1]) == (-2.0, 60)
    assert np.isfinite(found.mean).sum() == np.isfinite(found.std_error).sum() == 2
    assert np.isnan(found.mean[found.samples == 5]).all()


def test_samples_that_do_not_count_are_in_no_cell():
    a, correction = np.r_[np.zeros(50), np.full(50, 9.0)][None], np.ones((1, 100))
    found = signal_map(correction, a, a, ("a", "b"), a < 5.0)
    assert found.samples.sum() == 50
    assert found.a_edges[-1] < 1e-6


def test_neighbouring_samples_are_one_visit():
    """Sixty samples in one visit say less than sixty in twenty."""
    noise = np.random.default_rng(1).normal(size=(1, 120))
    once = np.repeat([0.0, 1.0], 60)[None]
    often = np.tile(np.repeat([0.0, 1.0], 3), 20)[None]
    every = np.ones(noise.shape, bool)
    errors = [signal_map(noise, a, np.zeros_like(a), ("a", "b"), every).std_error[0, 0] for a in (once, often)]
    assert errors[0] > 2 * errors[1]
    assert errors[0] == pytest.approx(noise[0, :60].std(), rel=1e-9)
