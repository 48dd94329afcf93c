"""Settings of a training run: names that are unique, groups of the configuration and back, old spellings."""

import warnings
from dataclasses import fields

import pytest

from pgrssnn_jax.models.spec import VARIANTS, ModelSpec
from pgrssnn_jax.training.settings import (
    GROUP_OF,
    GROUPS,
    ROLLBACKS,
    DataSettings,
    FitSettings,
    MemberSettings,
    RunSettings,
    TrainingSettings,
    settings_from_config,
    settings_to_config,
    training_settings,
)


def test_names_are_unique_over_all_groups():
    assert len(GROUP_OF) == sum(len(fields(kind)) for kind in GROUPS.values())
    assert set(GROUPS) == set(TrainingSettings._fields) - {"name"}


def test_nothing_said_is_the_default_of_every_group():
    found = training_settings("pg_rssnn")
    assert found == TrainingSettings(
        "pg_rssnn", ModelSpec(), FitSettings(), RunSettings(), DataSettings(), MemberSettings()
    )


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_by_name_is_its_spec(name):
    found = training_settings(name)
    assert (found.name, found.model) == (name, ModelSpec(**VARIANTS[name]))


def test_a_spec_of_ones_own_is_called_custom():
    own = ModelSpec(hidden=3, feedback=True)
    found = training_settings(own, {"epochs": 7})
    assert (found.name, found.model, found.fit.epochs) == ("custom", own, 7)


def test_later_changes_win_and_all_over_the_models_own():
    first, second = {"epochs": 5, "n_seeds": 2, "activation": "relu"}, {"epochs": 9, "window": 64, "devices": 1}
    found = training_settings("pg_rssnn_sgm", first, second)
    assert (found.fit.epochs, found.run.n_seeds, found.model.activation) == (9, 2, "relu")
    assert (found.data.window, found.members.devices) == (64, 1)


@pytest.mark.parametrize(
    ("model", "changes", "sentence"),
    [
        ("pg_lstm", {}, r"model: expected one of \['fcssnn', .*\], found 'pg_lstm'"),
        ("pg_rssnn", {"epoch": 3}, r"settings: expected some of \['accelerate', .*\], found 'epoch'"),
        ("pg_rssnn", {"name": "x"}, "settings: expected some of .*, found 'name'"),
        ("pg_rssnn", {"epochs": "many"}, "fit.epochs: expected int, found 'many'"),
        ("pg_rssnn", {"epochs": -1}, "fit: epochs: expected 0 or more, found -1"),
        ("pg_rssnn", {"hidden": 2.5}, "model.hidden: expected int, found 2.5"),
        ("pg_rssnn", {"n_seeds": 0}, "^n_seeds: expected 1 to 1000000, found 0"),
        ("pg_rssnn", {"seed": -1}, "^seed: expected 0 to 2147483647, found -1"),
        ("pg_rssnn", {"initial_state": "warm"}, r"^initial_state: expected zero \| .*, found 'warm'"),
        (
            "pg_rssnn",
            {"report_n_init": [0, -5]},
            r"^report_n_init: expected a list of sample counts .*, found \[0, -5\]",
        ),
        ("pg_rssnn", {"report_n_init": 5}, "^report_n_init: expected a list of sample counts"),
        ("pg_rssnn", {"how": "fast"}, r"members.how: expected auto \| vmap \| loop, found 'fast'"),
        ("pg_rssnn", {"devices": "all"}, r"members.devices: expected int \| auto, found 'all'"),
        ("pg_rssnn", {"guard": "retreat"}, r"fit.guard: expected none \| rollback, found 'retreat'"),
    ],
)
def test_what_no_setting_takes_is_refused_in_one_sentence(model, changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        training_settings(model, changes)


ELSEWHERE = {
    "model": {"hidden": 5, "gru_layers": 2, "activation": "sigmoid"},
    "fit": {"epochs": 12, "clip_norm": None, "guard": "none", "physics_parameters": "trained"},
    "run": {"seed": 3, "n_seeds": 4, "initial_state": "estimated", "report_n_init": (0, 7), "accelerate": False},
    "data": {"window": 16, "published_scaling": True},
    "members": {"how": "loop", "sub_batch": 2, "devices": 1, "optimisation": 0},
}


@pytest.mark.parametrize("model", ["pg_rssnn", "w_pgnn", "physics_only"])
def test_settings_go_through_the_configuration_and_back(model):
    whole = {name: value for group in ELSEWHERE.values() for name, value in group.items()}
    for changes in ({}, *ELSEWHERE.values(), whole):
        settings = training_settings(model, changes)
        config = settings_to_config(settings)
        assert settings_from_config(config) == settings
        config["data"] = {"name": "csv", "train": "a.csv", **config["data"]}  # beside the loader's own arguments
        assert settings_from_config({**config, "physics": {}, "resume": False}) == settings


def test_a_configuration_is_plain_data_with_a_run_at_its_top():
    config = settings_to_config(training_settings("pg_rssnn", {"report_n_init": (0, 7)}))
    assert set(config) == {"model", "fit", "data", "members", *(field.name for field in fields(RunSettings))}
    assert config["report_n_init"] == [0, 7]
    assert config["model"]["name"] == "pg_rssnn"


def test_the_old_spelling_of_rollback_is_taken_with_one_warning():
    config = settings_to_config(training_settings("pg_rssnn"))
    config["fit"]["guard"] = "retreat"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = settings_from_config(config)
    assert [(w.category, str(w.message)) for w in caught] == [
        (FutureWarning, "fit.guard: 'retreat' is now called 'rollback'")
    ]
    assert found == training_settings("pg_rssnn")
    assert config["fit"]["guard"] == "retreat"  # what was given is not changed


def test_only_a_guard_goes_back():
    assert (FitSettings().rollbacks, FitSettings(guard="none").rollbacks) == (ROLLBACKS, 0)


@pytest.mark.parametrize(("chunk", "every", "blocks"), [(20, 5, 4), (20, 6, 3), (4, 5, 1)])
def test_a_chunk_has_whole_validations(chunk, every, blocks):
    assert FitSettings(chunk_epochs=chunk, validate_every=every).blocks == blocks
