"""An arm is drawn as it is: to one scale, upright, its tip's error as computed; the moving picture is plain XML."""

import io
import json
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from report_samples import CONFIG, ENVIRONMENT, Run, arm, tanks, with_skeleton
from rich.console import Console

from pgrssnn_jax.reports import content, tables
from pgrssnn_jax.reports.pages import run_html
from pgrssnn_jax.reports.poses import floor_lines, project, read_poses, set_stage
from pgrssnn_jax.reports.stick import distance_text, stick_animation, stick_figure
from pgrssnn_jax.reports.write import write_report
from pgrssnn_jax.training.run_folder import RunFolder


def sample(samples: int = 60, sequences: int = 2, **changes) -> Run:
    return with_skeleton(arm(members=2, samples=samples, sequences=sequences, **changes))


def without(run: Run, name: str, rows: slice) -> dict[str, np.ndarray]:
    """The predictions with some poses of `skeleton_<name>` missing."""
    points = run.predictions[f"skeleton_{name}"].copy()
    points[:, rows] = np.nan
    return {**run.predictions, f"skeleton_{name}": points}


RUN = sample()
NOTHING = without(RUN, "predicted", slice(None))
CASES = {
    "all": (RUN.predictions, RUN.metrics),
    "no prediction at first": (without(RUN, "predicted", slice(0, 7)), RUN.metrics),
    "no prediction in the middle": (without(RUN, "predicted", slice(20, 40)), RUN.metrics),
    "no prediction": (NOTHING, RUN.metrics),
    "no measurement": (without(RUN, "measured", slice(None)), RUN.metrics),
    "nothing": ({**NOTHING, "skeleton_measured": NOTHING["skeleton_predicted"]}, RUN.metrics),
    "runs away": ({**RUN.predictions, "skeleton_predicted": RUN.predictions["skeleton_predicted"] * 1e30}, RUN.metrics),
}
for name, run in {
    "one sample": sample(samples=1),
    "three samples": sample(samples=3, source="simulated", dt=1),
}.items():
    CASES[name] = run.predictions, run.metrics


def said(figure: Figure) -> str:
    figure.draw_without_rendering()
    return "\n".join(t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text")))  # type: ignore[attr-defined]


def line(ax, gid: str) -> np.ndarray:
    return next(np.stack(one.get_data(), -1) for one in ax.lines if one.get_gid() == gid)


@pytest.mark.parametrize("name", CASES)
def test_every_case_is_drawn_and_said(name):
    predictions, metrics = CASES[name]
    figure = stick_figure(predictions, metrics)
    time = predictions["skeleton_measured"].shape[1]
    assert len(figure.axes) == min(8, time) + 1
    text = said(figure)
    assert "arm · pg_rssnn" in text
    assert ("SIMULATED DATA" in text) == (metrics["source"] == "simulated")
    assert ("no prediction to compare" in text) == (name in ("no prediction", "no measurement", "nothing"))
    assert "nan" not in text.lower()


def test_the_curve_is_the_distance_of_the_tips():
    predictions = without(RUN, "predicted", slice(20, 40))
    *shots, curve = stick_figure(predictions, RUN.metrics).axes
    tips = [predictions[f"skeleton_{name}"][0, :, -1].astype(float) for name in ("measured", "predicted")]
    expected = np.sqrt(((tips[0] - tips[1]) ** 2).sum(-1))
    np.testing.assert_allclose(curve.lines[0].get_ydata(), expected, rtol=1e-6)
    np.testing.assert_allclose(curve.lines[0].get_xdata(), 0.1 * np.arange(60))
    assert curve.get_ylabel().endswith("(m)")
    assert curve.get_xlabel() == "time (s)"
    times, values = line(curve, "shots").T
    for ax, time, value in zip(shots, times, values, strict=True):
        end = f"tip {distance_text(value)} off" if np.isfinite(value) else "no prediction"
        assert ax.get_title(loc="left").endswith(f" · {time:.4g} s · {end}")
    counted = stick_figure(RUN.predictions, {**RUN.metrics, "n_init": 50})
    assert "10 samples · n_init 50" in said(counted)


def test_all_panels_have_one_scale_and_lengths_across_the_view_are_true():
    figure = stick_figure(RUN.predictions, RUN.metrics)
    figure.draw_without_rendering()
    scales = [np.diag(ax.transData.get_matrix())[:2] for ax in figure.axes[:-1]]
    np.testing.assert_allclose(scales, np.broadcast_to(scales[0][0], (8, 2)), rtol=1e-6)
    poses = read_poses(RUN.predictions)
    square = set_stage(poses).square
    assert f"{square:g} m" in said(figure).splitlines()
    assert any(np.ptp(one.get_xdata()) == pytest.approx(square) for one in figure.axes[0].lines[-1:])
    np.testing.assert_allclose(line(figure.axes[0], "measured"), project(poses.measured[0]))
    np.testing.assert_allclose(line(figure.axes[-2], "predicted"), project(poses.predicted[-1]))
    np.testing.assert_allclose(line(figure.axes[3], "path"), project(poses.measured[: int(60 * 3 / 7) + 1, -1]))
    np.testing.assert_allclose(project(np.eye(3))[0], [1.0, 0.0])


def test_turning_the_frame_leaves_the_picture():
    poses = read_poses(RUN.predictions)
    links = np.linalg.norm(np.diff(RUN.predictions["skeleton_measured"][0], axis=1), axis=-1)
    np.testing.assert_allclose(np.linalg.norm(np.diff(poses.measured, axis=1), axis=-1), links, atol=1e-6)
    assert poses.measured[:, :, 0].mean() > np.abs(poses.measured[:, :, 1]).mean()
    c, s = np.cos(0.7), np.sin(0.7)
    aside = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = {name: RUN.predictions[name] @ aside for name in ("skeleton_measured", "skeleton_predicted")}
    for one, other in zip(read_poses(turned), poses, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_the_floor_carries_squares_around_the_base():
    stage = set_stage(read_poses(RUN.predictions))
    lines = floor_lines(stage)[..., :2]
    np.testing.assert_allclose(np.linalg.norm(lines, axis=-1), stage.radius)
    steps = np.diff(lines, axis=1)[:, 0]
    along = steps / np.linalg.norm(steps, axis=-1, keepdims=True)
    off = (lines[:, 0] * along[:, ::-1] * (1, -1)).sum(-1) / stage.square
    np.testing.assert_allclose(off, off.round(), atol=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_the_animation_is_plain_xml_that_loads_and_runs_nothing(name):
    predictions, metrics = CASES[name]
    svg = stick_animation(predictions, metrics)
    root = ElementTree.fromstring(svg)
    assert root.tag == "svg"
    assert root.get("role") == "img"
    assert [child.tag for child in root][:3] == ["title", "desc", "image"]
    assert {element.tag for element in root.iter()} <= {
        "svg", "title", "desc", "image", "g", "path", "polyline", "animate",
    }  # fmt: skip
    assert root[2].attrib.pop("href").startswith("data:image/png;base64,")
    assert not {key for element in root.iter() for key in element.attrib if "href" in key or key.startswith("on")}
    drawn = ElementTree.tostring(root, encoding="unicode")
    assert not re.search(r"url\(|://|nan|inf\b", drawn)
    assert len(drawn) < 150_000
    assert len(svg) < 400_000
    for element in root.iter("animate"):
        values = element.attrib["values"].split(";")
        assert len({len(re.findall(r"[\d.-]+", value)) for value in values}) == 1
    assert ("SIMULATED DATA" in drawn) == (metrics["source"] == "simulated")


@pytest.mark.parametrize(("samples", "poses"), [(605, 120), (60, 60)])
def test_the_animation_shows_the_poses_in_step(samples, poses):
    run = sample(samples=samples, sequences=1)
    svg = stick_animation(run.predictions, run.metrics)
    root = ElementTree.fromstring(svg)
    (duration,) = {element.get("dur") for element in root.iter("animate")}
    speed = float(re.search(r"([\d.]+) times real time", svg)[1])  # type: ignore[index]
    assert float(duration[:-1]) == pytest.approx(0.1 * (samples - 1) / speed, rel=1e-3)
    assert 6 <= 0.1 * (samples - 1) / speed <= 15
    moving = [element for line in root.iter("polyline") for element in line if element.tag == "animate"]
    shown = np.unique(np.linspace(0, samples - 1, poses).round().astype(int))
    known = read_poses(run.predictions)
    arms = (known.measured * (1, 1, 0), *known)
    for element, points in zip(moving, arms, strict=False):
        found = np.array([re.split("[ ,]", v) for v in element.attrib["values"].split(";")], float)
        place = project(points[shown]) * (1, -1)
        found = found.reshape(place.shape)
        scale = np.ptp(found[..., 0]) / np.ptp(place[..., 0])
        np.testing.assert_allclose(found - found[0, 0], scale * (place - place[0, 0]), atol=0.4)
    assert len(moving) == 4


def test_ten_seconds_run_in_real_time():
    run = sample(samples=101, sequences=1)
    assert "side, real time." in stick_animation(run.predictions, run.metrics)
    assert "<animate" not in stick_animation(*CASES["one sample"])


def test_a_missing_prediction_is_hidden_while_it_is_missing():
    root = ElementTree.fromstring(stick_animation(*CASES["no prediction in the middle"]))
    (hide,) = [e for group in root.iter("g") for e in group if e.get("attributeName") == "opacity"]
    assert hide.get("calcMode") == "discrete"
    np.testing.assert_array_equal(hide.attrib["values"].split(";"), ["1"] * 20 + ["0"] * 20 + ["1"] * 20)
    assert len(list(ElementTree.fromstring(stick_animation(NOTHING, RUN.metrics)).iter("g"))) == 3


def test_names_are_escaped():
    evil = "<script>&\"'</script>"
    root = ElementTree.fromstring(stick_animation(RUN.predictions, {**RUN.metrics, "system": evil, "origin": evil}))
    assert evil in "".join(root.itertext())
    assert "script" not in {element.tag for element in root.iter()}


def page(tmp_path, run: Run, titles, **changes) -> str:
    png = tmp_path / "f.png"
    Figure((2, 1)).savefig(png)
    given = {"config_text": CONFIG, "environment": ENVIRONMENT, **changes}
    return run_html(run.metrics, dict.fromkeys(titles, png), **given)


def test_the_page_shows_the_animation_below_the_arm_and_only_if_there_is_one(tmp_path):
    titles = ("Prediction", "Arm", "Training")
    assert "<svg" not in page(tmp_path, RUN, titles)
    svg = stick_animation(RUN.predictions, RUN.metrics)
    text = page(tmp_path, RUN, titles, animation=svg)
    places = [text.index(part) for part in ('id="figure-2"', svg, 'id="figure-3"')]
    assert places == sorted(places)
    assert text.count("<svg") == 1
    assert "http://" not in text


def test_outputs_are_listed_with_the_means_over_finished_members(tmp_path):
    run = arm(members=3, samples=40, sequences=1, failed=(1,))
    tests = [member["test"] for member in run.metrics["members"] if member["test"]]
    paper = io.StringIO()
    Console(file=paper, width=80, color_system=None).print(tables.output_table(run.metrics))
    assert "…" not in paper.getvalue()
    text = page(tmp_path, run, ())
    table = tables.output_table(run.metrics)
    assert table._repr_html_() in text
    for k, (_, (name, unit, *merits)) in enumerate(table.rows):
        expected = [np.mean([test[name][k] for test in tests]) for name in ("rmse", "nrmse", "fit_percent", "cc")]
        assert (name, unit) == (f"position_{k + 1}", "rad")
        assert merits == [content.number(value) for value in expected]
        (cells,) = re.findall(rf"position_{k + 1} +rad +(.*)", paper.getvalue())
        np.testing.assert_allclose([float(cell) for cell in cells.split()], expected, rtol=1e-3)
    alone = page(tmp_path, tanks(members=2, samples=30), ())
    assert "outputs; test record" not in alone
    sad = arm(members=2, samples=20, sequences=1, failed=(0, 1))
    assert "nan" not in page(tmp_path, sad, ()).lower()


@pytest.mark.slow
@pytest.mark.parametrize("run", [sample(samples=30), tanks(members=2, samples=30)], ids=["arm", "tanks"])
def test_a_run_folder_with_an_arm_gets_its_pictures(tmp_path, run):
    (tmp_path / "metrics.json").write_text(json.dumps(run.metrics), encoding="utf-8")
    (tmp_path / "config.yaml").write_text(CONFIG, encoding="utf-8")
    (tmp_path / "environment.json").write_text(json.dumps(ENVIRONMENT), encoding="utf-8")
    run.history.to_csv(tmp_path / "history.csv", index=False)
    np.savez(tmp_path / "predictions.npz", **run.predictions)
    write_report(RunFolder(tmp_path))
    moves = "skeleton_measured" in run.predictions
    assert (tmp_path / "figures" / "arm.png").is_file() == moves
    assert ("<svg" in (tmp_path / "report.html").read_text(encoding="utf-8")) == moves
