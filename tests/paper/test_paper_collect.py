"""Every run folder is found, finished or not, and says what it was, whatever is left of it."""

import json

import pytest
from paper_samples import begin_run, fail_run, write_run

from pgrssnn_jax.paper.collect import collect, read_metrics
from pgrssnn_jax.paper.published import Variant, read_paper

PAPER = read_paper()


def by_name(*roots):
    return {run.path.name: run for run in collect(roots, PAPER)}


def test_runs_at_any_depth_and_every_folder_once(tmp_path):
    first = write_run(tmp_path / "a/table1_tank/model=rssnn", [0.5], model="rssnn")
    write_run(tmp_path / "b/deep/er/model=pg_rssnn", [0.4])
    (first / "checkpoint/5").mkdir(parents=True)
    (first / "checkpoint/5/config.yaml").touch()
    (tmp_path / "a/.hidden").mkdir()
    (tmp_path / "a/.hidden/DONE").touch()
    runs = collect([tmp_path, tmp_path / "a", first], PAPER)
    assert sorted(run.path.name for run in runs) == ["model=pg_rssnn", "model=rssnn"]


def test_how_a_run_ended(tmp_path):
    sweep = tmp_path / "table1_tank"
    write_run(sweep / "model=rssnn", [0.5, None], model="rssnn")
    begin_run(sweep / "model=fcssnn", model="fcssnn", n_seeds=7)
    fail_run(sweep / "model=pg_fcssnn", "fit.epochs: expected at least 1, found 0\nmore")
    (write_run(sweep / "model=pg_rssnn", [0.5]) / "metrics.json").write_text('{"schema"')
    (write_run(sweep / "model=rssnn_fb", [0.5], model="rssnn_fb") / "metrics.json").unlink()
    (write_run(sweep / "model=rssnn_sgm", [0.5], model="rssnn_sgm") / "DONE").unlink()
    runs = by_name(tmp_path)
    found = {name: (run.state, run.planned, run.metrics is None) for name, run in runs.items()}
    assert found == {
        "model=rssnn": ("finished", 2, False),
        "model=fcssnn": ("unfinished", 7, True),
        "model=pg_fcssnn": ("failed", None, True),
        "model=pg_rssnn": ("damaged", 1, True),
        "model=rssnn_fb": ("damaged", 1, True),
        "model=rssnn_sgm": ("unfinished", 1, True),  # numbers without DONE are not counted
    }
    assert runs["model=pg_fcssnn"].reason == "fit.epochs: expected at least 1, found 0"
    assert "metrics.json: expected JSON" in runs["model=pg_rssnn"].reason
    assert "metrics.json: expected one beside DONE, found none" in runs["model=rssnn_fb"].reason
    assert all(run.experiment == "table1_tank" for run in runs.values())
    assert all(run.variant == Variant(name.removeprefix("model="), "tanks", 768) for name, run in runs.items())


def test_a_finished_run_is_finished_whatever_else_lies_there(tmp_path):
    folder = write_run(tmp_path / "run", [0.5])
    (folder / "FAILED").write_text("an old reason")
    assert by_name(tmp_path)["run"].state == "finished"


def test_runs_of_discovery_are_no_runs_of_training(tmp_path):
    write_run(tmp_path / "trained", [0.5])
    (begin_run(tmp_path / "discovered") / "discovery.json").write_text("{}")
    unfinished = begin_run(tmp_path / "discovering")
    (unfinished / "config.yaml").write_text("discovery: {}\n")
    assert list(by_name(tmp_path)) == ["trained"]


def test_what_a_run_was_comes_from_its_metrics_then_its_choices_then_its_name(tmp_path):
    told = {"experiment": "table2_robot_simulated", "physics": "arm_model3", "n_train": 605}
    write_run(tmp_path / "mine/x", [0.6], system="robot_simulated", **told)
    chosen = write_run(tmp_path / "mine/y", [0.6], system="robot_simulated")
    environment = {"choices": {"experiment": "table2_robot_simulated", "physics": "arm_model2"}}
    (chosen / "environment.json").write_text(json.dumps(environment))
    write_run(tmp_path / "mine/model=pg_rssnn,physics=arm_model2", [0.6], system="robot_simulated")
    write_run(tmp_path / "data_efficiency_tank/data.n_train=128,model=pg_rssnn", [0.6])
    write_run(tmp_path / "mine/plain", [0.6], experiment=None)
    runs = by_name(tmp_path)
    assert runs["x"].experiment == runs["y"].experiment == "table2_robot_simulated"
    assert runs["x"].variant == Variant("pg_rssnn", "arm_model3", None)
    assert runs["y"].variant == Variant("pg_rssnn", "arm_model2", None)
    assert runs["model=pg_rssnn,physics=arm_model2"].variant.physics == "arm_model2"
    assert runs["data.n_train=128,model=pg_rssnn"].variant.n_train == 128
    assert runs["data.n_train=128,model=pg_rssnn"].experiment == "data_efficiency_tank"
    assert runs["plain"].experiment is None


def test_a_sweep_under_a_budget_or_another_name(tmp_path):
    write_run(
        tmp_path / "table1_tank_smoke/model=rssnn", [0.5], model="rssnn", experiment="table1_tank", budget="smoke"
    )
    fail_run(tmp_path / "table1_tank_smoke/model=fcssnn")
    write_run(tmp_path / "other/model=rssnn_fb", [0.5], model="rssnn_fb", experiment="table1_tank", budget="paper")
    runs = by_name(tmp_path)
    assert [runs[f"model={name}"].budget for name in ("rssnn", "fcssnn")] == ["smoke", "smoke"]
    assert runs["model=rssnn_fb"].budget is None
    assert {run.experiment for run in runs.values()} == {"table1_tank"}
    assert runs["model=fcssnn"].variant == Variant("fcssnn", "tanks", 768)


def test_members_that_a_configuration_plans(tmp_path):
    begin_run(tmp_path / "a", n_seeds=4)
    begin_run(tmp_path / "b", system="lgssm", n_seeds=2, config={"realisations": 50})
    begin_run(tmp_path / "c", model="physics_only", n_seeds=10)
    (begin_run(tmp_path / "d") / "config.yaml").write_text("no: [yaml")
    assert [run.planned for run in by_name(tmp_path).values()] == [4, 100, 1, None]


def test_a_name_cut_short_by_a_hash_still_says_what_it_can(tmp_path):
    fail_run(tmp_path / "table1_tank/model=rssnn,fit.epochs=5,initial_st~0123456789ab")
    (run,) = collect([tmp_path], PAPER)
    assert run.variant.model == "rssnn"
    assert run.overrides == {"fit.epochs": "5"}


def test_nothing_to_report_is_one_sentence(tmp_path):
    with pytest.raises(ValueError, match=r"runs: expected a folder with runs of train\.py, found none below"):
        collect([tmp_path], PAPER)
    (write_run(tmp_path / "run", [0.5]) / "metrics.json").write_text("{}")
    with pytest.raises(
        ValueError, match=r"expected a run that can be read, found .*run: metrics\.json: expected the form"
    ):
        collect([tmp_path], PAPER)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("schema",), 2),
        (("model",), None),
        (("outputs",), []),
        (("n_init",), "0"),
        (("summary",), {}),
        (("members",), 5),
        (("members", 0, "seed"), None),
        (("members", 0, "test"), None),
        (("members", 0, "test", "rmse"), [0.1, 0.2]),
        (("members", 0, "test", "rmse"), ["small"]),
        (("seconds", "total"), "long"),
        (("seconds",), None),
    ],
)
def test_metrics_of_another_form_are_damaged(tmp_path, path, value):
    file = write_run(tmp_path / "run", [0.5]) / "metrics.json"
    metrics = json.loads(file.read_text())
    read_metrics(file)
    inner = metrics
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    file.write_text(json.dumps(metrics))
    with pytest.raises(ValueError, match=r"^metrics\.json: "):
        read_metrics(file)
