"""The description of an arm with effects moves in Pinocchio as the arm does here."""

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from arm_cases import NUMBERS
from toys import quick_jit

import pgrssnn_jax as pg
from pgrssnn_jax.effects.arm_common import points_of
from pgrssnn_jax.effects.arm_corrected import beyond_urdf, corrected_tables
from pgrssnn_jax.physics.arms.urdf import read_urdf
from pgrssnn_jax.physics.arms.urdf_writer import urdf_of
from pgrssnn_jax.physics.tanks import cascaded_tanks

pytestmark = pytest.mark.usefixtures("x64")
HELD = ("payload", "link_mass", "home_offset", "gravity_direction", "viscous_friction", "coulomb_friction")
UPSIDE_DOWN = {"about_x": -3.1, "about_y": 0.0}


def changed(physics, names, **more):
    for name in names:
        physics = pg.add(physics, name, **{**NUMBERS[name], **more.get(name, {})})
    return physics


def saved(physics, folder):
    file = folder / "corrected.urdf"
    file.write_text(urdf_of(corrected_tables(physics)), encoding="utf-8")
    return file


@pytest.mark.parametrize("gravity", [None, UPSIDE_DOWN, "none"])
def test_torques_of_rigid_bodies_are_those_of_the_physics(gravity, tmp_path):
    names = HELD if gravity != "none" else ()
    physics = changed(pg.physics.arm(gravity=(0.0, 0.0, -9.81)), names, gravity_direction=gravity or {})
    model = pin.buildModelFromUrdf(str(saved(physics, tmp_path)))
    data = model.createData()
    q, v, a = np.random.default_rng(0).normal(size=(3, 7, 6))
    wrapped = [np.clip(one, model.lowerPositionLimit, model.upperPositionLimit) for one in q]
    expected = np.array([pin.rnea(model, data, *one).copy() for one in zip(wrapped, v, a, strict=True)])
    points = points_of(physics)
    params = jax.tree.map(jnp.asarray, physics.params)

    def torques(params, readings, v, a):
        place = jax.vmap(lambda reading: points.position(params, reading))(readings)
        bare = points.masses(params)._replace(rotor=None)
        return points.inverse(params, place.T, v.T, a.T, bare).T - points.tables.armature[None] * a

    found = quick_jit(torques)(params, jnp.asarray(wrapped), v, a)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_damping_and_friction_stand_on_the_link_side(tmp_path):
    physics = changed(pg.physics.arm(), HELD)
    tables = read_urdf(saved(physics, tmp_path))
    own, gear = physics.params.own, np.abs(np.asarray(physics.params.own["G"]))
    np.testing.assert_allclose(tables.viscous, gear**2 * (own["B"] + NUMBERS["viscous_friction"]["B"]))
    np.testing.assert_allclose(tables.coulomb, gear * (own["Tc"] + NUMBERS["coulomb_friction"]["Tc"]))


def test_limits_names_and_branches_come_back(tmp_path):
    before = points_of(pg.physics.arm()).tables
    tables = read_urdf(saved(pg.physics.arm(), tmp_path))
    assert tables.joints == before.joints
    assert tables.parents == before.parents
    np.testing.assert_allclose(tables.position_max, before.position_max)
    np.testing.assert_allclose(tables.velocity_max, before.velocity_max)


def test_what_a_urdf_cannot_hold_is_said_beside_it():
    physics = changed(pg.physics.arm(), ("payload", "rotor_inertia", "torque_bias", "gravity_counterbalance"))
    said = beyond_urdf(physics)
    assert said["in_urdf"] == ["payload"]
    assert set(said["effects"]) == {"torque_bias", "gravity_counterbalance"}
    assert said["effects"]["gravity_counterbalance"]["moment"] == {"value": 300.0, "unit": "Nm"}
    nominal = points_of(pg.physics.arm()).tables.motor_inertia
    np.testing.assert_allclose(said["motor_inertia"]["value"], nominal + NUMBERS["rotor_inertia"]["J"])


def test_only_arms_have_such_a_description():
    with pytest.raises(ValueError, match="corrected arm: expected an arm, found physics 'tanks'"):
        corrected_tables(cascaded_tanks())
