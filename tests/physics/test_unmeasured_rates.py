"""Two masses on springs, of which only the first's position is measured: a velocity may be the rate of a state."""

import jax.numpy as jnp
import numpy as np
import pytest
from toys import small_record

from pgrssnn_jax.discovery.problem import build_problem, start_guess
from pgrssnn_jax.discovery.stretches import stretches
from pgrssnn_jax.models.model import build_model
from pgrssnn_jax.models.scaling import fit_scaling
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Physics, Signal, continuous, measured_rate
from pgrssnn_jax.physics.check import check_physics
from pgrssnn_jax.physics.simulate import first_output_state

K, C, M, DT = 4.0, 0.3, (1.0, 2.0), 0.1


def derivative(p, x, u):
    q1, v1, q2, v2 = x
    pull = p["k"] * (q2 - q1)
    return x.at[:].set([v1, (u[0] - p["k"] * q1 + pull - C * v1) / M[0], v2, (-pull - C * v2) / M[1]])


def two_masses(states=None) -> Physics:
    return continuous(
        "two_masses",
        derivative,
        lambda p, x, u: x[:1],
        {"k": K},
        dt=DT,
        states=states
        or (
            Signal("q1", "m", like="reading"),
            Signal("v1", "m/s", rate_of="q1"),
            Signal("q2", "m"),
            Signal("v2", "m/s", rate_of="q2"),
        ),
        inputs=(Signal("force", "N"),),
        outputs=(Signal("reading", "m"),),
    )


def simulated(count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """u `[time, 1]` and states `[time, 4]` of the loop in NumPy, RK4."""
    u = np.sin(0.2 * np.arange(count)) + 0.5 * np.sin(0.05 * np.arange(count))

    def f(x, v):
        pull = K * (x[2] - x[0])
        return np.array([x[1], (v - K * x[0] + pull - C * x[1]) / M[0], x[3], (-pull - C * x[3]) / M[1]])

    x, found = np.zeros(4), []
    for v in u:
        k1 = f(x, v)
        k2 = f(x + 0.5 * DT * k1, v)
        k3 = f(x + 0.5 * DT * k2, v)
        x = x + DT / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + DT * k3, v))
        found.append(x)
    return u[:, None], np.array(found)


U, X = simulated()
RECORD = small_record(U[None], 0.01 + X[None, :, :1])


def test_a_rate_is_of_what_is_measured_or_of_nothing_measured():
    physics = two_masses()
    check_physics(physics, "here")
    assert [measured_rate(physics, state) for state in physics.states] == [None, "reading", None, None]


def test_what_is_not_measured_is_scaled_by_a_simulation():
    scale = np.asarray(fit_scaling(RECORD, two_masses()).x.scale)
    assert scale[0] == pytest.approx(X[:, 0].std(), rel=1e-4)
    np.testing.assert_allclose(scale[2:], X[:, 2:].std(0), rtol=1e-3)
    assert scale[1] == pytest.approx(np.sqrt(np.mean(X[:, 1] ** 2)), rel=0.1), "the rate of a reading: its differences"


def test_it_starts_at_zero():
    physics = two_masses()
    model = build_model(ModelSpec(guided=True, networks=False), physics)
    first = first_output_state(model.physics, jnp.asarray(RECORD.y[0, 0]), jnp.asarray(RECORD.u[0, 0]))
    np.testing.assert_allclose(first, [RECORD.y[0, 0, 0], 0.0, 0.0, 0.0])
    start = start_guess(physics, np.asarray(RECORD.u), np.asarray(RECORD.y), np.asarray(RECORD.mask))
    np.testing.assert_allclose(start, [[RECORD.y[0, 0, 0], 0.0, 0.0, 0.0]])


def test_a_stretch_knows_the_rate_of_a_reading_alone():
    problem = build_problem(two_masses(), ())
    found = stretches(problem, RECORD, 40, folds=2, at_rest=False)
    inside = found.start[2:8]
    np.testing.assert_allclose(inside[:, 1], X[79:319:40, 1], atol=0.05)
    np.testing.assert_array_equal(inside[:, 2:], 0.0)
    assert np.all(found.precision[:, :2] > 0)
    np.testing.assert_array_equal(found.precision[:, 2:], 0.0)


@pytest.mark.parametrize(
    ("state", "sentence"),
    [
        (Signal("q2", "m", rate_of="q3"), r"state 'q2': expected rate_of one of \['q1', 'reading'\], found 'q3'"),
        (Signal("q2", "m", rate_of="q2"), r"state 'q2': expected rate_of one of \['q1', 'reading'\], found 'q2'"),
        (Signal("q2", "m", like="q1"), r"state 'q2': expected like one of \['reading'\], found 'q1'"),
    ],
)
def test_other_names_are_refused(state, sentence):
    with pytest.raises(ValueError, match=sentence):
        two_masses((Signal("q1", "m"), state))
