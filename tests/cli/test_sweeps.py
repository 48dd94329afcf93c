"""Sweeps without running one: names by content, what a folder says, the last table, what an experiment sweeps."""

import io
import itertools
import os
import threading

import pytest
from commands import ROOT, config_names
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from hypothesis import strategies as st
from omegaconf import OmegaConf
from rich.console import Console

from pgrssnn_jax.cli import packages
from pgrssnn_jax.cli.config_store import register
from pgrssnn_jax.cli.resume import override
from pgrssnn_jax.cli.sweep_jobs import launcher_env, name_sweep
from pgrssnn_jax.cli.sweeps import JobResult, content_name, job_status, result_table
from pgrssnn_jax.training.run_folder import RunFolder
from pgrssnn_jax.training.run_lock import locked

TABLES = {
    "table1_tank": ("cascaded_tank", 12),
    "table1_lgssm": ("lgssm", 12),
    "table1_robot_simulated": ("robot_simulated", 12),
    "table1_robot_real": ("robot_real", 12),
    "table2_lgssm": ("lgssm", 6),
    "table2_robot_simulated": ("robot_simulated", 6),
    "data_efficiency_tank": ("cascaded_tank", 12),
}
KEYS = st.sampled_from(["model", "+experiment", "data.n_train", "fit.learning_rate", "++physics.gravity", "data.path"])
VALUES = st.text("abAB01 =,./\\'\"~%[]{}é", max_size=6) | st.text("ab", min_size=90, max_size=140)
OVERRIDES = st.lists(st.builds("{}={}".format, KEYS, VALUES), max_size=4)


@given(first=OVERRIDES, second=OVERRIDES)
def test_sets_of_overrides_share_a_name_only_when_they_are_the_same_set(first, second):
    """Even on file systems that do not tell capitals apart."""
    same = sorted(first) == sorted(second)
    assert (content_name(first).casefold() == content_name(second).casefold()) == same


@given(overrides=OVERRIDES, random=st.randoms())
def test_a_name_knows_no_order_and_is_a_safe_file_name(overrides, random):
    name = content_name(overrides)
    shuffled = overrides[:]
    random.shuffle(shuffled)
    assert content_name(shuffled) == name
    assert 0 < len(name) <= 120
    assert set(name) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+._=-,~")
    assert name not in (".", "..")


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        ([], "defaults"),
        (["data.n_train=128", "model=pg_rssnn"], "model=pg_rssnn,data.n_train=128"),
        (["physics.clamp=True"], "physics.clamp=true"),
        (["+physics.length=0.5", "fit.learning_rate=0.001"], "+physics.length=0.5,fit.learning_rate=0.001"),
    ],
)
def test_plain_overrides_can_be_read_in_the_name(overrides, name):
    assert content_name(overrides) == name


def test_what_cannot_be_written_is_told_apart_by_a_hash():
    names = {content_name([text]) for text in ("data.path=a/b.csv", "data.path=a-b.csv", "data.path=a b.csv", "a=~b")}
    assert len(names) == 4
    assert "data.path=a-b.csv" in names
    assert sum("~" in name for name in names) == 3


@given(
    text=st.text("ab1.é /'\"\\,=", max_size=8)
    | st.sampled_from(["null", "True", "1e3", ".1", ".5e-2", "../.1", "nan", "runs/a-b_c.d"])
)
def test_hydra_reads_back_what_was_quoted_for_it(text):
    found = OverridesParser.create().parse_override(override("resume", text))
    assert found.get_key_element() == "resume"
    assert found.value() == text


def named(*overrides: str, **config) -> tuple[str, set[str]]:
    """The name of a sweep's folder and what it spells. config: of the composed master."""
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    base = {"sweep": None, "budget": {}, "hydra": {"runtime": {"choices": {"budget": "paper"}}}, **config}
    master = OmegaConf.create(base)
    OmegaConf.update(master, "hydra.sweep", {"dir": "runs/${sweep}"})
    spelled = name_sweep(parsed, master)
    return str(master.hydra.sweep.dir), spelled


def test_a_sweep_is_named_by_its_experiment_and_by_a_budget_that_caps():
    chosen = {"runtime": {"choices": {"experiment": "lgssm", "budget": "smoke"}}}
    caps = {"any": {"n_seeds": 2}}
    spelled = {"experiment", "budget"}
    assert named("+experiment=lgssm", "model=a,b", hydra=chosen) == ("runs/lgssm", spelled)
    assert named("+experiment=lgssm", "budget=smoke", hydra=chosen, budget=caps) == ("runs/lgssm_smoke", spelled)
    assert named("model=a,b") == ("runs/sweep", spelled)
    assert named("model=a,b", "sweep=mine", sweep="mine", hydra=chosen) == ("runs/mine", set())
    assert named("+experiment=lgssm,other") == ("runs/sweep", {"budget"})
    assert named("+experiment=lgssm", "budget=paper,smoke", hydra=chosen, budget=caps) == ("runs/lgssm", {"experiment"})


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [(["resume=a,b"], "resume: expected none in a sweep"), (["sweep=a,b"], "sweep: expected one name, found several")],
)
def test_what_no_sweep_can_have_is_named(overrides, sentence):
    with pytest.raises(ValueError, match=sentence):
        named(*overrides)


def test_a_folder_says_how_far_its_run_has_come(tmp_path):
    run = RunFolder(tmp_path / "run")
    settings = {"fit": {"learning_rate": 1e-05, "guard": "none"}, "n": [0, 5], "resume": None}
    assert job_status(run, settings) == "new"
    run.begin(OmegaConf.to_yaml(settings), command="python train.py", data={})
    assert job_status(run, {"other": 1}) == "new"
    (run.checkpoint / "0.orbax-checkpoint-tmp").mkdir(parents=True)
    assert job_status(run, settings) == "new"
    (run.checkpoint / "0").mkdir()
    assert job_status(run, settings) == "begun"
    run.finish()
    assert job_status(run, {**settings, "resume": "elsewhere"}) == "finished"
    for other in ({**settings, "n": [0]}, {**settings, "new": None}, {"n": [0, 5]}):
        with pytest.raises(ValueError, match="give the sweep another name .* or remove the folder"):
            job_status(run, other)


def test_a_failure_is_one_sentence_until_the_next_start(tmp_path):
    run = RunFolder(tmp_path / "run")
    assert run.failure is None
    run.fail("k1: expected less", "Traceback ...")
    assert run.failure == "k1: expected less"
    assert (run.path / "FAILED").read_text() == "k1: expected less\n"
    run.begin("a: 1\n", command=None, data={})
    assert run.failure is None
    assert [path.name for path in run.path.iterdir()] == ["config.yaml"]


def test_the_table_counts_and_names_every_job(tmp_path):
    outcomes = [
        JobResult(tmp_path / "model=a", "finished", seconds=12.4),
        JobResult(tmp_path / "model=b", "skipped"),
        JobResult(tmp_path / "model=[c]", "failed", "fit: epochs: expected [more]", 3.0),
    ]
    file = io.StringIO()
    Console(width=160, file=file).print(result_table(outcomes, tmp_path))
    text = file.getvalue()
    lines = [line.split() for line in text.splitlines()]
    assert "3 jobs: 1 finished, 1 skipped, 1 failed" in text
    assert ["finished", "12", "model=a"] in lines
    assert ["skipped", "model=b"] in lines
    assert ["failed", "3", "model=[c]", "fit:", "epochs:", "expected", "[more]"] in lines


def test_one_process_at_a_time_in_a_folder(tmp_path):
    """A second one waits, and is let go when it is told to stop; nothing stays behind."""
    order: list[str] = []
    stop, inside = threading.Event(), threading.Event()

    def second() -> None:
        with locked(tmp_path / "run", stop, order.append):
            order.append("second")
            inside.set()

    with locked(tmp_path / "run", stop, order.append):
        thread = threading.Thread(target=second)
        thread.start()
        assert not inside.wait(0.5)
        order.append("first")
    thread.join(20)
    assert order == ["waiting for another process that works in run", "first", "second"]
    with locked(tmp_path / "run", threading.Event(), order.append):
        stop.set()
        second()
    assert order[3:] == ["second"]
    assert not list(tmp_path.iterdir())


def master_with(launcher: str, **settings):
    chosen = {"runtime": {"choices": {"hydra/launcher": launcher}}, "launcher": settings}
    return OmegaConf.create({"hydra": chosen})


@pytest.mark.parametrize(
    ("config", "jobs", "share"),
    [
        (master_with("basic"), 9, None),
        (master_with("joblib", n_jobs=-1), 9, "1"),
        (master_with("joblib", n_jobs=-1), 2, "4"),
        (master_with("joblib", n_jobs=3), 9, "2"),
        (master_with("joblib", n_jobs=-7), 9, "4"),
        (master_with("submitit_local"), 16, "1"),
        (master_with("submitit_slurm"), 16, None),
    ],
)
def test_workers_on_this_machine_share_its_cores(monkeypatch, config, jobs, share):
    monkeypatch.setattr("pgrssnn_jax.cli.sweep_jobs.usable_cores", lambda: 8)
    monkeypatch.delenv("JAX_NUM_CPU_DEVICES", raising=False)
    environ = os.environ
    before = dict(environ)
    with launcher_env(config, jobs):
        assert environ.get("JAX_NUM_CPU_DEVICES") == share
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", "5")
    with launcher_env(config, jobs):
        assert environ["JAX_NUM_CPU_DEVICES"] == "5"
    monkeypatch.delenv("JAX_NUM_CPU_DEVICES")
    assert dict(environ) == before


def test_a_launcher_that_is_not_installed_is_named(monkeypatch):
    assert packages.launcher_problem(["-m", "hydra/launcher=basic", "model=a"]) is None
    monkeypatch.setattr(packages, "_installed", lambda name: False)
    assert packages.launcher_problem(["-m", "model=joblib"]) is None
    for name in ("joblib", "submitit_local", "submitit_slurm"):
        problem = packages.launcher_problem(["-m", f"hydra/launcher={name}"])
        assert problem is not None
        assert f"hydra/launcher={name}: expected the package hydra-{name.split('_')[0]}-launcher" in problem
        assert "pgrssnn_jax[sweep]" in problem


@pytest.mark.parametrize(
    "experiment",
    [
        pytest.param(
            name, marks=[] if name in ("table1_tank", "table2_lgssm", "data_efficiency_tank") else pytest.mark.slow
        )
        for name in TABLES
    ],
)
def test_a_table_is_a_sweep_of_known_configurations_without_a_guard(experiment):
    register()
    base, count = TABLES[experiment]
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        whole = compose("train", overrides=[f"+experiment={experiment}"], return_hydra_config=True)
        assert whole.hydra.mode == whole.hydra.mode.MULTIRUN
        values = {name: str(text).replace("\n", "").split(",") for name, text in whole.hydra.sweeper.params.items()}
        jobs = list(itertools.product(*([f"{name}={value.strip()}" for value in values[name]] for name in values)))
        assert len(jobs) == len(set(jobs)) == count
        for job in (jobs[0], jobs[-1]):
            config = compose("train", overrides=[f"+experiment={experiment}", *job])
            assert config.fit.guard == "none"
            own = ["model.correction=0.1"] if experiment.startswith("data_efficiency") else []
            same = compose("train", overrides=[f"+experiment={base}", "fit.guard=none", *own, *job])
            assert config == same


def test_table_1_is_every_model_there_is():
    for experiment in (name for name in TABLES if name.startswith("table1")):
        text = OmegaConf.load(ROOT / f"conf/experiment/{experiment}.yaml").hydra.sweeper.params.model
        assert sorted(text.replace(" ", "").split(",")) == config_names("model")
