"""The facts of a discovery, as its page and its tables say them."""

import math

from discovery_samples import ARM

from pgrssnn_jax.reports import discovery_facts as facts


def test_numbers_by_joint_name_their_joint():
    rows = facts.quantities(ARM[0]["effects"][0])
    assert [(row.name, row.value, row.std) for row in rows] == [
        ("c, joint 2", 812.4, 14.2),
        ("c, joint 3", 655.1, 19.9),
    ]
    gain = {"parameters": {"g": {"value": [1.0, 2.0], "std": None, "symbol": "g"}}, "channels": "output"}
    assert [row.name for row in facts.quantities(gain)] == ["g, output 1", "g, output 2"]
    named = gain | {"channel_names": ["level", "temperature"]}
    assert [row.name for row in facts.quantities(named)] == ["g, level", "g, temperature"]
    (one,) = facts.quantities(named | {"acts_at": ["temperature"]})
    assert (one.name, one.value) == ("g, temperature", 2.0)


def test_an_effect_that_leaves_most_of_the_gap_open_is_a_part_of_what_is_missing():
    found = {"verdict": "effect_found", "effects": [{}], "gap": {"open_fraction": 0.4}}
    assert facts.heading(found) == facts.VERDICTS["effect_found"]
    assert facts.heading(found | {"gap": {"open_fraction": 0.9}}) == "A part of what is missing was found"


def test_numbers_of_channels_have_the_units_of_their_signals():
    offset = {"value": [0.1, 0.2], "std": [0.01, 0.02], "symbol": "b", "unit": "V, K"}
    rows = facts.quantities({"parameters": {"offset": offset}, "channel_names": ["level", "temperature"]})
    assert [row.unit for row in rows] == ["V", "K"]


def test_a_limit_that_is_not_there_is_no_quantity():
    high = {"value": [0.9, math.inf], "std": [0.01, 0.0], "symbol": "y_max"}
    low = {"value": [None, None], "std": [0.0, 0.0], "symbol": "y_min"}
    effect = {"parameters": {"high": high, "low": low}, "channels": "output"}
    assert [(row.name, row.value) for row in facts.quantities(effect)] == [("y_max, output 1", 0.9)]
