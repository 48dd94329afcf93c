"""A speed whose position is no state (of a motor, a flow) takes the forces of velocities; its unit tells it."""

import numpy as np
import pytest

import pgrssnn_jax as pg
from pgrssnn_jax.effects.base import Effect, SignalRange
from pgrssnn_jax.effects.places import levels, velocities
from pgrssnn_jax.physics.simulate import free_run

pytestmark = pytest.mark.usefixtures("x64")
DT, LAG, DRY, NOISE = 0.02, 0.4, 12.0, 0.3  # s, s, rad/s², rad/s
FORCES = ["viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag", "constant_force"]


def motor(unit: str = "rad/s") -> pg.Physics:
    """dv/dt = (u - v) / τ."""
    return pg.continuous(
        "motor",
        lambda p, x, u: (u - x) / p["lag"],
        lambda p, x, u: x,
        {"lag": LAG},
        parameters={"lag": pg.Parameter("τ", "s", bounds=(0.01, 10.0))},
        dt=DT,
        states=(pg.Signal("speed", unit, like="speed"),),
        inputs=(pg.Signal("command", unit),),
        outputs=(pg.Signal("speed", unit),),
    )


def effect(name: str, physics: pg.Physics) -> Effect:
    return next(one for one in pg.effects.catalogue(physics) if one.name == name)


def commands(seed: int, samples: int = 600) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(-20.0, 20.0, samples // 20), 20)[:, None]


def tiny_steps(u: np.ndarray, lag: float = LAG, dry: float = DRY, sub: int = 2000) -> np.ndarray:
    """In every tiny step friction cuts the speed."""
    v, h, found = 0.0, DT / sub, []
    for (held,) in u:
        for _ in range(sub):
            free = v + h * (held - v) / lag
            v = np.sign(free) * max(abs(free) - h * dry, 0.0)
        found.append([v])
    return np.array(found)


@pytest.mark.parametrize("unit", ["rad/s", "rpm", "m/s"])
def test_forces_act_on_speeds_and_flows_do_not(unit):
    names = [one.name for one in pg.effects.catalogue(motor(unit))]
    assert names[:6] == ["periodic_disturbance", *FORCES]
    assert not {"leak", "inflow", "power_law", "linear_spring", "hysteresis", "hard_stop"} & set(names)


@pytest.mark.parametrize("unit", ["V", "K", "", "m"])
def test_any_other_unit_is_that_of_a_first_order_state(unit):
    names = {one.name for one in pg.effects.catalogue(motor(unit))}
    assert {"leak", "inflow", "power_law", "ceiling", "floor"} <= names
    assert not set(FORCES) & names


def test_what_a_state_is_the_rate_of_is_no_speed_itself():
    """An acceleration beside the speed that it is the rate of: that one is the position."""
    states = (pg.Signal("speed", "m/s"), pg.Signal("acceleration", "m/s^2", rate_of="speed"))
    physics = motor()._replace(states=states)
    assert [(place.state, place.way) for place in velocities(physics)] == [(1, 0)]
    assert levels(physics) == []


@pytest.mark.parametrize(("only_steps", "most"), [(False, 2e-3), (True, 0.03)])
def test_dry_friction_of_a_speed_slides_turns_and_sticks(only_steps, most):
    u = 0.5 * commands(0, samples=200)
    expected = tiny_steps(u)
    assert 0.05 < (np.abs(expected) < 1e-9).mean() < 0.9
    physics = motor()._replace(extension=None) if only_steps else motor()
    y, _ = free_run(pg.add(physics, "coulomb_friction", a=DRY), u[None], np.zeros((1, 1)))
    assert np.abs(np.asarray(y[0]) - expected).max() < most * np.abs(expected).max()


@pytest.mark.parametrize("name", FORCES)
def test_fits_begin_at_the_same_forces_in_any_unit_of_speed(name):
    ends = np.array([[-15.0], [18.0]])
    here, there = (effect(name, motor()).guesses(SignalRange(s * ends, s * ends, s * ends)) for s in (1.0, 1e-3))
    power = {"viscous_friction": 0, "quadratic_drag": -1}.get(name, 1)
    for one, other in zip(here, there, strict=True):
        for key, value in one.items():
            np.testing.assert_allclose(other[key], value * 1e-3**power, rtol=1e-12)


def test_units_of_its_numbers_follow_from_that_of_the_speed():
    assert effect("coulomb_friction", motor()).parameters["a"].unit == "rad/s^2"
    assert effect("quadratic_drag", motor()).parameters["c"].unit == "1/rad"
    assert effect("quadratic_drag", motor("rpm")).parameters["c"].unit == ""


@pytest.mark.slow
def test_hidden_dry_friction_of_a_motor_is_named():
    def recorded(seed: int):
        u = commands(seed)
        y = tiny_steps(u, lag=0.43, sub=200) + NOISE * np.random.default_rng(seed + 50).standard_normal(u.shape)
        return pg.record(u, y, dt=DT, inputs={"command": "rad/s"}, outputs={"speed": "rad/s"})

    found = pg.discover(motor(), recorded(1), recorded(2), network_epochs=0, quiet=True)
    assert found.verdict == "effect_found"
    assert [one.name for one in found.effects] == ["coulomb_friction"]
    assert found.effects[0].parameters["a"]["value"][0] == pytest.approx(DRY, rel=0.05)
    assert found.gap["after"]["test"] < 1.1 * NOISE
