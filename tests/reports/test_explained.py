"""What a page says beside the errors: interval, share of the networks, range of training, choice of the settings."""

import numpy as np
import pytest
from report_samples import Run, lgssm, tanks
from test_report_page import Reader, write

from pgrssnn_jax.reports.network import network_figure
from pgrssnn_jax.reports.pages import discovery_command
from pgrssnn_jax.reports.prediction import compared, prediction_figure
from pgrssnn_jax.reports.tables import choice_table

RECIPE = {
    "name": "auto",
    "chosen": "correction=0.1",
    "score": "left-out NRMSE",
    "tried": [
        {"settings": "correction=0.1", "left_out_nrmse": 0.12, "epochs": 300},
        {"settings": "the physics alone", "left_out_nrmse": 0.4, "epochs": 0},
    ],
    "fell_back": [{"seed": 3, "dataset": 0}],
}


def explained(run: Run, share: float = 0.5, coverage: float = 0.91, outside=None) -> Run:
    """The run with what evaluation adds to it."""
    y, outputs = run.predictions["y"], run.metrics["outputs"]
    mean = run.predictions["ensemble_mean"]
    arrays = {
        "interval_low": mean - 0.5, "interval_high": mean + 0.5, "network": share * (y - y.mean()),
        "x": np.concatenate([y, y**2], -1),
    }  # fmt: skip
    metrics = {
        "interval": {"level": 0.9, "coverage": [coverage] * len(outputs), "width": [1.0] * len(outputs)},
        "network": {"share": [share] * len(outputs)},
        "outside": outside or {},
        "signals": {"inputs": [["pump_voltage", "V"]], "states": [["upper_level", "V"], ["lower_level", "V"]]},
        "recipe": RECIPE,
    }
    return run._replace(metrics=run.metrics | metrics, predictions=run.predictions | arrays)


def test_the_page_shows_the_interval_the_share_and_the_candidates(tmp_path):
    page = Reader(write(tmp_path, explained(tanks(4, 200))))
    for text in ("90 % interval holds", "91 %", "networks supply", "50 %", "How the settings were chosen"):
        assert text in page.text
    assert page.text.index("correction=0.1") < page.text.index("the physics alone")
    assert "physics alone: 3" in page.text
    assert "choice" in page.ids
    assert "#choice" in page.anchors


def test_a_run_without_them_says_nothing_of_them(tmp_path):
    page = Reader(write(tmp_path, tanks(4, 200)))
    for text in ("interval holds", "networks supply", "OUTSIDE THE RANGE", "How the settings", "discover"):
        assert text not in page.text


def test_a_large_share_invites_to_discovery_and_a_small_one_does_not(tmp_path):
    command = "python train.py +experiment=cascaded_tank fit.epochs=20 physics.clamp=false hydra.run.dir=runs/x"
    given = {"environment": {"command": command}}
    page = write(tmp_path, explained(tanks(4, 200), share=0.5), **given)
    assert "python discover.py +experiment=cascaded_tank physics.clamp=false</code>" in page
    assert "DO MUCH OF THE WORK" not in write(tmp_path, explained(tanks(4, 200), share=1e-4), **given)


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("train.py physics=tanks data=csv data.train=A.csv seed=3", "physics=tanks data=csv data.train=A.csv"),
        ("train.py +experiment=lgssm model=rssnn", "+experiment=lgssm"),
        ("train.py physics=tanks 'data.train=my file.csv'", "physics=tanks 'data.train=my file.csv'"),
    ],
)
def test_the_command_of_discovery_keeps_physics_and_data(command, expected):
    assert discovery_command({"command": f"python {command}"}) == f"python discover.py {expected}"


@pytest.mark.parametrize("command", ["pg.fit", None])
def test_a_run_of_the_python_api_is_examined_by_it(command):
    assert discovery_command({"command": command}) == "pg.discover(physics, train, test)"


def test_samples_outside_the_range_of_training_are_loud(tmp_path):
    page = Reader(write(tmp_path, explained(tanks(4, 200), outside={"pump_voltage": 0.125, "level_voltage": 0.001})))
    assert "OUTSIDE THE RANGE OF TRAINING" in page.text
    assert "pump_voltage in 12.5 % of the samples" in page.text
    assert "level_voltage in" not in page.text


def test_the_table_of_candidates_names_the_chosen_one_first():
    table = choice_table(RECIPE, "tanks")
    assert [row[0] for row in table.rows] == ["headline", ""]
    assert table.rows[0][1] == ["0.1200", "300", "correction=0.1"]


def test_a_run_of_an_earlier_version_lists_seeds_alone():
    footer = " ".join(choice_table(RECIPE | {"fell_back": [3, 7]}, "tanks").footer)
    assert footer.endswith("physics alone: 3, 7")


@pytest.mark.parametrize("run", [tanks(4, 200), tanks(2, 200, failed=(0, 1)), lgssm(3, 2000)])
def test_the_figure_of_the_networks_shows_signals_with_their_names(run):
    figure = network_figure(explained(run).predictions, explained(run).metrics)
    labels = {ax.get_xlabel() for ax in figure.axes}
    assert {"time (s)", "lower_level (V)", "upper_level (V)"} <= labels


def test_the_band_of_the_prediction_is_the_interval():
    run = explained(tanks(4, 200))
    found = compared(run.predictions, run.metrics)
    np.testing.assert_allclose(found.half_width, 0.5)
    assert found.band == "90 % interval"
    assert compared(tanks(4, 200).predictions, tanks(4, 200).metrics).band == "±1 std over members"
    figure = prediction_figure(run.predictions, run.metrics)
    assert "90 % interval" in {text.get_text() for legend in figure.legends for text in legend.get_texts()}
