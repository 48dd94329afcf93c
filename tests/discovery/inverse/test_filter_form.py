"""The filter form of an arm: parameters estimated from a record, positions predicted from torques alone."""

import json

import numpy as np
import pytest
from arm_logs import KUKA, log
from commands import ROOT

import pgrssnn_jax as pg
from pgrssnn_jax.discovery.inverse.filter_form import filter_form, filter_numbers
from pgrssnn_jax.discovery.inverse.motion import motion_of
from pgrssnn_jax.physics.simulate import free_run

SETTLED = 100  # samples after which a start that is not known no longer matters


def arm(**settings):
    return pg.physics.arm(gravity=tuple(KUKA.gravity), **settings)


def errors(physics, test):
    """RMS over the standard deviation of every joint, from the mean position, without a single position fed in."""
    start = np.zeros((len(test.u), len(physics.states)))
    y = np.asarray(free_run(physics, np.asarray(test.u), start)[0])[:, SETTLED:]
    measured = np.asarray(test.y)[:, SETTLED:]
    return np.sqrt(np.mean(np.nan_to_num(y - measured, nan=9.0) ** 2, (0, 1))) / measured.std((0, 1))


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_the_numbers_are_those_of_the_record():
    bias = np.array([300.0, 0.0, 0.0, 0.0, 0.0, 100.0])
    train = log(1, torque_noise=0.05, bias=bias)
    numbers = filter_numbers(arm(), motion_of(train, 0.1, at_rest=False))
    np.testing.assert_allclose(numbers.position, np.asarray(train.y).std((0, 1)), rtol=0.03)
    np.testing.assert_allclose(numbers.speed, np.gradient(np.asarray(train.y), 0.1, axis=1).std((0, 1)), rtol=0.05)
    white = filter_numbers(arm(), motion_of(log(1, torque_noise=3.0), 0.1, at_rest=False))
    np.testing.assert_allclose(white.noise, 3.0, rtol=0.2)
    assert (numbers.noise < 0.6).all()
    constant = bias / KUKA.gear
    np.testing.assert_allclose(numbers.moving[[0, 5]], np.abs(constant[[0, 5]]), rtol=0.5)
    assert (numbers.acceleration / numbers.speed > numbers.speed / numbers.position).all()


@pytest.mark.usefixtures("x64")
def test_torques_alone_say_where_an_arm_is():
    train, test = log(1, sequences=8), log(2, sequences=3)
    physics = filter_form(arm(), train)
    assert physics.settings["form"] == "filter"
    assert not physics.settings["starts_at_rest"]
    found = errors(physics, test)
    assert found.mean() < 0.5
    assert found.mean() < 0.7 * errors(arm(limits=False), test).mean()


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_effects_come_along():
    """A bias that the filter knows costs it nothing; one that it does not know does."""
    bias = np.array([0.0, 400.0, -300.0, 0.0, 0.0, 0.0])
    train, test = log(1, bias=bias), log(2, sequences=3, bias=bias)
    known = pg.add(arm(), "torque_bias", theta=bias)
    assert errors(filter_form(known, train), test).mean() < 0.8 * errors(filter_form(arm(), train), test).mean()


def test_what_is_no_arm_is_refused():
    train = log(1, sequences=1)
    with pytest.raises(ValueError, match="filter_form: physics: expected an arm with backend=jax, found 'arm'"):
        filter_form(arm(backend="pinocchio"), train)
    shipped = json.loads((ROOT / "conf/physics/robot_real_filter.json").read_text())
    filtered = arm(form="filter", filter_numbers=shipped["physics"]["filter_numbers"])
    with pytest.raises(ValueError, match=r"physics.form: expected forward in a discovery, found filter"):
        pg.discover(filtered, train, log(2, sequences=1), quiet=True)


@pytest.mark.slow
def test_tuning_follows_the_record_better_and_a_later_one_too():
    train, test = log(1, sequences=6), log(2, sequences=4)
    plain, tuned = filter_form(arm(), train), filter_form(arm(), train, tune=150)
    assert errors(tuned, train).mean() < 0.9 * errors(plain, train).mean()
    assert errors(tuned, test).mean() < errors(plain, test).mean()
