"""An arm as plain arrays: the one form that both backends of forward dynamics, the physics and the pictures read.

Joint i turns by offset_i + q_i about the z axis of its own frame, which sits at (position_i, rotation_i) in the frame
of its parent joint. Frames of a URDF whose joints turn about another axis are turned until it is z; nothing else
depends on the choice. Only revolute joints on a fixed base; branches are allowed.
"""

from collections.abc import Mapping
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - its files are in a folder of their own
from jaxtyping import Float
from omegaconf import OmegaConf

PerJoint = Float[np.ndarray, " n"]
_NO_INERTIA = 1e-9  # kg m²


class ArmTables(NamedTuple):
    """joints: names, depth first; parents: index of the parent joint, -1 for the base. rotation, position: placement of
    the joint frame in its parent's, m; offset: rad at q = 0. mass kg, center m and inertia kg m² (about center) of what
    moves with the joint, in its frame; motor_inertia kg m², on the motor side; gear: motor turns per joint turn,
    negative if they turn against each other; viscous Nm s and coulomb Nm: friction on the motor side. Limits in rad and
    rad/s, infinite where there are none. gravity m/s²; tip: end of the last link in its joint's frame, m, for pictures.
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    rotation: Float[np.ndarray, "n 3 3"]
    position: Float[np.ndarray, "n 3"]
    offset: PerJoint
    mass: PerJoint
    center: Float[np.ndarray, "n 3"]
    inertia: Float[np.ndarray, "n 3 3"]
    motor_inertia: PerJoint
    gear: PerJoint
    viscous: PerJoint
    coulomb: PerJoint
    position_min: PerJoint
    position_max: PerJoint
    velocity_max: PerJoint
    gravity: Float[np.ndarray, "3"]
    tip: Float[np.ndarray, "3"]

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def armature(self) -> PerJoint:
        """Motor inertia as the links feel it, kg m²."""
        return self.motor_inertia * self.gear**2


def read_description(robot: str) -> Mapping[str, Any]:
    """The description of an arm that comes with the package, as plain data. Raises `ValueError` if there is none."""
    folder = files("pgrssnn_jax.physics.arms")
    known = sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))
    if robot not in known:
        raise ValueError(f"physics.robot: expected one of {known}, found {robot!r}")
    found = OmegaConf.to_container(OmegaConf.create((folder / f"{robot}.yaml").read_text(encoding="utf-8")))
    assert isinstance(found, dict)
    return {str(key): value for key, value in found.items()}


def described(robot: str, preset: str | None = "reference") -> ArmTables:
    """Tables of an arm that comes with the package, under the conventions of one of its presets (None: Pinocchio's
    gravity, no limits). Raises `ValueError` for a robot or a preset that there is not."""
    description = read_description(robot)
    tables = denavit_hartenberg(description)
    if preset is None:
        return tables
    known = description["presets"]
    if preset not in known:
        raise ValueError(f"physics.preset: expected one of {sorted(known)}, found {preset!r}")
    return tables._replace(**{name: np.array(values, float) for name, values in known[preset].items()})


def denavit_hartenberg(description: Mapping[str, Any]) -> ArmTables:
    """Tables of a serial chain in standard Denavit-Hartenberg form (the fields are explained in `kuka_kr300.yaml`).

    Built once as a `pin.Model`, whose joint i sits at A_{i-1} and carries its body at A_i, and exported from it.
    """
    links = description["links"]
    model, parent, before = pin.Model(), 0, pin.SE3.Identity()
    model.name = description["name"]
    for i, link in enumerate(links, 1):
        c, s = np.cos(link["alpha"]), np.sin(link["alpha"])
        after = pin.SE3(np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]]), np.array([link["a"], 0.0, link["d"]]))
        xx, yy, zz, xy, yz, xz = link["I"]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        parent = model.addJoint(parent, pin.JointModelRZ(), before, f"joint_{i}")
        model.appendBodyToJoint(parent, pin.Inertia(link["m"], np.array(link["r"]), inertia), after)
        model.addFrame(pin.Frame(f"link_{i}", parent, after, pin.FrameType.BODY))
        before = after
    n = len(links)
    model.lowerPositionLimit, model.upperPositionLimit = np.full(n, -np.inf), np.full(n, np.inf)
    model.velocityLimit = np.full(n, np.inf)

    def column(name: str) -> PerJoint:
        return np.array([link[name] for link in links], float)

    return tables_of(model)._replace(
        offset=column("offset"),
        motor_inertia=column("Jm"),
        gear=column("G"),
        viscous=column("B"),
        coulomb=column("Tc"),
    )


def tables_of(model: pin.Model, where: str = "") -> ArmTables:
    """Exports a Pinocchio model. where: begins the sentence of the `ValueError` for what is not supported."""
    n = model.njoints - 1
    if not n:
        raise ValueError(f"{where}expected at least one revolute joint, found none")
    data, names = model.createData(), tuple(model.names)[1:]
    pin.forwardKinematics(model, data, pin.neutral(model))  # fills in the joints' axes
    turned = [_turned_to_z(model, data, i, where) for i in range(1, n + 1)]
    parents = tuple(model.parents[i] - 1 for i in range(1, n + 1))
    placements = [model.jointPlacements[i] for i in range(1, n + 1)]
    back = [np.eye(3) if parent < 0 else turned[parent].T for parent in parents]
    inertias = [model.inertias[i] for i in range(1, n + 1)]
    simple = np.array([model.joints[i].nq == 1 for i in range(1, n + 1)])

    def limit(values: np.ndarray, none: float) -> PerJoint:
        """Per joint; a continuous joint, which Pinocchio gives two numbers of position, has none."""
        found = [values[model.joints[i].idx_q] if one else none for i, one in zip(range(1, n + 1), simple, strict=True)]
        return np.array(found, float)

    return ArmTables(
        name=model.name,
        joints=names,
        parents=parents,
        rotation=np.stack([b @ p.rotation @ t for b, p, t in zip(back, placements, turned, strict=True)]),
        position=np.stack([b @ p.translation for b, p in zip(back, placements, strict=True)]),
        offset=np.zeros(n),
        mass=np.array([inertia.mass for inertia in inertias]),
        center=np.stack([t.T @ inertia.lever for t, inertia in zip(turned, inertias, strict=True)]),
        inertia=np.stack([t.T @ inertia.inertia @ t for t, inertia in zip(turned, inertias, strict=True)]),
        motor_inertia=np.array(model.armature, float),
        gear=np.ones(n),
        viscous=np.array(model.damping, float),
        coulomb=np.array(model.friction, float),
        position_min=limit(model.lowerPositionLimit, -np.inf),
        position_max=limit(model.upperPositionLimit, np.inf),
        velocity_max=np.array(model.velocityLimit, float),
        gravity=np.array(model.gravity.linear),
        tip=turned[-1].T @ _tip(model),
    )


def pinocchio_model(tables: ArmTables) -> pin.Model:
    """The same arm as a Pinocchio model whose every joint turns about z."""
    model = pin.Model()
    model.name = tables.name
    for i, parent in enumerate(tables.parents):
        placement = pin.SE3(tables.rotation[i] @ turn_z(tables.offset[i]), tables.position[i])
        joint = model.addJoint(parent + 1, pin.JointModelRZ(), placement, tables.joints[i])
        model.appendBodyToJoint(joint, _body(tables, i), pin.SE3.Identity())
    model.armature = np.array(tables.armature)
    model.gravity.linear = np.array(tables.gravity)
    return model


def without_inertia(tables: ArmTables) -> list[str]:
    """Joints that turn neither mass nor motor: they have no acceleration. Looked at in a pose in which no axis meets a
    centre of mass."""
    model = pinocchio_model(tables)
    own = np.diag(pin.crba(model, model.createData(), 0.3 + 0.1 * np.arange(tables.n)))
    return [name for name, inertia in zip(tables.joints, own, strict=True) if not inertia > _NO_INERTIA]


def _body(tables: ArmTables, i: int) -> pin.Inertia:
    """By its ten parameters: given as a matrix, Pinocchio refuses the inertia of a point mass for its rounding."""
    mass, center = tables.mass[i], tables.center[i]
    about = tables.inertia[i] + mass * (center @ center * np.eye(3) - np.outer(center, center))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = about
    return pin.Inertia.FromDynamicParameters(np.array([mass, *(mass * center), xx, xy, yy, xz, yz, zz]))


def turn_z(angle: Float[np.ndarray, "*batch"] | float) -> Float[np.ndarray, "*batch 3 3"]:
    """Rz(angle), with exact zeros and ones at quarter turns."""
    c, s = (np.where(np.abs(v - np.round(v)) < 1e-15, np.round(v), v) for v in (np.cos(angle), np.sin(angle)))
    zero, one = np.zeros_like(c), np.ones_like(c)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], -1).reshape(*np.shape(angle), 3, 3)


def _turned_to_z(model: pin.Model, data: pin.Data, i: int, where: str) -> Float[np.ndarray, "3 3"]:
    """A rotation whose third column is the axis of joint i."""
    joint, name = model.joints[i], model.names[i]
    subspace = np.asarray(data.joints[i].S, float).reshape(6, -1) if joint.nv else np.empty((6, 0))
    if subspace.shape[1] != 1:
        kinds = {0: "joint that mimics another", 6: "floating base"}
        kind = kinds.get(joint.nv, f"joint of {joint.nv} degrees of freedom")
        raise ValueError(f"{where}joint {name!r}: expected revolute joints on a fixed base, found a {kind}")
    if np.any(subspace[:3] != 0):
        kind = "helical" if np.any(subspace[3:] != 0) else "prismatic"
        hint = f"; lock=[{name}] holds it"
        raise ValueError(f"{where}joint {name!r}: expected a revolute joint, found a {kind} one{hint}")
    axis = subspace[3:, 0]
    if np.array_equal(axis, [0.0, 0.0, 1.0]):
        return np.eye(3)
    along = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(along, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _tip(model: pin.Model) -> Float[np.ndarray, "3"]:
    """The frame on the last joint that is farthest from it; its centre of mass where it has no other frame."""
    last = model.njoints - 1
    ends = [frame.placement.translation for frame in model.frames if frame.parentJoint == last]
    farthest = max([*ends, np.zeros(3)], key=lambda end: float(np.linalg.norm(end)))
    return np.array(farthest if np.any(farthest) else model.inertias[last].lever)
