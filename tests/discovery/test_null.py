"""What the best of a catalogue gains by luck: laws that are known, and p-values that keep what they promise."""

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from pgrssnn_jax.discovery.likelihood import Linearisation, Noise, noise_of
from pgrssnn_jax.discovery.null import Known, Null, nats, null_distribution, null_of

SAMPLES, TESTS = 300, 80
RAMP = np.linspace(-1.0, 1.0, SAMPLES)


def linearised(error: np.ndarray, columns: np.ndarray, precision: float = 0.0) -> Linearisation:
    """Of one sequence with one output, at the least squares estimate; columns `[n, k]`."""
    left = error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]
    return Linearisation(
        left[None, :, None],
        columns[None, :, None],
        np.ones((1, len(error), 1), bool),
        np.full(columns.shape[1], precision),
        np.zeros(columns.shape[1]),
    )


def slow(rng: np.random.Generator, count: int) -> np.ndarray:
    """Columns that vary slowly, as effects do."""
    return lfilter([1.0], [1.0, -0.95], rng.standard_normal((SAMPLES, count)), axis=0)


def gained(error: np.ndarray, columns: np.ndarray, added: np.ndarray) -> float:
    """Gain of log-likelihood of the larger of two regressions."""
    energies = []
    for regressors in (columns, np.hstack([columns, added])):
        left = error - regressors @ np.linalg.lstsq(regressors, error, rcond=None)[0]
        energies.append(left @ left)
    return 0.5 * len(error) * np.log(energies[0] / energies[1])


def noise(kind: str, level: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    drawn = rng.standard_normal(SAMPLES)
    if kind == "heavy tails":
        return rng.standard_t(3.0, SAMPLES)
    if kind == "larger at high levels":
        return drawn * np.where(level > np.quantile(level, 0.75), 6.0, 1.0)
    return lfilter([1.0], [1.0, -0.9], drawn) if kind == "AR(0.9)" else drawn


def least_p_value(kind: str, seed: int, hidden: float = 0.0) -> float:
    """Over a catalogue of eight effects with two numbers, one of them a stop that acts at high levels."""
    rng = np.random.default_rng(seed)
    level = slow(rng, 1)[:, 0]
    columns = np.column_stack([np.ones(SAMPLES), level, slow(rng, 2)])
    stop = np.maximum(level[:, None] - np.quantile(level, [0.75, 0.9]), 0.0)
    catalogue = [("stop", stop), *((f"effect {i // 2}", slow(rng, 2)) for i in range(14))]  # two starts of each
    error = noise(kind, level, rng) + hidden * stop[:, 0]
    at = linearised(error, columns)
    null = null_distribution(at, noise_of(at).recoloured, catalogue, 199, 99, rng)
    return min(null.p_value(name, gained(error, columns, added)) for name, added in catalogue)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("white", marks=pytest.mark.slow),
        "AR(0.9)",
        "larger at high levels",
        pytest.param("heavy tails", marks=pytest.mark.slow),
    ],
)
def test_at_the_5_percent_level_no_more_than_that_is_found_in_noise(kind):
    found = np.array([least_p_value(kind, seed) for seed in range(TESTS)])
    assert (found <= 0.05).mean() <= 0.08
    assert (found <= 0.5).mean() == pytest.approx(0.5, abs=0.2)


def test_what_is_there_is_found():
    assert max(least_p_value("white", seed, hidden=2.0) for seed in range(5)) <= 0.01


def drawn(added: list[tuple[str, np.ndarray]], columns: np.ndarray, precision: float = 0.0, draws: int = 2000) -> Null:
    rng = np.random.default_rng(0)
    at = linearised(rng.standard_normal(SAMPLES), columns, precision)
    return null_distribution(at, Noise(np.array([[1.0]]), at.error).recoloured, added, draws, 99, rng)


def test_by_luck_a_number_gains_half_a_nat():
    """Wilks: twice the gain in white noise is chi-square with as many degrees of freedom as numbers."""
    rng = np.random.default_rng(2)
    null = drawn([("four", rng.standard_normal((SAMPLES, 4)))], np.ones((SAMPLES, 1)))
    for level in (0.5, 0.1, 0.02):
        assert null.p_value("four", 0.5 * stats.chi2.isf(level, 4)) == pytest.approx(level, rel=0.35)
    assert null.p_value("four", 0.0) == 1.0
    assert null.p_value("four", 1e3) == 1.0 / 2001
    assert np.median(null.gains("four")) == pytest.approx(0.5 * stats.chi2.median(4), rel=0.1)


def test_every_look_is_paid_for():
    rng = np.random.default_rng(3)
    many = [(f"effect {i}", rng.standard_normal((SAMPLES, 1))) for i in range(20)]
    gain = 0.5 * stats.chi2.isf(0.01, 1)
    one, all_of_them = (drawn(some, np.ones((SAMPLES, 1))).p_value("effect 0", gain) for some in (many[:1], many))
    assert one == pytest.approx(0.01, rel=0.5)
    assert all_of_them == pytest.approx(1.0 - 0.99**20, rel=0.35)


@pytest.mark.parametrize("what", ["nothing", "what the parameters do"])
def test_an_effect_that_adds_nothing_gains_nothing(what):
    column = {"nothing": np.zeros((SAMPLES, 1)), "what the parameters do": RAMP[:, None]}[what]
    null = drawn([("none", column)], np.column_stack([np.ones(SAMPLES), RAMP]), draws=99)
    assert null.gains("none").max() < 0.05


def test_what_parameters_may_not_take_up_counts():
    """A prior that holds a parameter leaves its direction to the effect."""
    effect = [("ramp", RAMP[:, None])]
    free, held = (drawn(effect, RAMP[:, None], precision, 400) for precision in (0.0, 1e6))
    assert free.p_value("ramp", 1.0) < 0.01
    assert held.p_value("ramp", 0.5 * stats.chi2.isf(0.3, 1)) == pytest.approx(0.3, rel=0.3)


def test_gains_of_effects_are_compared_by_how_likely_they_are():
    rng = np.random.default_rng(4)
    null = null_of({"wild": rng.gamma(2.0, 10.0, 500), "tame": rng.gamma(2.0, 0.1, 500)})
    assert null.p_value("wild", 30.0) > 0.2 > 0.01 > null.p_value("tame", 2.0)
    assert nats(1.0 - np.exp(-1.0), 2) == pytest.approx(1.0)


def test_a_known_p_value_is_that_of_its_fit_and_not_of_a_much_better_one():
    """Beside nothing a ceiling may be fitted badly, and well beside another effect (a boiler of a fourth author)."""
    null = drawn([("one", np.random.default_rng(7).standard_normal((SAMPLES, 1)))], np.ones((SAMPLES, 1)))
    usual = null.p_value("one", 30.0)
    assert usual < 0.01
    known = null._replace(known={"one": Known(10.0, 0.6)})
    assert known.p_value("one", 10.5) == 0.6
    assert known.p_value("one", 30.0) == usual


def test_an_effect_without_a_law_is_the_luckiest_one():
    draw = np.random.default_rng(6)
    null = null_of({"often": draw.gamma(2.0, 1.5, 999), "seldom": draw.gamma(0.5, 0.2, 999)})
    for gain in (0.5, 3.0, 30.0):
        assert null.p_value("elsewhere", gain) == null.p_value("often", gain)
    assert null_of({}).p_value("elsewhere", 100.0) == 1.0, "nothing to compare with"


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_size_of_the_errors_does_not_matter(scale):
    """Also that of a free run that diverges, and of a record in a tiny unit."""
    rng = np.random.default_rng(4)
    error, columns, added = rng.standard_normal(SAMPLES), slow(rng, 2), slow(rng, 2)
    laws = []
    for factor in (1.0, scale):
        at = linearised(factor * error, columns)
        null = null_distribution(at, noise_of(at).recoloured, [("one", added)], 199, 99, np.random.default_rng(5))
        laws.append(null.law)
    np.testing.assert_allclose(laws[1], laws[0], rtol=1e-4)
