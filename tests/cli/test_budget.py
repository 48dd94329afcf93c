"""Budgets: caps on the composed configuration, for every data set."""

import pytest
from commands import composed
from hypothesis import given
from hypothesis import strategies as st

from pgrssnn_jax.cli.plan import capped

BASES = ["cascaded_tank", "lgssm", "robot_simulated", "robot_real"]
NAMES = st.sampled_from("abcde")
VALUES = st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-9, 9) | st.sampled_from(["", "many"])
CONFIGS = st.dictionaries(NAMES, st.dictionaries(NAMES, VALUES) | VALUES)
CAPS = st.dictionaries(NAMES, st.integers(-9, 9))


@given(config=CONFIGS, caps=CAPS)
def test_numbers_and_nulls_end_at_their_cap_and_nothing_else_changes(config, caps):
    leaves = {name: value for name, value in config.items() if not isinstance(value, dict)}
    after = capped(leaves, {"any": caps})
    assert set(after) == set(leaves)
    for name, value in leaves.items():
        number = type(value) in (int, float)
        if name in caps and (number or value is None):
            assert after[name] <= caps[name]
            assert after[name] in (value, caps[name])
        else:
            assert after[name] == value


@given(config=CONFIGS)
def test_a_budget_without_caps_changes_nothing(config):
    assert capped(config, {}) == config
    assert capped(config, {"any": {"group": {"key": 1}}, "data": {"other": {"a": 1}}}) == config


def test_caps_reach_into_groups_and_those_of_a_data_set_only_meet_their_own():
    budget = {"any": {"fit": {"epochs": 5}}, "data": {"A": {"n_seeds": 1, "data": {"n": 3}}, "B": {"n_seeds": 0}}}
    config = {"fit": {"epochs": 9, "rate": 0.1}, "n_seeds": 4, "data": {"name": "A", "n": None}}
    after = {"fit": {"epochs": 5, "rate": 0.1}, "n_seeds": 1, "data": {"name": "A", "n": 3}}
    assert capped(config, budget) == after
    assert capped(after, budget) == after


@pytest.mark.parametrize(
    ("budget", "sentence"),
    [
        ({"all": {}}, "budget: expected the keys any and data, found 'all'"),
        ({"any": {"fit": {"epochs": "few"}}}, r"budget.any.fit.epochs: expected a number, found 'few'"),
        ({"any": {"n_seeds": {"a": 1}}}, r"budget.any.n_seeds: expected a number as the configuration has there"),
        ({"any": {"fit": 3}}, r"budget.any.fit: expected a group as the configuration has there, found 3"),
    ],
)
def test_a_budget_that_fits_nowhere_is_named(budget, sentence):
    with pytest.raises(ValueError, match=sentence):
        capped({"fit": {"epochs": 9}, "n_seeds": 4}, budget)


@pytest.mark.parametrize("base", BASES)
def test_smoke_has_at_most_two_members_and_few_epochs_whatever_is_asked(base):
    paper, smoke = (composed(f"+experiment={base}", "n_seeds=50", f"budget={name}") for name in ("paper", "smoke"))
    assert smoke["n_seeds"] * smoke["data"].get("realisations", 1) <= 2
    assert smoke["fit"]["epochs"] <= 10
    assert paper == composed(f"+experiment={base}", "n_seeds=50")
    assert set(smoke) == set(paper)
    assert smoke["fit"].keys() == paper["fit"].keys()
    assert smoke["data"].keys() == paper["data"].keys()
