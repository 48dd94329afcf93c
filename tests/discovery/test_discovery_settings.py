"""Which settings of a discovery are refused, and the least that is not."""

import pytest

from pgrssnn_jax.discovery.settings import DiscoverySettings

LEAST = {
    "starts": 1, "folds": 2, "block": 2, "n_init": 1, "steps": 1, "most": 1, "draws": 99, "seed": 0,
    "network_epochs": 0,
}  # fmt: skip


@pytest.mark.parametrize(("name", "least"), LEAST.items())
def test_a_count_may_be_its_least_and_no_less(name, least):
    assert getattr(DiscoverySettings(**{name: least}), name) == least
    with pytest.raises(ValueError, match=f"discovery.{name}: expected at least {least}, found {least - 1}$"):
        DiscoverySettings(**{name: least - 1})


@pytest.mark.parametrize("name", ["p_value", "share"])
def test_a_share_lies_between_none_and_all(name):
    assert getattr(DiscoverySettings(**{name: 0.5}), name) == 0.5
    for wrong in (-0.1, 0.0, 1.0):
        with pytest.raises(ValueError, match=f"discovery.{name}: expected a number between 0 and 1, found {wrong:g}$"):
            DiscoverySettings(**{name: wrong})
