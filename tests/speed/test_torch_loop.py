"""The PyTorch loop that `benchmarks/rollout.py --compare` measures predicts, learns and moves the arm as ours does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.speed.cases import SYSTEMS, in_precision, inputs, model_and_params, training
from pgrssnn_jax.models.model import ModelParams
from pgrssnn_jax.models.rollout import rollout

torch = pytest.importorskip("torch", reason="torch is not installed: extra `compare`")
torch_loop = pytest.importorskip("benchmarks.speed.torch_loop")
torch_physics = pytest.importorskip("benchmarks.speed.torch_physics")

SAMPLES = {"tanks": 60, "lgssm": 60, "arm": 8}
FORMS = ("Loop", "Batched")


@pytest.fixture(params=sorted(SYSTEMS))
def system(request):
    return SYSTEMS[request.param]


def in_torch(form, model, params):
    step, measure = torch_physics.physics_in_torch(model.physics, torch.float64)
    return getattr(torch_loop, form)(model, params, step, measure, torch.float64)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("form", FORMS)
def test_predicts_as_ours(system, form):
    model, params = model_and_params(system, system.physics(), dtype=np.float64)
    u, x0 = inputs(system, 3, SAMPLES[system.name], np.float64)
    expected = np.asarray(rollout(model, params, u, x0).y)
    networks = in_torch(form, model, params)
    found = torch_loop.free_run(networks, *(torch_loop.tensor(a, torch.float64) for a in (u, x0)))()
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["tanks", "lgssm"])
def test_an_epoch_moves_the_weights_as_ours_does(name, form):
    system = SYSTEMS[name]._replace(train=(2, 40))
    fit, data = training(system, system.physics(), epochs=1, dtype=np.float64)
    state = in_precision(fit.begin(jax.random.key(0), data), np.float64)
    params = fit.objective.assemble(state.theta, data.scaling)
    networks = in_torch(form, fit.objective.model, params)
    before = {name: weight.detach().clone() for name, weight in networks.named_parameters()}
    x0 = np.zeros((2, 2))
    run = torch_loop.epoch(networks, *(torch_loop.tensor(a, torch.float64) for a in (data.train.u, data.train.y, x0)))
    mean = float(run()) / data.train.u.shape[1]

    after, history = jax.jit(fit.advance)(state, data)
    np.testing.assert_allclose(mean, history.train[0, 0], rtol=1e-5)
    moved = torch_loop.weights(ModelParams(after.theta.network, None, data.scaling))
    for name, weight in networks.named_parameters():
        assert (weight - before[name]).abs().max() > 1e-4, name
        np.testing.assert_allclose(weight.detach(), moved[name], rtol=1e-5, atol=1e-6, err_msg=name)


def test_pinocchio_called_from_python_accelerates_as_the_equations_do():
    tables = torch_physics.described("kuka_kr300")
    given = [torch.tensor(a) for a in np.random.default_rng(0).uniform(-1, 1, (3, 5, tables.n))]
    ours = torch_physics.spatial_dynamics(tables, torch.float64)(*given)
    np.testing.assert_allclose(torch_physics.pinocchio_dynamics(tables)(*given), ours, rtol=1e-9)
    assert jnp.asarray(ours).std() > 0
