"""An arm under motor torques that are held over the sample.

    M(q) q̈ + h(q, q̇) = G u + θ - G² B q̇ - |G| Tc sign(q̇)        RK4 over dt, then q and q̇ limited, then
    q̇_t ← q̇_t + S q̇_{t-1},      y = q

x = [q, q̇] in rad and rad/s; u: motor torque, Nm on the motor side; G: gear ratio; B, Tc: viscous (Nm s) and Coulomb
(Nm) friction on the motor side, none at standstill; θ: torque bias on the link side, Nm; S: the published disturbance
of the velocities. Source: Li, Seth, Kok, IFAC 2026, section 4.3, and the released code.

Effects enter at the extension points of `points.py`.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.arms import jax_dynamics, pinocchio_dynamics
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.filter import filter_states, filter_step
from pgrssnn_jax.physics.arms.jax_dynamics import Derivatives, ForwardDynamics
from pgrssnn_jax.physics.arms.kinematics import skeleton
from pgrssnn_jax.physics.arms.motion_prior import MEANINGS, OF_ALL_JOINTS, FilterNumbers
from pgrssnn_jax.physics.arms.points import ArmPoints, own_points
from pgrssnn_jax.physics.arms.tables import ArmTables, described, without_inertia
from pgrssnn_jax.physics.arms.urdf import read_urdf
from pgrssnn_jax.physics.base import Measure, Parameter, Physics, Signal, Step, discrete, extended, remembered
from pgrssnn_jax.physics.integrate import zero_order_hold

PerJoint = float | Sequence[float] | np.ndarray | None
BACKENDS: dict[str, Callable[[ArmTables, Derivatives], ForwardDynamics]] = {
    "jax": jax_dynamics.forward_dynamics,
    "native": partial(jax_dynamics.forward_dynamics, native=True),
    "pinocchio": pinocchio_dynamics.forward_dynamics,
}
_BEYOND = 1.0  # rad beyond a limit that a noisy position may still have
_MEANINGS = {
    "G": Parameter("G", "", trainable=False),
    "B": Parameter("B", "Nm s", bounds=(0.0, float("inf")), neutral=0.0),
    "Tc": Parameter("Tc", "Nm", bounds=(0.0, float("inf")), neutral=0.0),
    "S": Parameter("S", "", bounds=(-1.0, 1.0), neutral=0.0),
    "theta": Parameter("θ", "Nm", neutral=0.0),
}


@remembered
def arm(
    *,
    robot: str = "kuka_kr300",
    preset: str | None = "reference",
    urdf: str | Path | None = None,
    lock: Sequence[str] = (),
    gravity: Sequence[float] | None = None,
    joint_offset: PerJoint = None,
    gear_ratio: PerJoint = None,
    motor_inertia: PerJoint = None,
    viscous_friction: PerJoint = None,
    coulomb_friction: PerJoint = None,
    position_min: PerJoint = None,
    position_max: PerJoint = None,
    velocity_max: PerJoint = None,
    limits: bool = True,
    velocity_disturbance: PerJoint = None,
    torque_bias: PerJoint = None,
    measured: bool = True,
    dt: float = 0.1,
    integrator: str = "rk4_looped",
    sub_steps: int = 1,
    form: Literal["forward", "filter"] = "forward",
    filter_numbers: Mapping[str, PerJoint] | None = None,
    starts_at_rest: bool = True,
    backend: Literal["jax", "native", "pinocchio"] = "jax",
    physics_gradient: Literal["full", "stopped"] = "full",
    derivatives: Derivatives = "reverse",
) -> Physics:
    """An arm that comes with the package (robot, preset), or that of a URDF file (urdf, with the joints `lock` held).

    The settings from gravity (m/s²) to velocity_max replace the values of the preset or the URDF; one number stands for
    all joints. motor_inertia: kg m²; joint_offset, position_min, position_max: rad; velocity_max: rad/s;
    limits: false leaves q and q̇ unlimited. velocity_disturbance: diagonal of S; torque_bias: θ, Nm. measured: false
    when the measurement is not known (g_phy = 0, the published Model 3). physics_gradient: stopped lets no gradient
    through f_phy except that of S, as the released code does. form: `filter` for the one of `filter.py`, which needs
    filter_numbers (`FilterNumbers`; `filter_form` finds them in a record). starts_at_rest: the filter begins a record
    with all joints at rest at the positions of x_0. backend: of the forward dynamics; `native` is `jax` with a C++
    kernel where there is a compiler, equal to rounding. derivatives: the one mode in which f_phy can be differentiated,
    reverse for training, forward for the Jacobians of least squares. Raises `ValueError` for settings
    that do not fit the number of joints.
    """
    if physics_gradient not in ("full", "stopped"):
        raise ValueError(f"physics.physics_gradient: expected full or stopped, found {physics_gradient!r}")
    if derivatives not in ("reverse", "forward"):
        raise ValueError(f"physics.derivatives: expected reverse or forward, found {derivatives!r}")
    if form not in ("forward", "filter"):
        raise ValueError(f"physics.form: expected forward or filter, found {form!r}")
    if form == "filter" and backend != "jax":
        raise ValueError(f"physics.backend: expected jax with physics.form=filter, found {backend!r}")
    if backend not in BACKENDS:
        raise ValueError(f"physics.backend: expected one of {sorted(BACKENDS)}, found {backend!r}")
    if urdf is None and lock:
        raise ValueError(f"physics.lock: expected none without physics.urdf, found {list(lock)}")
    tables = described(robot, preset) if urdf is None else read_urdf(urdf, lock)
    settings: dict[str, tuple[str, Any]] = {
        "offset": ("joint_offset", joint_offset),
        "gear": ("gear_ratio", gear_ratio),
        "motor_inertia": ("motor_inertia", motor_inertia),
        "viscous": ("viscous_friction", viscous_friction),
        "coulomb": ("coulomb_friction", coulomb_friction),
        "position_min": ("position_min", position_min),
        "position_max": ("position_max", position_max),
        "velocity_max": ("velocity_max", velocity_max),
        "S": ("velocity_disturbance", velocity_disturbance),
        "theta": ("torque_bias", torque_bias),
    }
    given = {field: per_joint(name, value, tables) for field, (name, value) in settings.items() if value is not None}
    disturbances = {symbol: given.pop(symbol) for symbol in ("S", "theta") if symbol in given}
    if "gear" in given and not given["gear"].all():
        raise ValueError(f"physics.gear_ratio: expected numbers other than 0, found {gear_ratio}")
    if urdf is not None and "gear" in given:  # a URDF says friction and armature on the link side
        gear = np.abs(given["gear"])
        moved = {"viscous": tables.viscous / gear**2, "coulomb": tables.coulomb / gear}
        given = {**moved, "motor_inertia": tables.motor_inertia / gear**2, **given}
    tables = tables._replace(**given)
    if gravity is not None:
        tables = tables._replace(gravity=_gravity(gravity))
    _check_limits(tables)
    params: dict[str, Any] = {"G": tables.gear, "B": tables.viscous, "Tc": tables.coulomb, **disturbances}
    meanings: dict[str, Any] = {name: _MEANINGS[name] for name in params}
    if form == "filter":
        params["filter"] = _filter_numbers(filter_numbers, tables)
        meanings["filter"] = MEANINGS._asdict()
    accelerations = BACKENDS[backend](tables, derivatives)

    def assemble(points: ArmPoints) -> tuple[Step, Measure]:
        if form == "filter":
            filtered = filter_step(points, dt, at_rest=starts_at_rest, limits=limits)
            return _held(filtered, stopped=physics_gradient == "stopped"), points.measure

        def derivative(p: Any, x: Float[jax.Array, " x"], u: Float[jax.Array, " u"]) -> Float[jax.Array, " x"]:
            """d[q, q̇]/dt."""
            reading, v = jnp.split(x, 2)
            q = points.position(p, reading)
            extra = points.masses(p) if points.masses else Extra()
            return jnp.concatenate([v, accelerations(q, v, points.torque(p, q, v, points.drive(p, u)), extra)])

        advance = zero_order_hold(derivative, dt=dt, integrator=integrator, sub_steps=sub_steps)
        step = _step(points, advance, tables, limits=limits, stopped=physics_gradient == "stopped")
        return step, points.measure

    points = own_points(tables, masses=backend != "pinocchio", measured=measured, filtered=form == "filter")
    physics = discrete(
        "arm",
        *assemble(points),
        params,
        parameters=meanings,
        states=_states(tables.n) + (filter_states(tables.n) if form == "filter" else ()),
        inputs=tuple(Signal(f"torque_{i + 1}", "Nm") for i in range(tables.n)),
        outputs=_outputs(tables, limits=limits),
        dt=dt,
        skeleton=skeleton(tables) if tables.parents == tuple(range(-1, tables.n - 1)) else None,
        remark=_remark(tables) if urdf is not None else "",
        differentiable=physics_gradient == "full",
    )
    return extended(physics, points, assemble)


def _remark(tables: ArmTables) -> str:
    numbered = ", ".join(f"{i} {name}" for i, name in enumerate(tables.joints, 1))
    light = without_inertia(tables)
    warned = f"; without any inertia, so that they cannot be simulated before physics.motor_inertia is given: {light}"
    return f"joints of {tables.name}: {numbered}{warned if light else ''}"


def per_joint(name: str, value: Any, tables: ArmTables) -> Float[np.ndarray, " n"]:
    """A setting as one number per joint; one number stands for all. Only limits may be infinite."""
    found = _numbers(value)
    usable = np.isfinite(found) | (np.isinf(found) & (name.endswith(("_min", "_max"))))
    if found.shape not in ((), (tables.n,)) or not usable.all():
        raise ValueError(f"physics.{name}: expected one number or {tables.n}, one per joint, found {value}")
    return np.broadcast_to(found, (tables.n,)).copy()


def _filter_numbers(given: Mapping[str, PerJoint] | None, tables: ArmTables) -> dict[str, Any]:
    """Those of `FilterNumbers`, one per joint but for the last two."""
    expected = FilterNumbers._fields
    found = given or {}
    if set(found) != set(expected):
        raise ValueError(f"physics.filter_numbers: expected {', '.join(expected)}, found {', '.join(found) or 'none'}")
    for name in OF_ALL_JOINTS:
        if _numbers(found[name]).size != 1:
            raise ValueError(f"physics.filter_numbers.{name}: expected one number, found {found[name]}")
    numbers = {name: per_joint(f"filter_numbers.{name}", value, tables) for name, value in found.items()}
    numbers |= {name: numbers[name][0] for name in OF_ALL_JOINTS}
    fast = numbers["speed"] ** 2 < numbers["position"] * numbers["acceleration"]
    if not fast.all():
        name = tables.joints[int(np.argmin(fast))]
        raise ValueError(f"physics.filter_numbers: expected speed² below position x acceleration, found more at {name}")
    return numbers


def _held(step: Step, *, stopped: bool) -> Step:
    """A step in the precision of the state, through which gradients pass or not."""

    def held(p: Any, x: Float[jax.Array, " x"], u: Float[jax.Array, " u"]) -> Float[jax.Array, " x"]:
        known = (jax.tree.map(lambda number: jnp.asarray(number, x.dtype), p), x, u)
        return step(*(jax.lax.stop_gradient(known) if stopped else known))

    return held


def _gravity(value: Any) -> Float[np.ndarray, "3"]:
    found = _numbers(value)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise ValueError(f"physics.gravity: expected three numbers in m/s², found {value}")
    return found


def _numbers(value: Any) -> np.ndarray:
    """NaN for what is no number."""
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return np.asarray(np.nan)


def _check_limits(tables: ArmTables) -> None:
    for i, name in enumerate(tables.joints):
        low, high, fastest = tables.position_min[i], tables.position_max[i], tables.velocity_max[i]
        if not low < high:
            raise ValueError(
                f"physics.position_max: expected more than the {low:g} of position_min at {name}, found {high:g} rad"
            )
        if not fastest > 0:
            raise ValueError(f"physics.velocity_max: expected more than 0 rad/s at {name}, found {fastest:g}")


def _step(points: ArmPoints, advance: Step, tables: ArmTables, *, limits: bool, stopped: bool) -> Step:
    low = np.concatenate([tables.position_min, -tables.velocity_max])
    high = np.concatenate([tables.position_max, tables.velocity_max])

    def step(p: Any, x: Float[jax.Array, " x"], u: Float[jax.Array, " u"]) -> Float[jax.Array, " x"]:
        p = jax.tree.map(lambda number: jnp.asarray(number, x.dtype), p)
        known = (p, x, u)
        p_held, x_held, u_held = jax.lax.stop_gradient(known) if stopped else known
        new = advance(p_held, x_held, u_held)
        if limits:
            new = jnp.clip(new, jnp.asarray(low, x.dtype), jnp.asarray(high, x.dtype))
        return points.disturbance(p, x, points.stop(p_held, new))

    return step


def _states(n: int) -> tuple[Signal, ...]:
    names = [f"position_{i + 1}" for i in range(n)]
    return tuple(Signal(name, "rad", like=name) for name in names) + tuple(
        Signal(name.replace("position", "velocity"), "rad/s", rate_of=name) for name in names
    )


def _outputs(tables: ArmTables, *, limits: bool) -> tuple[Signal, ...]:
    """A position far beyond the joint's limits is no angle in rad."""
    beyond = _BEYOND if limits else np.inf
    low, high = tables.position_min - beyond, tables.position_max + beyond
    return tuple(Signal(f"position_{i + 1}", "rad", range=(float(low[i]), float(high[i]))) for i in range(tables.n))
