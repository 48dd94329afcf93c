"""Rows: one per variant and system, honest counts, figures that a reader can find again by hand."""

import json
import math
import statistics

import numpy as np
import pytest
from paper_samples import begin_run, fail_run, spread_over, write_run

from pgrssnn_jax.paper.collect import collect
from pgrssnn_jax.paper.merits import Figures, difference
from pgrssnn_jax.paper.published import Value, read_paper
from pgrssnn_jax.paper.rows import evidence_tables

PAPER = read_paper()


def tables(*roots):
    return evidence_tables(collect(roots, PAPER), PAPER)


def row_of(table, label):
    (row,) = [row for row in table.rows if row.label == label]
    return row


def test_a_row_for_every_variant_of_the_table_in_its_order(tmp_path):
    write_run(tmp_path / "table1_tank/model=rssnn", [0.5, 0.7], model="rssnn")
    fail_run(tmp_path / "table1_tank/model=fcssnn")
    begin_run(tmp_path / "table1_tank/model=pg_fcssnn", model="pg_fcssnn")
    (table,) = tables(tmp_path)
    assert table.title == "Table 1 · cascaded tanks"
    assert table.heading == "test RMSE in V"
    states = {row.label: row.state for row in table.rows}
    assert list(states)[:3] == ["FCSSNN-sgm", "PG-FCSSNN-sgm", "RSSNN-sgm"]
    assert list(states)[-4:] == ["W-PGNN", "physics only", "NLSS2", "GRU (black box)"]
    assert {name: states.pop(name) for name in ("RSSNN", "FCSSNN", "PG-FCSSNN", "NLSS2", "GRU (black box)")} == {
        "RSSNN": "finished",
        "FCSSNN": "failed",
        "PG-FCSSNN": "unfinished",
        "NLSS2": "quoted",
        "GRU (black box)": "quoted",
    }
    assert set(states.values()) == {"missing"}


def test_figures_are_those_of_the_finished_members(tmp_path):
    errors = [0.5, None, 0.9, 0.6, None, 0.61]
    write_run(tmp_path / "table1_tank/model=rssnn", errors, model="rssnn", cc=0.8, seconds=12.5)
    (table,) = tables(tmp_path)
    row = row_of(table, "RSSNN")
    left = [0.5, 0.9, 0.6, 0.61]
    expected = (statistics.mean(left), statistics.stdev(left), statistics.median(left), 0.5, 0.9 * np.mean(left), 0.8)
    assert row.figures == pytest.approx(expected)
    assert (row.planned, len(row.finished), len(row.failed), row.seconds) == (6, 4, 2, 12.5)
    assert [member.seed for member in row.failed] == [1, 4]
    assert table.seconds == 12.5


def test_an_arm_is_judged_by_its_nrmse_and_its_ensemble_comes_from_the_predictions(tmp_path):
    folder = write_run(tmp_path / "table1_robot_real/model=rssnn", [0.8, 1.0], model="rssnn", system="robot_real")
    metrics = json.loads((folder / "metrics.json").read_text())
    metrics["n_init"] = 5
    for member in metrics["members"]:
        member["test"]["rmse"] = [99.0] * 6
    (folder / "metrics.json").write_text(json.dumps(metrics))
    rng = np.random.default_rng(0)
    y, mean = rng.normal(size=(2, 3, 30, 6))
    np.savez(folder / "predictions.npz", y=y, mask=np.ones(y.shape, bool), ensemble_mean=mean)
    row = row_of(tables(tmp_path)[0], "RSSNN")
    assert row.figures.mean == pytest.approx(0.9)
    late, far = y[:, 5:].reshape(-1, 6), (y - mean)[:, 5:].reshape(-1, 6)
    assert row.figures.ensemble == pytest.approx(np.mean(np.sqrt((far**2).mean(0)) / late.std(0)))

    (folder / "predictions.npz").write_bytes(b"PK damaged")
    row = row_of(tables(tmp_path)[0], "RSSNN")
    assert math.isnan(row.figures.ensemble)
    assert "predictions.npz cannot be read" in row.reason
    assert row.figures.mean == pytest.approx(0.9)


def test_members_with_test_records_of_their_own_have_no_ensemble(tmp_path):
    folder = write_run(tmp_path / "table1_robot_real/model=rssnn", [0.8, 1.0], model="rssnn", system="robot_real")
    with np.load(folder / "predictions.npz") as stored:
        arrays = dict(stored)
    np.savez(folder / "predictions.npz", **{**arrays, "ensemble_mean": np.nan * arrays["y"]})
    row = row_of(tables(tmp_path)[0], "RSSNN")
    assert math.isnan(row.figures.ensemble)
    assert row.reason == ""


def test_a_run_whose_members_all_failed_has_counts_and_no_figures(tmp_path):
    write_run(tmp_path / "table1_tank/model=rssnn", [None, None], model="rssnn")
    (table,) = tables(tmp_path)
    row = row_of(table, "RSSNN")
    assert (row.state, row.planned, len(row.finished), len(row.failed)) == ("finished", 2, 0, 2)
    assert all(map(math.isnan, [*row.figures, row.difference]))
    assert table.measured == []


def test_the_difference_is_a_standard_score():
    """Where measured and published runs are drawn from one law, and the published mean is rounded to a step as wide as
    their deviation, the difference has mean 0 and deviation 1 over many experiments."""
    rng = np.random.default_rng(1)
    std, n, n_p, rounding = 0.1, 30, 6, 0.1
    truth = rng.uniform(0.4, 0.8, 4000)
    measured = truth + rng.normal(0, std, (n, 4000)).mean(0)
    published = np.round(truth + rng.normal(0, std, (n_p, 4000)).mean(0), 1)
    away = [
        difference(Figures(m, std, m, m, m, 0.9), n, Value(p, 10, n_p, None), rounding)
        for m, p in zip(measured.tolist(), published.tolist(), strict=True)
    ]
    assert np.mean(away) == pytest.approx(0.0, abs=0.05)
    assert np.std(away) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    ("std", "published"),
    [(math.nan, Value(0.5, 10, 10, None)), (0.1, None), (0.1, Value(None, 10, 0, None))],
)
def test_no_difference_without_spread_or_published_mean(std, published):
    assert math.isnan(difference(Figures(0.5, std, 0.5, 0.5, 0.5, 0.9), 4, published, 0.01))


def test_the_published_runs_that_finished_count(tmp_path):
    """FCSSNN on the tanks: 1.70 over 6 of 10 runs."""
    write_run(tmp_path / "table1_tank/model=fcssnn", spread_over(1.9, 0.3, 10, failed=(2, 5)), model="fcssnn")
    row = row_of(tables(tmp_path)[0], "FCSSNN")
    assert row.difference == pytest.approx(0.2 / math.sqrt(0.09 / 8 + 0.09 / 6 + 1e-4 / 12))


def test_why_a_figure_differs_stands_beside_it_only_where_it_differs(tmp_path):
    write_run(tmp_path / "a/table1_lgssm/model=physics_only", [1.449] * 4, model="physics_only", system="lgssm")
    write_run(tmp_path / "b/table1_lgssm/model=physics_only", [1.67, 1.69], model="physics_only", system="lgssm")
    assert "standardised" in row_of(tables(tmp_path / "a")[0], "physics only").why
    assert row_of(tables(tmp_path / "b")[0], "physics only").why == ""


def test_physics_and_samples_stand_in_the_label_where_a_table_has_several(tmp_path):
    write_run(tmp_path / "table2_lgssm/model=pg_rssnn,physics=lgssm_model2", [1.4, 1.5], system="lgssm")
    write_run(tmp_path / "data_efficiency_tank/data.n_train=128,model=rssnn", [0.9], model="rssnn")
    second, less = tables(tmp_path)
    assert (second.title, less.title) == ("Table 2 · LGSSM", "Data efficiency · cascaded tanks")
    assert row_of(second, "Model 2 · PG-RSSNN").published.mean == 1.38
    assert row_of(less, "128 samples · RSSNN").figures.mean == 0.9
    assert less.sizes == [128, 256, 384, 768]
    assert second.sizes == []
    assert row_of(less, "384 samples · PG-RSSNN").published.best == 0.36


def test_a_free_sweep_is_labelled_by_what_differs(tmp_path):
    for rate in ("1e-3", "1e-2"):
        for model in ("pg_rssnn", "rssnn"):
            name = f"fit.learning_rate={rate},model={model}"
            write_run(tmp_path / "free" / name, [0.5], model=model, asked="n_seeds=1", experiment="cascaded_tank")
    (table,) = tables(tmp_path)
    assert [row.label for row in table.rows] == [
        "RSSNN, fit.learning_rate=1e-2",
        "RSSNN, fit.learning_rate=1e-3",
        "PG-RSSNN, fit.learning_rate=1e-2",
        "PG-RSSNN, fit.learning_rate=1e-3",
    ]
    assert table.common == {"n_seeds": "1"}
    assert {row.published.mean for row in table.rows} == {0.71, 0.44}


def test_runs_alike_are_told_apart_by_their_folders(tmp_path):
    for place in ("a", "b"):
        write_run(tmp_path / place / "table1_tank/model=rssnn", [0.5], model="rssnn")
    write_run(tmp_path / "b/table1_tank/twin", [0.5], model="rssnn", experiment="table1_tank")
    labels = [row.label for row in tables(tmp_path)[0].rows if row.run]
    assert len(set(labels)) == 3
    assert f"RSSNN [{tmp_path.name}/a/table1_tank]" in labels


def test_other_settings_than_the_tables_are_rows_of_their_own(tmp_path):
    write_run(tmp_path / "table1_tank/data.n_train=100,model=rssnn", [0.5, 0.6], model="rssnn")
    (table,) = tables(tmp_path)
    extra = row_of(table, "100 samples · RSSNN")
    assert extra.published is None
    assert row_of(table, "768 samples · RSSNN").state == "missing"


def test_a_capped_sweep_and_a_whole_one_are_two_tables(tmp_path):
    write_run(tmp_path / "table1_tank/model=rssnn", [0.5], model="rssnn")
    write_run(tmp_path / "table1_tank_smoke/model=rssnn", [2.0], model="rssnn")
    whole, capped = tables(tmp_path)
    assert (whole.budget, capped.budget) == (None, "smoke")
    assert "budget smoke" in capped.title
    assert whole.slug != capped.slug
    assert row_of(whole, "RSSNN").figures.mean == 0.5


def test_a_system_that_the_paper_has_not(tmp_path):
    changes = {"data": "csv", "experiment": None, "physics": "custom", "outputs": [{"name": "angle", "unit": "rad"}]}
    write_run(tmp_path / "mine", [0.5, 0.6], **changes)
    (table,) = tables(tmp_path)
    assert (table.heading, table.title, table.slug) == ("test RMSE in rad", "Runs · csv", "csv")
    assert [row.label for row in table.rows] == ["PG-RSSNN"]
    assert table.rows[0].published is None


def test_a_member_without_a_figure_leaves_no_mean(tmp_path):
    folder = write_run(tmp_path / "table1_tank/model=rssnn", [0.5, 0.7], model="rssnn")
    metrics = json.loads((folder / "metrics.json").read_text())
    metrics["members"][0]["test"]["rmse"] = [None]
    (folder / "metrics.json").write_text(json.dumps(metrics))
    row = row_of(tables(tmp_path)[0], "RSSNN")
    assert all(map(math.isnan, row.figures[:4]))
    assert len(row.finished) == 2
