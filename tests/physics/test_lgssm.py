import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from toys import quick_jit

from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.scaling import Scaling, identity

PUBLISHED = {"A": [[0.7, 0.8], [0.0, 0.1]], "B": [[-1.0], [0.1]], "C": [[1.0, 0.0]]}
WIDE = {
    "A": [[0.5, 0.2, 0.0], [-0.3, 0.6, 0.1], [0.0, 0.4, 0.2]],
    "B": [[1.0, 0.0], [0.5, -1.0], [0.3, 2.0]],
    "C": [[1.0, 0.0, 2.0], [0.0, 1.0, -1.0]],
}


def simulate(physics, u, x0):
    scaling = Scaling(*(identity(len(s)) for s in (physics.inputs, physics.states, physics.outputs)))
    model = build_model(ModelSpec(networks=False), physics)
    run = quick_jit(lambda params, u, x0: rollout(model, params, u, x0))
    return run(ModelParams({}, physics.params, scaling), jnp.asarray(u), jnp.asarray(x0))


@pytest.mark.usefixtures("x64")
def test_published_system_equals_scipy():
    """scipy reads y before u acts on x; ours after: y_t = C A x_{t-1} + C B u_t, a system with feedthrough."""
    a, b, c = (np.array(PUBLISHED[name]) for name in "ABC")
    u = np.random.default_rng(0).normal(size=(50, 1))
    _, y, before = scipy.signal.dlsim((a, b, c @ a, c @ b, 1.0), u, x0=[0.4, -0.2])
    found = simulate(lgssm(**PUBLISHED), u[None], np.array([[0.4, -0.2]]))
    np.testing.assert_allclose(found.y[0], y, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.x[0, :-1], before[1:], rtol=1e-12, atol=1e-12)


@pytest.mark.usefixtures("x64")
def test_several_inputs_and_outputs_equal_a_loop():
    physics = lgssm(**WIDE, inputs=("f", "g"), outputs=("p", "q"))
    draw = np.random.default_rng(1)
    u, x = draw.normal(size=(2, 9, 2)), draw.normal(size=(2, 3))
    found = simulate(physics, u, x)
    a, b, c = (np.array(WIDE[name]) for name in "ABC")
    for s in range(2):
        state = x[s]
        for t in range(9):
            state = a @ state + b @ u[s, t]
            np.testing.assert_allclose(found.x[s, t], state, rtol=1e-12)
            np.testing.assert_allclose(found.y[s, t], c @ state, rtol=1e-12, atol=1e-14)


def test_first_input_acts_on_first_output():
    physics = lgssm(**PUBLISHED)
    u = np.zeros((1, 3, 1), np.float32)
    u[0, 0] = 1.0
    y = simulate(physics, u, np.zeros((1, 2), np.float32)).y[0, :, 0]
    np.testing.assert_allclose(y, [-1.0, -0.62, -0.426], rtol=1e-5)


def test_signals_are_named_and_every_matrix_means_something():
    physics = lgssm(**WIDE, inputs=("f", "g"), outputs=("p", "q"), dt=0.1)
    assert [s.name for s in physics.states] == ["x1", "x2", "x3"]
    assert [s.name for s in physics.inputs] == ["f", "g"]
    assert [s.name for s in physics.outputs] == ["p", "q"]
    assert (physics.dt, physics.output_timing) == (0.1, "after_step")
    assert {name: meaning.symbol for name, meaning in physics.parameters.items()} == {n: n for n in "ABC"}


def test_single_precision_stays_single():
    physics = lgssm(**PUBLISHED)
    x = jax.jit(physics.step)(physics.params, jnp.ones(2, jnp.float32), jnp.ones(1, jnp.float32))
    assert x.dtype == jnp.float32


@pytest.mark.parametrize(
    ("name", "matrix", "expected"),
    [
        ("A", [[1.0, 0.0]], r"\(1, 1\), found \(1, 2\)"),
        ("B", [[1.0, 0.0], [0.0, 1.0]], r"\(2, 1\), found \(2, 2\)"),
        ("C", [[1.0, 0.0], [0.0, 1.0]], r"\(1, 2\), found \(2, 2\)"),
        ("C", [[1.0]], r"\(1, 2\), found \(1, 1\)"),
    ],
)
def test_wrong_shapes_are_named(name, matrix, expected):
    with pytest.raises(ValueError, match=rf"{name}: expected shape {expected}"):
        lgssm(**{**PUBLISHED, name: matrix})


@pytest.mark.parametrize("matrix", [np.array(0.7), np.array([0.7]), np.full((1, 2, 2), 0.1), [[0.7, 0.8], [0.1]]])
def test_a_matrix_has_rows_of_equal_length(matrix):
    with pytest.raises(ValueError, match="A: expected rows of numbers of equal length, found"):
        lgssm(**{**PUBLISHED, "A": matrix})


def test_matrices_must_fit_the_signal_names():
    with pytest.raises(ValueError, match=r"B: expected shape \(2, 2\), found \(2, 1\)"):
        lgssm(**PUBLISHED, inputs=("f", "g"))
