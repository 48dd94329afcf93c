"""The benchmarks by name: records that know their benchmark, their start and the part that validates."""

import numpy as np
import pytest

from pgrssnn_jax.data.benchmarks import LOADERS, as_records, load_benchmark, loader_settings
from pgrssnn_jax.data.lgssm import load_lgssm
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.matching import matched

SMALL = {"generated": True, "n_train": 20, "n_validation": 10, "n_test": 15}


@pytest.mark.parametrize(
    ("name", "settings", "physics", "start"),
    [
        ("cascaded_tank", {"generated": True}, cascaded_tanks(), "shared"),
        ("lgssm", {**SMALL, "realisations": 1}, lgssm(), "rest"),
    ],
)
def test_a_benchmark_needs_no_physics_and_fits_its_own(capsys, name, settings, physics, start):
    train, test = load_benchmark(name, **settings)
    for record in (train, train.validation, test):
        assert (record.info.benchmark, record.info.start) == (name, start)
        assert record.u.ndim == 3
        found = matched(record, physics.inputs, physics.outputs, physics.dt, where="here")
        np.testing.assert_array_equal(found.u, record.u)
    assert test.validation is None
    assert capsys.readouterr().out == f"{name}: simulated: {train.info.origin}\n"


def test_several_realisations_keep_their_axis(capsys):
    train, test = load_benchmark("lgssm", **SMALL, realisations=3)
    assert (train.u.shape, train.validation.u.shape, test.u.shape) == ((3, 1, 20, 1), (3, 1, 10, 1), (3, 1, 15, 1))
    splits = load_lgssm(**SMALL, realisations=3)
    np.testing.assert_array_equal(train.y, splits.train.y)
    np.testing.assert_array_equal(as_records(splits)[0].validation.y, train.validation.y)


def test_a_loaders_settings_are_what_a_user_may_say():
    assert set(LOADERS) == {"cascaded_tank", "lgssm", "robot_real", "robot_simulated", "csv", "arm_log"}
    found = loader_settings("lgssm")
    assert (found["n_train"], found["realisations"], found["path"]) == (2000, 50, None)
    assert not {"physics", "notify", "timeout"} & set(found)
    assert loader_settings("csv")["train"] is ...


@pytest.mark.parametrize(
    ("name", "settings", "sentence"),
    [
        ("tanks", {}, r"load_benchmark: expected one of \['cascaded_tank', .*\], found 'tanks'"),
        ("csv", {}, "load_benchmark: expected one of .*, found 'csv'"),
        ("lgssm", {"window": 64}, r"load_benchmark: expected the keys \[.*'n_train'.*\], found 'window'"),
        ("lgssm", {"n_train": "all"}, "load_benchmark.n_train: expected int, found 'all'"),
        ("lgssm", {**SMALL, "n_test": 0}, "data.n_test: expected between 1 and .*, found 0"),
    ],
)
def test_unknown_names_and_settings_are_refused(name, settings, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        load_benchmark(name, **settings)
