"""The order of the paper: which pairs it tells apart, which of them hold here."""

import math
from itertools import combinations

from paper_samples import spread_over, write_run

from pgrssnn_jax.paper.collect import collect
from pgrssnn_jax.paper.order import order_held, order_lines
from pgrssnn_jax.paper.published import read_paper
from pgrssnn_jax.paper.rows import evidence_tables

PAPER = read_paper()


def table_of(folder, errors, system="cascaded_tank", experiment="table1_tank"):
    for model, values in errors.items():
        write_run(folder / experiment / f"model={model}", values, model=model, system=system)
    (table,) = evidence_tables(collect([folder], PAPER), PAPER)
    return table


def test_every_pair_is_counted_once_and_judged_by_hand_alike(tmp_path):
    means = {"rssnn": 0.60, "pg_rssnn": 0.45, "pg_rssnn_fb": 0.44, "pg_fcssnn": 0.9, "fcssnn": 0.7, "rssnn_fb": 1.4}
    published = {
        "rssnn": 0.71,
        "pg_rssnn": 0.44,
        "pg_rssnn_fb": 0.46,
        "pg_fcssnn": 0.71,
        "fcssnn": 1.7,
        "rssnn_fb": 1.49,
    }
    std = {name: 0.05 * (k + 1) for k, name in enumerate(means)}
    table = table_of(tmp_path, {name: spread_over(mean, std[name], 10) for name, mean in means.items()})
    told_apart = {
        pair
        for pair in combinations(means, 2)
        if abs(published[pair[0]] - published[pair[1]]) > 2 * math.sqrt(sum(std[name] ** 2 / 10 for name in pair))
    }
    alike = {(a, b) for a, b in told_apart if (means[a] - means[b]) * (published[a] - published[b]) > 0}
    assert 0 < len(alike) < len(told_apart) < 15
    assert order_held(table, PAPER) == (len(alike), len(told_apart))
    (line,) = order_lines(table, PAPER)
    assert f"{len(told_apart)} pairs" in line
    assert f"{len(alike)} of these" in line


def test_a_pair_that_is_turned_round_does_not_hold(tmp_path):
    table = table_of(tmp_path, {"pg_rssnn": spread_over(0.9, 0.1, 10), "rssnn": spread_over(0.5, 0.1, 10)})
    assert order_held(table, PAPER) == (0, 1)


def test_one_seed_has_no_spread_but_the_physics_alone_needs_none(tmp_path):
    errors = {"rssnn": [0.9], "pg_rssnn": spread_over(0.86, 0.02, 10), "physics_only": [3.3]}
    assert order_held(table_of(tmp_path, errors, "robot_real", "table1_robot_real"), PAPER) == (1, 1)


def test_variants_without_a_published_mean_and_quoted_ones_stay_out(tmp_path):
    errors = {"w_pgnn": spread_over(0.5, 0.1, 10), "physics_only": [0.85], "rssnn": spread_over(0.7, 0.1, 10)}
    assert order_held(table_of(tmp_path, errors), PAPER) == (0, 0)


def test_runs_of_one_variant_are_no_pair(tmp_path):
    for place in ("a", "b"):
        write_run(tmp_path / place / "table1_tank/model=rssnn", spread_over(0.7, 0.1, 10), model="rssnn")
    table = table_of(tmp_path, {"pg_rssnn": spread_over(0.4, 0.1, 10)})
    assert order_held(table, PAPER) == (2, 2)


def test_a_table_without_published_means_says_nothing_of_their_order(tmp_path):
    write_run(tmp_path / "free/mine", [0.5, 0.6], data="csv", experiment=None)
    (table,) = evidence_tables(collect([tmp_path], PAPER), PAPER)
    assert order_lines(table, PAPER) == []
