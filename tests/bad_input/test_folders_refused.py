"""Run folders that are not finished, of something else, of another version, or damaged."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import called
from sentences import assert_one_sentence, contents, refused
from stored_run import change_json, change_yaml, copied, save, use

import pgrssnn_jax as pg


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return save(tmp_path_factory.mktemp("good") / "run")


@pytest.fixture
def run(good, folder) -> Path:
    return copied(good, folder / "run")


def text(name, content):
    return lambda run: (run / name).write_text(content)


def half(name):
    return lambda run: (run / name).write_bytes((run / name).read_bytes()[: (run / name).stat().st_size // 2])


def metrics(*place, value):
    return lambda run: change_json(run / "metrics.json", *place, value=value)


def physics(*place, value):
    return lambda run: change_json(run / "physics.json", *place, value=value)


def config(*place, value):
    return lambda run: change_yaml(run / "config.yaml", *place, value=value)


def arrays(name, **changes):
    def change(run):
        with np.load(run / name) as found:
            kept = dict(found)
        np.savez(run / name, **{**kept, **changes})

    return change


def removed(name):
    return lambda run: shutil.rmtree(run / name) if (run / name).is_dir() else (run / name).unlink()


def replaced(name):
    """A folder in the place of a file."""

    def change(run):
        (run / name).unlink()
        (run / name).mkdir()

    return change


DAMAGES = {
    "not finished": (removed("DONE"), "expected a finished run with the file DONE, found none"),
    "without a configuration": (removed("config.yaml"), "run folder: expected one with a config.yaml, found none"),
    "a configuration that is a folder": (replaced("config.yaml"), "expected one with a config.yaml"),
    "a configuration that is empty": (
        text("config.yaml", ""),
        "config.yaml: physics: expected a group of named values",
    ),
    "a configuration that is no YAML": (
        text("config.yaml", "a: [1"),
        "config.yaml: expected the configuration of a run",
    ),
    "a configuration that is a list": (text("config.yaml", "- 1\n"), "config.yaml: expected groups of named values"),
    "of another version: a setting": (config("fit", "epohcs", value=3), "fit: expected the keys", "found 'epohcs'"),
    "of another version: a value": (config("fit", "optimizer", value="sgd"), "fit.optimizer: expected adam | adamw"),
    "of another version: a group": (config("members", value=None), "config.yaml: members: expected a group"),
    "settings in words": (config("model", "hidden", value="many"), "model.hidden: expected int, found 'many'"),
    "settings of NaN": (config("fit", "learning_rate", value=float("nan")), "fit: learning_rate: expected a positive"),
    "a start in words": (config("data", "shared_initial_state", value="yes"), "expected true or false, found 'yes'"),
    "another size of model": (config("model", "hidden", value=0), "model: hidden and gru_layers: expected at least 1"),
    "another model": (config("model", "networks", value=True), "checkpoint: state: expected the arrays of this model"),
    "a physics that is half": (half("physics.json"), "physics.json: expected a JSON file, found"),
    "a physics that is empty": (text("physics.json", "{}"), "physics.json: expected the key 'system'"),
    "another physics": (physics("system", value="arm"), "expected physics 'tanks', found 'arm'"),
    "a builder of others": (physics("physics", "_target_", value="os.getcwd"), "expected the physics of one's own"),
    "a parameter in words": (physics("numbers", "parameters", "k1", value="much"), "k1: expected numbers of shape ()"),
    "a start that is a number": (physics("initial_state", value=3), "initial_state: expected a group of named values"),
    "signals in words": (physics("signals", value="many"), "physics.json: signals: expected lists of states, inputs"),
    "signals that are none": (
        physics("signals", "states", value=None),
        "physics.json: signals: expected lists of states",
    ),
    "other signals": (
        physics("signals", "inputs", value=[["u", "V"]]),
        "physics: inputs: expected [['u', 'V']], found",
    ),
    "metrics that are half": (half("metrics.json"), "metrics.json: expected a JSON file, found"),
    "metrics that are a list": (text("metrics.json", "[]"), "metrics.json: expected named values, found list"),
    "a member too many": (metrics("members", value=[{"seed": 0, "dataset": 0}] * 2), "seed and dataset of 1 members"),
    "members that are a number": (metrics("members", value=2), "metrics.json: members: expected seed and dataset of 1"),
    "a seed in words": (
        metrics("members", 0, "seed", value="first"),
        "members: expected seed and dataset of 1 members",
    ),
    "seconds that are a number": (metrics("seconds", value=3), "metrics.json: seconds: expected seconds by the names"),
    "predictions that are half": (half("predictions.npz"), "predictions.npz: expected arrays of numbers, found"),
    "predictions that are empty": (text("predictions.npz", ""), "predictions.npz: expected arrays of numbers, found"),
    "starts of other members": (
        arrays("predictions.npz", x0_train=np.zeros((9, 2))),
        "x0_train: expected numbers (1, 2)",
    ),
    "starts in words": (arrays("predictions.npz", x0_train=np.full((1, 2), "a")), "x0_train: expected numbers (1, 2)"),
    "intervals that are half": (half("intervals.npz"), "intervals.npz: expected arrays of numbers, found"),
    "intervals that are empty": (text("intervals.npz", ""), "intervals.npz: expected arrays of numbers, found"),
    "intervals of two outputs": (
        arrays("intervals.npz", y=np.zeros((4, 2))),
        "intervals.npz: expected arrays of shapes",
    ),
    "other intervals": (arrays("intervals.npz", more=np.zeros(3)), "intervals.npz: expected arrays of shapes"),
    "without a checkpoint": (removed("checkpoint"), "checkpoint: expected one in", "found none"),
    "an empty checkpoint": (removed("checkpoint/0"), "checkpoint: expected one in", "found none"),
    "a checkpoint without its list": (half("checkpoint/0/default/_METADATA"), "checkpoint: expected a whole one in"),
}


@pytest.mark.parametrize(("damage", "words"), [(damage, words) for damage, *words in DAMAGES.values()], ids=DAMAGES)
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_folder_that_is_no_whole_run_is_refused(run, damage, words):
    damage(run)
    refused(lambda: use(run), *words)


def test_a_whole_run_is_read(run):
    use(run)


def test_another_configuration_has_another_checkpoint(run, folder):
    save(folder / "other", physics_parameters="trained")
    shutil.rmtree(run / "checkpoint")
    shutil.copytree(folder / "other/checkpoint", run / "checkpoint")
    refused(
        lambda: use(run), "checkpoint: state: expected the arrays of this model and its members, found those of another"
    )


def test_a_physics_of_ones_own_must_be_that_of_the_run(run):
    refused(lambda: pg.load(run, physics=pg.physics.lgssm()), "physics: states: expected [['upper_level', 'V']")
    refused(lambda: pg.load(run / "config.yaml"), "run folder: expected a folder at", "found the file")


@pytest.mark.parametrize("name", ["without a configuration", "a configuration that is no YAML", "settings in words"])
def test_a_command_resumes_no_damaged_folder(run, folder, name):
    damage, *words = DAMAGES[name]
    damage(run)
    before = contents(run)
    code, out, err = called(f"resume={run}", cwd=folder)
    assert code == 2, out + err
    assert "Traceback" not in out + err
    # the data of a run of the API are nowhere on disk, which is found before its settings are read
    assert_one_sentence(err.strip(), *(words if name != "settings in words" else ["data.name: expected one of"]))
    assert contents(run) == before


def test_a_report_of_no_folder_is_refused(folder):
    (folder / "A.csv").write_text("a\n")
    for arguments, words in (
        (["runs=none"], "runs: expected a folder, or several with commas between them, found 'none'"),
        (["runs=A.csv"], "runs: expected a folder"),
        (["runs=.", "out=A.csv"], "out: expected a folder, found the file 'A.csv'"),
        (["runs=.", "+depth=1"], "expected the keys ['out', 'runs', 'verify'], found 'depth'"),
    ):
        before = contents(folder)
        code, out, err = called(*arguments, cwd=folder, script="report.py")
        assert code == 2, out + err
        assert_one_sentence(err.strip(), words)
        assert contents(folder) == before
