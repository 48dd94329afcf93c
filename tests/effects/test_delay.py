"""An input that is late by parts of a sample, beside plants whose input changes within a sample."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from toys import TOY_PARAMS, quick_jit, toy_physics, toy_step

import pgrssnn_jax as pg
from pgrssnn_jax.effects.delay import LONGEST_DELAY
from pgrssnn_jax.physics.simulate import free_run

pytestmark = pytest.mark.usefixtures("x64")
GAIN = 2.0


def plant(dt: float, gain: float = GAIN, sub_steps: int = 4) -> pg.Physics:
    """Two vessels in a row, the first with a curved outlet, filled through a valve of this gain."""

    def rate(p, x, u):
        return jnp.stack([p["gain"] * u[0] - x[0] - 0.3 * x[0] ** 3, x[0] - 0.5 * x[1]])

    return pg.continuous(
        "vessels",
        rate,
        lambda p, x, u: x,
        {"gain": gain},
        parameters={"gain": pg.Parameter("g")},
        states=(pg.Signal("a"), pg.Signal("b")),
        inputs=(pg.Signal("u"),),
        outputs=(pg.Signal("a"), pg.Signal("b")),
        dt=dt,
        sub_steps=sub_steps,
    )


def held(dt: float, time: float = 24.0) -> np.ndarray:
    """An input `[sample]` that changes every two seconds."""
    levels = np.random.default_rng(2).uniform(-1.0, 1.0, 12)
    return levels[(np.arange(round(time / dt)) * dt / 2.0 + 1e-9).astype(int)]


def exact(u: np.ndarray, dt: float, delay: float, dead: float = 0.0) -> np.ndarray:
    """States `[sample, 2]` of the plant behind the delay in s and a dead zone, from one change of its input to the
    next; at rest, with no input before the record."""
    u = np.sign(u) * np.maximum(np.abs(u) - dead, 0.0)
    x, found, changes = np.zeros(2), [], np.arange(len(u)) * dt + delay
    for k in range(len(u)):
        inside = changes[(changes > k * dt + 1e-12) & (changes < (k + 1) * dt - 1e-12)]
        for begin, end in zip([k * dt, *inside], [*inside, (k + 1) * dt], strict=True):
            seen = np.searchsorted(changes, (begin + end) / 2) - 1
            value = GAIN * u[seen] if seen >= 0 else 0.0
            x = solve_ivp(
                lambda t, x, value=value: [value - x[0] - 0.3 * x[0] ** 3, x[0] - 0.5 * x[1]],
                (begin, end), x, rtol=1e-10, atol=1e-12,
            ).y[:, -1]  # fmt: skip
        found.append(x)
    return np.array(found)


def simulated(physics: pg.Physics, u: np.ndarray) -> np.ndarray:
    return np.asarray(free_run(physics, u[None, :, None], np.zeros((1, len(physics.states))))[0])[0, :, :2]


@pytest.mark.parametrize("part", [0.2, 0.5, 0.7])
def test_a_delay_between_samples_is_that_of_an_input_which_is_held(part):
    """The error falls faster than the square of the sample time, and is small beside that of two inputs mixed."""
    errors, mixed = [], []
    for dt in (0.5, 0.25):
        u, delay = held(dt), (1 + part) * dt
        truth = exact(u, dt, delay)
        errors.append(np.abs(simulated(pg.add(plant(dt), "input_delay", delay=delay), u) - truth).max())
        late = np.concatenate([[0.0, 0.0], u])
        between = part * late[: len(u)] + (1 - part) * late[1 : len(u) + 1]
        mixed.append(np.abs(simulated(plant(dt), between) - truth).max())
    assert errors[0] < 0.1 * mixed[0]
    assert errors[1] < errors[0] / 5.0
    assert errors[1] < 0.06 * mixed[1]


def test_a_dead_zone_behind_the_delay_sees_both_inputs():
    """Not their mean, which may lie inside of it."""
    dt, u = 0.25, held(0.25)
    numbers = {"input_dead_zone": {"width": 0.4}, "input_delay": {"delay": 1.5 * dt}}
    physics = plant(dt)
    for name, of_effect in numbers.items():
        physics = pg.add(physics, name, **of_effect)
    truth = exact(u, dt, 1.5 * dt, dead=0.4)
    between = 0.5 * np.concatenate([[0.0, 0.0], u])[: len(u)] + 0.5 * np.concatenate([[0.0], u])[: len(u)]
    mixed = simulated(pg.add(plant(dt), "input_dead_zone", width=0.4), between)
    assert np.abs(simulated(physics, u) - truth).max() < 0.1 * np.abs(mixed - truth).max()


def test_every_input_changes_at_its_own_time():
    """Of two vessels with an input each, which are one vessel twice."""
    dt, u, delays = 0.25, held(0.25), (1.3 * 0.25, 2.6 * 0.25)

    def rate(p, x, u):
        return jnp.stack([GAIN * u[i] - x[i] - 0.3 * x[i] ** 3 for i in (0, 1)])

    signals = {kind: tuple(pg.Signal(f"{kind}{i}") for i in (1, 2)) for kind in ("states", "inputs", "outputs")}
    both = pg.continuous("pair", rate, lambda p, x, u: x, {}, parameters={}, dt=dt, sub_steps=4, **signals)
    late = pg.add(both, "input_delay", delay=list(delays))
    start = np.zeros((1, len(late.states)))
    found = np.asarray(free_run(late, np.stack([u, u], -1)[None], start)[0])[0]
    for i, delay in enumerate(delays):
        alone = simulated(pg.add(plant(dt), "input_delay", delay=delay), u)
        np.testing.assert_allclose(found[:, i], alone[:, 0], rtol=1e-10, atol=1e-12)


def test_what_an_input_passes_on_its_way_acts_on_its_early_part_too():
    dt, u = 0.25, held(0.25)
    delay = {"delay": 1.3 * dt}
    expected = simulated(pg.add(plant(dt, gain=3.0), "input_delay", **delay), u)
    stronger = pg.add(plant(dt), "input_gain", gain=1.5)
    np.testing.assert_allclose(simulated(pg.add(stronger, "input_delay", **delay), u), expected, rtol=1e-12)
    later = pg.add(pg.add(plant(dt), "input_delay", **delay), "input_gain", gain=1.5)
    np.testing.assert_allclose(simulated(later, u), expected, rtol=1e-12)


def test_a_later_effect_inside_the_step_changes_the_early_part_too():
    """Two orders of a delay and a leak of the first vessel, which changes how the early part of an input decays."""
    dt, u = 0.25, held(0.25)
    numbers = {"input_delay": {"delay": 1.4 * dt}, "leak": {"r": 0.4}}
    orders = (["leak", "input_delay"], ["input_delay", "leak"])
    found = []
    for names in orders:
        physics = plant(dt)
        for name in names:
            physics = pg.add(physics, name, **numbers[name])
        found.append(simulated(physics, u))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12, atol=1e-14)
    assert np.abs(found[0] - simulated(pg.add(plant(dt), "input_delay", delay=1.4 * dt), u)).max() > 0.05


@settings(max_examples=8, deadline=None)
@given(whole=st.integers(0, LONGEST_DELAY - 1), part=st.floats(0.0, 1.0, exclude_max=True))
def test_a_physics_of_steps_has_the_impulses_of_its_own_step(whole, part):
    u = np.random.default_rng(4).normal(size=(20, 2))
    late = pg.add(toy_physics("after_step"), "input_delay", delay=[(whole + part) * 0.5] * 2)
    past = np.concatenate([np.zeros((LONGEST_DELAY + 1, 2)), u])
    x, step = np.array([0.2, -0.1, 0.4]), toy_step
    with jax.enable_x64(True):
        whole_x = jnp.concatenate([jnp.asarray(x), jnp.zeros(len(late.states) - 3)])
        advance = quick_jit(late.step)
        for k in range(len(u)):
            whole_x = advance(late.params, whole_x, jnp.asarray(u[k]))
            newer, older = past[k + LONGEST_DELAY + 1 - whole], past[k + LONGEST_DELAY - whole]
            mean, a, e = newer + part * (older - newer), 0.0, 0.0
            for i in (0, 1):
                old, new = (step(TOY_PARAMS, x, np.where(np.arange(2) == i, one, mean)) for one in (older, newer))
                a = a + part * (1 - part) / 2 * (old - new)
                e = e + part * old + (1 - part) * new - step(TOY_PARAMS, x, mean)
            x = step(TOY_PARAMS, x + a + e / 2, mean) - a + e / 2
    np.testing.assert_allclose(np.asarray(whole_x)[:3], x, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("delay", [0.5, 1.3, 3.7])
def test_a_step_between_samples_moves_a_mass_as_much(delay):
    """A mass under a force of 1 that sets in between two samples: position and velocity, in samples."""
    mass = pg.continuous(
        "mass",
        lambda p, x, u: jnp.stack([x[1], u[0]]),
        lambda p, x, u: x,
        {},
        parameters={},
        states=(pg.Signal("q"), pg.Signal("v", rate_of="q")),
        inputs=(pg.Signal("f"),),
        outputs=(pg.Signal("q"), pg.Signal("v")),
        dt=1.0,
    )
    late = pg.add(mass, "input_delay", delay=delay)
    step = quick_jit(late.step)
    x = np.zeros(2 + LONGEST_DELAY)
    with jax.enable_x64(True):
        for t in range(1, 13):
            x = np.asarray(step(late.params, jnp.asarray(x), jnp.ones(1)))
            acted = max(t - delay, 0.0)
            np.testing.assert_allclose(x[:2], [acted**2 / 2, acted], rtol=1e-12, atol=1e-14)
