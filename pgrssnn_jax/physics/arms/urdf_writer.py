"""An arm as a URDF: kinematics, rigid bodies, limits, damping and friction on the link side, and how its base stands.

A URDF knows gravity along -z alone. Where that of the tables has another direction, the base is fixed to a link `world`
by the rotation R under which R g points down; the size of g is that of whoever reads the file.
"""

from xml.etree import ElementTree

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - its files are in a folder of their own
from jaxtyping import Float

from pgrssnn_jax.physics.arms.tables import ArmTables, turn_z

_BASE = "base"


def urdf_of(tables: ArmTables) -> str:
    """Motor inertia, gear ratios and the torques of motors have no place in it. Joints turn about their own z axis, and
    bodies have neither shape nor colour."""
    robot = ElementTree.Element("robot", name=tables.name)
    upright = _upright(tables.gravity)
    if not np.allclose(upright, np.eye(3), atol=1e-12):
        ElementTree.SubElement(robot, "link", name="world")
        _joint(robot, "mount", "fixed", "world", _BASE, upright, np.zeros(3))
    ElementTree.SubElement(robot, "link", name=_BASE)
    links = [f"{joint}_body" for joint in tables.joints]
    for i, (name, parent) in enumerate(zip(tables.joints, tables.parents, strict=True)):
        _body(robot, links[i], tables, i)
        bounded = bool(np.isfinite(tables.position_min[i]) and np.isfinite(tables.position_max[i]))
        rotation = tables.rotation[i] @ turn_z(tables.offset[i])
        above = _BASE if parent < 0 else links[parent]
        kind = "revolute" if bounded else "continuous"
        joint = _joint(robot, name, kind, above, links[i], rotation, tables.position[i])
        ElementTree.SubElement(joint, "axis", xyz="0 0 1")
        ends = {"lower": tables.position_min[i], "upper": tables.position_max[i]} if bounded else {}
        fastest = tables.velocity_max[i] if np.isfinite(tables.velocity_max[i]) else 0.0  # 0: nobody knows
        _numbers(joint, "limit", **ends, velocity=fastest, effort=0.0)
        gear = abs(tables.gear[i])
        _numbers(joint, "dynamics", damping=gear**2 * tables.viscous[i], friction=gear * tables.coulomb[i])
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _upright(gravity: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A rotation R with R g along -z; the x axis stays as level as it can."""
    size = np.linalg.norm(gravity)
    if size == 0:
        return np.eye(3)
    up = -gravity / size
    along = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
    level = along - (along @ up) * up
    level /= np.linalg.norm(level)
    return np.stack([level, np.cross(up, level), up])


def _body(robot: ElementTree.Element, name: str, tables: ArmTables, i: int) -> None:
    inertial = ElementTree.SubElement(ElementTree.SubElement(robot, "link", name=name), "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_row(tables.center[i]), rpy="0 0 0")
    _numbers(inertial, "mass", value=tables.mass[i])
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tables.inertia[i]
    _numbers(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)


def _joint(
    robot: ElementTree.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    rotation: Float[np.ndarray, "3 3"],
    place: Float[np.ndarray, "3"],
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "origin", xyz=_row(place), rpy=_row(pin.rpy.matrixToRpy(rotation)))
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    return joint


def _numbers(parent: ElementTree.Element, name: str, **values: float) -> None:
    ElementTree.SubElement(parent, name, {key: repr(float(value)) for key, value in values.items()})


def _row(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
