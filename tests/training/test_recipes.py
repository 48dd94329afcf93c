"""The settings of each benchmark: names that exist, values that they take, and what a discovered physics changes."""

import pytest

from pgrssnn_jax.data.benchmarks import LOADERS
from pgrssnn_jax.training.recipes import DEFAULT, PROOF, RECIPES, Recipe, recipe_for
from pgrssnn_jax.training.settings import GROUP_OF, training_settings

ALL = {**RECIPES, "": DEFAULT}


def test_every_benchmark_has_its_recipe_and_other_data_the_default():
    assert set(RECIPES) == set(LOADERS) - {"csv", "arm_log"}
    for name, recipe in RECIPES.items():
        assert recipe_for(name) is recipe
    assert recipe_for("") is recipe_for("mine") is DEFAULT


@pytest.mark.parametrize("discovered", [False, True])
@pytest.mark.parametrize("name", ALL)
def test_a_recipe_names_settings_that_exist_and_take_its_values(name, discovered):
    found = ALL[name].settings(discovered=discovered)
    assert set(found) <= set(GROUP_OF)
    settings = training_settings("pg_rssnn", found)
    for key, value in found.items():
        assert getattr(getattr(settings, GROUP_OF[key]), key) == value


@pytest.mark.parametrize("name", ALL)
def test_every_change_is_one(name):
    """What is as the defaults are is no part of a recipe."""
    usual = training_settings("pg_rssnn")
    changes = ALL[name].changes
    same = [k for k, value in changes.items() if getattr(getattr(usual, GROUP_OF[k]), k) == value]
    assert [k for k in same if k != "initial_state"] == []  # which is said because the published one is another


def test_the_settings_of_a_discovered_physics_win():
    recipe = Recipe({"epochs": 5, "folds": 0}, {"folds": 10})
    assert recipe.settings(discovered=False) == {"epochs": 5, "folds": 0}
    assert recipe.settings(discovered=True) == {"epochs": 5, "folds": 10}
    assert recipe.changes == {"epochs": 5, "folds": 0}


@pytest.mark.parametrize("name", ALL)
def test_training_begins_at_a_discovered_physics(name):
    settings = training_settings("pg_rssnn", ALL[name].settings(discovered=True))
    assert settings.model.start_from_physics


def test_members_take_turns_after_a_discovery_on_the_tanks():
    settings = training_settings("pg_rssnn", RECIPES["cascaded_tank"].settings(discovered=True))
    assert (settings.data.folds, settings.run.n_seeds, settings.run.initial_state) == (10, 10, "estimated")
    assert training_settings("pg_rssnn", RECIPES["cascaded_tank"].settings(discovered=False)).data.folds == 0


def test_published_numbers():
    lgssm = training_settings("pg_rssnn", RECIPES["lgssm"].settings(discovered=False))
    assert (lgssm.data.window, lgssm.fit.epochs, lgssm.run.n_seeds, lgssm.run.initial_state) == (64, 200, 1, "zero")
    for name in ("robot_real", "robot_simulated"):
        arm = training_settings("pg_rssnn", RECIPES[name].settings(discovered=False))
        assert (arm.model.hidden, arm.model.gru_layers, arm.run.initial_state) == (64, 3, "zero")


def test_a_proof_trains_few_members_and_reports_one_window():
    settings = training_settings("pg_rssnn", PROOF)
    assert (settings.run.n_seeds, settings.run.report_n_init) == (2, (0,))


def test_recipes_cannot_be_changed():
    with pytest.raises(TypeError):
        RECIPES["mine"] = DEFAULT  # pyright: ignore[reportIndexIssue]
