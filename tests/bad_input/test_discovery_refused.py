"""Bad arguments of `pg.discover`, and damaged `discovery.json` files."""

import copy
import json

import jax.numpy as jnp
import numpy as np
import pytest
from sentences import NAMES, U, Y, but, record, refused, shift, tanks

import pgrssnn_jax as pg
from pgrssnn_jax.effects.stored import physics_to_json, read_stored, stored_physics


def discover(physics=None, train=None, test=None, **settings):
    given = [record() if one is None else one for one in (train, test)]
    return pg.discover(tanks() if physics is None else physics, *given, quiet=True, **settings)


def quick(**settings):
    """Settings that the short records allow, but for those that are given."""
    return discover(**{"folds": 2, "block": 8, "n_init": 5, "draws": 99, "p_value": 0.02, **settings})


STILL = np.full_like(Y, 2.0)
GIVEN = {
    "a physics that is not called": (
        lambda: discover(pg.physics.cascaded_tanks),
        "physics: expected a pg.Physics, which",
    ),
    "an array to learn from": (lambda: discover(train=Y), "data: train: expected a record"),
    "an array to test on": (lambda: discover(test=Y), "data: test: expected a record"),
    "an array to validate on": (lambda: discover(validation=Y), "data: validation: expected a record"),
    "names that are exchanged": (
        lambda: discover(test=record(inputs=NAMES["outputs"], outputs=NAMES["inputs"])),
        "data: test: inputs: expected those of the physics",
    ),
    "another sample time": (lambda: discover(test=record(dt=2.0)), "data: test: dt: expected 4 s"),
    "another unit": (
        lambda: discover(train=record(outputs={"level_voltage": "m"})),
        "a unit that converts to V, found m",
    ),
    "an input that stands still": (lambda: quick(train=record(STILL)), "pump_voltage: expected a signal that varies"),
    "an output that stands still": (
        lambda: quick(train=record(U, STILL)),
        "level_voltage: expected a signal that varies",
    ),
    "nothing measured": (
        lambda: quick(train=record(U, Y * np.nan)),
        "data: train: level_voltage: expected at least one",
    ),
    "nothing measured in the test": (
        lambda: quick(test=record(U, Y * np.nan)),
        "data: test: level_voltage: expected at",
    ),
    "numbers beyond float32": (lambda: quick(train=record(but(U, 1e30))), "data: train: expected values up to 1e+18"),
    "a short record": (lambda: quick(train=record(U[:9], Y[:9])), "data: train: expected at least 64 samples"),
    "a short test": (lambda: quick(test=record(U[:3], Y[:3])), "discovery.n_init: expected fewer than the 3 samples"),
    "a name for effects": (
        lambda: discover(effects="leak_tank1"),
        "effects: expected a list of pg.Effect, found 'leak",
    ),
    "names for effects": (
        lambda: discover(effects=["leak_tank1"]),
        "effects: expected a list of pg.Effect, found 'leak",
    ),
    "one effect for a list": (lambda: discover(effects=shift()), "effects: expected a list of pg.Effect, found Effect"),
    "no list of effects": (lambda: discover(effects=None), "effects: expected a list of pg.Effect, found None"),
    "an effect that is there": (
        lambda: discover(effects=[shift(name="leak_tank1")]),
        "names of their own, found another",
    ),
    "an effect that raises": (
        lambda: discover(effects=[shift(wrap=lambda p: 1 / 0)]),
        "effects: shift: wrap: expected",
    ),
    "an effect of another shape": (
        lambda: discover(
            effects=[shift(wrap=lambda p: pg.effects.on_output(p, "shift", lambda n, y: jnp.ones(2) * n["by"]))]
        ),
        "effects: shift: physics 'tanks': measure: expected shape (1,), found (2,)",
    ),
    "an effect without a beginning": (
        lambda: discover(effects=[shift(parameters={"by": pg.Parameter("b", neutral=np.inf)})]),
        "effects: shift: expected initial_guesses beside an infinite neutral",
    ),
    "an effect that acts at its neutral value": (
        lambda: quick(effects=[shift(wrap=lambda p: pg.effects.on_output(p, "shift", lambda n, y: y + n["by"] + 0.5))]),
        "effects: shift: expected that it changes nothing at its neutral value, by=0, found output 'level_voltage' "
        "changed by up to 0.5 V",
    ),
    "a catalogue without what is not there": (
        lambda: discover(without=["leek"]),
        "effects: expected some of",
        "'leek'",
    ),
    "a name for a list": (
        lambda: discover(without="leak_tank1"),
        "discovery.without: expected list, found 'leak_tank1'",
    ),
    "no list": (lambda: discover(without=None), "discovery.without: expected list, found None"),
    "a realisation that is not there": (lambda: discover(realisation=1), "realisation: expected 0 to 0, found 1"),
    "half a realisation": (lambda: discover(realisation=0.5), "realisation: expected 0 to 0, found 0.5"),
    "a setting that there is not": (lambda: discover(epochs=3), "discovery: expected the keys", "found 'epochs'"),
    "no certainty": (lambda: discover(p_value=0), "discovery.p_value: expected a number between 0 and 1, found 0"),
    "more certainty than draws": (lambda: quick(p_value=1e-6), "discovery.p_value: expected at least 1 / 100"),
    "a share of NaN": (lambda: discover(share=np.nan), "discovery.share: expected a number between 0 and 1, found nan"),
    "a negative tolerance": (
        lambda: discover(tolerance=-1.0),
        "discovery.tolerance: expected null or a number above 0",
    ),
    "evidence that there is not": (lambda: discover(evidence="torques"), "evidence: expected auto | inverse_dynamics"),
    "stretches of one sample": (
        lambda: quick(stretches=[1]),
        "discovery.stretches: expected auto or a list of lengths",
    ),
    "stretches that are too long": (lambda: quick(stretches=[5000]), "expected sequences of at least 5000 measured"),
    "a parameter that is not there": (lambda: quick(fixed=["k9"]), "discovery.fixed: expected some of ['k1'", "'k9'"),
    "an integrator that there is not": (lambda: quick(replace={"integrator": "bdf"}), "integrator: expected one of"),
    "one fold": (lambda: discover(folds=1), "discovery.folds: expected at least 2, found 1"),
    "epochs in words": (lambda: discover(network_epochs="few"), "discovery.network_epochs: expected int, found 'few'"),
}


@pytest.mark.parametrize(("call", "words"), [(call, words) for call, *words in GIVEN.values()], ids=GIVEN)
def test_what_cannot_be_discovered_is_refused(call, words):
    refused(call, *words)


def two_inputs(p, x, u):
    return -p["a"] * x + u[:1] + 0.2 * u[1:]


def test_a_constant_input_among_several_refuses_nothing(monkeypatch):
    begun = []
    monkeypatch.setattr(pg.api, "discovered", lambda setup, *_, **__: begun.append(setup))
    physics = pg.continuous(
        "two", two_inputs, lambda p, x, u: x, {"a": 0.5}, states=(pg.Signal("x", like="y"),),
        inputs=(pg.Signal("heat"), pg.Signal("valve")), outputs=(pg.Signal("y"),), dt=1.0,
    )  # fmt: skip
    names = {"dt": 1.0, "inputs": {"heat": "", "valve": ""}, "outputs": {"y": ""}}
    moved = pg.record(np.c_[U, STILL], Y, **names)
    settings = {"folds": 2, "block": 8, "n_init": 5, "draws": 99, "p_value": 0.02, "quiet": True, "network_epochs": 0}
    pg.discover(physics, moved, moved, **settings)
    assert [setup.estimation.u.shape for setup in begun] == [(1, 160, 2)]
    assert pg.fit("physics_only", physics, moved, recipe="default", epochs=0, quiet=True).losses.epochs == 0
    still = pg.record(np.c_[STILL, STILL], Y, **names)
    refused(lambda: pg.discover(physics, still, moved, **settings), "heat: expected a signal that varies, found only 2")


# --- discovery.json ---------------------------------------------------------------------------------------------------

FOUND = json.loads(json.dumps(physics_to_json(pg.add(tanks(integrator="rk4"), "leak_tank1", rate=0.01))))
NUMBERS = ("numbers", "parameters")
EFFECTS = ("numbers", "effects")


def changed(place, value):
    found = copy.deepcopy(FOUND)
    inner = found
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return found


FILES = {
    "a list": ([1], "expected the key 'system' of a stored physics, found none"),
    "another file": ({"name": "a"}, "expected the key 'system' of a stored physics, found none"),
    "another physics": (changed(["system"], "arm"), "expected physics 'tanks', found 'arm'"),
    "a physics in words": (changed(["physics"], "tanks"), "physics: expected a group of named values, found 'tanks'"),
    "numbers in words": (changed(["numbers"], "many"), "numbers: expected a group of named values, found 'many'"),
    "no parameters": (changed(["numbers"], {"effects": {}}), "numbers: expected a group of named values, found"),
    "other parameters": (
        changed(NUMBERS, {"k1": 1.0}),
        "expected parameters ['k1', 'k2', 'k3', 'k4', 'k5'], found ['k1']",
    ),
    "a parameter in words": (changed([*NUMBERS, "k1"], "much"), "k1: expected numbers of shape (), found 'much'"),
    "a parameter of two numbers": (changed([*NUMBERS, "k1"], [0.1, 0.2]), "k1: expected numbers of shape ()"),
    "a parameter of NaN": (changed([*NUMBERS, "k1"], float("nan")), "k1: expected numbers of shape (), found nan"),
    "a parameter without end": (changed([*NUMBERS, "k1"], 10**400), "k1: expected numbers of shape (), found 1000"),
    "an effect that there is not": (changed([*EFFECTS, "flood"], {}), "effects: expected some of", "found 'flood'"),
    "an effect of None": (changed([*EFFECTS, "leak_tank1"], None), "leak_tank1: expected numbers by their names"),
    "an effect of a list": (changed([*EFFECTS, "leak_tank1"], [0.01]), "leak_tank1: expected numbers by their names"),
    "another number": (
        changed([*EFFECTS, "leak_tank1"], {"level": 1.0}),
        "leak_tank1: expected ['rate'], found 'level'",
    ),
    "a rate in words": (changed([*EFFECTS, "leak_tank1", "rate"], "much"), "leak_tank1.rate: expected numbers"),
    "a rate of NaN": (changed([*EFFECTS, "leak_tank1", "rate"], float("nan")), "leak_tank1.rate: expected 0 to 0.1"),
    "a negative rate": (changed([*EFFECTS, "leak_tank1", "rate"], -1.0), "leak_tank1.rate: expected 0 to 0.1"),
    "an order of others": (
        changed(["numbers", "order"], ["flood"]),
        "numbers.order: expected names among ['leak_tank1']",
    ),
    "an order in words": (changed(["numbers", "order"], "leak_tank1"), "numbers.order: expected names among"),
    "a start in words": (changed(["initial_state"], {"upper_level": "full"}), "initial_state: upper_level: expected a"),
    "a start of NaN": (
        changed(["initial_state"], {"upper_level": float("nan")}),
        "upper_level: expected a finite number",
    ),
    "a start that is a number": (changed(["initial_state"], 3.0), "initial_state: expected a group of named values"),
    "an optimism in words": (changed(["optimism"], "much"), "optimism: expected null or a number of at least 1"),
    "an optimism below 1": (changed(["optimism"], 0.5), "optimism: expected null or a number of at least 1"),
    "an optimism of NaN": (changed(["optimism"], float("nan")), "optimism: expected null or a number of at least 1"),
    "an integrator that there is not": (changed(["physics", "integrator"], "bdf"), "integrator: expected one of"),
    "an integrator that is a list": (changed(["physics", "integrator"], ["rk4"]), "integrator: expected one of"),
    "half a sub-step": (changed(["physics", "sub_steps"], 0.5), "sub_steps: expected a whole number of at least 1"),
}


@pytest.mark.parametrize(("content", "words"), [(content, words) for content, *words in FILES.values()], ids=FILES)
def test_a_file_of_something_else_is_refused(folder, content, words):
    (folder / "discovery.json").write_text(json.dumps(content))
    where = "physics.effects: discovery.json"
    refused(lambda: stored_physics(tanks(), read_stored(folder / "discovery.json", where), where=where), *words)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00", json.dumps(FOUND).encode()[:-9], b"[" * 100_000, None])
def test_a_file_that_is_damaged_is_refused(folder, content):
    if content is not None:
        (folder / "discovery.json").write_bytes(content)
    refused(
        lambda: read_stored(folder / "discovery.json", "physics.effects"), "physics.effects: expected a discovery.json"
    )
