"""The physics of the three systems in PyTorch, batched over sequences: the equations of `pgrssnn_jax.physics`."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import torch

from pgrssnn_jax.physics.arms.tables import ArmTables, described, pinocchio_model, turn_z
from pgrssnn_jax.physics.base import Physics

Step = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
Dynamics = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]  # q, q̇, τ `[seq, n]` -> q̈


def physics_in_torch(physics: Physics, dtype: torch.dtype) -> tuple[Step, Step]:
    """step and measure of one of the systems in `cases.py`."""
    if physics.name == "arm":
        tables = described("kuka_kr300")
        return arm_step(tables, spatial_dynamics(tables, dtype), physics.dt, dtype), lambda x, u: x[..., : tables.n]
    numbers = {name: torch.tensor(np.asarray(value), dtype=dtype) for name, value in physics.params.items()}
    if physics.name == "tanks":
        return tank_step(numbers, physics.dt), lambda x, u: x[..., 1:]
    a, b, c = (numbers[name].T for name in "ABC")
    return lambda x, u: x @ a + u @ b, lambda x, u: x @ c


def tank_step(p: dict[str, torch.Tensor], dt: float) -> Step:
    def step(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        wet = x > 0
        root = torch.where(wet, torch.sqrt(torch.where(wet, x, 1.0)), 0.0)
        level = torch.clamp(x, min=0.0)
        upper = p["k1"] * root[:, 0] - p["k2"] * level[:, 0]
        outlet = p["k4"] * root[:, 1] - p["k5"] * level[:, 1]
        return x + dt * torch.stack([p["k3"] * u[:, 0] - upper, upper - outlet], -1)

    return step


def arm_step(tables: ArmTables, dynamics: Dynamics, dt: float, dtype: torch.dtype) -> Step:
    """RK4 over one sample with the torque held, then q and q̇ limited."""
    gear, viscous, coulomb = (torch.tensor(v, dtype=dtype) for v in (tables.gear, tables.viscous, tables.coulomb))
    damping, dry = gear**2 * viscous, gear.abs() * coulomb
    low = torch.tensor(np.concatenate([tables.position_min, -tables.velocity_max]), dtype=dtype)
    high = torch.tensor(np.concatenate([tables.position_max, tables.velocity_max]), dtype=dtype)

    def step(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        drive = gear * u

        def field(x: torch.Tensor) -> torch.Tensor:
            q, v = x.split(tables.n, -1)
            return torch.cat([v, dynamics(q, v, drive - damping * v - dry * torch.sign(v))], -1)

        k1 = field(x)
        k2 = field(x + 0.5 * dt * k1)
        k3 = field(x + 0.5 * dt * k2)
        k4 = field(x + dt * k3)
        x = x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        return torch.minimum(torch.maximum(x, low), high)

    return step


def spatial_dynamics(tables: ArmTables, dtype: torch.dtype) -> Dynamics:
    """M(q) q̈ + h(q, q̇) = τ of a serial chain: h by recursive Newton-Euler, M by composite inertias, both in the links'
    frames with matrices of 6 x 6 (angular part first). Source: Featherstone, Rigid Body Dynamics Algorithms, 2008."""
    n = tables.n
    fixed = [torch.tensor(tables.rotation[i] @ turn_z(tables.offset[i]), dtype=dtype) for i in range(n)]
    shift = [torch.tensor(_skew(tables.position[i]), dtype=dtype) for i in range(n)]
    inertia = [torch.tensor(_spatial_inertia(tables, i), dtype=dtype) for i in range(n)]
    armature = torch.diag(torch.tensor(tables.armature, dtype=dtype))
    weight = torch.tensor([0.0, 0.0, 0.0, *(-tables.gravity)], dtype=dtype)

    def dynamics(q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
        to_child = [_transform(fixed[i], shift[i], q[:, i]) for i in range(n)]
        velocity, acceleration = torch.zeros(len(q), 6, 1, dtype=dtype), weight[:, None].expand(len(q), 6, 1)
        force = []
        for i in range(n):
            own = torch.zeros(len(q), 6, 1, dtype=dtype)
            own[:, 2, 0] = v[:, i]
            velocity = to_child[i] @ velocity + own
            cross = _motion_cross(velocity[..., 0])
            acceleration = to_child[i] @ acceleration + cross @ own
            force.append(inertia[i] @ acceleration - cross.mT @ (inertia[i] @ velocity))
        carried = [one.expand(len(q), 6, 6) for one in inertia]
        bias = [torch.empty(0)] * n
        mass = [[torch.zeros(len(q), dtype=dtype)] * n for _ in range(n)]
        for i in reversed(range(n)):
            bias[i] = force[i][:, 2, 0]
            column = carried[i][:, :, 2:3]
            mass[i][i] = column[:, 2, 0]
            for j in reversed(range(i)):
                column = to_child[j + 1].mT @ column
                mass[i][j] = mass[j][i] = column[:, 2, 0]
            if i:
                force[i - 1] = force[i - 1] + to_child[i].mT @ force[i]
                carried[i - 1] = carried[i - 1] + to_child[i].mT @ carried[i] @ to_child[i]
        matrix = torch.stack([torch.stack(row, -1) for row in mass], -2) + armature
        return torch.linalg.solve(matrix, tau - torch.stack(bias, -1))

    return dynamics


def pinocchio_dynamics(tables: ArmTables) -> Dynamics:
    """Pinocchio called from Python for one sequence after another; no gradient."""
    model = pinocchio_model(tables)
    data = model.createData()

    def dynamics(*given: torch.Tensor) -> torch.Tensor:
        rows = zip(*(one.numpy().astype(np.float64) for one in given), strict=True)
        return torch.tensor(np.stack([pin.aba(model, data, *row) for row in rows]), dtype=given[0].dtype)

    return dynamics


def _transform(fixed: torch.Tensor, shift: torch.Tensor, angle: torch.Tensor) -> torch.Tensor:
    """Motion vectors of the parent in the frame of the child, `[seq, 6, 6]`."""
    c, s, zero = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)
    turn = torch.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1.0], -1).reshape(-1, 3, 3)
    back = (fixed @ turn).mT
    upper = torch.cat([back, torch.zeros_like(back)], -1)
    return torch.cat([upper, torch.cat([-back @ shift, back], -1)], -2)


def _motion_cross(v: torch.Tensor) -> torch.Tensor:
    """v × of a motion vector, `[seq, 6, 6]`."""
    wx, wy, wz, x, y, z = v.unbind(-1)
    zero = torch.zeros_like(wx)
    turn = torch.stack([zero, -wz, wy, wz, zero, -wx, -wy, wx, zero], -1).reshape(-1, 3, 3)
    move = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    return torch.cat([torch.cat([turn, torch.zeros_like(turn)], -1), torch.cat([move, turn], -1)], -2)


def _spatial_inertia(tables: ArmTables, i: int) -> Any:
    """About the joint's origin: [[I + m c× c×ᵀ, m c×], [m c×ᵀ, m 1]]."""
    mass, arm = tables.mass[i], _skew(tables.center[i])
    about = tables.inertia[i] + mass * arm @ arm.T
    return np.block([[about, mass * arm], [mass * arm.T, mass * np.eye(3)]])


def _skew(p: np.ndarray) -> np.ndarray:
    x, y, z = p
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
