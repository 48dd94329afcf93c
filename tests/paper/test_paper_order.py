"""The order of the paper: which pairs it tells apart, which of them hold here, and how little data go."""

import math
from itertools import combinations

import pytest
from paper_samples import spread_over, write_run

from pgrssnn_jax.paper.collect import collect
from pgrssnn_jax.paper.order import beats_lines, order_lines, ordering
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
    found = ordering(table, PAPER)
    assert {frozenset((p.better.variant.model, p.worse.variant.model)) for p in found.held} == set(
        map(frozenset, alike)
    )
    assert len(found.turned) == len(told_apart - alike) > 0
    assert found.close == 15 - len(told_apart) > 0
    assert found.unknown == 45 - 15  # ten variants with a published mean, four of them without a run
    for pair in found.turned:
        a, b = pair.better.variant.model, pair.worse.variant.model
        assert published[a] < published[b]
        assert means[a] > means[b]
        assert pair.errors == pytest.approx((means[b] - means[a]) / math.sqrt((std[a] ** 2 + std[b] ** 2) / 10))


def test_pairs_that_are_turned_round_are_spelled_out(tmp_path):
    table = table_of(tmp_path, {"pg_rssnn": spread_over(0.9, 0.1, 10), "rssnn": spread_over(0.5, 0.1, 10)})
    counts, turned = order_lines(table, PAPER)
    assert "of 45 pairs" in counts
    assert "0 of these stand in the same order here, 1 are turned round" in counts
    assert "44 cannot be judged" in counts
    assert turned.startswith(
        "Turned round: PG-RSSNN before RSSNN in the paper (0.44, 0.71), here 0.9000 against 0.5000, 8.9"
    )


def test_one_seed_has_no_spread_but_the_physics_alone_needs_none(tmp_path):
    errors = {"rssnn": [0.9], "pg_rssnn": spread_over(0.86, 0.02, 10), "physics_only": [3.3]}
    found = ordering(table_of(tmp_path, errors, "robot_real", "table1_robot_real"), PAPER)
    assert [(p.better.label, p.worse.label) for p in found.held] == [("PG-RSSNN", "physics only")]
    assert found.turned == []


def test_variants_without_a_published_mean_and_quoted_ones_stay_out(tmp_path):
    errors = {"w_pgnn": spread_over(0.5, 0.1, 10), "physics_only": [0.85], "rssnn": spread_over(0.7, 0.1, 10)}
    found = ordering(table_of(tmp_path, errors), PAPER)
    assert (found.held, found.turned, found.close, found.unknown) == ([], [], 0, 45)


def test_runs_of_one_variant_are_no_pair(tmp_path):
    for place in ("a", "b"):
        write_run(tmp_path / place / "table1_tank/model=rssnn", spread_over(0.7, 0.1, 10), model="rssnn")
    table = table_of(tmp_path, {"pg_rssnn": spread_over(0.4, 0.1, 10)})
    found = ordering(table, PAPER)
    assert len(found.held) == 2
    assert found.close == 0


def test_a_table_without_published_means_says_nothing_of_their_order(tmp_path):
    write_run(tmp_path / "free/mine", [0.5, 0.6], data="csv", experiment=None)
    (table,) = evidence_tables(collect([tmp_path], PAPER), PAPER)
    assert order_lines(table, PAPER) == beats_lines(table, PAPER) == []


@pytest.mark.parametrize(
    ("rssnn", "cc", "words"),
    [
        (0.9, 0.8, ("yes in RMSE", "yes in CC")),
        (0.5, 0.8, ("NO in RMSE", "yes in CC")),
        (0.9, 0.97, ("yes", "NO in CC")),
    ],
)
def test_little_data_as_the_paper_says(tmp_path, rssnn, cc, words):
    folder = tmp_path / "data_efficiency_tank"
    write_run(folder / "data.n_train=128,model=pg_rssnn", [0.6, 0.6], cc=0.95)
    write_run(folder / "data.n_train=128,model=rssnn", [rssnn], model="rssnn", cc=cc)
    write_run(folder / "data.n_train=768,model=physics_only", [0.1], model="physics_only")
    (table,) = evidence_tables(collect([tmp_path], PAPER), PAPER)
    black_box, physics = beats_lines(table, PAPER)
    assert black_box.startswith("With 128 samples PG-RSSNN is better than RSSNN in the paper; here ")
    assert all(word in black_box for word in words)
    assert physics.endswith("that cannot be judged here: a run is missing.")
