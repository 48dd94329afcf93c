import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arm_samples import DISTURBED

from pgrssnn_jax.data.robot import load_robot_real, load_robot_simulated
from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.records.scaling import Scaling, identity
from pgrssnn_jax.training.metrics import nrmse


def score(splits, physics):
    """NRMSE of a free run from rest at zero, mean over the joints."""
    test = splits.test
    u, y = (np.asarray(signal[0], np.float32) for signal in (test.u, test.y))
    model = build_model(ModelSpec(networks=False), physics)
    params = ModelParams({}, physics.params, Scaling(identity(6), identity(12), identity(6)))
    found = jax.jit(lambda params, u, x0: rollout(model, params, u, x0))(params, u, jnp.zeros((len(u), 12)))
    return nrmse(measured=y, predicted=np.asarray(found.y), n_init=0).mean()


@pytest.mark.data
@pytest.mark.usefixtures("data")
@pytest.mark.parametrize("backend", [pytest.param("jax", marks=pytest.mark.compiles), "pinocchio"])
@pytest.mark.parametrize(
    ("known", "expected", "tolerance"),
    [
        pytest.param(("velocity_disturbance",), 0.524, 0.006, marks=pytest.mark.slow),
        pytest.param((), 0.806, 0.003, marks=pytest.mark.slow),
        (tuple(DISTURBED), 0.328, 0.003),
    ],
)
def test_physics_alone_scores_on_the_simulated_arm_as_published(backend, known, expected, tolerance):
    physics = arm(backend=backend, **{name: DISTURBED[name] for name in known})
    assert score(load_robot_simulated(realisations=1, physics=physics), physics) == pytest.approx(
        expected, abs=tolerance
    )


@pytest.mark.data
@pytest.mark.usefixtures("data")
def test_physics_alone_scores_on_the_measured_arm_as_published():
    physics = arm()
    assert 3.23 <= score(load_robot_real(physics=physics), physics) <= 3.31
