"""A group of the configuration becomes arguments, or one sentence."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import pytest

from pgrssnn_jax.records.arguments import call_with


@dataclass(frozen=True)
class Some:
    count: int
    kind: Literal["a", "b"] = "a"
    rate: float = 1.0
    limit: float | None = None
    on: bool = False


def matrix(rows: Sequence[Sequence[float]], notify=None, name: str = "") -> tuple:
    return rows, notify, name


def test_values_arrive_with_their_types():
    some = call_with(Some, {"count": 3, "kind": "b", "rate": 2, "limit": None, "on": True}, "some")
    assert some == Some(3, "b", 2.0, None, True)
    assert isinstance(some.rate, float)
    assert call_with(Some, {"count": 1, "limit": 2}, "some").limit == 2.0


def test_further_arguments_go_where_they_are_taken():
    assert call_with(matrix, {"rows": [[1.0]]}, "m", notify="n", physics="left out") == ([[1.0]], "n", "")
    assert call_with(lambda: 5, {}, "m", notify="n") == 5


@pytest.mark.parametrize(
    ("group", "sentence"),
    [
        ({"count": "many"}, r"some.count: expected int, found 'many'"),
        ({"count": True}, r"some.count: expected int, found True"),
        ({"count": 1.5}, r"some.count: expected int, found 1.5"),
        ({"count": 1, "kind": "c"}, r"some.kind: expected a \| b, found 'c'"),
        ({"count": 1, "limit": "x"}, r"some.limit: expected float \| null, found 'x'"),
        ({"count": 1, "on": 1}, r"some.on: expected bool, found 1"),
        ({"count": 1, "other": 1}, r"some: expected the keys \['count', .*\], found 'other'"),
        ({}, r"some.count: expected a value, found none"),
    ],
)
def test_what_does_not_fit_is_one_sentence(group, sentence):
    with pytest.raises(ValueError, match=sentence):
        call_with(Some, group, "some")


def test_text_is_no_list():
    with pytest.raises(ValueError, match="m.rows: expected a list, found 'abc'"):
        call_with(matrix, {"rows": "abc"}, "m")
