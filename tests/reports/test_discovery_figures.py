"""Discovery figures draw the arrays they are given, say what is missing, and stand every gap in the data."""

import re
from typing import Any

import numpy as np
import pytest
from discovery_samples import ARM, SAD, STAGES, TANK, tank_discovery
from matplotlib import rcParams
from matplotlib.figure import Figure
from test_report_figures import texts

from pgrssnn_jax.reports import discovery_figures as figures


def named(figure: Figure, gid: str) -> list[Any]:
    """The artists of a figure that carry this name."""
    return figure.findobj(lambda artist: artist.get_gid() == gid)


ALIKE = ("no arrays at all", "one sample", "nothing measured")


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in ALIKE else []) for n in SAD])
def test_gaps_in_the_data_do_not_stop_a_figure(name):
    for figure in figures.discovery_figures(*SAD[name]).values():
        assert "nan" not in texts(figure).lower()


def test_what_cannot_be_drawn_is_said():
    drawn = figures.discovery_figures(*SAD["nothing found, signals only"])
    said = {title: texts(figure) for title, figure in drawn.items()}
    assert "no correction could be estimated" in said["Disagreement"]
    assert "no map could be made" in said["Map"]
    assert "no candidate effect was tried" in said["Candidates"]
    assert "no number of the physics was refitted" in said["Shifts"]
    assert "there is no test record" in texts(figures.simulation_figure(*SAD["no arrays at all"]))


@pytest.mark.parametrize("run", [TANK, ARM], ids=["tank", "arm"])
def test_headers_state_verdict_error_and_source_and_axes_their_units(run):
    for title, figure in figures.discovery_figures(*run).items():
        said = texts(figure)
        assert f"{run[0]['system']} · A missing effect was found" in said
        assert f"before {run[0]['gap']['before']['test']:#.4g}" in said
        assert ("SIMULATED DATA" in said) == (run[0]["data"]["source"] == "simulated")
        if title in ("Simulation", "Disagreement"):
            assert all(re.search(r"\(.+\)$", ax.get_ylabel()) for ax in figure.axes)


def test_the_global_settings_stay_and_a_dollar_sign_opens_no_formula():
    before = dict(rcParams)
    found = TANK[0] | {"system": "a $ b", "outputs": [{"name": "cost_$x^{", "unit": "$"}]}
    for figure in figures.discovery_figures(found, TANK[1]).values():
        assert r"\$" in texts(figure)
    assert dict(rcParams) == before


def test_simulation_draws_measurement_before_and_after_of_the_test_record():
    _, arrays = TANK
    figure = figures.simulation_figure(*TANK)
    (measured,) = named(figure, "measured")
    np.testing.assert_array_equal(measured.get_ydata(), arrays["y_test"][0, :, 0])
    np.testing.assert_array_equal(measured.get_xdata(), arrays["time_test"])
    for stage in ("before", "after"):
        simulated, residual = named(figure, stage)
        np.testing.assert_array_equal(simulated.get_ydata(), arrays[f"y_{stage}_test"][0, :, 0])
        np.testing.assert_array_equal(residual.get_ydata(), measured.get_ydata() - simulated.get_ydata())
    assert len(figures.simulation_figure(*ARM).axes) == 12


def test_a_simulation_that_runs_away_leaves_the_others_readable():
    found, arrays = TANK
    far = arrays["y_before_test"].copy()
    far[0, 60:] = 1e30
    figure = figures.simulation_figure(found, arrays | {"y_before_test": far})
    for ax in figure.axes:
        low, high = ax.get_ylim()
        assert high - low < 6 * np.ptp(arrays["y_test"])
    assert texts(figure).count("predictions leave the axis") == 2


def test_samples_that_were_not_measured_leave_a_gap():
    mask = TANK[1]["mask_test"].copy()
    mask[0, 10:20] = False
    (measured,) = named(figures.simulation_figure(TANK[0], TANK[1] | {"mask_test": mask}), "measured")
    assert np.isnan(measured.get_ydata()[10:20]).all()


def test_a_long_record_is_shown_around_its_largest_residual():
    found, arrays = tank_discovery(samples=2000)
    figure = figures.simulation_figure(found, arrays)
    shown = named(figure, "measured")[0].get_xdata()
    worst = np.argmax(np.abs(arrays["y_test"] - arrays["y_before_test"])[0, :, 0])
    assert len(shown) == 300
    assert shown[0] <= arrays["time_test"][worst] <= shown[-1]
    assert re.search(r"samples \d+ to \d+ of 2000", texts(figure))


def test_disagreement_draws_every_stage_the_worst_correction_and_its_times():
    found, arrays = ARM
    figure = figures.disagreement_figure(found, arrays)
    (drawn,) = named(figure, "correction")
    np.testing.assert_array_equal(drawn.get_ydata(), arrays["correction"][7, 0])
    assert "missing in the equation of velocity_2" in texts(figure)
    assert figure.axes[-1].get_ylabel() == "correction (rad/s²)"
    assert [len(named(figure, stage)) for stage in STAGES] == [6, 6, 6]
    assert len(named(figure, "interval")) == 7


def test_a_worst_equation_without_correction_gives_way_to_the_largest_one():
    listed = [{"equation": "level_voltage", "share_of_error": 0.9, "intervals_s": [[0, 8]]}]
    figure = figures.disagreement_figure(TANK[0] | {"disagreement": listed}, TANK[1])
    assert "missing in the equation of upper_level" in texts(figure)
    assert len(named(figure, "interval")) == 2


def test_map_cells_with_few_visits_or_no_value_are_grey():
    found, arrays = ARM
    mean = arrays["map_mean"].copy()
    mean[0, 0], count = np.nan, arrays["map_count"].copy()
    count[0, 0] = 30
    figure = figures.map_figure(found, arrays | {"map_mean": mean, "map_count": count})
    hidden = (count < 8) | np.isnan(mean)
    for ax in figure.axes[:2]:
        (mesh,) = ax.collections
        np.testing.assert_array_equal(np.ma.getmaskarray(mesh.get_array()), hidden.T)
        grey = mesh.to_rgba(np.ma.masked_all(1))[0, :3]
        assert np.ptp(grey) < 0.1
    mesh = figure.axes[0].collections[0]
    np.testing.assert_array_equal(mesh.get_array().compressed(), mean.T[~hidden.T])
    assert mesh.norm.vmin == -mesh.norm.vmax
    assert figure.axes[2].get_ylabel() == "correction (rad/s²)"


def test_map_outlines_the_region_and_marks_what_is_certain():
    found, arrays = TANK
    figure = figures.map_figure(found, arrays)
    (box,) = named(figure, "region")
    assert box.get_bbox().extents.tolist() == [7.5, 3.0, 11.0, 9.0]
    (dots,) = named(figure, "certain")
    sure = (np.abs(arrays["map_mean"]) > 2 * arrays["map_std_error"]) & (arrays["map_count"] >= 8)
    assert len(dots.get_xdata()) == sure.sum()
    elsewhere = [{"equation": "upper_level", "region": {"lower_level": [0, 1]}}]
    assert not named(figures.map_figure(found | {"disagreement": elsewhere}, arrays), "region")


def test_candidates_are_sorted_chosen_ones_stand_out_and_the_threshold_is_drawn():
    found, arrays = TANK
    figure = figures.candidates_figure(found | {"ranking": found["ranking"][::-1]}, arrays)
    ax = figure.axes[0]
    gains = [100 * row["gain"] for row in found["ranking"]]
    np.testing.assert_allclose([bar.get_width() for bar in ax.patches], gains)
    assert [bar.get_gid() for bar in ax.patches] == ["chosen"] + ["candidate"] * (len(gains) - 1)
    assert ax.get_yticklabels()[0].get_text() == "overflow_1to2"
    (line,) = named(figure, "threshold")
    assert line.get_xdata()[0] == pytest.approx(5.1)
    (ticks,) = named(figure, "null")
    np.testing.assert_allclose(ticks.get_xdata(), 100 * arrays["null_law"])
    assert not named(figures.candidates_figure(found | {"null": {}}, arrays), "threshold")


def test_of_many_candidates_the_best_are_drawn_and_the_chosen_ones_always():
    ranking = [{"name": f"effect_{k}", "gain": -0.01 * k, "p_value": None, "chosen": k == 39} for k in range(40)]
    figure = figures.candidates_figure(TANK[0] | {"ranking": [*ranking, {"name": "x", "gain": None}]}, {})
    assert len(figure.axes[0].patches) == figures.SHOWN_BARS + 1
    assert len(named(figure, "chosen")) == 1
    assert "15 weaker ones left out" in texts(figure)


def test_shifts_are_relative_largest_first_and_numbers_that_began_at_zero_are_left_to_the_table():
    figure = figures.shifts_figure(*TANK)
    ax = figure.axes[0]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["k2", "k1", "k3", "k4"]
    points = {tuple(np.round(line.get_xydata()[0], 6)) for line in ax.lines if len(line.get_xdata()) == 1}
    assert (round(100 * (0.0551 - 0.0464) / 0.0464, 6), 0.86) in points
    assert (round(100 * (0.0467 - 0.0464) / 0.0464, 6), 1.14) in points
    assert "4 of 5 numbers" in texts(figure)


def test_an_uncertain_shift_does_not_hide_the_others():
    wild = {"k": {"before": 1.0, "after": 1.1, "std": 1e6, "unit": ""}}
    low, high = figures.shifts_figure(TANK[0] | {"recalibration": wild, "parameters": {}}, {}).axes[0].get_xlim()
    assert high - low < 40
