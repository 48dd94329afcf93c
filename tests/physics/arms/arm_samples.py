"""Arms that several tests share, and the documented equation of the arm in plain NumPy."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from robots import published

from pgrssnn_jax.physics.arms.tables import ArmTables, described, pinocchio_model
from pgrssnn_jax.physics.arms.urdf import read_urdf

KUKA = described("kuka_kr300", "reference")
S = np.array([-0.05, 0.1, -0.2, 0.05, 0.1, -0.1])
THETA = np.array([4.0, 5.0, 5.0, 0.5, 2.0, 0.5])
DISTURBED = {"velocity_disturbance": S.tolist(), "torque_bias": THETA.tolist()}
MOVING = "<limit lower='-2' upper='1.5' velocity='3' effort='9'/>"


class Joint(NamedTuple):
    name: str
    parent: str = "base"
    axis: str = "0 0 1"
    xyz: str = "0 0 0"
    rpy: str = "0 0 0"
    kind: str = "revolute"
    more: str = MOVING


TREE = (
    Joint("waist", axis="0 0 1", xyz="0.1 0 0.3"),
    Joint("left", "waist", "0 1 0", "0.2 0.3 0.1", "0.3 -0.2 0.5"),
    Joint("left_elbow", "left", "0.6 0 0.8", "0 0 0.5"),
    Joint("right", "waist", "-1 0 0", "0.2 -0.3 0.1"),
    Joint("right_elbow", "right", "0 0 -1", "0 0.1 0.4", "1.2 0 0.1"),
    Joint("right_hand", "right_elbow", "0.48 0.6 -0.64", "0.3 0 0", kind="continuous", more=""),
)
OBLIQUE = (
    Joint("first", axis="1 2 -3", xyz="0 0.1 0.2", rpy="0.4 1.1 -2"),
    Joint("second", "first", "-1 1 0.2", "0.3 0.2 0.1", "-1 0.2 0.7"),
    Joint("third", "second", "0 -1 0", "0.1 -0.2 0.3", more=MOVING + "<dynamics damping='0.7' friction='0.2'/>"),
)
#: the smallest arm that branches, which compiles in half the time
FORK = (TREE[0], TREE[2]._replace(parent="waist"), TREE[3], TREE[5]._replace(parent="right"))
PENDULUM = (Joint("swing", axis="0 1 0", more=MOVING),)


def urdf(folder: Path, joints: tuple[Joint, ...], seed: int = 3) -> Path:
    """A file with a link `{joint}` moved by every joint; masses and inertias are those of random bodies."""
    draw, parts = np.random.default_rng(seed), ["<link name='base'/>"]
    for joint in joints:
        spread = draw.normal(size=(3, 5))
        second = 0.02 * spread @ spread.T
        inertia = np.trace(second) * np.eye(3) - second
        names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        entries = " ".join(f"{k}='{v}'" for k, v in zip(names, inertia[np.triu_indices(3)], strict=True))
        center = " ".join(map(str, draw.normal(size=3) * 0.2))
        parts.append(
            f"<link name='{joint.name}'><inertial><origin xyz='{center}'/><mass value='{draw.uniform(0.5, 3)}'/>"
            f"<inertia {entries}/></inertial></link><joint name='{joint.name}_joint' type='{joint.kind}'>"
            f"<parent link='{joint.parent}'/><child link='{joint.name}'/><axis xyz='{joint.axis}'/>"
            f"<origin xyz='{joint.xyz}' rpy='{joint.rpy}'/>{joint.more}</joint>"
        )
    file = folder / "robot.urdf"
    file.write_text(f"<robot name='sample'>{''.join(parts)}</robot>")
    return file


def sample_arm(name: str, folder: Path) -> tuple[ArmTables, pin.Model]:
    """Tables, and Pinocchio's own model of the same arm from its own source."""
    if name == "kuka":
        return KUKA, pinocchio_model(KUKA)
    own = {"tree": TREE, "fork": FORK, "oblique": OBLIQUE}
    file = urdf(folder, own[name]) if name in own else published(name)
    return read_urdf(file), pin.buildModelFromUrdf(str(file))


def with_rotor(tables: ArmTables, model: pin.Model) -> tuple[ArmTables, pin.Model]:
    """Both with an armature, which a URDF has none of."""
    rotor = np.linspace(0.1, 0.3, tables.n)
    model.armature = rotor.copy()
    return tables._replace(motor_inertia=rotor), model


def states(n: int, count: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    """q, q̇ and something per joint of size one, `[count, n]`."""
    draw = np.random.default_rng(seed)
    return draw.uniform(-np.pi, np.pi, (count, n)), draw.normal(size=(count, n)), draw.normal(size=(count, n))


def in_model(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Angles as Pinocchio's configuration, which keeps cosine and sine of a continuous joint."""
    return pin.integrate(model, pin.neutral(model), q)


def accelerations(model: pin.Model, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
    data = model.createData()
    return np.stack([pin.aba(model, data, in_model(model, a), b, c).copy() for a, b, c in zip(q, v, tau, strict=True)])


def torques(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Pinocchio's rnea, which counts the armature, as does its aba."""
    data = model.createData()
    return np.stack([pin.rnea(model, data, in_model(model, x), y, z).copy() for x, y, z in zip(q, v, a, strict=True)])


def slope_by_hand(tables: ArmTables, theta: np.ndarray | float = 0.0):
    """dx/dt of the documented equation, on motor torques."""
    model, n, g = pinocchio_model(tables), tables.n, tables.gear
    data = model.createData()

    def slope(x, u):
        q, v = x[:n], x[n:]
        tau = g * u + theta - g**2 * tables.viscous * v - g * tables.coulomb * np.sign(v)
        return np.concatenate([v, pin.aba(model, data, q, v, tau)])

    return slope


def step_by_hand(tables, x, u, *, dt=0.1, theta=0.0, s=0.0, limits=True):
    slope = slope_by_hand(tables, theta)
    a = slope(x, u)
    b = slope(x + dt / 2 * a, u)
    c = slope(x + dt / 2 * b, u)
    d = slope(x + dt * c, u)
    new = x + dt / 6 * (a + 2 * b + 2 * c + d)
    if limits:
        low = np.concatenate([tables.position_min, -tables.velocity_max])
        high = np.concatenate([tables.position_max, tables.velocity_max])
        new = np.minimum(np.maximum(new, low), high)
    return new + np.concatenate([np.zeros(tables.n), s * x[tables.n :]])
