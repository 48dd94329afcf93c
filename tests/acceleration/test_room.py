"""Programs are dropped when their memory maps are many, and work again afterwards."""

import jax
import jax.numpy as jnp
import pytest

from pgrssnn_jax.acceleration import room


@pytest.fixture
def most(tmp_path, monkeypatch):
    def allow(text: str) -> None:
        (tmp_path / "maps").write_text("7f00-7f01 r-xp\n" * 10)
        (tmp_path / "most").write_text(text)
        monkeypatch.setattr(room, "_MAPS", tmp_path / "maps")
        monkeypatch.setattr(room, "_MOST", tmp_path / "most")

    return allow


def test_programs_are_dropped_where_they_fill_half_of_the_room(most):
    doubled = jax.jit(lambda x: 2 * x)
    assert doubled(jnp.ones(3)).tolist() == [2.0] * 3
    most("19")
    assert room.make_room()
    assert doubled._cache_size() == 0
    assert doubled(jnp.ones(3)).tolist() == [2.0] * 3


@pytest.mark.parametrize("text", ["21", "no number"])
def test_programs_stay_where_there_is_room_or_the_system_does_not_tell(most, text):
    doubled = jax.jit(lambda x: 2 * x)
    doubled(jnp.ones(3))
    most(text)
    assert not room.make_room()
    assert doubled._cache_size() == 1


def test_a_process_that_cannot_see_its_maps_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(room, "_MAPS", tmp_path / "missing")
    assert not room.make_room()
