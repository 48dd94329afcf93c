"""Self-check: python -m benchmarks.hidden.check, from the root of the repository.

Without effect, noise and wrong parameters a case must be the base physics up to discretisation: RMS of the difference
of the test outputs is printed for the nominal integrator and for finer ones. Then a few cases of every system.
"""

import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.linear import lgssm as linear
from pgrssnn_jax.physics.tanks import cascaded_tanks

from . import arm as hidden_arm
from . import chain, circuit, drive, duffing, hysteretic, lgssm, pendulum, reactor, servo, tanks
from .case import SYSTEMS, Case
from .nominal import USERS
from .suite import KINDS, build, plans


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    print("RMS of (case without effect - base physics), test record, unit of the output")
    exact_tanks()
    exact_pendulum()
    exact_users()
    exact_linear()
    exact_arm()
    same_twice()
    for system in SYSTEMS:
        print(f"\n{system}: three cases of each kind")
        for plan in plans(system, 3 * len(KINDS), seed=1):
            started = time.perf_counter()
            show(plan.kind, build(plan), time.perf_counter() - started)


def free_run(physics: Physics, u: np.ndarray, x0: Any) -> np.ndarray:
    """Outputs `[seq, time, y]` of the base physics from x0 `[x]`."""

    def run(u: jax.Array) -> jax.Array:
        def body(x: jax.Array, u_t: jax.Array) -> tuple[jax.Array, jax.Array]:
            x = physics.step(params, x, u_t)
            return x, physics.measure(params, x, u_t)

        return jax.lax.scan(body, jnp.asarray(x0, float), u)[1]

    params = jax.tree.map(jnp.asarray, physics.params)
    return np.asarray(jax.jit(jax.vmap(run))(jnp.asarray(u)))


def difference(case: Case, physics: Physics, x0: Any) -> np.ndarray:
    """Per output; x0: of the plant, whose effects may have states of their own after those of the physics."""
    x0 = x0[: len(physics.states)]
    return np.sqrt(np.mean((case.test.y - free_run(physics, case.test.u, x0)) ** 2, axis=(0, 1)))


def exact_tanks() -> None:
    settings = {"Euler, nominal": {}, "RK4": {"integrator": "rk4"}, "RK4, 20": {"integrator": "rk4", "sub_steps": 20}}
    for seed in range(3):
        case = tanks.build(seed, noise=0.0, spread=0.0)
        x0 = case.magnitudes["start"][1]
        print("tanks", seed, {k: f"{difference(case, cascaded_tanks(**s), x0)[0]:.2g}" for k, s in settings.items()})


def exact_pendulum() -> None:
    for seed in range(3):
        case = pendulum.build(seed, noise=0.0)
        physics = pendulum.pendulum(**case.magnitudes["parameters"])
        print("pendulum", seed, f"{difference(case, physics, case.magnitudes['start'][1])[0]:.2g}")


def exact_users() -> None:
    for module in (servo, duffing, chain, hysteretic, drive, circuit, reactor):
        case = module.build(0, noise=0.0)
        physics = USERS[case.system](**case.magnitudes["parameters"])
        found, size = difference(case, physics, case.magnitudes["start"][1]), case.test.y.std(axis=(0, 1))
        print(case.system, found.round(9), "of the deviation", (found / size).round(9))


def exact_linear() -> None:
    case = lgssm.build(0, noise=0.0)
    print("lgssm", f"{difference(case, linear(**case.magnitudes['parameters']), case.magnitudes['start'][1])[0]:.2g}")


def exact_arm() -> None:
    case = hidden_arm.build(0, noise=0.0)
    friction = {f"{name}_friction": case.magnitudes[name] for name in ("viscous", "coulomb")}
    for sub_steps in (1, 2, 5, 10, 20):
        found = difference(case, arm(dt=case.train.info.dt, sub_steps=sub_steps, **friction), np.zeros(12))
        print(f"arm, {sub_steps} sub-steps, per joint", found.round(5))


def same_twice() -> None:
    """A case is a function of its seed; another noise changes nothing else."""
    for module in (tanks, lgssm, pendulum, hidden_arm, servo, duffing, chain, hysteretic, drive, circuit, reactor):
        name = next(iter(module.CATALOGUE.acts_on))
        quiet, again, loud = (module.build(7, (name,), noise=n) for n in (0.005, 0.005, 0.01))
        assert np.array_equal(quiet.train.y, again.train.y)
        assert np.array_equal(quiet.test.u, loud.test.u)
        assert not np.array_equal(quiet.test.y, loud.test.y)


def show(kind: str, case: Case, seconds: float) -> None:
    def ends(a: np.ndarray) -> str:
        return f"{a.min():.2f}..{a.max():.2f}"

    effects = {k: v for k, v in case.magnitudes.items() if k not in ("parameters", "start", "process_noise")}
    print(
        f"{kind:8s}{seconds:5.2f} s  noise {case.noise:<6g}floor {case.floor:.4f}  change {case.change:7.3f}"
        f"  u {ends(case.train.u)}  y {ends(case.train.y)} / {ends(case.test.y)}  {case.truth} {case.removed} {effects}"
    )


if __name__ == "__main__":
    main()
