"""The PyTorch loop that `benchmarks/rollout.py --compare` measures predicts, learns and moves the arm as ours does."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import compiled_rollout, quick_jit

from benchmarks.speed.cases import SYSTEMS, in_precision, inputs, model_and_params, training
from pgrssnn_jax.models.model import ModelParams

torch = pytest.importorskip("torch", reason="torch is not installed: extra `compare`")
torch_loop = pytest.importorskip("benchmarks.speed.torch_loop")
torch_physics = pytest.importorskip("benchmarks.speed.torch_physics")

SAMPLES = {"tanks": 60, "lgssm": 60, "arm": 8}
FORMS = ("Loop", "Batched")


@pytest.fixture(params=["tanks", *(pytest.param(name, marks=pytest.mark.compiles) for name in ("lgssm", "arm"))])
def system(request):
    return SYSTEMS[request.param]


@cache
def predicted(name):
    """Model, parameters, inputs and start of a small run, and its outputs; once for both forms."""
    system = SYSTEMS[name]
    model, params = model_and_params(system, system.physics(), dtype=np.float64)
    u, x0 = inputs(system, 3, SAMPLES[name], np.float64)
    return model, params, u, x0, np.asarray(compiled_rollout(model)(params, u, x0).y)


@cache
def moved_by_an_epoch(name):
    """Model, data, parameters before and after, and the losses."""
    system = SYSTEMS[name]._replace(train=(2, 40))
    fit, data = training(system, system.physics(), epochs=1, dtype=np.float64)
    state = in_precision(quick_jit(fit.begin)(jax.random.key(0), data), np.float64)
    after, history = quick_jit(fit.advance)(state, data)
    params = fit.objective.assemble(state.theta, data.scaling)
    return fit.objective.model, data, params, ModelParams(after.theta.network, None, data.scaling), history


def in_torch(form, model, params):
    step, measure = torch_physics.physics_in_torch(model.physics, torch.float64)
    return getattr(torch_loop, form)(model, params, step, measure, torch.float64)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("form", FORMS)
def test_predicts_as_ours(system, form):
    model, params, u, x0, expected = predicted(system.name)
    networks = in_torch(form, model, params)
    found = torch_loop.free_run(networks, *(torch_loop.tensor(a, torch.float64) for a in (u, x0)))()
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.compiles
@pytest.mark.parametrize("name", ["tanks", "lgssm"])
def test_an_epoch_moves_the_weights_as_ours_does(name, form):
    model, data, params, after, history = moved_by_an_epoch(name)
    networks = in_torch(form, model, params)
    before = {name: weight.detach().clone() for name, weight in networks.named_parameters()}
    x0 = np.zeros((2, 2))
    run = torch_loop.epoch(networks, *(torch_loop.tensor(a, torch.float64) for a in (data.train.u, data.train.y, x0)))
    mean = float(run()) / data.train.u.shape[1]

    np.testing.assert_allclose(mean, history.train[0, 0], rtol=1e-5)
    moved = torch_loop.weights(after)
    for name, weight in networks.named_parameters():
        assert (weight - before[name]).abs().max() > 1e-4, name
        np.testing.assert_allclose(weight.detach(), moved[name], rtol=1e-5, atol=1e-6, err_msg=name)


def test_pinocchio_called_from_python_accelerates_as_the_equations_do():
    tables = torch_physics.described("kuka_kr300")
    given = [torch.tensor(a) for a in np.random.default_rng(0).uniform(-1, 1, (3, 5, tables.n))]
    ours = torch_physics.spatial_dynamics(tables, torch.float64)(*given)
    np.testing.assert_allclose(torch_physics.pinocchio_dynamics(tables)(*given), ours, rtol=1e-9)
    assert jnp.asarray(ours).std() > 0
