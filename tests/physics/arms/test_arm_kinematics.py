import numpy as np
import pinocchio as pin
import pytest
from arm_samples import KUKA, OBLIQUE, TREE, published, states, urdf

from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.arms.kinematics import skeleton
from pgrssnn_jax.physics.arms.tables import pinocchio_model
from pgrssnn_jax.physics.arms.urdf import read_urdf


@pytest.fixture(params=["kuka", "oblique", "ur5_robot.urdf"])
def chain(request, tmp_path):
    if request.param == "kuka":
        return KUKA
    return read_urdf(urdf(tmp_path, OBLIQUE) if request.param == "oblique" else published(request.param))


def test_points_are_base_joints_and_tip_of_pinocchio(chain):
    model = pinocchio_model(chain)
    data, q = model.createData(), states(chain.n, 20)[0]
    for angles, found in zip(q, skeleton(chain)(q), strict=True):
        pin.forwardKinematics(model, data, angles)
        joints = [place.translation for place in list(data.oMi)[1:]]
        tip = data.oMi[chain.n].act(chain.tip)
        np.testing.assert_allclose(found, [np.zeros(3), *joints, tip], atol=1e-12)


def test_links_keep_their_lengths_along_a_motion(chain):
    points = skeleton(chain)(states(chain.n, 50)[0])
    lengths = np.linalg.norm(np.diff(points, axis=-2), axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), atol=1e-12)
    assert lengths[0, -1] > 0


def test_points_of_any_batch_are_those_of_each_sample(chain):
    q, points = states(chain.n, 12)[0], skeleton(chain)
    found = points(q.reshape(3, 4, chain.n))
    assert found.shape == (3, 4, chain.n + 2, 3)
    np.testing.assert_array_equal(found.reshape(12, -1, 3)[5], points(q[5]))


def test_kuka_at_zero_stands_as_in_its_drawing():
    """Its z axis points down: at q = 0 the table's arm is 0.35 m out, then follows its published lengths."""
    points = skeleton(KUKA)(np.zeros(6))
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    links = [(0, 0), (0.675, 0.35), (0.189, 1.15), (0.189, 0.041), (1.0, 0), (0, 0), (0.24, 0)]
    np.testing.assert_allclose(lengths, [np.hypot(d, a) for d, a in links], atol=1e-12)


def test_a_branching_arm_has_no_skeleton(tmp_path):
    assert arm(urdf=urdf(tmp_path, TREE)).skeleton is None
