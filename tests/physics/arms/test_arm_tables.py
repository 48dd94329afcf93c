import numpy as np
import pinocchio as pin
import pytest
from arm_samples import KUKA, OBLIQUE, PENDULUM, TREE, Joint, accelerations, in_model, published, states, urdf

from pgrssnn_jax.physics.arms.tables import ArmTables, described, pinocchio_model, read_description, tables_of, turn_z
from pgrssnn_jax.physics.arms.urdf import read_urdf

LINKS = read_description("kuka_kr300")["links"]


def homogeneous(rotation=None, shift=(0.0, 0.0, 0.0)):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = np.eye(3) if rotation is None else rotation, shift
    return found


def about(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]] if axis == "x" else [[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def link_frames(q):
    """Textbook Denavit-Hartenberg: T_i = T_{i-1} Rz(q + offset) Tz(d) Tx(a) Rx(alpha)."""
    frames, frame = [], np.eye(4)
    for link, angle in zip(LINKS, q, strict=True):
        frame = frame @ homogeneous(about("z", angle + link["offset"])) @ homogeneous(shift=(0, 0, link["d"]))
        frame = frame @ homogeneous(shift=(link["a"], 0, 0)) @ homogeneous(about("x", link["alpha"]))
        frames.append(frame)
    return frames


def body(link):
    xx, yy, zz, xy, yz, xz = link["I"]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def mass_and_potential(q, gravity):
    """M = Σ m JᵥᵀJᵥ + JωᵀIJω + rotors, with Jacobians from geometry alone, and potential energy."""
    frames = link_frames(q)
    before = [np.eye(4), *frames[:-1]]
    total, potential = np.diag([link["Jm"] * link["G"] ** 2 for link in LINKS]), 0.0
    for i, (link, frame) in enumerate(zip(LINKS, frames, strict=True)):
        center = frame[:3, :3] @ link["r"] + frame[:3, 3]
        turning, moving = np.zeros((3, 6)), np.zeros((3, 6))
        for j in range(i + 1):
            turning[:, j] = before[j][:3, 2]
            moving[:, j] = np.cross(before[j][:3, 2], center - before[j][:3, 3])
        inertia = frame[:3, :3] @ body(link) @ frame[:3, :3].T
        total = total + link["m"] * moving.T @ moving + turning.T @ inertia @ turning
        potential -= link["m"] * gravity @ center
    return total, potential


@pytest.mark.parametrize("seed", range(3))
def test_kuka_masses_follow_from_denavit_hartenberg(seed):
    q = states(6, 1, seed)[0][0]
    model = pinocchio_model(KUKA)
    found = pin.crba(model, model.createData(), q)
    expected, _ = mass_and_potential(q, KUKA.gravity)
    np.testing.assert_allclose(np.triu(found), np.triu(expected), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_kuka_weight_is_the_slope_of_its_potential_energy(seed):
    q, h = states(6, 1, seed)[0][0], 1e-5
    model = pinocchio_model(KUKA)
    found = pin.computeGeneralizedGravity(model, model.createData(), q)
    energy = [[mass_and_potential(q + sign * step, KUKA.gravity)[1] for sign in (1, -1)] for step in h * np.eye(6)]
    np.testing.assert_allclose(found, [(high - low) / (2 * h) for high, low in energy], rtol=1e-6, atol=1e-4)


def test_kuka_joints_turn_about_the_z_axis_of_the_link_before():
    q = states(6, 1)[0][0]
    model = pinocchio_model(KUKA)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    for i, before in enumerate([np.eye(4), *link_frames(q)[:-1]], 1):
        expected = before @ homogeneous(about("z", q[i - 1] + LINKS[i - 1]["offset"]))
        np.testing.assert_allclose(data.oMi[i].homogeneous, expected, atol=1e-12)


def test_kuka_has_published_drives_and_limits():
    np.testing.assert_allclose(KUKA.armature, [link["Jm"] * link["G"] ** 2 for link in LINKS])
    for column, name in ((KUKA.gear, "G"), (KUKA.viscous, "B"), (KUKA.coulomb, "Tc"), (KUKA.mass, "m")):
        np.testing.assert_array_equal(column, [link[name] for link in LINKS])
    np.testing.assert_allclose(np.rad2deg(KUKA.position_min), [-90, -30, -110, -180, -90, -180])
    np.testing.assert_allclose(np.rad2deg(KUKA.position_max), [90, 40, 40, 180, 90, 180])
    np.testing.assert_allclose(np.rad2deg(KUKA.velocity_max), [63.4, 61.7, 59.5, 91.5, 85.8, 131.3])
    assert KUKA.gravity.tolist() == [0.0, 0.0, 9.81]


def test_without_a_preset_the_kuka_is_unlimited_under_ordinary_gravity():
    plain = described("kuka_kr300", None)
    assert plain.gravity.tolist() == [0.0, 0.0, -9.81]
    assert np.isinf([plain.position_min, plain.position_max, plain.velocity_max]).all()


def same_arm(a: ArmTables, b: ArmTables):
    """Offsets may have gone into the rotations."""
    assert (a.joints, a.parents) == (b.joints, b.parents)
    turned = [np.stack([r @ turn_z(o) for r, o in zip(t.rotation, t.offset, strict=True)]) for t in (a, b)]
    np.testing.assert_allclose(*turned, atol=1e-15)
    for name in ("position", "mass", "center", "inertia", "armature", "gravity"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("joints", [None, TREE, OBLIQUE])
def test_export_of_the_built_model_is_the_same_arm(tmp_path, joints):
    tables = KUKA if joints is None else read_urdf(urdf(tmp_path, joints))
    same_arm(tables_of(pinocchio_model(tables)), tables)


@pytest.mark.parametrize(
    "name", ["ur5_robot.urdf", "kinova.urdf", "talos_left_arm.urdf", "double_pendulum_continuous.urdf", "solo12.urdf"]
)
def test_published_urdf_moves_as_its_own_model(name):
    own, tables = pin.buildModelFromUrdf(str(published(name))), read_urdf(published(name))
    given = states(tables.n, 100)
    expected = accelerations(own, *given)
    error = np.abs(accelerations(pinocchio_model(tables), *given) - expected).max(-1)
    assert np.all(error < 1e-9 * np.abs(expected).max(-1))


@pytest.mark.parametrize("joints", [TREE, OBLIQUE, PENDULUM])
def test_any_axis_moves_as_in_the_urdf(tmp_path, joints):
    file = urdf(tmp_path, joints)
    given = states(len(joints), 100)
    found, own = accelerations(pinocchio_model(read_urdf(file)), *given), pin.buildModelFromUrdf(str(file))
    np.testing.assert_allclose(found, accelerations(own, *given), rtol=1e-9, atol=1e-9)


def test_joint_names_order_and_parents_are_pinocchios(tmp_path):
    file = urdf(tmp_path, TREE)
    tables, model = read_urdf(file), pin.buildModelFromUrdf(str(file))
    assert tables.joints == tuple(model.names)[1:]
    assert tables.parents == (-1, 0, 1, 0, 3, 4)


def test_friction_and_limits_come_from_the_urdf_and_gears_are_one(tmp_path):
    tables = read_urdf(urdf(tmp_path, OBLIQUE))
    assert tables.viscous.tolist() == [0.0, 0.0, 0.7]
    assert tables.coulomb.tolist() == [0.0, 0.0, 0.2]
    assert (tables.position_min.tolist(), tables.position_max.tolist()) == ([-2.0] * 3, [1.5] * 3)
    assert tables.velocity_max.tolist() == [3.0] * 3
    assert (tables.gear.tolist(), tables.armature.tolist(), tables.offset.tolist()) == ([1.0] * 3, [0.0] * 3, [0.0] * 3)


def test_continuous_joint_has_no_position_limits_but_its_own_speed(tmp_path):
    joints = (PENDULUM[0], Joint("wheel", "swing", kind="continuous", more="<limit velocity='7' effort='1'/>"))
    tables = read_urdf(urdf(tmp_path, (*joints, Joint("arm", "wheel"))))
    assert tables.position_min.tolist() == [-2.0, -np.inf, -2.0]
    assert tables.position_max.tolist() == [1.5, np.inf, 1.5]
    assert tables.velocity_max.tolist() == [3.0, 7.0, 3.0]


def test_held_joints_carry_their_links_along():
    """The fingers of a Panda, prismatic, stay where they are and keep their mass."""
    fingers = ["panda_finger_joint1", "panda_finger_joint2"]
    own, tables = pin.buildModelFromUrdf(str(published("panda.urdf"))), read_urdf(published("panda.urdf"), fingers)
    assert tables.joints == tuple(f"panda_joint{i}" for i in range(1, 8))
    np.testing.assert_allclose(tables.mass.sum(), sum(inertia.mass for inertia in list(own.inertias)[1:]), rtol=1e-12)
    q, v, a = states(7, 1)
    still = np.zeros(2)
    full = pin.rnea(own, own.createData(), *(np.concatenate([x[0], still]) for x in (q, v, a)))
    held = pinocchio_model(tables)
    np.testing.assert_allclose(pin.rnea(held, held.createData(), q[0], v[0], a[0]), full[:7], rtol=1e-10)
    np.testing.assert_allclose(tables.viscous, own.damping[:7])


def test_tip_of_a_urdf_is_the_frame_farthest_from_the_last_joint(tmp_path):
    hand = Joint("hand", "third", xyz="0.4 0.1 -0.2", kind="fixed", more="")
    file = urdf(tmp_path, (*OBLIQUE, hand))
    tables, model = read_urdf(file), pin.buildModelFromUrdf(str(file))
    q = states(3, 1)[0][0]
    data, built = model.createData(), pinocchio_model(tables)
    pin.framesForwardKinematics(model, data, in_model(model, q))
    turned = built.createData()
    pin.forwardKinematics(built, turned, q)
    expected = data.oMf[model.getFrameId("hand")].translation
    np.testing.assert_allclose(turned.oMi[3].act(tables.tip), expected, atol=1e-12)


def test_masses_and_inertias_are_those_of_bodies():
    for tables in (KUKA, read_urdf(published("ur5_robot.urdf"))):
        assert np.all(tables.mass > 0)
        moments = np.linalg.eigvalsh(tables.inertia)
        assert np.all(moments > 0)


def test_quarter_turns_are_exact():
    assert turn_z(np.pi / 2).tolist() == [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    np.testing.assert_allclose(turn_z(0.3), about("z", 0.3), rtol=1e-15)
