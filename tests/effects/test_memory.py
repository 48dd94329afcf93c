"""Effects of an input that remember, where an output depends on the input directly."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

import pgrssnn_jax as pg
from pgrssnn_jax.effects.memory import reads_input

SAMPLES = 40


def slider(output_timing: str) -> pg.Physics:
    """A body with damping, pushed by u; measured are its speed and its acceleration."""
    return pg.continuous(
        "slider",
        lambda p, x, u: p["gain"] * u - x,
        lambda p, x, u: jnp.concatenate([x, p["gain"] * u - x]),
        {"gain": 2.0},
        dt=0.1,
        states=(pg.Signal("speed", "m/s", like="speed"),),
        inputs=(pg.Signal("force", "N"),),
        outputs=(pg.Signal("speed", "m/s"), pg.Signal("acceleration", "m/s^2")),
        output_timing=output_timing,
    )


def free_run(physics: pg.Physics, u: Float[np.ndarray, "time 1"]) -> Float[np.ndarray, "time 2"]:
    return np.asarray(pg.simulate(physics, u, np.zeros(len(physics.states))).y)


def late(u: np.ndarray, samples: int) -> np.ndarray:
    return np.concatenate([np.repeat(u[:1], samples, 0), u[: len(u) - samples]])


def lagged(u: np.ndarray, kept: float) -> np.ndarray:
    """Mean of a first-order lag over each sample."""
    z, found = u[0], []
    for now in u:
        found.append(now + (z - now) * (1.0 - kept) / -np.log(kept))
        z = now + kept * (z - now)
    return np.array(found)


def played(u: np.ndarray, half: float) -> np.ndarray:
    z, found = u[0], []
    for now in u:
        z = np.minimum(np.maximum(z, now - half), now + half)
        found.append(z)
    return np.array(found)


@pytest.mark.parametrize("timing", ["after_step", "before_step"])
@pytest.mark.parametrize(
    ("name", "number", "acting"),
    [
        ("input_delay", {"delay": 0.3}, lambda u: late(u, 3)),
        ("input_lag", {"time_constant": 0.2}, lambda u: lagged(u, np.exp(-0.5))),
        ("backlash", {"half_width": 0.3}, lambda u: played(u, 0.3)),
    ],
)
def test_an_output_that_depends_on_the_input_sees_what_acts(name, number, acting, timing):
    """As if the input itself were late; the first sample acts from the beginning."""
    physics = slider(timing)
    u = np.random.default_rng(1).normal(size=(SAMPLES, 1))
    u[0] = 0.0
    found = free_run(pg.add(physics, name, **number), u)
    np.testing.assert_allclose(found, free_run(physics, acting(u)), rtol=1e-4, atol=1e-5)
    assert np.abs(found - free_run(physics, u))[:, 1].max() > 0.1


def test_effects_with_memory_follow_one_another():
    """What is added later acts earlier: late, then with play."""
    physics = slider("after_step")
    u = np.cumsum(np.random.default_rng(2).normal(size=(SAMPLES, 1)), 0)
    u[0] = 0.0
    both = pg.add(pg.add(physics, "backlash", half_width=0.5), "input_delay", delay=0.2)
    expected = free_run(physics, played(late(u, 2), 0.5))
    np.testing.assert_allclose(free_run(both, u), expected, rtol=1e-4, atol=1e-5)


def test_physics_whose_outputs_are_states_remember_no_more_than_before():
    physics = slider("after_step")
    assert reads_input(physics)
    alone = physics._replace(measure=lambda p, x, u: jnp.concatenate([x, x]))
    assert not reads_input(alone)
    counts = [len(pg.add(one, "input_lag", time_constant=0.1).states) for one in (alone, physics)]
    assert counts == [2, 3]
