"""The linear Gaussian data: published files, generated realisations, and the floor of the true system."""

import shutil

import numpy as np
import pytest

from pgrssnn_jax.data.lgssm import A, B, C, load_lgssm
from pgrssnn_jax.physics.linear import lgssm

TRAIN, TEST = "toy_lgssm_pre_trainingset_shifted_{}.npz", "toy_lgssm_pre_testset_shifted.npz"
SMALL = {"realisations": 2, "n_train": 20, "n_validation": 10, "n_test": 15}


def columns(parts, samples=30):
    return {f"{s}_{part}": np.full((samples, 1), i + 1.0) for i, part in enumerate(parts) for s in "uy"}


@pytest.fixture
def folder(tmp_path):
    """Files of the published layout."""
    for i in range(2):
        np.savez(tmp_path / TRAIN.format(i), **columns(["train", "val"]))
    np.savez(tmp_path / TEST, **columns(["test"]))
    return tmp_path


def simulate(u):
    """The true system without noise."""
    x, y = np.zeros(2), []
    for u_t in u:
        x = A @ x + B * u_t
        y.append(C @ x)
    return np.array(y)


def test_shapes_and_source_of_files(folder):
    splits = load_lgssm(path=folder, **SMALL)
    assert splits.train.u.shape == splits.train.y.shape == (2, 1, 20, 1)
    assert splits.validation.u.shape == (2, 1, 10, 1)
    assert splits.test.mask.shape == (2, 1, 15, 1)
    assert splits.train.info.source == "file"
    assert splits.test.info.origin.startswith("toy_lgssm_pre_trainingset_shifted_0..1.npz, test record sha256 ")
    np.testing.assert_array_equal(splits.validation.u, 2.0)


@pytest.mark.data
def test_published_shapes(data):
    splits = load_lgssm(realisations=2)
    assert splits.train.u.shape == (2, 1, 2000, 1)
    assert splits.validation.u.shape == (2, 1, 2000, 1)
    assert splits.test.u.shape == (2, 1, 5000, 1)
    assert not np.array_equal(splits.train.u[0], splits.train.u[1])


@pytest.mark.data
def test_the_true_system_scores_the_floor_on_the_published_test_record(data):
    test = load_lgssm(realisations=1).test
    error = simulate(test.u[0, 0, :, 0]) - test.y[0, 0, :, 0]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1.361, abs=2e-3)


def test_the_true_system_scores_the_same_floor_on_generated_data():
    test = load_lgssm(generated=True, **{**SMALL, "n_test": 20000}).test
    error = simulate(test.u[0, 0, :, 0]) - test.y[0, 0, :, 0]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1.361, abs=0.05)


def test_generated_inputs_are_white_and_uniform():
    u = load_lgssm(generated=True, **{**SMALL, "n_test": 20000}).test.u[0, 0, :, 0]
    assert np.abs(u).max() <= 2.5
    assert u.std() == pytest.approx(5 / np.sqrt(12), rel=0.02)
    assert abs(np.corrcoef(u[1:], u[:-1])[0, 1]) < 0.03


def test_generated_data_are_seeded():
    first, second, other = (load_lgssm(generated=True, seed=seed, **SMALL) for seed in (1, 1, 2))
    for a, b, c in zip(first, second, other, strict=True):
        np.testing.assert_array_equal(a.y, b.y)
        assert not np.array_equal(a.y, c.y)
    assert (first.train.info.source, first.train.info.origin) == ("simulated", "generated, seed 1")


def test_less_generated_data_is_the_beginning_of_more():
    small = load_lgssm(generated=True, **SMALL)
    big = load_lgssm(generated=True, realisations=3, n_train=60, n_validation=40, n_test=30)
    np.testing.assert_array_equal(small.train.y, big.train.y[:2, :, :20])
    np.testing.assert_array_equal(small.validation.y, big.validation.y[:2, :, :10])
    np.testing.assert_array_equal(small.test.y, big.test.y[:2, :, :15])


def test_realisations_differ_and_share_their_test_record():
    splits = load_lgssm(generated=True, **SMALL)
    assert not np.array_equal(splits.train.u[0], splits.train.u[1])
    assert not np.array_equal(splits.train.u[0, 0, :10], splits.validation.u[0, 0])
    np.testing.assert_array_equal(splits.test.y[0], splits.test.y[1])


def test_the_sample_time_is_that_of_the_physics():
    physics = lgssm(A=A.tolist(), B=B[:, None].tolist(), C=C[None].tolist(), dt=0.5)
    assert load_lgssm(generated=True, physics=physics, **SMALL).train.info.dt == 0.5
    assert load_lgssm(generated=True, **SMALL).train.info.dt == 1.0


@pytest.mark.parametrize("is_set", [True, False])
def test_data_nobody_asked_to_generate_are_announced(tmp_path, monkeypatch, is_set):
    monkeypatch.setenv("PGRSSNN_DATA", str(tmp_path) if is_set else "")
    lines = []
    splits = load_lgssm(notify=lines.append, **SMALL)
    assert splits.train.info.source == "simulated"
    reason = "no folder lgssm under PGRSSNN_DATA" if is_set else "PGRSSNN_DATA is not set"
    assert lines == [f"data: NO PUBLISHED DATA, GENERATING THE REALISATIONS (seed 0): {reason}"]


def test_files_under_the_variable_are_used(folder, monkeypatch):
    shutil.copytree(folder, folder / "lgssm")
    monkeypatch.setenv("PGRSSNN_DATA", str(folder))
    lines = []
    assert load_lgssm(notify=lines.append, **SMALL).train.info.source == "file"
    assert load_lgssm(generated=True, notify=lines.append, **SMALL).train.info.source == "simulated"
    assert lines == []


def broken(folder, kind):
    file = folder / TRAIN.format(1)
    arrays = columns(["train", "val"])
    if kind == "missing":
        file.unlink()
    elif kind == "text":
        file.write_text("no archive")
    elif kind == "cut":
        file.write_bytes(file.read_bytes()[:200])
    elif kind == "array":
        with file.open("wb") as stream:
            np.save(stream, np.zeros(3))
    elif kind == "words":
        np.savez(file, **{**arrays, "u_train": np.array([["a"]] * 30)})
    elif kind == "key":
        del arrays["y_val"]
        np.savez(file, **arrays)
    elif kind == "shape":
        np.savez(file, **{**arrays, "y_train": np.zeros(30)})
    elif kind == "short":
        np.savez(file, **columns(["train", "val"], samples=15))
    elif kind == "NaN":
        arrays["u_val"][3] = np.nan
        np.savez(file, **arrays)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("missing", "expected a file of the published data, found no such file"),
        ("text", "expected a readable .npz file of numbers, found "),
        ("cut", "expected a readable .npz file of numbers, found "),
        ("array", "expected a readable .npz file of numbers, found "),
        ("words", "expected a readable .npz file of numbers, found "),
        ("key", "array 'y_val': expected it in the file, found u_train, y_train, u_val"),
        ("shape", "array 'y_train': expected shape (at least 20, 1), found (30,)"),
        ("short", "array 'u_train': expected shape (at least 20, 1), found (15, 1)"),
        ("NaN", "array 'u_val': expected finite numbers, found nan at t = 3"),
    ],
)
def test_a_bad_file_is_one_sentence_with_its_place(folder, kind, expected):
    broken(folder, kind)
    with pytest.raises(ValueError) as caught:
        load_lgssm(path=folder, **SMALL)
    assert str(caught.value).startswith(f"{folder / TRAIN.format(1)}: {expected}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"realisations": 0}, "data.realisations: expected between 1 .*, found 0"),
        ({"n_test": 0}, "data.n_test: expected between 1 .*, found 0"),
        ({"path": "nowhere", "generated": False}, "data.path: expected the folder .*, found no folder: nowhere"),
        ({"path": "nowhere"}, "data.generated: expected false where data.path names a folder, found true"),
        ({"seed": -1}, "data.seed: expected between 0 .*, found -1"),
    ],
)
def test_bad_options(options, expected):
    with pytest.raises(ValueError, match=f"^{expected}$"):
        load_lgssm(**{"generated": True, **SMALL, **options})
