"""The published figures stand under names that the configuration has, and the tables are those that the sweeps fill."""

from itertools import product

import pytest
from commands import ROOT, config_names
from omegaconf import OmegaConf

from pgrssnn_jax.paper.published import Variant, read_paper

PAPER = read_paper()


def test_every_name_is_one_of_the_configuration():
    assert set(PAPER.models) == set(config_names("model"))
    assert set(PAPER.systems) == set(config_names("data")) - {"csv", "arm_log"}  # the readers of own files
    assert set(PAPER.physics) <= set(config_names("physics"))
    assert set(PAPER.experiments) <= set(config_names("experiment"))
    for system, variant in PAPER.values:
        assert system in PAPER.systems
        assert variant.model in PAPER.models
        assert variant.physics in config_names("physics")


def test_every_sweep_of_the_configuration_has_a_table():
    """What a sweep trains and what its table expects are the same, so that a row is missing only when a run is."""
    for path in (ROOT / "conf/experiment").glob("*.yaml"):
        params = OmegaConf.to_container(OmegaConf.load(path)).get("hydra", {}).get("sweeper", {}).get("params")
        assert (params is None) == (path.stem not in PAPER.experiments)
        if params is None:
            continue
        system = PAPER.systems[PAPER.experiments[path.stem].system]
        axes = {key: [word.strip() for word in str(text).split(",")] for key, text in params.items()}
        swept = product(
            axes["model"], axes.get("physics", [system.physics]), axes.get("data.n_train", [system.n_train])
        )
        expected = [Variant(model, physics, None if n is None else int(n)) for model, physics, n in swept]
        assert set(PAPER.experiments[path.stem].variants) == set(expected)
        assert len(PAPER.experiments[path.stem].variants) == len(expected)


@pytest.mark.parametrize(
    ("system", "variant", "value"),
    [
        ("cascaded_tank", Variant("pg_rssnn", "tanks", 768), (0.44, 10, 10, 0.34)),
        ("cascaded_tank", Variant("pg_rssnn", "tanks", 384), (0.46, 10, 10, 0.36)),
        ("cascaded_tank", Variant("fcssnn", "tanks", 768), (1.70, 10, 6, None)),
        ("lgssm", Variant("physics_only", "lgssm", None), (1.68, 50, 50, None)),
        ("robot_real", Variant("pg_rssnn_fb", "arm", None), (None, 10, 0, None)),
        ("robot_simulated", Variant("pg_rssnn", "arm_model3", None), (0.67, 10, 10, None)),
    ],
)
def test_published_values_and_how_many_runs_they_are_of(system, variant, value):
    assert PAPER.values[system, variant] == value


def test_what_the_paper_does_not_report_has_no_value():
    assert ("cascaded_tank", Variant("physics_only", "tanks", 768)) not in PAPER.values
    assert not [variant for _, variant in PAPER.values if variant.model == "w_pgnn"]
    assert PAPER.experiments["table1_tank"].quoted == {"NLSS2": 0.34, "GRU (black box)": 0.40}
    assert not PAPER.experiments["table1_lgssm"].quoted
