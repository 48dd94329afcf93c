"""Bad input to the commands: exit code 2, one sentence, nothing written; missing packages are named too."""

import shutil
import subprocess
import sys
from functools import partial

import pytest
from commands import ROOT, called, command, planned

#: Hydra shows tracebacks to whatever traces a process: coverage must not follow this one
NO_TRACER = {"COVERAGE_PROCESS_CONFIG": "", "COVERAGE_PROCESS_START": ""}


@pytest.mark.parametrize(
    ("run", "arguments", "sentence"),
    [
        (partial(command, **NO_TRACER), ["+experiment=cascaded_tank", "model=unknown"], "model/unknown"),
        pytest.param(
            partial(command, **NO_TRACER), ["+experiment=cascaded_tank", "fit.epohcs=3"], "fit.epohcs",
            marks=pytest.mark.slow,
        ),
        (called, ["+experiment=cascaded_tank", "data.path=none.csv"], "none.csv"),
        (called, [], "physics._target_: expected +experiment=cascaded_tank"),
        (called, ["resume=none"], "run folder: expected one with a config.yaml"),
    ],
)  # fmt: skip
def test_bad_input_ends_with_2_one_sentence_and_nothing_written(tmp_path, run, arguments, sentence):
    code, out, err = run(*arguments, cwd=tmp_path)
    assert code == 2, err
    assert sentence in err + out
    assert "Traceback" not in err
    assert not list(tmp_path.rglob("*.*"))


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (["fit.epochs=many"], "fit.epochs: expected int, found 'many'"),
        (["fit.optimizer=sgd"], "fit.optimizer: expected adam | adamw, found 'sgd'"),
        (["model.activation=tanh"], "model.activation: expected relu | sigmoid, found 'tanh'"),
        (["model.hidden=0"], "model: hidden and gru_layers: expected at least 1"),
        (["model.guided=false", "model.networks=false"], "expected at least one of them to be true"),
        (["initial_state=guessed"], "initial_state: expected zero | scaled_zero | first_output | estimated"),
        (["initial_state=estimated", "n_init=0"], "n_init: expected at least 1 sample"),
        (["initial_state=estimated", "n_init=4000"], "n_init: expected fewer than"),
        (["n_seeds=0"], "n_seeds: expected 1 to 1000000, found 0"),
        (["seed=-1"], "seed: expected 0 to 2147483647, found -1"),
        (["report_n_init=[]"], "report_n_init: expected a count below the 160 samples"),
        (["report_n_init=[2000]"], "report_n_init: expected a count below the 160 samples"),
        (["report_n_init=many"], "report_n_init: expected a list of sample counts"),
        (["report_n_init=[-1]"], "report_n_init: expected a list of sample counts like [0, 5, 50], found [-1]"),
        (["+foo=bar"], "configuration: expected the keys"),
        (["seed=99999999999999999999"], "seed: expected 0 to"),
        (["fit.clip_norm=-1"], "fit: clip_norm: expected a positive number, found -1"),
        (["fit.checkpoint_seconds=abc"], "fit.checkpoint_seconds: expected float, found 'abc'"),
        (["data.shared_initial_state=perhaps"], "data.shared_initial_state: expected true or false, found 'perhaps'"),
        (["physics.k1=2.0"], "physics 'tanks': k1: expected 0 to 1 sqrt(V)/s, found 2.0"),
        (["physics._target_=no_such.physics"], "physics._target_: expected an importable function"),
        (["physics._target_=os.getcwd"], "physics: expected the keys []"),
        (["physics.integrator=heun"], "physics: integrator: expected one of"),
        (["physics.dt=fast"], "physics.dt: expected float, found 'fast'"),
        (["physics.dt=-4"], "dt: expected a positive sample time"),
        (["members.devices=99"], "members: devices: expected 1 to 2, found 99"),
        (["members.how=threads"], "members.how: expected auto | vmap | loop, found 'threads'"),
        (["data.n_train=0"], "n_train"),
        (["data.n_validation=160"], "n_validation"),
    ],
)
def test_a_value_that_does_not_fit_is_named(benchmark, overrides, sentence):
    base = ["+experiment=cascaded_tank", f"data.path={benchmark}", "data.n_validation=40"]
    with pytest.raises(ValueError) as caught:
        planned(*base, *overrides)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_wrong_pinocchio_and_missing_packages_are_named(monkeypatch, tmp_path):
    from pgrssnn_jax.cli import packages

    monkeypatch.setattr(packages, "_installed", lambda name: name == "pinocchio")
    assert "unrelated package 'pinocchio'" in str(packages.package_problem())
    monkeypatch.setattr(packages, "_installed", lambda name: True)
    assert packages.package_problem() is None
    monkeypatch.setattr(packages.util, "find_spec", lambda name: None if name == "flax" else True)
    assert "expected flax, found none installed" in str(packages.package_problem())
    with pytest.raises(SystemExit) as ended:
        packages.check_packages()
    assert ended.value.code == 2
    assert shutil.which("make")  # the sentence points to it


def test_without_any_package_the_command_ends_with_one_sentence():
    standard_library_alone = [sys.executable, "-S", ROOT / "train.py"]
    ended = subprocess.run(standard_library_alone, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith("error: packages: expected jax, flax, optax")
    assert ended.stderr.count("\n") == 1
