"""Figures say what they show: units on every axis, the result, the source, failed members; at every size."""

import re
from functools import cache

import numpy as np
import pandas as pd
import pytest
from matplotlib import rcParams
from matplotlib.figure import Figure
from report_samples import arm, lgssm, tanks

from pgrssnn_jax.reports.members import median, members_figure, training_figure
from pgrssnn_jax.reports.prediction import prediction_figure

SMALL = {
    "tanks": tanks(members=4, samples=120),
    "some failed": tanks(members=4, samples=120, failed=(1, 3)),
    "all failed": tanks(members=3, samples=60, failed=(0, 1, 2)),
    "one member": tanks(members=1, samples=60),
    "one sample": tanks(members=2, samples=1),
    "simulated": lgssm(members=3, samples=1600),
    "arm": arm(members=3, samples=40, sequences=2, failed=(2,)),
}


def texts(figure: Figure) -> str:
    """All text of a figure, that of its legends and panels too."""
    figure.draw_without_rendering()
    return "\n".join(t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text")))  # type: ignore[attr-defined]


def all_figures(run) -> dict[str, Figure]:
    return {
        "prediction": prediction_figure(run.predictions, run.metrics),
        "training": training_figure(run.history, run.metrics),
        "members": members_figure(run.metrics),
    }


@cache
def drawn(name: str) -> dict[str, tuple[Figure, str]]:
    """The figures of a small run and their texts; nobody may change them."""
    return {which: (figure, texts(figure)) for which, figure in all_figures(SMALL[name]).items()}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if n in ("one member", "one sample") else []) for n in SMALL]
)
def test_axes_carry_units_and_the_header_the_facts(name):
    run = SMALL[name]
    for which, (figure, said) in drawn(name).items():
        assert f"{run.metrics['system']} · pg_rssnn" in said
        assert ("SIMULATED DATA" in said) == (run.metrics["source"] == "simulated")
        count = run.metrics["summary"]["failed"]
        assert (f"{count} OF {len(run.metrics['members'])} MEMBERS FAILED" in said) == (count > 0)
        assert f"{count} failed" in said
        for ax in figure.axes:
            assert re.search(r"\(.+\)$", ax.get_ylabel()), (which, ax.get_ylabel())
            assert (
                ax.get_xlabel() in ("epoch", "output")
                or ax.get_xlabel().startswith(("time (s)", "members"))
                or (not ax.xaxis.get_tick_params()["labelbottom"])
            )


def test_every_figure_leaves_the_global_settings_alone():
    before = dict(rcParams)
    all_figures(SMALL["arm"])
    assert dict(rcParams) == before


def test_the_title_states_the_results_of_metrics():
    metrics = SMALL["tanks"].metrics
    _, said = drawn("tanks")["prediction"]
    assert f"ensemble {metrics['summary']['rmse_ensemble']:#.4g} V" in said
    assert f"members {metrics['summary']['rmse_mean']:#.4g} ±" in said


def test_measured_ensemble_and_residual_are_drawn_as_given():
    run = SMALL["tanks"]
    top, under = prediction_figure(run.predictions, run.metrics).axes
    y, mean = run.predictions["y"][0, :, 0], run.predictions["ensemble_mean"][0, :, 0]
    drawn = [line.get_ydata() for line in top.lines]
    assert len(drawn) == 4 + 2
    np.testing.assert_array_equal(drawn[-2], y)
    np.testing.assert_array_equal(drawn[-1], mean)
    np.testing.assert_allclose(under.lines[-1].get_ydata(), y - mean)
    np.testing.assert_allclose(under.lines[-1].get_xdata(), 4.0 * np.arange(len(y)))


def test_failed_members_are_not_drawn_and_unmeasured_samples_leave_a_gap():
    run = SMALL["some failed"]
    mask = run.predictions["mask"].copy()
    mask[0, 10:20] = False
    top = prediction_figure({**run.predictions, "mask": mask}, run.metrics).axes[0]
    assert len(top.lines) == 2 + 2
    assert np.isnan(top.lines[-2].get_ydata()[10:20]).all()


def test_no_member_is_said():
    for _, said in drawn("all failed").values():
        assert "3 OF 3 MEMBERS FAILED" in said
        assert "no member finished" in said or "no finished member" in said or "failed" in said


def test_members_with_other_test_records_are_not_held_against_this_one():
    run = tanks(members=4, samples=60)
    for member, dataset in zip(run.metrics["members"], (0, 0, 1, 2), strict=True):
        member["dataset"] = dataset
    nothing = np.full(run.predictions["y"].shape, np.nan)
    apart = {**run.predictions, "ensemble_mean": nothing, "ensemble_std": nothing}
    figure = prediction_figure(apart, run.metrics)
    assert "only dataset 0: members have test records of their own, hence no ensemble" in texts(figure)
    assert "mean of dataset 0" in texts(figure)
    top = figure.axes[0]
    assert len(top.lines) == 2 + 2
    np.testing.assert_allclose(top.lines[-1].get_ydata(), run.predictions["y_hat"][:2, 0, :, 0].mean(0))

    for member in run.metrics["members"][:2]:
        member["status"] = "failed"
    assert "no finished member to show" in texts(prediction_figure(apart, run.metrics))


def test_a_long_record_is_shown_through_a_window_above_its_whole_residual():
    run = SMALL["simulated"]
    figure, said = drawn("simulated")["prediction"]
    assert "samples 0 to 299 of 1600" in said
    top, _, whole = figure.axes
    mean = run.predictions["ensemble_mean"]
    assert len(top.lines[-1].get_ydata()) == 300
    assert whole.dataLim.x1 >= 1590
    np.testing.assert_array_equal(whole.lines[0].get_ydata(), (run.predictions["y"] - mean)[0, :, 0])


def test_one_pair_of_panels_per_output_of_the_first_sequence():
    run = SMALL["arm"]
    figure, said = drawn("arm")["prediction"]
    assert len(figure.axes) == 12
    assert "all 40 samples, sequence 1 of 2" in said
    np.testing.assert_array_equal(figure.axes[0].lines[-2].get_ydata(), run.predictions["y"][0, :, 0])


def test_a_prediction_that_runs_away_leaves_the_measurement_readable():
    run = SMALL["tanks"]
    far = run.predictions["y_hat"].copy()
    far[0, 0, 50:] = 1e30
    changed = {**run.predictions, "y_hat": far, "ensemble_mean": far.mean(0), "ensemble_std": far.std(0)}
    figure = prediction_figure(changed, run.metrics)
    low, high = figure.axes[0].get_ylim()
    assert high - low < 6 * np.ptp(run.predictions["y"])
    assert "predictions leave the axis" in texts(figure)


def test_a_dollar_sign_in_a_name_is_a_dollar_sign():
    run = tanks(members=2, samples=30, outputs=[{"name": "cost_$x^{", "unit": "$"}], origin="a $ and $\\frac{ b")
    for figure in all_figures(run).values():
        assert r"\$" in texts(figure)


def test_training_curves_are_those_of_the_history():
    run = SMALL["some failed"]
    left, right = training_figure(run.history, run.metrics).axes
    assert left.get_yscale() == right.get_yscale() == "log"
    one = run.history[run.history["seed"] == 0]
    np.testing.assert_array_equal(left.lines[0].get_ydata(), one["train_loss"])
    np.testing.assert_array_equal(right.lines[0].get_ydata(), one["validation_loss"].dropna())
    for ax in (left, right):
        assert sum(line.get_gid() == "failed" for line in ax.lines) == 2
        kept = [float(line.get_xdata()[0]) for line in ax.lines if line.get_gid() == "kept"]
        assert kept == [member["best_epoch"] for member in run.metrics["members"] if member["status"] == "ok"]


def test_a_failed_loss_does_not_squash_the_others():
    run = SMALL["some failed"]
    assert run.history["train_loss"].max() > 1e4
    left, _ = training_figure(run.history, run.metrics).axes
    assert left.get_ylim()[1] < 1e2


def test_a_history_without_a_loss_to_draw_says_so():
    run = SMALL["tanks"]
    nothing = run.history.assign(train_loss=np.nan, validation_loss=-1.0)
    for history in (run.history.iloc[:0], nothing):
        assert texts(training_figure(history, run.metrics)).count("no finite loss was recorded") == 2


def test_the_median_covers_epochs_that_half_of_the_members_reach():
    short, long = pd.Series({1: 1.0, 2: 3.0}), pd.Series(dict.fromkeys((1, 2, 3, 4), 5.0))
    assert median(pd.DataFrame({0: short, 1: long})).to_dict() == {1: 3.0, 2: 4.0, 3: 5.0, 4: 5.0}
    assert list(median(pd.DataFrame({0: short, 1: short, 2: long})).index) == [1, 2]


def test_members_stand_in_order_and_failed_ones_at_the_end():
    run = SMALL["some failed"]
    ax = members_figure(run.metrics).axes[0]
    dots, crosses = (next(line for line in ax.lines if line.get_marker() == m) for m in ("o", "x"))
    rmse = [member["test"]["rmse"][0] for member in run.metrics["members"] if member["test"]]
    np.testing.assert_array_equal(dots.get_ydata(), sorted(rmse))
    np.testing.assert_array_equal(crosses.get_xdata(), [3, 4])
    assert {label.get_text() for label in ax.get_xticklabels()[2:]} == {"1", "3"}


def test_fifty_members_are_drawn_without_a_name_for_each():
    run = lgssm(members=50, samples=60, failed=(7,))
    figure = members_figure(run.metrics)
    assert "1 OF 50 MEMBERS FAILED" in texts(figure)
    assert len(figure.axes[0].get_xticks()) < 15


def test_an_outlier_makes_the_scale_logarithmic():
    run = tanks(members=6, samples=60)
    run.metrics["members"][0]["test"]["rmse"] = [1e6]
    assert members_figure(run.metrics).axes[0].get_yscale() == "log"


def test_missing_figures_of_a_finished_member_are_drawn_around():
    run = tanks(members=3, samples=60)
    run.metrics["members"][1]["test"] = {name: [None] for name in ("rmse", "nrmse", "fit_percent", "cc")}
    run.metrics["summary"]["rmse_mean"] = float("nan")
    for figure in all_figures(run).values():
        texts(figure)


def test_figures_become_png_files(tmp_path):
    for name, figure in all_figures(SMALL["some failed"]).items():
        figure.savefig(tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
