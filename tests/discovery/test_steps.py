"""Integration steps that are short enough for a record."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

import pgrssnn_jax as pg
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import set_up
from pgrssnn_jax.discovery.steps import with_short_steps
from pgrssnn_jax.physics.simulate import free_run
from pgrssnn_jax.training.settings import training_settings

TAU, NOISE, SAMPLES = 3.3e-3, 1e-3, 400  # s, rad


def motor(dt: float, friction: float = 0.0, tau: float = TAU, **settings: int) -> pg.Physics:
    """friction: deceleration by dry friction, rad/s²."""

    def rate(p, x, u):
        return jnp.stack([(p["gain"] * u[0] - x[0]) / p["tau"] - friction * jnp.sign(x[0]), x[0]])

    return pg.continuous(
        "motor", rate, lambda p, x, u: x[1:], {"gain": 10.0, "tau": tau}, dt=dt,
        states=(pg.Signal("speed", "rad/s"), pg.Signal("angle", "rad", like="angle")),
        inputs=(pg.Signal("voltage", "V"),), outputs=(pg.Signal("angle", "rad"),), **settings,
    )  # fmt: skip


def exact(u: Float[np.ndarray, " time"], dt: float) -> Float[np.ndarray, "time 1"]:
    """Angle of the motor without friction from rest."""
    kept, (speed, angle), found = np.exp(-dt / TAU), (0.0, 0.0), []
    for end in 10.0 * u:
        angle += end * dt + (speed - end) * TAU * (1.0 - kept)
        speed = end + (speed - end) * kept
        found.append([angle])
    return np.array(found)


def record(dt: float, noise: float = NOISE) -> pg.Record:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.normal(size=SAMPLES // 4), 4).astype(np.float32)
    y = exact(u, dt) + noise * rng.normal(size=(SAMPLES, 1))
    return pg.record(u[:, None], y, dt=dt, inputs={"voltage": "V"}, outputs={"angle": "rad"}, start="rest")


def steps(physics: pg.Physics) -> int:
    return physics.settings["sub_steps"]


@pytest.mark.parametrize("noise", [NOISE, NOISE / 100])
def test_the_free_run_is_exact_to_a_small_part_of_the_noise(noise, x64):
    said: list[str] = []
    given, dt = record(0.005, noise), 0.005
    before, after = motor(dt), with_short_steps(motor(dt), given, said.append)
    truth = exact(given.u[0, :, 0], dt)
    wrong, right = (
        np.sqrt(np.mean((np.asarray(free_run(one, given.u.astype(float), np.zeros((1, 2)))[0][0]) - truth) ** 2))
        for one in (before, after)
    )
    assert wrong > 0.5 * noise
    assert right < 0.1 * noise
    (line,) = said
    assert f"{steps(after)} steps a sample in place of 1" in line


@pytest.mark.parametrize(
    "physics",
    [motor(0.001), motor(0.005, sub_steps=4), motor(0.005, friction=100.0), motor(0.005, tau=1e-4)],
    ids=["short already", "chosen by the user", "dry friction jumps", "diverges"],
)
def test_what_more_steps_do_not_help_stays(physics):
    def say(line: str) -> None:
        raise AssertionError(line)

    assert with_short_steps(physics, record(physics.dt), say) is physics


@pytest.mark.parametrize(("long", "expected"), [(True, [1]), (False, [2, 4, 8, 16])])
def test_data_without_noise_are_no_division_by_zero(long, expected):
    given, dt = record(0.005), 0.005
    u = given.u[0].astype(float)
    with jax.enable_x64(True):
        own = free_run(motor(dt), u[None], np.zeros((1, 2)))[0]
    y = np.asarray(own) if long else exact(u[:, 0], dt)[None]
    assert steps(with_short_steps(motor(dt), given._replace(y=y), print)) in expected


def test_data_that_were_simulated_with_long_steps_keep_them():
    given, dt = record(0.005), 0.005
    y = pg.simulate(motor(dt), given.u[0], jnp.zeros(2)).y
    own = given._replace(y=np.asarray(y)[None] + given.y - exact(given.u[0, :, 0], dt))
    assert steps(with_short_steps(motor(dt), own, print)) == 1


def test_a_discovery_keeps_the_number_that_a_user_fixes():
    given, said = record(0.005), list[str]()
    chosen = [DiscoverySettings(), DiscoverySettings(replace={"sub_steps": 1})]
    found = [
        set_up(motor(0.005), given, given, one, training_settings("pg_rssnn"), notify=said.append).physics
        for one in chosen
    ]
    assert steps(found[0]) > 1
    assert steps(found[1]) == 1
