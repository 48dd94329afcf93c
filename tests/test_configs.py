"""Every configuration composes and trains for two epochs, and says where its numbers come from."""

import json

import numpy as np
import pytest
from commands import QUICK, ROOT, composed, planned, trained, write_benchmark

MODELS = sorted(path.stem for path in (ROOT / "conf/model").glob("*.yaml"))
PUBLISHED = {
    f"{guide}{rest}" for guide in ("pg_", "") for rest in ("rssnn", "rssnn_fb", "rssnn_sgm", "fcssnn", "fcssnn_sgm")
}


def test_the_ten_published_variants_the_baseline_and_the_physics_are_there():
    assert set(MODELS) == PUBLISHED | {"w_pgnn", "physics_only"}


FAST = ("fcssnn", "pg_rssnn_fb", "w_pgnn")  # without recurrence, with feedback, and the one with a network inside


@pytest.mark.parametrize("model", [m if m in FAST else pytest.param(m, marks=pytest.mark.slow) for m in MODELS])
def test_every_model_trains_for_two_epochs(tmp_path, model):
    path = write_benchmark(tmp_path / "tanks.csv", samples=80)
    run = trained(
        tmp_path / "run",
        "+experiment=cascaded_tank",
        f"data.path={path}",
        "data.n_validation=20",
        *QUICK,
        f"model={model}",
    )
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert metrics["model"] == model
    assert metrics["summary"]["failed"] == 0
    assert np.isfinite(metrics["summary"]["rmse_mean"])


LGSSM = sorted(path.stem for path in (ROOT / "conf/physics").glob("lgssm*.yaml"))


@pytest.mark.parametrize(
    "physics", [p if p == "lgssm_model3" else pytest.param(p, marks=pytest.mark.slow) for p in LGSSM]
)
def test_every_lgssm_physics_trains_for_two_epochs(tmp_path, physics):
    small = ["data.generated=true", "data.realisations=3", "data.n_train=130", "data.n_validation=50", "data.n_test=90"]
    overrides = ["+experiment=lgssm", f"physics={physics}", "model=pg_fcssnn", *small, *QUICK, "n_seeds=1"]
    run = trained(tmp_path / "run", *overrides)
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert [m["dataset"] for m in metrics["members"]] == [0, 1, 2]
    assert metrics["source"] == "simulated"


def test_seeds_and_realisations_train_in_one_program():
    small = ["data.generated=true", "data.realisations=3", "data.n_train=130", "data.n_validation=50", "data.n_test=90"]
    plan = planned("+experiment=lgssm", *small, "n_seeds=2")
    assert [tuple(member) for member in plan.members] == [(0, 0), (1, 0), (0, 1), (1, 1), (0, 2), (1, 2)]
    assert plan.data.train.u.shape == (6, 2, 64, 1)


def test_after_a_discovery_training_begins_at_its_physics_and_seeds_share_the_record():
    tanks, found = "+experiment=cascaded_tank", "physics.effects=discovery.json"

    def chosen(*overrides: str) -> tuple:
        config = composed(*overrides)
        return (
            config["data"]["folds"], config["initial_state"], config["fit"]["learning_rate"],
            config["model"]["start_from_physics"],
        )  # fmt: skip

    assert chosen(tanks) == chosen(tanks, "physics.effects=null") == (0, "first_output", 1e-3, False)
    assert chosen(tanks, found) == (10, "estimated", 3e-3, True)
    own = ("data.folds=0", "initial_state=zero", "fit.learning_rate=1e-2")
    assert chosen(tanks, found, *own) == (0, "zero", 1e-2, True)
    assert chosen(tanks, found, "model=rssnn")[3]
    assert not chosen(tanks, "model=rssnn")[3]


@pytest.mark.parametrize("path", sorted((ROOT / "conf").rglob("*.yaml")), ids=lambda path: path.stem)
def test_every_file_opens_with_its_command_line(path):
    first = next(line for line in path.read_text().splitlines() if line != "# @package _global_")
    assert first.startswith(("# python train.py", "# python discover.py", "# python report.py"))


@pytest.mark.parametrize("group", ["physics", "data", "fit", "discovery"])
def test_every_number_has_its_unit_or_source(group):
    for path in (ROOT / "conf" / group).glob("*.yaml"):
        for line in path.read_text().splitlines():
            key, _, rest = line.partition(":")
            value = rest.split("#")[0].strip()
            if not line.startswith("#") and value and (value[0].isdigit() or value[0] in "[-") and key != "defaults":
                assert "#" in rest, f"{path.name}: {line}"


@pytest.mark.data
@pytest.mark.parametrize(
    ("overrides", "volts"),
    [
        (["initial_state=zero", "physics.clamp=false"], 1.042),
        pytest.param(["initial_state=first_output", "physics.clamp=false"], 0.763, marks=pytest.mark.slow),
        pytest.param(["initial_state=zero", "physics.clamp=true"], 1.110, marks=pytest.mark.slow),
        (["initial_state=first_output", "physics.clamp=true"], 0.852),
    ],
)
def test_the_published_tanks_figures_of_the_physics_alone(tmp_path, data, overrides, volts):
    run = trained(tmp_path / "run", "+experiment=cascaded_tank", "model=physics_only", *overrides)
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert round(metrics["summary"]["rmse_mean"], 3) == volts
    assert metrics["n_init"] == 0


@pytest.mark.data
@pytest.mark.parametrize(("physics", "scaling", "rmse"), [
    ("lgssm", "true", "1.680"), ("lgssm", "false", "1.449"), ("lgssm_true", "false", "1.361"),
])  # fmt: skip
def test_the_published_lgssm_figures_of_the_physics_alone(tmp_path, data, physics, scaling, rmse):
    """1.680 on the first realisation; the standardisation, and so the figure, differs between realisations."""
    overrides = ["+experiment=lgssm", "model=physics_only", f"physics={physics}", f"data.published_scaling={scaling}"]
    run = trained(tmp_path / "run", *overrides, "data.realisations=1")
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert f"{metrics['summary']['rmse_mean']:.3f}" == rmse


def test_defaults_are_the_documented_ones():
    config = composed("+experiment=cascaded_tank")
    assert config["n_seeds"] == 10
    assert config["fit"]["epochs"] == 1000
    assert config["report_n_init"] == [0, 5, 50]
