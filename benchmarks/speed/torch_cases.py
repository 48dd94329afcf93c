"""The PyTorch loop of each system beside our program, with the same weights."""

from typing import Any

import numpy as np
import torch

from pgrssnn_jax.physics.arms.tables import described

from .cases import System, inputs, member_data, model_and_params
from .measure import Case
from .torch_loop import Batched, Loop, epoch, free_run, tensor
from .torch_physics import arm_step, physics_in_torch, pinocchio_dynamics

_FORMS = {"PyTorch loop": Loop, "PyTorch, networks batched over time": Batched}
_KIND = torch.float32


def epochs(system: System, physics: Any) -> dict[str, Case]:
    """An epoch of one member; those of several are trained one after another, so that ten take ten times as long."""
    model, params = model_and_params(system, physics)
    record = member_data(system, physics, *system.train, np.float32).train
    step, measure = physics_in_torch(physics, _KIND)
    u, y, x0 = (tensor(a, _KIND) for a in (record.u, record.y, np.zeros((len(record.u), model.n_x))))
    return {
        f"{name}, epoch": Case(epoch(form(model, params, step, measure, _KIND), u, y, x0))
        for name, form in _FORMS.items()
    }


def rollouts(system: System, physics: Any) -> dict[str, Case]:
    model, params = model_and_params(system, physics)
    u, x0 = (tensor(a, _KIND) for a in inputs(system, *system.run, np.float32))
    step, measure = physics_in_torch(physics, _KIND)
    cases = {
        f"{name}, rollout": Case(free_run(form(model, params, step, measure, _KIND), u, x0))
        for name, form in _FORMS.items()
    }
    if system.name == "arm":
        tables = described("kuka_kr300")
        called = arm_step(tables, pinocchio_dynamics(tables), physics.dt, _KIND)
        networks = Loop(model, params, called, measure, _KIND)
        cases["PyTorch loop that calls Pinocchio, rollout"] = Case(free_run(networks, u, x0))
    return cases
