"""The figures of many runs draw the numbers they are given, name what is missing, and no label lies on another."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.text import Text
from paper_samples import begin_run, fail_run, spread_over, write_run
from test_report_figures import texts

from pgrssnn_jax.paper.collect import collect
from pgrssnn_jax.paper.figures import box_figure, can_be_curves, efficiency_figure, overlay_figure
from pgrssnn_jax.paper.published import read_paper
from pgrssnn_jax.paper.rows import evidence_tables

PAPER = read_paper()


def tables(*roots):
    return evidence_tables(collect(roots, PAPER), PAPER)


@pytest.fixture(scope="module")
def table1(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boxes") / "table1_tank"
    write_run(folder / "model=pg_rssnn", spread_over(0.4, 0.05, 10))
    write_run(folder / "model=fcssnn", spread_over(1.9, 0.2, 10, failed=(3, 8)), model="fcssnn")
    write_run(folder / "model=pg_rssnn_fb", [None] * 9 + [0.5], model="pg_rssnn_fb")
    write_run(folder / "model=physics_only", [0.852], model="physics_only")
    begin_run(folder / "model=rssnn", model="rssnn")
    fail_run(folder / "model=rssnn_sgm")
    return tables(folder)[0]


@pytest.fixture(scope="module")
def less(tmp_path_factory):
    folder = tmp_path_factory.mktemp("less") / "data_efficiency_tank"
    for n_train in (128, 256, 384):
        for model, error in (("pg_rssnn", 0.5), ("rssnn", 0.9), ("physics_only", 0.85)):
            values = [0.85] if model == "physics_only" else spread_over(error + 20 / n_train, 0.1, 5)
            name = f"data.n_train={n_train},model={model}"
            write_run(folder / name, values, model=model, samples=900, cc=1 - error / 4)
    return tables(folder)[0]


def marks(ax, gid):
    return [(float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in ax.lines if line.get_gid() == gid]


def test_one_box_per_variant_that_has_seeds_and_a_place_for_every_variant(table1):
    (ax,) = box_figure(table1, PAPER).axes
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names == [row.label for row in table1.rows if row.state != "quoted"]
    place = {name: k for k, name in enumerate(names)}
    drawn = sorted(round(float(box.get_path().vertices[:, 1].mean())) for box in ax.patches)
    assert drawn == sorted([place["PG-RSSNN"], place["FCSSNN"]])
    dots = {
        round(float(np.mean(line.get_ydata()))): sorted(line.get_xdata())
        for line in ax.lines
        if line.get_marker() == "o" and len(line.get_xdata())
    }
    for row in table1.measured:
        assert dots[place[row.label]] == pytest.approx(sorted(row.finite("rmse")))


def test_published_means_and_the_physics_alone_are_marked(table1):
    (ax,) = box_figure(table1, PAPER).axes
    published = marks(ax, "published")
    rows = [row for row in table1.rows if row.state != "quoted"]
    assert published == [(row.published.mean, k) for k, row in enumerate(rows) if row.published]
    assert [x for x, _ in marks(ax, "physics")] == [0.852]


def test_failed_members_and_absent_runs_are_named(table1):
    said = texts(box_figure(table1, PAPER))
    assert "2 of 10 failed: seed 3, 8" in said
    assert "9 of 10 failed: seed 0, 1, 2, 3 and 5 more" in said
    assert "11 MEMBERS FAILED" in said
    assert "8 RUNS WITHOUT FIGURES" in said
    assert {"missing", "failed", "unfinished"} <= set(said.splitlines())
    assert "test RMSE (V)" in said


def shown_texts(figure) -> list[Text]:
    """What a reader sees: matplotlib also keeps labels of ticks beyond the ends of an axis."""
    figure.draw_without_rendering()
    found = [*figure.texts, *(text for legend in figure.legends for text in legend.get_texts())]
    for ax in figure.axes:
        found += [*ax.texts, ax.title, ax.xaxis.label, ax.yaxis.label]
        for axis, (low, high) in ((ax.xaxis, sorted(ax.get_xlim())), (ax.yaxis, sorted(ax.get_ylim()))):
            ticks = zip(axis.get_majorticklocs(), axis.get_majorticklabels(), strict=True)
            found += [label for place, label in ticks if low <= place <= high]
    return [text for text in found if text.get_text().strip()]


@pytest.mark.parametrize("which", ["boxes", "samples", "overlay"])
def test_no_text_lies_on_another_or_beyond_the_edge(table1, less, which):
    make = {"boxes": box_figure, "samples": efficiency_figure, "overlay": overlay_figure}[which]
    figure = make(table1 if which == "boxes" else less, PAPER)
    boxes = [(text.get_text(), text.get_window_extent().padded(-1.5)) for text in shown_texts(figure)]
    assert len(boxes) > 15
    for text, box in boxes:
        assert figure.bbox.x0 <= box.x0 <= box.x1 <= figure.bbox.x1, text
        assert figure.bbox.y0 <= box.y0 <= box.y1 <= figure.bbox.y1, text
    for (a, one), (b, other) in combinations(boxes, 2):
        assert not one.overlaps(other), (a, b)


def test_a_far_member_makes_the_scale_logarithmic(tmp_path):
    write_run(tmp_path / "table1_tank/model=pg_rssnn", [0.4, 0.41, 80.0])
    figure = box_figure(tables(tmp_path)[0], PAPER)
    assert figure.axes[0].get_xscale() == "log"
    assert "10^" not in texts(figure)


def test_error_and_correlation_against_the_samples(less):
    figure = efficiency_figure(less, PAPER)
    error, likeness = figure.axes
    assert (error.get_ylabel(), likeness.get_ylabel()) == ("test RMSE (V)", "test CC (–)")
    for ax, merit in ((error, "mean"), (likeness, "cc")):
        lines = [line for line in ax.lines if line.get_gid() == "mean"]
        assert len(lines) == 3
        for model, line in zip(("pg_rssnn", "rssnn", "physics_only"), lines, strict=True):
            rows = [row for row in less.measured if row.variant.model == model]
            np.testing.assert_array_equal(line.get_xdata(), [128, 256, 384])
            np.testing.assert_allclose(line.get_ydata(), [getattr(row.figures, merit) for row in rows])
    assert sorted(marks(error, "published")) == [(384.0, 0.46), (768.0, 0.44), (768.0, 0.71)]
    assert marks(likeness, "published") == []
    band = error.collections[0].get_paths()[0].vertices
    rows = [row for row in less.measured if row.variant.model == "pg_rssnn"]
    lowest, highest = min(min(r.finite("rmse")) for r in rows), max(max(r.finite("rmse")) for r in rows)
    assert (band[:, 1].min(), band[:, 1].max()) == pytest.approx((lowest, highest))


def test_other_data_and_other_settings_have_lines_of_their_own(tmp_path):
    for rate in ("1e-3", "1e-2"):
        for n_train in (2, 4):
            name = f"data.n_train={n_train},fit.learning_rate={rate}"
            write_run(tmp_path / "free" / name, [0.8, 0.9], system="robot_real", experiment=None)
    (table,) = tables(tmp_path)
    figure = efficiency_figure(table, PAPER)
    assert len([line for line in figure.axes[0].lines if line.get_gid() == "mean"]) == 2
    assert figure.axes[0].get_xlabel() == "n_train"
    assert "PG-RSSNN, fit.learning_rate=1e-2" in texts(figure)
    assert "n_train: 2" in texts(overlay_figure(table, PAPER))


def test_more_variants_than_can_be_told_apart_are_boxes_alone(tmp_path, less, table1):
    assert can_be_curves(less)
    assert not can_be_curves(table1)
    for rate in range(6):
        for n_train in (2, 4):
            write_run(tmp_path / "free" / f"data.n_train={n_train},fit.learning_rate={rate}", [0.8], experiment=None)
    assert not can_be_curves(tables(tmp_path)[0])


def test_the_overlay_shows_the_fewest_samples_a_stretch_and_all_of_it(less):
    figure = overlay_figure(less, PAPER)
    assert "training samples: 128" in texts(figure)
    top, under = figure.axes
    row = next(row for row in less.rows if row.variant == ("pg_rssnn", "tanks", 128))
    with np.load(row.run.path / "predictions.npz") as stored:
        measured, mean = stored["y"][0, :, 0], stored["ensemble_mean"][0, :, 0]
    np.testing.assert_array_equal(under.lines[0].get_ydata(), measured)
    np.testing.assert_allclose(under.lines[1].get_ydata(), mean)
    np.testing.assert_array_equal(top.lines[0].get_ydata(), measured[300:600])
    np.testing.assert_allclose(top.lines[1].get_xdata(), 4.0 * np.arange(300, 600))
    assert len(top.lines) == len(under.lines) == 1 + 3


def test_the_overlay_names_what_it_cannot_show(tmp_path):
    folder = tmp_path / "data_efficiency_tank"
    write_run(folder / "data.n_train=128,model=pg_rssnn", [0.5])
    broken = write_run(folder / "data.n_train=128,model=rssnn", [0.9], model="rssnn")
    (broken / "predictions.npz").write_bytes(b"nothing")
    write_run(folder / "data.n_train=128,model=physics_only", [0.9], model="physics_only", samples=50)
    figure = overlay_figure(tables(tmp_path)[0], PAPER)
    assert "left out, no prediction: RSSNN, physics only" in texts(figure)
    assert len(figure.axes[0].lines) == 2


def test_nothing_finished_is_said_in_every_figure(tmp_path):
    begin_run(tmp_path / "data_efficiency_tank/data.n_train=128,model=rssnn", model="rssnn")
    (table,) = tables(tmp_path)
    for make in (efficiency_figure, overlay_figure):
        assert "no member finished" in texts(make(table, PAPER))
    write_run(tmp_path / "free/mine", [None], data="csv", experiment=None)
    assert "no member finished" in texts(box_figure(tables(tmp_path)[1], PAPER))


def test_dollar_signs_and_global_settings_stay_as_they_are(tmp_path, less):
    before = dict(rcParams)
    write_run(tmp_path / "a/x=$1^{$", [0.5], experiment="cost_$x^{")
    write_run(tmp_path / "b/x=$2^{$", [0.6], experiment="cost_$x^{")
    assert r"\$" in texts(box_figure(tables(tmp_path)[0], PAPER))
    texts(efficiency_figure(less, PAPER))
    assert dict(rcParams) == before
