import pinocchio as pin
import pytest
from arm_samples import PENDULUM, Joint, urdf

from pgrssnn_jax.physics.arms.tables import described, tables_of
from pgrssnn_jax.physics.arms.urdf import read_urdf


@pytest.mark.parametrize(
    ("joints", "lock", "message"),
    [
        ((Joint("slide", kind="prismatic"),), (), r"joint 'slide_joint': .*revolute.*prismatic.*lock=\[slide_joint\]"),
        ((Joint("slide", axis="1 2 3", kind="prismatic"),), (), "found a prismatic one"),
        ((Joint("base_moves", kind="floating", more=""),), (), "joint 'base_moves_joint': .*found a floating base"),
        ((Joint("table", kind="planar", more=""),), (), "found a joint of 3 degrees of freedom"),
        ((Joint("stiff", kind="fixed", more=""),), (), "expected at least one revolute joint, found none"),
        (
            (
                Joint("first"),
                Joint(
                    "second",
                    "first",
                    more="<mimic joint='first_joint'/><limit lower='-1' upper='1' effort='1' velocity='1'/>",
                ),
            ),
            (),
            "joint 'second_joint': .*found a joint that mimics another",
        ),
        (PENDULUM, ("elbow",), r"physics.lock: expected names among \['swing_joint'\], found 'elbow'"),
        (PENDULUM, ("swing_joint",), "expected at least one revolute joint, found none"),
        (PENDULUM, ("universe",), "physics.lock: expected names among"),
        (PENDULUM, "swing_joint", r"physics.lock: expected a list of joint names, \[swing_joint\] say"),
    ],
)
def test_unsupported_urdf_is_refused_in_a_sentence(tmp_path, joints, lock, message):
    file = urdf(tmp_path, joints)
    with pytest.raises(ValueError, match=message) as error:
        read_urdf(file, lock)
    assert str(error.value).startswith(("physics.lock: ", f"physics.urdf: {file}: "))


@pytest.mark.parametrize("text", ["", "not xml", "<robot name='a'><link name='x'/><link name='y'/></robot>"])
def test_unreadable_urdf_is_refused_in_a_line(tmp_path, text):
    file = tmp_path / "bad.urdf"
    file.write_text(text)
    with pytest.raises(ValueError, match="physics.urdf: .*bad.urdf: expected a URDF") as error:
        read_urdf(file)
    assert "\n" not in str(error.value)


def test_missing_urdf_is_named(tmp_path):
    with pytest.raises(ValueError, match="physics.urdf: expected a URDF file, found no such file: .*nowhere.urdf"):
        read_urdf(tmp_path / "nowhere.urdf")


@pytest.mark.parametrize(
    ("joint", "found"),
    [
        (pin.JointModelFreeFlyer(), "found a floating base"),
        (pin.JointModelSpherical(), "found a joint of 3 degrees of freedom"),
        (pin.JointModelPX(), "found a prismatic one"),
        (pin.JointModelHX(0.1), "found a helical one"),
    ],
)
def test_models_with_other_joints_are_refused(joint, found):
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3.Identity(), "other")
    with pytest.raises(ValueError, match=f"here: joint 'other': expected .*{found}"):
        tables_of(model, "here: ")


def test_unknown_robot_and_preset_are_named():
    with pytest.raises(ValueError, match=r"physics.robot: expected one of \['kuka_kr300'\], found 'kr16'"):
        described("kr16")
    with pytest.raises(ValueError, match=r"physics.preset: expected one of \['reference'\], found 'best'"):
        described("kuka_kr300", "best")
