"""Effects of an input that remember, where an output depends on the input directly."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float
from scipy.integrate import solve_ivp

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


def lagged(u: np.ndarray, kept: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean of a first-order lag over each sample, and its value at the end."""
    z, mean, last = u[0], [], []
    for now in u:
        mean.append(now + (z - now) * (1.0 - kept) / -np.log(kept))
        z = now + kept * (z - now)
        last.append(z)
    return np.array(mean), np.array(last)


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


@pytest.mark.parametrize("timing", ["after_step", "before_step"])
def test_an_output_is_read_with_the_lagged_input_at_the_end_of_the_sample(timing):
    """The mean over the sample, which moves the state, was true half a sample before; with the state before the step
    it is the best that is known."""
    physics, u = slider(timing), np.random.default_rng(1).normal(size=(SAMPLES, 1))
    u[0] = 0.0
    mean, last = lagged(u, np.exp(-0.5))
    speed = free_run(physics, mean)[:, :1]
    acting = last if timing == "after_step" else mean
    expected = np.hstack([speed, 2.0 * acting - speed])
    found = free_run(pg.add(physics, "input_lag", time_constant=0.2), u)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_a_lagged_acceleration_agrees_with_small_steps():
    """dz/dt = (u - z) / T, dv/dt = 2 z - v, both read at the end of the sample; scipy with tight tolerances."""
    u, t, dt = np.random.default_rng(3).normal(size=(SAMPLES, 1)), 0.2, 0.1
    u[0], at, expected, flow = 0.0, np.zeros(2), [], np.array([[-1.0 / t, 0.0], [2.0, -1.0]])
    for now in u[:, 0]:
        run = solve_ivp(lambda _, s, now=now: flow @ s + [now / t, 0.0], (0.0, dt), at, rtol=1e-9, atol=1e-12)
        at = run.y[:, -1]
        expected.append([at[1], 2.0 * at[0] - at[1]])
    found = free_run(pg.add(slider("after_step"), "input_lag", time_constant=t), u)
    assert np.abs(found - expected).max() < 0.02 * np.std(expected)


@pytest.mark.parametrize("delay", [0.04, 0.24, 0.3])
@pytest.mark.parametrize("behind", ["input_lag", "backlash"])
def test_a_late_acceleration_is_that_of_the_end_of_the_sample_beside_another_memory(delay, behind):
    """dv/dt = 2 u(t - d) - v, exactly: u changes once within a sample at most. The other effect does nothing."""
    u, dt, v, expected = np.random.default_rng(4).normal(size=SAMPLES), 0.1, 0.0, []
    u[:4] = 0.0
    whole = int(np.floor(delay / dt + 1e-9))
    for k in range(SAMPLES):
        old, new = (u[max(k - n, 0)] for n in (whole + 1, whole))
        for force, span in ((old, delay - whole * dt), (new, dt - delay + whole * dt)):
            v = 2.0 * force + (v - 2.0 * force) * np.exp(-span)
        expected.append([v, 2.0 * new - v])
    physics = pg.add(pg.add(slider("after_step"), behind), "input_delay", delay=delay)
    np.testing.assert_allclose(free_run(physics, u[:, None]), expected, atol=2e-4)


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
