"""Payload, heavier links, motor inertia and gravity against Pinocchio's model of the arm that has them."""

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from arm_samples import KUKA, OBLIQUE, TREE, accelerations, in_model, published, states, urdf
from toys import quick_jit

from pgrssnn_jax.effects.arm import tilted
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.jax_dynamics import forward_dynamics
from pgrssnn_jax.physics.arms.pinocchio_dynamics import forward_dynamics as pinocchios
from pgrssnn_jax.physics.arms.points import own_points
from pgrssnn_jax.physics.arms.tables import pinocchio_model
from pgrssnn_jax.physics.arms.urdf import read_urdf

pytestmark = pytest.mark.usefixtures("x64")
MASS, DISTANCE, ACROSS, GYRATION = 12.5, 0.35, (0.2, -0.1), 0.15  # kg, m
FILES = {"tree": TREE, "oblique": OBLIQUE}


@pytest.fixture(params=["kuka", pytest.param("ur5_robot.urdf", marks=pytest.mark.compiles), "tree", "oblique"])
def tables(request, tmp_path):
    if request.param == "kuka":
        return KUKA
    file = urdf(tmp_path, FILES[request.param]) if request.param in FILES else published(request.param)
    return read_urdf(file)


def test_accelerations_are_those_of_pinocchios_changed_model(tables):
    """Everything at once, and each alone: one program for all."""
    n, model = tables.n, pinocchio_model(tables)
    q, v, a = states(n, 20)
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *one).copy() for one in zip(q, v, a, strict=True)])
    run = quick_jit(jax.vmap(forward_dynamics(tables), (0, 0, 0, None)))
    rotor, gravity, share = np.linspace(1.0, 2.0, n), np.array([2.0, -3.0, -7.0]), np.linspace(-0.3, 0.5, n)
    for mass, more, pull, heavier in (
        (MASS, rotor, gravity, share),
        (MASS, 0 * rotor, tables.gravity, 0 * share),
        (0.0, rotor, tables.gravity, 0 * share),
        (0.0, 0 * rotor, gravity, 0 * share),
        (0.0, 0 * rotor, tables.gravity, share),
    ):
        factor = 1.0 + heavier
        other = pinocchio_model(
            tables._replace(mass=factor * tables.mass, inertia=factor[:, None, None] * tables.inertia)
        )
        if mass:
            outwards = -1.0 if tables.tip[2] < 0 else 1.0
            placed = pin.SE3(np.eye(3), tables.tip + np.array([*ACROSS, outwards * DISTANCE]))
            body = pin.Inertia(mass, np.zeros(3), mass * GYRATION**2 * np.eye(3))
            other.appendBodyToJoint(n, body, placed)
        other.armature = tables.armature + more
        other.gravity.linear = pull
        load = jnp.array([mass, DISTANCE, *ACROSS, GYRATION])
        extra = Extra(load, jnp.asarray(more), jnp.asarray(pull), links=jnp.asarray(heavier * tables.mass))
        np.testing.assert_allclose(run(q, v, tau, extra), accelerations(other, q, v, tau), rtol=1e-8, atol=1e-8)


def test_the_kukas_payload_hangs_beyond_its_flange():
    """The last joint's axis points back into the wrist of this arm: the load is on the other side, and lifting it takes
    its weight times its level distance from the second joint's axis."""
    np.testing.assert_allclose(KUKA.tip, [0.0, 0.0, -0.24])
    q, still, upright = jnp.zeros(6), jnp.zeros(6), jnp.array([0.0, 0.0, -9.81])
    forward = forward_dynamics(KUKA)

    @quick_jit
    def holding(m):
        """The torques M q̈ of an arm that does not fall, q̈: as it falls without torques."""
        extra = Extra(jnp.stack([m, DISTANCE, 0.0, 0.0, 0.0]), gravity=upright)
        by_torque = jax.jacrev(forward, 2)(q, still, still, extra)
        return -jnp.linalg.solve(by_torque, forward(q, still, still, extra))

    bare, loaded = holding(jnp.asarray(0.0)), holding(jnp.asarray(MASS))
    model = pinocchio_model(KUKA)
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(6))
    load, shoulder = data.oMi[6].act(np.array([0.0, 0.0, -0.24 - DISTANCE])), data.oMi[2]
    far, near = (np.linalg.norm(place - shoulder.translation) for place in (load, data.oMi[6].translation))
    assert far > near + 0.5
    moment = np.cross(load - shoulder.translation, [0.0, 0.0, -9.81 * MASS])
    np.testing.assert_allclose((loaded - bare)[1], -moment @ shoulder.rotation[:, 2], rtol=1e-10)


@pytest.mark.parametrize(("about_x", "about_y"), [(0.3, 0.0), (0.0, -0.4), (0.3, -0.4)])
def test_gravity_is_that_in_the_axes_of_a_tilted_base(about_x, about_y):
    base = pin.rpy.rpyToMatrix(about_x, about_y, 0.0)
    gravity = np.array([0.5, -1.0, 9.0])
    np.testing.assert_allclose(tilted(gravity, jnp.asarray(about_x), jnp.asarray(about_y)), base.T @ gravity)


def test_an_arm_on_a_tilted_base_falls_as_if_the_base_were_tilted():
    """Pinocchio places the first joint on the tilted base, under the gravity of the world."""
    base = pin.rpy.rpyToMatrix(0.3, -0.4, 0.0)
    stood = KUKA._replace(rotation=np.concatenate([[base @ KUKA.rotation[0]], KUKA.rotation[1:]]))
    stood = stood._replace(position=np.concatenate([[base @ KUKA.position[0]], KUKA.position[1:]]))
    q, v, a = states(6, 5)
    extra = Extra(gravity=tilted(KUKA.gravity, jnp.asarray(0.3), jnp.asarray(-0.4)))
    found = quick_jit(jax.vmap(forward_dynamics(KUKA), (0, 0, 0, None)))(q, v, 500 * a, extra)
    np.testing.assert_allclose(found, accelerations(pinocchio_model(stood), q, v, 500 * a), rtol=1e-9)


def test_pinocchios_backend_says_that_its_masses_are_its_own():
    with pytest.raises(ValueError, match="physics.backend: expected jax for effects on the moving masses"):
        pinocchios(KUKA)(jnp.zeros(6), jnp.zeros(6), jnp.zeros(6), Extra(rotor=jnp.zeros(6)))


def test_the_torque_of_a_motion_is_pinocchios(tables):
    """Inverse dynamics, with a payload, rotors, another gravity and a coupled last motor."""
    n, more = tables.n, np.linspace(0.1, 1.0, tables.n)
    q, v, a = np.random.default_rng(3).normal(size=(3, 5, n))
    model = pinocchio_model(tables)
    outwards = -1.0 if tables.tip[2] < 0 else 1.0
    placed = pin.SE3(np.eye(3), tables.tip + np.array([*ACROSS, outwards * DISTANCE]))
    model.appendBodyToJoint(n, pin.Inertia(MASS, np.zeros(3), MASS * GYRATION**2 * np.eye(3)), placed)
    model.armature = tables.armature + more
    model.gravity.linear = np.array([1.0, -2.0, 8.0])
    data = model.createData()
    expected = [pin.rnea(model, data, in_model(model, one), *rest) for one, *rest in zip(q, v, a, strict=True)]
    turning = 0.7 * (a[:, -1] - 1.5 * a[:, -2])
    expected = np.array(expected) + turning[:, None] * np.r_[np.zeros(n - 2), -1.5, 1.0]
    payload, gravity = jnp.array([MASS, DISTANCE, *ACROSS, GYRATION]), jnp.array([1.0, -2.0, 8.0])
    extra = Extra(payload, jnp.asarray(more), gravity, jnp.array([0.7, -1.5]))
    inverse = own_points(tables, masses=True, measured=True).inverse
    found = quick_jit(lambda *motion: inverse({}, *motion, extra))(q.T, v.T, a.T)
    np.testing.assert_allclose(found.T, expected, rtol=1e-9, atol=1e-9)
