"""Bad arguments of `pg.record` and `pg.fit`."""

import numpy as np
import pytest
from sentences import NAMES, U, Y, but, record, refused, tanks

import pgrssnn_jax as pg

RECORDS = {
    "inputs that are text": (lambda: record(np.array([["a"]] * 160)), "record: u: expected real numbers, found text"),
    "a list of words": (lambda: record(["a", "b"]), "record: u: expected real numbers, found text"),
    "outputs that are text": (lambda: record(U, Y.astype(str)), "record: y: expected real numbers, found text"),
    "no inputs": (lambda: record(None), "record: u: expected real numbers, found None"),
    "no outputs": (lambda: record(U, None), "record: y: expected real numbers, found None"),
    "a dictionary": (lambda: record({"pump_voltage": U}), "record: u: expected real numbers, found {'pump_voltage'"),
    "objects": (lambda: record(np.array([[None]] * 160)), "record: u: expected real numbers, found None"),
    "complex inputs": (lambda: record(U + 1j), "record: u: expected real numbers, found complex numbers"),
    "complex outputs": (lambda: record(U, Y + 0j), "record: y: expected real numbers, found complex numbers"),
    "dates": (
        lambda: record(np.full((160, 1), "2020-01-01", "M8[s]")),
        "record: u: expected real numbers, found dates",
    ),
    "one number": (lambda: record(3.0), "record: u: expected [time, 1] or sequences of it, found shape ()"),
    "four axes": (lambda: record(U[None, None]), "expected [time, 1] or sequences of it, found shape (1, 160, 1)"),
    "time along the second axis": (lambda: record(U.T, Y.T), "record: u: expected [time, 1]"),
    "two columns for one name": (lambda: record(np.c_[U, U]), "record: u: expected [time, 1]"),
    "one column for two names": (lambda: record(inputs={"a": "V", "b": "V"}), "record: u: expected [time, 2]"),
    "rows of unequal length": (lambda: record([[[1.0], [1.0, 2.0]]]), "record: u: expected an array of numbers, found"),
    "no sample": (lambda: record(U[:0], Y[:0]), "found shape (0, 1)"),
    "no sequence": (lambda: record([], []), "record: u: expected at least one sequence, found none"),
    "outputs that are shorter": (lambda: record(U, Y[1:]), "u and y: expected sequences of equal lengths, found [160]"),
    "a sequence too few": (lambda: record([U, U], [Y]), "u and y: expected sequences of equal lengths"),
    "NaN in an input": (lambda: record(but(U, np.nan)), "u: expected finite numbers, found nan in sample 7 of 'pump_v"),
    "infinity in an input": (lambda: record(but(U, np.inf)), "u: expected finite numbers, found inf in sample 7"),
    "NaN in the second sequence": (lambda: record([U, but(U, np.nan, 3)], [Y, Y]), "in sequence 1, sample 3"),
    "a mask of another length": (lambda: record(mask=np.ones((159, 1), bool)), "record: mask: expected"),
    "a mask of words": (
        lambda: record(mask=np.full((160, 1), "no")),
        "record: mask: expected real numbers, found text",
    ),
    "a mask of shares": (lambda: record(mask=np.full((160, 1), 0.5)), "mask: expected True or False, found 0.5"),
    "a mask of NaN": (lambda: record(mask=np.full((160, 1), np.nan)), "mask: expected True or False, found nan"),
    "no sample time": (lambda: record(dt=None), "record: dt: expected a positive sample time in seconds, found None"),
    "a sample time of zero": (lambda: record(dt=0), "record: dt: expected a positive sample time in seconds, found 0"),
    "a negative sample time": (lambda: record(dt=-4.0), "record: dt: expected a positive sample time"),
    "an endless sample time": (lambda: record(dt=np.inf), "record: dt: expected a positive sample time"),
    "a sample time that is text": (lambda: record(dt="4 s"), "found '4 s'"),
    "a list of sample times": (lambda: record(dt=[4.0]), "found [4.0]"),
    "a start that is none": (
        lambda: record(start="zero"),
        "record: start: expected one of ['unknown', 'rest', 'shared']",
    ),
    "names without units": (lambda: record(inputs=["pump_voltage"]), "record: inputs: expected names with units"),
    "no names": (lambda: record(outputs=None), "record: outputs: expected names with units"),
    "no name at all": (lambda: record(inputs={}), "record: inputs: expected at least one name"),
    "a unit that is None": (lambda: record(inputs={"pump_voltage": None}), "pump_voltage: expected the text of a unit"),
    "a unit that is a number": (lambda: record(outputs={"level_voltage": 1}), "level_voltage: expected the text of a"),
}


@pytest.mark.parametrize(("call", "words"), RECORDS.values(), ids=RECORDS)
def test_what_is_no_record_is_refused(call, words):
    refused(call, words)


def fit(model="pg_rssnn", physics=None, train=None, **settings):
    usual = {"quiet": True, "recipe": "default", "seeds": 1, "epochs": 0}
    return pg.fit(model, physics or tanks(), record() if train is None else train, **{**usual, **settings})


GIVEN = {
    "a physics that is not called": (lambda: fit(physics=pg.physics.cascaded_tanks), "expected a pg.Physics, which it"),
    "the name of a physics": (lambda: fit(physics="tanks"), "physics: expected a pg.Physics, found 'tanks'"),
    "no model": (lambda: fit(None), "model: expected the name of a model or a pg.ModelSpec, found None"),
    "a model that there is not": (lambda: fit("pg_rsnn"), "model: expected one of ["),
    "an array for a record": (lambda: fit(train=Y), "data: train: expected a record, as pg.record(u, y, ...)"),
    "a pair for a record": (lambda: fit(train=(U, Y)), "data: train: expected a record"),
    "a path for a record": (lambda: fit(train="A.csv"), "data: train: expected a record", "found 'A.csv'"),
    "an array to validate on": (lambda: fit(validation=Y), "data: validation: expected a record"),
    "other names": (lambda: fit(train=record(inputs={"u": "V"})), "expected those of the physics, ['pump_voltage']"),
    "names that are exchanged": (
        lambda: fit(train=record(inputs=NAMES["outputs"], outputs=NAMES["inputs"])),
        "data: train: inputs: expected those of the physics",
    ),
    "a unit of something else": (
        lambda: fit(train=record(inputs={"pump_voltage": "Nm"})),
        "data: train: pump_voltage: expected a unit that converts to V, found Nm",
    ),
    "a unit that nobody knows": (lambda: fit(train=record(outputs={"level_voltage": "furlong"})), "found furlong"),
    "another sample time": (lambda: fit(train=record(dt=1.0)), "data: train: dt: expected 4 s"),
    "validation of another sample time": (lambda: fit(validation=record(dt=2.0)), "data: validation: dt: expected 4 s"),
    "nothing measured": (lambda: fit(train=record(U, Y * np.nan)), "expected at least one measured output, found none"),
    "numbers beyond float32": (lambda: fit(train=record(U * 1e30)), "data: train: expected values up to 1e+18"),
    "one sample": (lambda: fit(train=record(U[:1], Y[:1])), "expected at least 1"),
    "a callback that is none": (lambda: fit(callback=3), "callback: expected a function of a Progress, found 3"),
    "a recipe that there is not": (lambda: fit(recipe="best"), "recipe: expected 'auto', 'experiment', 'default'"),
    "a recipe of a benchmark": (lambda: fit(recipe="experiment"), "for data that is no benchmark, found 'experiment'"),
}


@pytest.mark.parametrize(("call", "words"), [(c, w) for c, *w in GIVEN.values()], ids=GIVEN)
def test_what_cannot_be_trained_on_is_refused(call, words):
    refused(call, *words)


SETTINGS = [
    ({"epoch": 3}, "settings: expected some of", "'epoch'"),
    ({"epochs": "many"}, "fit.epochs: expected int, found 'many'"),
    ({"epochs": True}, "fit.epochs: expected int, found True"),
    ({"epochs": -1}, "fit: epochs: expected 0 or more, found -1"),
    ({"learning_rate": 0}, "fit: learning_rate: expected a positive number, found 0"),
    ({"learning_rate": np.nan}, "fit: learning_rate: expected a positive number, found nan"),
    ({"learning_rate": np.inf}, "fit: learning_rate: expected a positive number, found inf"),
    ({"weight_decay": np.inf}, "fit: weight_decay: expected 0 or more, found inf"),
    ({"clip_norm": -1.0}, "fit: clip_norm: expected a positive number"),
    ({"patience": 0}, "fit: patience: expected at least 1"),
    ({"guard": "hope"}, "fit.guard: expected none | rollback"),
    ({"physics_parameters": "free"}, "fit.physics_parameters: expected fixed | trained"),
    ({"seeds": 1.5}, "n_seeds: expected int, found 1.5"),
    ({"seeds": 0}, "n_seeds: expected 1 to"),
    ({"seed": -1}, "seed: expected 0 to"),
    ({"initial_state": "cold"}, "initial_state: expected zero"),
    ({"initial_state": "estimated", "n_init": 5000}, "n_init: expected fewer than"),
    ({"n_init": -1}, "n_init: expected 0 or more samples, found -1"),
    ({"report_n_init": "none"}, "report_n_init: expected a list of sample counts"),
    ({"folds": 1}, "data.folds: expected 0", "at least 2"),
    ({"folds": 50}, "data.folds: expected at least folds x block = 1600 samples"),
    ({"block": 0}, "data.block: expected between 1 and 1000000000 samples, found 0"),
    ({"lead": -1}, "data.lead: expected between 0 and 1000000000 samples, found -1"),
    ({"window": 5000}, "data.window: expected between 1 and"),
    ({"hidden": 0}, "model: hidden and gru_layers: expected at least 1"),
    ({"activation": "tanh"}, "model.activation: expected relu | sigmoid"),
    ({"correction": np.nan}, "model: correction: expected a finite number, found nan"),
    ({"regularisation": -1.0}, "model: regularisation: expected 0 or more"),
    ({"features": "radial"}, "model: recurrent: expected false with features=radial"),
    ({"how": "threads"}, "members.how: expected auto | vmap | loop"),
    ({"devices": 99}, "members: devices: expected 1 to"),
    ({"model": pg.ModelSpec(guided=False, networks=False)}, "guided and networks: expected at least one of them"),
]


@pytest.mark.parametrize(("settings", "words"), [(s, w) for s, *w in SETTINGS], ids=lambda v: str(v)[:40])
def test_a_setting_that_cannot_be_is_named(settings, words):
    refused(lambda: fit(**settings), *words)


def test_a_record_in_which_no_output_varies_teaches_nothing():
    refused(
        lambda: pg.fit("physics_only", tanks(), record(U, 0 * Y + 3.0), quiet=True), "an output that varies", "found 3"
    )


def test_numbers_of_numpy_are_numbers():
    settings = fit("physics_only", hidden=np.int64(3), learning_rate=np.float32(0.5)).settings
    assert (settings.model.hidden, settings.fit.learning_rate) == (3, 0.5)
