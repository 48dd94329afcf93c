"""What one process measures, on the cores that it was started with: `rollout.py` starts it.

Each part measures the calls that are compared in turn, and gives name -> figures: "ms" (median and quartiles of one
epoch, rollout or call), "rounds" (ms of each turn), and for compiled programs "compile_s", "compilations", "memory_mb"
and "roof".
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from pgrssnn_jax.acceleration.devices import usable_cores
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Physics

from . import arm_dynamics
from .cases import SYSTEMS, System, inputs, model_and_params, rollout_call, training, training_call, usual_route
from .goals import OF_AN_EPOCH, PINOCCHIO, XLA
from .roof import roof
from .timing import Program, compiled, interleaved, spread
from .work import Work, epoch_work, rollout_work

Figures = dict[str, dict[str, Any]]


class Case(NamedTuple):
    """per_call: epochs, or evaluations, of one call. program: None for what is not ours."""

    call: Callable[[], Any]
    per_call: float = 1.0
    program: Program | None = None
    work: Work | None = None
    dtype: Any = np.float32


def measured(cases: dict[str, Case], repeats: int) -> Figures:
    found = interleaved({name: case.call for name, case in cases.items()}, repeats)
    return {name: _figures(case, [ms / case.per_call for ms in found[name]]) for name, case in cases.items()}


def _figures(case: Case, rounds: list[float]) -> dict[str, Any]:
    figures: dict[str, Any] = {"ms": spread(rounds), "rounds": rounds}
    if case.program is not None:
        figures |= {name: getattr(case.program, name) for name in ("compile_s", "compilations", "memory_mb")}
        if case.work is not None:
            bounds = roof(case.work, case.program, int(case.per_call), figures["ms"][0], usable_cores(), case.dtype)
            figures["roof"] = bounds._asdict()
    return figures


def system_part(name: str, *, quick: bool, compare: bool) -> Figures:
    """Epochs of one member and of an experiment's, a rollout, and the PyTorch loop of each."""
    system = _smaller(SYSTEMS[name]) if quick else SYSTEMS[name]
    physics = system.physics()
    cases = {}
    for form, route in {"": usual_route(np.float32), XLA: None}.items():
        counts = sorted({1, system.members})
        cases |= {f"epoch, {_counted(n)}{form}": epoch_case(system, physics, n, route=route) for n in counts}
        cases[f"rollout{form}"] = rollout_case(system, physics, *system.run, route=route)
    if compare:
        from . import torch_cases  # PyTorch is an optional extra

        cases |= torch_cases.epochs(system, physics) | torch_cases.rollouts(system, physics)
    return measured(cases, 2 if quick else 7)


def arm_part(*, quick: bool, compare: bool) -> Figures:
    """Forward dynamics by every backend, epochs of one member, a rollout, and Pinocchio's algorithm alone."""
    system = _smaller(SYSTEMS["arm"]) if quick else SYSTEMS["arm"]
    samples = system.train[1]
    forms = {"": (usual_route(np.float32), "native"), XLA: (None, "jax")}
    physics = {form: arm(backend=backend) for form, (_, backend) in forms.items()}
    cases = {
        f"epoch, gradient {gradient}{form}": epoch_case(
            system, physics[form].variant(physics_gradient=gradient), 1, epochs=2, route=route
        )
        for gradient in (("stopped",) if quick else ("stopped", "full"))  # compiling is most of a quick run
        for form, (route, _) in forms.items()
    }
    backends = arm_dynamics.BACKENDS[:2] if quick else arm_dynamics.BACKENDS
    for name, program in arm_dynamics.free_runs(samples, backends, gradients=not quick).items():
        cases[f"evaluation, {name}"] = Case(program.call, arm_dynamics.evaluations(samples), program)
    alone = arm_dynamics.pinocchio_calls()
    for name, call in alone.items():
        cases[f"evaluation, {name}"] = Case(call, arm_dynamics.EVALUATIONS_PER_CALL)
    epochs = arm_dynamics.EVALUATIONS_PER_CALL / arm_dynamics.evaluations(samples)
    cases[OF_AN_EPOCH] = Case(alone[PINOCCHIO], epochs)
    found = measured(cases, 2 if quick else 5)
    runs = {
        f"rollout{form}": rollout_case(system, physics[form], *system.run, route=route)
        for form, (route, _) in forms.items()
    }
    if compare:
        from . import torch_cases

        runs |= torch_cases.rollouts(system, physics[XLA])
    return found | measured(runs, 2 if quick else 3)


def epoch_case(
    system: System,
    physics: Any,
    members: int,
    *,
    epochs: int = 20,
    dtype: Any = np.float32,
    mapping: Any = None,
    route: Any = None,
) -> Case:
    fit, data = training(system, physics, epochs=epochs, dtype=dtype, route=route, alone=members == 1)
    program = compiled(*training_call(fit, data, members, mapping))
    work = epoch_work(system.spec, _written_out(physics), system.stages, *system.train, members=members)
    return Case(program.call, epochs, program, work, dtype)


def rollout_case(
    system: System,
    physics: Any,
    sequences: int,
    samples: int,
    *,
    dtype: Any = np.float32,
    route: Any = None,
    chunk: Any = "auto",
) -> Case:
    model, params = model_and_params(system, physics, dtype=dtype)
    u, x0 = inputs(system, sequences, samples, dtype)
    program = compiled(*rollout_call(model, params, u, x0, route=route, chunk=chunk))
    work = rollout_work(system.spec, _written_out(physics), system.stages, sequences, samples)
    return Case(program.call, 1, program, work, dtype)


def _written_out(physics: Physics) -> Physics:
    """The same physics in operations that can be counted: without a C++ kernel."""
    return physics.variant(backend="jax") if physics.name == "arm" else physics


def gru_part(*, quick: bool, compare: bool) -> Figures:
    """The recurrence alone, forwards and with its gradient, at the sizes of the three systems."""
    from .gru import ours, theirs

    found: Figures = {}
    for system in SYSTEMS.values():
        sequences, samples = system.train
        size = (8 if quick else samples, sequences, system.spec.hidden)
        cases = ours(*size)
        if compare:
            cases |= theirs(*size)
        named = {f"{system.name} {list(size)}, {name}": Case(call) for name, call in cases.items()}
        found |= measured(named, 2 if quick else 9)
    return found


def _counted(members: int) -> str:
    return f"{members} member{'s' if members > 1 else ''}"


def _smaller(system: System) -> System:
    """A few samples and members."""
    (sequences, length), (runs, steps) = system.train, system.run
    return system._replace(train=(sequences, max(8, length // 30)), run=(runs, steps // 40), members=2)
