"""python discover.py, as a user types it: what it leaves, what it says to bad input, and that training takes it up."""

import json
import signal
from pathlib import Path

import numpy as np
import pytest
from commands import QUICK, called, command, composed, start

from pgrssnn_jax.cli.discover import checked
from pgrssnn_jax.discovery.discover import discover
from pgrssnn_jax.discovery.serialise import discovery_json

LINEAR = ["physics=lgssm", "physics.A=[[0.8]]", "physics.B=[[1.0]]", "physics.C=[[1.0]]", "data=csv"]
SHORT = ["discovery.network_epochs=0", "discovery.folds=2", "discovery.draws=99", "discovery.starts=1",
         "discovery.most=1", "discovery.block=20"]  # fmt: skip
KEYS = {
    "schema", "system", "data", "verdict", "sentence", "effects", "alternatives", "untestable", "formula",
    "disagreement", "recalibration", "gap", "seconds",
}  # fmt: skip


def write(path: Path, samples: int, seed: int, change=lambda u, y: None) -> Path:
    """x_t = 0.8 x_{t-1} + min(u_t, 0.8), with noise."""
    draw = np.random.default_rng(seed)
    u, x, y = draw.standard_normal(samples), 0.0, np.zeros(samples)
    for t in range(samples):
        x = 0.8 * x + min(u[t], 0.8)
        y[t] = x + 0.02 * draw.standard_normal()
    change(u, y)
    np.savetxt(path, np.c_[u, y], delimiter=",", header="u,y", comments="")
    return path


def files(folder: Path, samples: int = 240, change=lambda u, y: None) -> list[str]:
    train, test = write(folder / "a.csv", samples, 1, change), write(folder / "b.csv", 120, 2)
    return [f"data.train={train}", f"data.test={test}"]


@pytest.mark.compiles
def test_a_discovery_leaves_its_folder_and_training_takes_it_up(tmp_path):
    pair = files(tmp_path)
    shared = "data.shared_initial_state=true"
    network = ["discovery.network_epochs=2", "model.hidden=3"]
    every = [*LINEAR, *pair, shared, *SHORT, *network, "hydra.run.dir=run"]
    code, out, err = command(*every, cwd=tmp_path, script="discover.py")
    assert code == 0, err
    assert "run folder: run" in out
    run = tmp_path / "run"
    assert {p.name for p in run.iterdir()} >= {"config.yaml", "discovery.json", "discovery.npz", "report.html", "DONE"}
    said = json.loads((run / "discovery.json").read_text())
    assert set(said) >= KEYS
    assert (said["schema"], said["system"], said["verdict"]) == (1, "lgssm", "effect_found")
    assert said["data"] == {**said["data"], "source": "file", "n_train": 240, "n_test": 120, "dt": 1.0}
    (effect,) = said["effects"]
    assert effect["name"] == "input_saturation"
    assert set(effect) >= {"title", "equation", "acts_on", "parameters", "region", "active_fraction", "p_value",
                           "gain_test", "runner_up"}  # fmt: skip
    assert effect["parameters"]["high"]["value"] == [pytest.approx(0.8, abs=0.05)]
    assert set(said["gap"]) >= {"metric", "unit", "before", "recalibrated", "after", "floor", "closed_fraction"}
    assert said["gap"]["after"]["test"] < 0.2 * said["gap"]["recalibrated"]["test"]
    assert said["network"]["epochs"] == 2
    assert said["network"]["rmse_after"] < 0.2 * said["network"]["rmse_before"]
    with np.load(run / "discovery.npz") as arrays:
        measured, after = arrays["y_test"], arrays["y_after_test"]
    assert np.sqrt(np.mean((measured - after) ** 2)) == pytest.approx(said["gap"]["after"]["test"], rel=1e-3)

    effects = f"physics.effects={run / 'discovery.json'}"
    code, out, err = command(*LINEAR, *pair, effects, *QUICK, "hydra.run.dir=trained", cwd=tmp_path)
    assert code == 0, err
    assert "input_saturation" in out
    assert (tmp_path / "trained" / "DONE").exists()


@pytest.mark.compiles
def test_when_an_effect_acts_is_said_of_the_sequence_in_which_it_does(tmp_path):
    """The shorter first sequence never saturates, and what fills it up is no sample."""
    draw, lengths, rows = np.random.default_rng(3), {"calm": 150, "wild": 240}, []
    for name, samples in lengths.items():
        u = draw.standard_normal(samples) if name == "wild" else draw.uniform(-0.7, 0.7, samples)
        x = 0.0
        for now in u:
            x = 0.8 * x + min(now, 0.8)
            rows.append(f"{name},{now},{x + 0.02 * draw.standard_normal()}")
    (tmp_path / "two.csv").write_text("\n".join(["sequence,u,y", *rows]))
    pair = [f"data.train={tmp_path / 'two.csv'}", f"data.validation={tmp_path / 'two.csv'}", *files(tmp_path)[1:]]
    setup, _ = checked(composed(*LINEAR, *pair, *SHORT, name="discover"), lambda line: None)
    said = discovery_json(discover(setup, lambda line: None), setup, command="")
    (effect,) = said["effects"]
    above = sum(float(row.split(",")[1]) > 0.8 for row in rows)
    assert effect["name"] == "input_saturation"
    assert effect["sequence"] == 2
    assert effect["intervals_s"]
    assert effect["active_fraction"] == pytest.approx(above / len(rows), abs=0.01)
    assert all(row["share_of_samples"] <= 1.0 for row in said["disagreement"])


@pytest.mark.compiles
def test_a_saturation_is_found_in_stretches_too(tmp_path):
    config = composed(*LINEAR, *files(tmp_path), *SHORT, "discovery.stretches=[40,80]", name="discover")
    setup, _ = checked(config, lambda line: None)
    found = discover(setup, lambda line: None)
    assert found.judgement.verdict == "effect_found"
    assert found.selection.final.estimate.active == ("input_saturation",)
    high = found.problem.params(found.selection.final.estimate.theta).effects["input_saturation"]["high"]
    np.testing.assert_allclose(high, 0.8, atol=0.05)
    said = json.loads(json.dumps(discovery_json(found, setup, command="")))
    assert set(said) >= KEYS
    assert [effect["name"] for effect in said["effects"]] == ["input_saturation"]
    assert said["remaining"]["rule"] == "everywhere: no more than the noise"
    assert said["remaining"]["region"] == {}


@pytest.mark.compiles
@pytest.mark.parametrize("layout", ["many short sequences", "every second sample measured"])
def test_a_saturation_is_found_however_the_record_is_laid_out(tmp_path, layout):
    short, draw, rows = layout.startswith("many"), np.random.default_rng(4), []
    for sequence in range(40 if short else 1):
        x = 0.0
        for t, now in enumerate(draw.standard_normal(30 if short else 600)):
            x = 0.8 * x + min(now, 0.8)
            rows.append(f"{sequence},{now},{x + 0.02 * draw.standard_normal()},{int(short or t % 2 == 0)}")
    (tmp_path / "train.csv").write_text("\n".join(["sequence,u,y,mask", *rows]))
    pair = [f"data.train={tmp_path / 'train.csv'}", f"data.validation={tmp_path / 'train.csv'}", *files(tmp_path)[1:]]
    setup, _ = checked(composed(*LINEAR, *pair, *SHORT, name="discover"), lambda line: None)
    found = discover(setup, lambda line: None)
    assert found.judgement.verdict == "effect_found"
    assert found.selection.final.estimate.active == ("input_saturation",)
    assert found.selection.floor * np.std(setup.estimation.y[setup.estimation.mask]) == pytest.approx(0.02, rel=0.15)


@pytest.mark.compiles
def test_ctrl_c_ends_a_discovery_where_it_stands(tmp_path):
    arguments = [*LINEAR, *files(tmp_path, samples=2000), *SHORT, "discovery.most=4", "hydra.run.dir=run"]
    process = start(*arguments, cwd=tmp_path, script="discover.py")
    assert process.stdout is not None
    while "samples in the estimation record" not in (line := process.stdout.readline()):
        assert line, process.communicate()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err == "stopped; discovery cannot be resumed, start it again\n"
    assert {path.name for path in tmp_path.iterdir()} == {"a.csv", "b.csv"}


def refused(*arguments: str, cwd: Path, script: str) -> str:
    """The one sentence; nothing is left."""
    before = {p.name for p in cwd.iterdir()}
    code, _, err = called(*arguments, "hydra.run.dir=run", cwd=cwd, script=script)
    assert code == 2, err
    assert "Traceback" not in err
    assert {p.name for p in cwd.iterdir()} == before
    return err


def test_bad_input_is_one_sentence_and_leaves_nothing(tmp_path):
    def constant(u, y):
        u[:] = 0.5

    said = refused(*LINEAR, *files(tmp_path, change=constant), *SHORT, cwd=tmp_path, script="discover.py")
    assert "data: train: u: expected a signal that varies, found only 0.5" in said
    said = refused(*LINEAR, *files(tmp_path), "physics.effects=none.json", *QUICK, cwd=tmp_path, script="train.py")
    assert "physics.effects: expected a discovery.json, found 'none.json'" in said


def test_one_of_several_realisations_is_looked_at():
    data = ["+experiment=lgssm", "data.realisations=3", "data.generated=true"]
    records = []
    for number in range(3):
        said: list[str] = []
        setup, _ = checked(composed(*data, f"realisation={number}", name="discover"), said.append)
        assert f"discovery looks at realisation {number} of 3" in said
        records.append(np.asarray(setup.estimation.y))
    assert len({record.tobytes() for record in records}) == 3


def nothing(u, y):
    pass


def flat(u, y):
    y[:] = 1.5


def hole(u, y):
    u[17] = np.nan


@pytest.mark.parametrize(
    ("samples", "change", "more", "sentence"),
    [
        (240, flat, [], "data: train: y: expected a signal that varies, found only 1.5"),
        (
            60,
            nothing,
            [],
            r"data: train: expected at least 64 samples, 4 blocks of 8 for each of discovery.folds=2, found 60",
        ),
        (240, nothing, ["discovery.without=[overflow]"], r"effects: expected some of .* found 'overflow'"),
        (240, hole, [], "a.csv.*line 19.*u.*nan"),
        (240, nothing, ["discovery.folds=1"], "discovery.folds: expected at least 2, found 1"),
        (240, nothing, ["discovery.fixed=[arm.Q,Q]"], r"discovery.fixed: expected some of \['A', 'B', 'C'\] .*'Q'"),
        (240, nothing, ["discovery.tolerance=0"], "discovery.tolerance: expected null or a number above 0, found 0"),
        (240, nothing, ["discovery.p_value=0"], "discovery.p_value: expected a number between 0 and 1, found 0"),
        (240, nothing, ["discovery.stretches=[1]"], "discovery.stretches: expected auto or a list of lengths"),
        (
            240,
            nothing,
            ["discovery.stretches=[60,300]"],
            "data: train: expected sequences of at least 300 measured samples",
        ),
        (240, nothing, ["discovery.n_init=120"], "discovery.n_init: expected fewer than the 120 samples"),
        (240, nothing, ["discovery.p_value=0.005"], "discovery.p_value: expected at least 1 / 100"),
        (240, nothing, ["discovery.p_value=0.004", "discovery.draws=2000", "discovery.stretches=[60]"], "1 / 201"),
        (240, nothing, ["realisation=1"], "realisation: expected 0 to 0, found 1"),
        (240, nothing, ["resume=run"], "resume: expected null, .* found 'run'"),
        (240, nothing, ["physics.effects=found.json"], "physics.effects: expected a discovery.json"),
        (240, nothing, ["physics.A=[[50.0]]"], "physics 'lgssm': expected a free run that stays finite"),
        (
            240,
            nothing,
            ["discovery.network_epochs=1", "model.hidden=-3"],
            "model: hidden and gru_layers: expected at least 1, found -3",
        ),
    ],
)
def test_bad_input_is_named(tmp_path, samples, change, more, sentence):
    config = composed(*LINEAR, *files(tmp_path, samples, change), *SHORT, *more, name="discover")
    with pytest.raises(ValueError, match=sentence) as problem:
        checked(config, lambda line: None)
    assert "\n" not in str(problem.value)
