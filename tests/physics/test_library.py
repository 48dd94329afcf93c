"""Builders of the package by the names of a configuration."""

import pytest

import pgrssnn_jax as pg
from pgrssnn_jax.physics.library import library_builder


def test_a_builder_is_found_by_its_full_name():
    assert library_builder("pgrssnn_jax.physics.cascaded_tanks") is pg.physics.cascaded_tanks


@pytest.mark.parametrize("target", ["pgrssnn_jax.physics.nothing", "cascaded_tanks", "other.cascaded_tanks", ""])
def test_other_names_are_none_of_the_packages(target):
    assert library_builder(target) is None
