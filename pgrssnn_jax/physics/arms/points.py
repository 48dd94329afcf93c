"""What the step of an arm is made of, so that effects may enter it.

    τ  = torque(q, q̇, drive(u))               own: drive G u, then τ = drive - G² B q̇ - |G| Tc sign(q̇) + θ
    q  = position(reading)                     own: the reading
    M(q) q̈ + h(q, q̇) = τ                      inverse: the left side; masses: what the arm has besides its tables,
                                               or in their place
    q, q̇ ← stop(q, q̇)                         once the step is done and limited; own: nothing
    q̇_t ← disturbance(q̇_{t-1}, q̇_t)           own: q̇_t + S q̇_{t-1}
    y  = measure(q, q̇, u)                      own: q

u: motor torque, Nm; G: gear ratio; B (Nm s), Tc (Nm): on the motor side, none at standstill; θ: Nm on the link side.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from pgrssnn_jax.physics.arms.chain import Batch, Chain, torques, world_at
from pgrssnn_jax.physics.arms.derivatives import Matrix, inverse_jacobian
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.motion_prior import FilterNumbers
from pgrssnn_jax.physics.arms.tables import ArmTables

Joints = Float[jax.Array, " n"]
State = Float[jax.Array, " x"]
_WITH_WRIST = 6  # joints


class ArmPoints(NamedTuple):
    """Extension points of an arm. p: the physics' params in the precision of the state; x = [q, q̇].

    drive(p, u) -> Nm: torque of the motors on the link side; torque(p, q, q̇, drive) -> Nm: with all others on the link
    side; position(p, reading) -> rad, where the state holds what encoders read; masses(p) -> Extra, None where the
    moving masses are those of the tables whatever an effect says (Pinocchio); inverse(p, q, q̇, q̈, extra) -> Nm that a
    motion takes on the link side, for many samples at once `[n, batch]`; inverse_slopes: the same with its derivative
    by (q, q̇, q̈, extra), `[n, columns, batch]`; stop(p, x) -> x; disturbance(p, x_{t-1}, x_t) -> x_t;
    measure(p, x, u) -> y. tables: those of the arm without effects; filter(p): numbers of the filter, None where the
    arm is not in that form.
    """

    drive: Callable[[Any, Joints], Joints]
    torque: Callable[[Any, Joints, Joints, Joints], Joints]
    position: Callable[[Any, Joints], Joints]
    masses: Callable[[Any], Extra] | None
    inverse: Callable[[Any, Batch, Batch, Batch, Extra], Batch]
    inverse_slopes: Callable[[Any, Batch, Batch, Batch, Extra], tuple[Batch, Matrix]]
    stop: Callable[[Any, State], State]
    disturbance: Callable[[Any, State, State], State]
    measure: Callable[[Any, State, Joints], Joints]
    tables: ArmTables
    filter: Callable[[Any], FilterNumbers] | None = None

    @property
    def wrist(self) -> bool:
        """Are there six joints, the last three of which follow one another?"""
        n, parents = self.tables.n, self.tables.parents
        return n == _WITH_WRIST and parents[-2:] == (n - 3, n - 2)


def own_points(tables: ArmTables, *, masses: bool, measured: bool, filtered: bool = False) -> ArmPoints:
    """The points of an arm without effects. masses: may effects change them? measured: false for y = 0; filtered: are
    its params those of a filter too?"""
    inverse, inverse_slopes = _inverse_dynamics(Chain(tables))
    return ArmPoints(
        drive=lambda p, u: p["G"] * u,
        torque=_friction_and_bias,
        position=lambda p, reading: reading,
        masses=(lambda p: Extra()) if masses else None,
        inverse=inverse,
        inverse_slopes=inverse_slopes,
        stop=lambda p, x: x,
        disturbance=_known_disturbance,
        measure=_positions if measured else _nothing,
        tables=tables,
        filter=(lambda p: FilterNumbers(**p["filter"])) if filtered else None,
    )


def _inverse_dynamics(chain: Chain) -> tuple[Callable[..., Batch], Callable[..., tuple[Batch, Matrix]]]:
    """M q̈ + h, with a derivative in closed form, and together with that derivative."""

    @jax.custom_jvp
    def inverse(q: Batch, v: Batch, a: Batch, extra: Extra) -> Batch:
        return torques(chain, world_at(chain, q, extra), v, a, extra)

    def with_slopes(q: Batch, v: Batch, a: Batch, extra: Extra) -> tuple[Batch, Matrix]:
        world = world_at(chain, q, extra)
        return torques(chain, world, v, a, extra), inverse_jacobian(chain, v, a, world, extra)

    @inverse.defjvp
    def push(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Batch, Batch]:
        required, slopes = with_slopes(*primals)
        return required, along(slopes, *tangents)

    def columns(extra: Extra) -> Extra:
        return jax.tree.map(lambda number: number[:, None], extra)

    return (
        lambda p, q, v, a, extra: inverse(q, v, a, columns(extra)),
        lambda p, q, v, a, extra: with_slopes(q, v, a, columns(extra)),
    )


def along(slopes: Matrix, q: Batch, v: Batch, a: Batch, extra: Extra) -> Batch:
    """Derivative of the inverse dynamics along one direction of (q, q̇, q̈, extra); numbers of `extra` are columns or
    vectors."""
    motion, numbers = jnp.concatenate([q, v, a]), jax.tree.leaves(extra)
    moved = jnp.einsum("nkb,kb->nb", slopes[:, : len(motion)], motion)
    if numbers:
        moved += jnp.einsum("nkb,k->nb", slopes[:, len(motion) :], jnp.concatenate([one.ravel() for one in numbers]))
    return moved


def _friction_and_bias(p: Any, q: Joints, v: Joints, drive: Joints) -> Joints:
    gear = p["G"]
    tau = drive - (gear**2 * p["B"] * v + jnp.abs(gear) * p["Tc"] * jnp.sign(v))
    return tau + p["theta"] if "theta" in p else tau


def _known_disturbance(p: Any, x: State, new: State) -> State:
    n = len(x) // 2
    return new.at[n:].add(p["S"] * x[n:]) if "S" in p else new


def _positions(p: Any, x: State, u: Joints) -> Joints:
    return x[: len(u)]


def _nothing(p: Any, x: State, u: Joints) -> Joints:
    return jnp.zeros_like(x[: len(u)])
