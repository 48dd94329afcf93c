"""Bad arguments of `pg.simulate`, `pg.rollout`, `pg.add`, the loaders and trained ensembles."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from sentences import U, Y, record, refused, shift, tanks

import pgrssnn_jax as pg

SIMULATED = {
    "a physics that is not called": (lambda: pg.simulate(pg.physics.cascaded_tanks, U, [3.0, 4.0]), "which it returns"),
    "the name of a physics": (lambda: pg.simulate("tanks", U, [3.0, 4.0]), "physics: expected a pg.Physics"),
    "inputs that are text": (lambda: pg.simulate(tanks(), "abc", [3.0, 4.0]), "u: expected real numbers, found text"),
    "no inputs": (lambda: pg.simulate(tanks(), None, [3.0, 4.0]), "simulate: u: expected real numbers, found None"),
    "rows of unequal length": (lambda: pg.simulate(tanks(), [[1], [1, 2]], [3.0, 4.0]), "rows of unequal length"),
    "complex inputs": (lambda: pg.simulate(tanks(), U + 0j, [3.0, 4.0]), "found complex numbers"),
    "two inputs for one": (lambda: pg.simulate(tanks(), np.zeros((5, 2)), [3.0, 4.0]), "found shape (5, 2)"),
    "inputs without their axis": (lambda: pg.simulate(tanks(), U[:, 0], [3.0, 4.0]), "u: expected [time, 1]"),
    "no sample": (lambda: pg.simulate(tanks(), U[:0], [3.0, 4.0]), "found shape (0, 1)"),
    "a state too many": (
        lambda: pg.simulate(tanks(), U, [1.0, 2.0, 3.0]),
        "simulate: x0: expected shape (2,) or (1, 2)",
    ),
    "no start": (lambda: pg.simulate(tanks(), U, None), "simulate: x0: expected real numbers, found None"),
    "a start in words": (lambda: pg.simulate(tanks(), U, ["full", "empty"]), "simulate: x0: expected real numbers"),
    "starts of other sequences": (lambda: pg.simulate(tanks(), U, np.zeros((3, 2))), "found (3, 2)"),
}

ADDED = {
    "an effect of another system": (
        lambda: pg.add(tanks(), "payload"),
        "effects: expected some of ['periodic_disturbance', 'leak_tank1'",
    ),
    "an effect that there is not": (lambda: pg.add(tanks(), "leek"), "of physics 'tanks', found 'leek'"),
    "a number that there is not": (lambda: pg.add(tanks(), "leak_tank1", rat=1.0), "leak_tank1: expected ['rate']"),
    "a number out of its bounds": (
        lambda: pg.add(tanks(), "leak_tank1", rate=5.0),
        "leak_tank1.rate: expected 0 to 0.1",
    ),
    "NaN": (lambda: pg.add(tanks(), "leak_tank1", rate=np.nan), "leak_tank1.rate: expected 0 to 0.1 1/s, found nan"),
    "text": (lambda: pg.add(tanks(), "leak_tank1", rate="much"), "leak_tank1.rate: expected numbers, found 'much'"),
    "two numbers for one": (
        lambda: pg.add(tanks(), "leak_tank1", rate=[0.1, 0.0]),
        "leak_tank1.rate: expected shape ()",
    ),
    "a group for a number": (lambda: pg.add(tanks(), "leak_tank1", rate={"a": 1}), "leak_tank1.rate: expected numbers"),
    "an effect twice": (lambda: pg.add(pg.add(tanks(), "leak_tank1"), "leak_tank1"), "expected each effect once"),
    "no physics": (lambda: pg.add(None, "leak_tank1"), "physics: expected a pg.Physics, found None"),
    "no effect": (lambda: pg.add(tanks(), None), "effects: expected the name of an effect or a pg.Effect, found None"),
    "a list of effects": (
        lambda: pg.add(tanks(), ["leak_tank1"]),
        "the name of an effect or a pg.Effect, found ['leak",
    ),
    "a function for an effect": (lambda: pg.add(tanks(), lambda p: p), "the name of an effect or a pg.Effect"),
    "an own effect that raises": (
        lambda: pg.add(tanks(), shift(wrap=lambda p: 1 / 0)),
        "shift: wrap: expected",
        "Zero",
    ),
    "an own effect of None": (
        lambda: pg.add(tanks(), shift(wrap=lambda p: None)),
        "shift: wrap: expected it to return",
    ),
    "an own effect without wrap": (lambda: pg.add(tanks(), shift(wrap=None)), "shift: wrap: expected a function"),
    "an own effect of another name": (
        lambda: pg.add(tanks(), shift(name="other")),
        "effects: other",
        "KeyError: 'shift'",
    ),
    "an own effect of another shape": (
        lambda: pg.add(tanks(), shift(wrap=lambda p: pg.effects.on_output(p, "shift", lambda n, y: jnp.zeros(3)))),
        "effects: shift: physics 'tanks': measure: expected shape (1,), found (3,)",
    ),
    "an own effect without neutral": (
        lambda: pg.add(tanks(), shift(parameters={"by": pg.Parameter("b", "V")})),
        "effects: shift.by: expected a neutral value, found none",
    ),
}

LOADED = {
    "a benchmark that there is not": (
        lambda: pg.load_benchmark("tanks"),
        "load_benchmark: expected one of ['cascaded_",
    ),
    "no benchmark": (lambda: pg.load_benchmark(None), "load_benchmark: expected one of"),
    "a list of benchmarks": (lambda: pg.load_benchmark(["lgssm"]), "load_benchmark: expected one of"),
    "one's own data as a benchmark": (lambda: pg.load_benchmark("csv"), "load_benchmark: expected one of"),
    "a setting that there is not": (
        lambda: pg.load_benchmark("lgssm", samples=3),
        "expected the keys ['path'",
        "samples",
    ),
    "a count in words": (lambda: pg.load_benchmark("cascaded_tank", n_train="all"), "n_train: expected int | null"),
    "a count of none": (
        lambda: pg.load_benchmark("lgssm", generated=True, realisations=0),
        "data.realisations: expected",
    ),
    "a negative seed": (
        lambda: pg.load_benchmark("lgssm", generated=True, seed=-1),
        "data.seed: expected between 0 and",
    ),
    "generated from a file": (lambda: pg.load_benchmark("lgssm", generated=True, path="a"), "data.generated: expected"),
    "a file that is not there": (lambda: pg.load_benchmark("cascaded_tank", path="none.csv"), "none.csv: expected a"),
    "a folder for a file": (
        lambda: pg.load_benchmark("cascaded_tank", path="."),
        "expected a readable CSV file, found a",
    ),
    "a folder that is not there": (
        lambda: pg.load_benchmark("robot_simulated", path="none"),
        "data.path: expected the",
    ),
    "a run that is not there": (lambda: pg.load("none"), "run folder: expected one with a config.yaml, found none"),
    "no run": (lambda: pg.load(None), "run folder: expected the name of a folder, found None"),
    "no CSV file": (lambda: pg.read_csv(None, tanks()), "path: expected the name of a CSV file, found None"),
    "a CSV file of no physics": (
        lambda: pg.read_csv("A.csv", "tanks"),
        "physics: expected a pg.Physics, found 'tanks'",
    ),
    "a CSV file of another start": (lambda: pg.read_csv("A.csv", tanks(), start="zero"), "start: expected one of"),
    "logs of no arm": (
        lambda: pg.load_arm_log(tanks(), "A.csv"),
        "arm_log: expected physics=arm, found physics 'tanks'",
    ),
}

TABLE = {**SIMULATED, **ADDED, **LOADED}


@pytest.mark.parametrize(("call", "words"), [(call, words) for call, *words in TABLE.values()], ids=TABLE)
def test_what_cannot_be_is_refused(call, words):
    refused(call, *words)


@pytest.fixture(scope="module")
def ensemble():
    return pg.fit("physics_only", tanks(), record(), initial_state="zero", recipe="default", epochs=0, quiet=True)


AT_REST = np.zeros((1, 2))


def rolled(ensemble, u=U[None], x0=AT_REST, **more):
    return pg.rollout(ensemble.model, ensemble.params(0), u, x0, **more)


OF_MEMBERS = {
    "no record": (lambda e: e.score(None), "data: test: expected a record, as pg.record(u, y, ...)"),
    "an array for a record": (
        lambda e: e.score(Y),
        "data: test: expected a record",
        "found an array of shape (160, 1)",
    ),
    "other names": (lambda e: e.score(record(inputs={"a": "V"})), "data: test: inputs: expected those of the physics"),
    "another sample time": (lambda e: e.score(record(dt=2.0)), "data: test: dt: expected 4 s"),
    "another unit": (lambda e: e.score(record(outputs={"level_voltage": "m"})), "expected a unit that converts to V"),
    "nothing measured": (lambda e: e.score(record(U, Y * np.nan)), "data.test: expected at least one measured output"),
    "a picture of no record": (lambda e: e.plot(None), "data: test: expected a record"),
    "saved with an array": (lambda e: e.save("run", Y), "data: test: expected a record"),
    "saved with another sample time": (lambda e: e.save("run", record(dt=2.0)), "data: test: dt: expected 4 s"),
    "inputs of two channels": (lambda e: e.simulate(np.c_[U, U]), "simulate: u: expected [time, 1]"),
    "inputs with NaN": (lambda e: e.simulate(U * np.nan), "simulate: u: expected finite numbers, found NaN"),
    "a state too many": (lambda e: e.simulate(U, np.zeros(3)), "simulate: x0: expected shape (2,)"),
    "rows of inputs of unequal length": (
        lambda e: e.simulate([[1], [2, 3]]),
        "simulate: u: expected an array of numbers",
    ),
    "inputs in words": (lambda e: e.simulate(np.array([["a"]])), "simulate: u: expected real numbers, found text"),
    "complex inputs": (lambda e: e.simulate(U + 0j), "simulate: u: expected real numbers, found complex numbers"),
    "no sample": (lambda e: e.simulate(U[:0]), "simulate: u: expected [time, 1]"),
    "a start of NaN": (lambda e: e.simulate(U, [np.nan, 4.0]), "simulate: x0: expected finite numbers, found NaN"),
    "a start in words": (lambda e: e.simulate(U, ["full", "empty"]), "simulate: x0: expected real numbers"),
    "an interval in words": (lambda e: e.simulate(U, interval="0.9"), "interval: expected a level between 0 and 1"),
    "a folder of None": (lambda e: e.save(None), "save: folder: expected the name of a folder, found None"),
    "a folder that is a number": (lambda e: e.save(3), "save: folder: expected the name of a folder, found 3"),
    "a member that is not there": (lambda e: e.params(99), "params: member: expected 0 to 0, found 99"),
    "the last member": (lambda e: e.params(-1), "params: member: expected 0 to 0, found -1"),
    "an interval in per cent": (lambda e: e.simulate(U, interval=90), "interval: expected a level between 0 and 1"),
    "a route that there is not": (
        lambda e: rolled(e, route="fast"),
        "rollout: route: expected 'fused', 'split', 'native' or None",
    ),
    "a run without its sequences": (lambda e: rolled(e, U), "rollout: u: expected [sequence, time, 1]"),
    "a run of two channels": (lambda e: rolled(e, np.zeros((1, 5, 2))), "rollout: u: expected [sequence, time, 1]"),
    "a run of no channel": (lambda e: rolled(e, np.zeros((1, 5, 0))), "rollout: u: expected [sequence, time, 1]"),
    "a run of no sample": (lambda e: rolled(e, U[None, :0]), "rollout: u: expected [sequence, time, 1]"),
    "a run from three states": (lambda e: rolled(e, x0=np.zeros((1, 3))), "rollout: x0: expected shape (1, 2), found"),
    "a run from two starts": (lambda e: rolled(e, x0=np.zeros((2, 2))), "rollout: x0: expected shape (1, 2), found"),
    "a run with a short mask": (
        lambda e: rolled(e, valid=np.ones((1, 3), bool)),
        "rollout: valid: expected shape (1, 160)",
    ),
    "a run of no model": (
        lambda e: pg.rollout(e, e.params(0), U[None], np.zeros((1, 2))),
        "rollout: model: expected a",
    ),
}


@pytest.mark.parametrize(("call", "words"), [(c, w) for c, *w in OF_MEMBERS.values()], ids=OF_MEMBERS)
def test_what_trained_members_cannot_do_is_refused(ensemble, call, words):
    refused(lambda: call(ensemble), *words)


def test_a_run_is_not_saved_in_the_place_of_a_file(ensemble):
    Path("file").write_text("kept")
    refused(lambda: ensemble.save("file"), "run folder: expected a folder at 'file', found the file 'file'")
    refused(lambda: ensemble.save("file/run"), "run folder: expected a folder at 'file/run', found the file 'file'")


def test_a_run_from_whole_numbers_is_one_from_their_floats(ensemble):
    np.testing.assert_array_equal(rolled(ensemble, x0=[[3, 4]]).y, rolled(ensemble, x0=np.float32([[3, 4]])).y)
