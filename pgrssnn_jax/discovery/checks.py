"""What a physics must offer to be examined: a free run over the record that stays finite, and so do its derivatives."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.inverse.motion import Motion
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.neutral import check_neutral
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem
from pgrssnn_jax.discovery.scoring import scoring
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.physics.check import of_library
from pgrssnn_jax.physics.stiffness import LARGEST, of_shorter_steps


def check_physics(setup: Setup) -> None:
    """Raises `ValueError` when the nominal physics cannot be simulated over the record, or where its derivatives by a
    parameter or a state are not finite: no fit could move them. Those of the library's own physics are."""
    with jax.enable_x64(True):
        problem = build_problem(setup.physics, (), accelerate=False)  # one run is not worth a compiler
        record = scoring(problem, setup.estimation, setup.settings, setup.start, np.random.default_rng(0))
        signals = record.signals(problem)
        y, x = simulate(problem, signals.u, problem.theta[None], signals.start[None])
        _check_free_run(problem, signals, y[0], x[0])
        before = np.concatenate([signals.start[:, None], x[0][:, :-1]], 1)
        check_neutral(setup.physics, setup.own_effects, *(a.reshape(-1, a.shape[-1]) for a in (before, signals.u)))
        if not of_library(setup.physics):
            _check_derivatives(problem, before[0], signals.u[0])


def check_effects_of_motion(setup: Setup, motion: Motion) -> None:
    """Raises `ValueError` for an own effect that changes the physics at neutral numbers, along a measured motion."""
    x = np.concatenate([motion.reading, motion.v], -1)
    check_neutral(setup.physics, setup.own_effects, *(a.reshape(-1, a.shape[-1]) for a in (x, motion.torque)))


def _check_free_run(
    problem: Problem, signals: Signals, y: Float[np.ndarray, "seq time y"], x: Float[np.ndarray, "seq time x"]
) -> None:
    physics = problem.physics
    for what, named, values in (("state", problem.full.states, x), ("output", physics.outputs, y)):
        usable = np.abs(values) < LARGEST  # False for NaN
        finite = usable.all((0, 2))
        if finite.all():
            continue
        first = int(np.argmin(finite))
        name = named[int(np.argmin(usable[:, first].all(0)))].name
        hint = of_shorter_steps(physics, signals.u, signals.start) if what == "state" and first else ""
        raise ValueError(
            f"physics {physics.name!r}: expected a free run that stays finite over the record, found {what} {name!r} "
            f"beyond the floating-point range from sample {first} on{hint}"
        )


def _check_derivatives(problem: Problem, before: Float[np.ndarray, "time x"], u: Float[np.ndarray, "time u"]) -> None:
    """Of every step and reading of a sequence."""
    full, unravel = problem.full, problem.code.unravel

    def together(theta: jax.Array, x: jax.Array, u: jax.Array) -> jax.Array:
        p = unravel(theta)
        new = full.step(p, x, u)
        return jnp.concatenate([new, full.measure(p, new, u)])

    by_theta, by_x = jax.jit(jax.vmap(jax.jacfwd(together, (0, 1)), (None, 0, 0)))(
        jnp.asarray(problem.theta), jnp.asarray(before), jnp.asarray(u)
    )
    own = problem.of(None)
    _check(problem, np.asarray(by_x), "state", [state.name for state in problem.full.states])
    _check(problem, np.asarray(by_theta)[..., own], "parameter", [problem.slots[i].label for i in own])


def _check(
    problem: Problem, derivatives: Float[np.ndarray, "time out number"], kind: str, names: Sequence[str]
) -> None:
    for name, column in zip(names, np.moveaxis(derivatives, -1, 0), strict=True):
        finite = np.isfinite(column).all(-1)
        if not finite.all():
            raise ValueError(
                f"physics {problem.physics.name!r}: expected finite derivatives along the free run, found one by the "
                f"{kind} {name!r} that is not at sample {int(np.argmin(finite))} (a square root or a power at zero, "
                "say, which jnp.where must keep out of both branches)"
            )
