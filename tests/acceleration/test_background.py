"""Compiling on a second thread: in order, dropped when no longer wanted, and of what is then run."""

import logging
import threading

import jax
import numpy as np
import pytest
from discovery.small_cases import choices

from pgrssnn_jax.acceleration.background import ahead, compile_look
from pgrssnn_jax.discovery.estimate import Settings
from pgrssnn_jax.discovery.look import look_at
from pgrssnn_jax.discovery.problem import build_problem, weighted_signals
from pgrssnn_jax.discovery.prove import fitted_nominal
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import linear
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, record


def test_tasks_are_done_in_order_beside_the_caller():
    done, threads = [], set()

    def task(name):
        done.append(name)
        threads.add(threading.get_ident())

    with ahead({"first": lambda: task("first"), "second": lambda: task("second")}) as wait:
        wait("second")
        assert done == ["first", "second"]
        wait("none of that name")
    assert len(threads) == 1
    assert threading.get_ident() not in threads


def test_the_failure_of_a_task_reaches_who_waits_for_it():
    def fail():
        raise ValueError("no")

    with ahead({"failing": fail}) as wait, pytest.raises(ValueError, match="no"):
        wait("failing")


def test_what_is_no_longer_wanted_is_not_begun():
    held, done = threading.Event(), []

    def leave():
        with ahead({"first": held.wait, "second": lambda: done.append("second")}):
            threading.Timer(0.2, held.set).start()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        leave()
    assert done == []


def test_a_look_finds_its_programs_compiled(caplog):
    physics = linear(A=[[0.9]], B=[[0.1]], C=[[1.0]])
    problem = build_problem(physics, [e for e in catalogue(physics) if e.name in ("input_offset", "sensor_offset")])
    settings = Settings(lanes=8, steps=4)
    data = weighted_signals(problem, small_record(), folds=2, block=10)
    with jax.enable_x64(True):
        base = fitted_nominal(problem, data, settings)
        compiled = programs(caplog, lambda: compile_look(problem, data, settings))
        rng = np.random.default_rng(0)
        missing = programs(caplog, lambda: look_at(problem, data, base, settings, choices().rules, rng, ()))
    assert {"_fit", "_sensitivity"} <= compiled
    assert not {"_fit", "_sensitivity"} & missing


def programs(caplog, work) -> set[str]:
    """Names of the functions that are compiled meanwhile."""
    caplog.clear()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        work()
    lines = [line for line in caplog.messages if line.startswith("Finished XLA compilation of ")]
    return {line.split("jit(")[1].split(")")[0] for line in lines}


def small_record() -> Record:
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((2, 60, 1))
    info = RecordInfo((Channel("force", "N"),), (Channel("speed", "m/s"),), 1.0, "simulated")
    return record(u, y, info)
