import numpy as np
import pytest
from arm_logs import DT, log, path

from pgrssnn_jax.data.resample import Log, resampled
from pgrssnn_jax.discovery.inverse.motion import motion_of, spectrum_of, thinned


def test_speeds_and_accelerations_are_those_of_the_path():
    """The reading of row t is that of its end: a whole sample after its torque."""
    _, v, a = path(np.random.default_rng(0), 6, 300)
    found = motion_of(log(0, noise=0.0), DT, at_rest=False, shift=1.0)
    kept = slice((300 - found.v.shape[1]) // 2, 300 - (300 - found.v.shape[1]) // 2)
    for one, true in ((found.v, v[:, kept]), (found.a, a[:, kept])):
        error = one - true
        assert error.std() < 0.05 * true.std()
        assert error[:, 30:-30].std() < 1e-3 * true.std()  # a filter knows one side of an end


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
def test_the_noise_of_accelerations_is_what_the_spectrum_says(noise):
    """The cut-off leaves the motion, and the noise that is foretold is that of the difference from the true path."""
    _, _, a = path(np.random.default_rng(1), 12, 600)
    quiet, loud = (log(1, sequences=12, samples=600, noise=n) for n in (0.0, noise))
    found = motion_of(loud, DT, at_rest=False, shift=1.0)
    assert found.cutoff is not None
    same = motion_of(quiet, DT, at_rest=False, shift=1.0, cutoff=found.cutoff)
    error = (found.a - same.a).std(axis=(0, 1)) / a.std(axis=(0, 1))
    np.testing.assert_allclose(found.noise, error, rtol=0.5)
    np.testing.assert_allclose(found.unsure, (found.v - same.v).std(axis=(0, 1)), rtol=0.5)
    assert found.cutoff > 0.23 / 2


@pytest.mark.parametrize("faster", [5, 10])
def test_the_cut_off_of_a_motion_is_that_of_any_sampling(faster):
    """Noise of equal power per Hz."""
    dt, rng = DT / faster, np.random.default_rng(0)
    time = dt * np.arange(300 * faster)
    clean = sum(np.sin(2 * np.pi * f * time[:, None] + rng.uniform(0, 6, (8, 1, 3))) / f for f in (0.05, 0.1, 0.2))
    noisy = clean + 0.01 * np.sqrt(faster) * rng.normal(size=clean.shape)
    (often, _), (seldom, _) = spectrum_of(noisy, dt), spectrum_of(noisy[:, ::faster], DT)
    assert often < 1.3 * seldom  # noise of the thinned positions is larger per Hz: their cut-off is no higher


def test_the_floor_of_a_spectrum_is_that_of_white_noise():
    y = 0.01 * np.random.default_rng(0).normal(size=(20, 1000, 2))
    _, floor = spectrum_of(y, DT)
    np.testing.assert_allclose(floor * 0.5 / DT, 1e-4, rtol=0.1)


def test_the_floor_of_a_filtered_log_is_that_of_its_noise():
    """A log at 1 kHz, of which every tenth sample is kept behind a filter that leaves nothing at the upper end."""
    rng, rate, noise = np.random.default_rng(0), 1000.0, 1e-4
    time = np.arange(60_000) / rate
    position = np.sin(2 * np.pi * 0.4 * time)[:, None] + noise * rng.normal(size=(len(time), 2))
    found = resampled(Log(time, position, position), 0.01, None, "log")
    cutoff, floor = spectrum_of(found.position[None], 0.01, found.cutoff)
    white = 2 * noise**2 / rate
    assert (floor < 1.1 * white).all()
    assert (floor > 0.6 * white).all()  # the filter takes up to a quarter, the median of few lines as much
    assert cutoff < 1.0  # Hz; the motion has 0.4


def test_thinned_motions_keep_every_nth_sample():
    whole = motion_of(log(0, samples=100), DT, at_rest=False)
    few = thinned(whole, 7)
    np.testing.assert_array_equal(few.a, whole.a[:, ::7])
    assert few.spacing == pytest.approx(7 * DT)


def test_missing_positions_are_refused():
    record = log(0, samples=50)
    mask = np.asarray(record.mask).copy()
    mask[0, 3] = False
    with pytest.raises(ValueError, match="all positions measured, found missing ones"):
        motion_of(record._replace(mask=mask), DT, at_rest=False)
