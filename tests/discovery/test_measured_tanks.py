"""The measured tanks: what their physics lacks, and how near it comes with that."""

import pytest

import pgrssnn_jax as pg


@pytest.mark.slow
@pytest.mark.data
def test_the_measured_tanks_overflow_and_their_sensor_is_curved():
    train, test = pg.load_benchmark("cascaded_tank")
    found = pg.discover(pg.physics.cascaded_tanks(clamp=True), train, test, network_epochs=0, quiet=True)
    assert found.verdict == "effect_found"
    assert {effect.name for effect in found.effects} == {
        "overflow_1to2",
        "tank2_overflow",
        "sensor_nonlinearity",
        "input_delay",
    }
    assert found.gap["after"]["test"] < 0.19, "V, the best grey box reported"
    assert found.gap["recalibrated"]["test"] > 0.6
    rims = {effect.name: effect.parameters["level"]["value"] for effect in found.effects if "overflow" in effect.name}
    assert 5.0 < rims["overflow_1to2"] < 12.0, "V"
    assert 9.0 < rims["tank2_overflow"] < 10.1, "V"
    nominal, own = pg.physics.cascaded_tanks().params, found.physics.params.own
    for name, known in nominal.items():
        assert abs(own[name] - known) < 1.96 * 0.5 * known, "within the prior of the physics"
