"""What the tests demand beyond what users do is demanded."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from commands import ROOT
from jaxtyping import Float, TypeCheckError, jaxtyped
from typechecking import checked

from pgrssnn_jax.effects.arm import tilted


def test_shapes_are_checked():
    with pytest.raises(TypeCheckError, match="gravity"):
        tilted(np.zeros(2), jnp.asarray(0.1), jnp.asarray(0.1))


def test_functions_inside_of_others_are_checked_by_their_own_annotations_each_time():
    def made(n: int, kind: type):
        @jaxtyped(typechecker=checked)
        def inner(x: Float[np.ndarray, f"{n}"], factor: kind = 2) -> Float[np.ndarray, f"{n}"]:
            return factor * x[: 2 * n - 1]

        return inner

    for n, kind in ((2, int), (3, int), (3, float), (2, int)):
        one = made(n, kind)
        np.testing.assert_array_equal(one(np.ones(n), kind(3)), 3.0 * np.ones(n))
        with pytest.raises(TypeCheckError):
            one(np.ones(n + 1), kind(3))
        with pytest.raises(TypeCheckError):
            one(np.ones(n), "3")
    with pytest.raises(TypeCheckError):
        made(2, int)(np.ones(2), 3.0)
    with pytest.raises(TypeCheckError):
        made(1, int)(np.ones(2))


def test_arrays_are_not_broadcast_by_rank():
    with pytest.raises(ValueError, match="rank"):
        jnp.zeros(3) + jnp.zeros((2, 3))


@pytest.mark.parametrize(("marks", "until", "begins"), [
    ({"slow"}, "0", False), ({"slow"}, "inf", True), ({"slow"}, None, True), (set(), "0", True),
])  # fmt: skip
def test_only_slow_tests_are_left_out_for_want_of_time_and_each_is_named(request, monkeypatch, marks, until, begins):
    path = str(ROOT / "tests/conftest.py")
    (conftest,) = (one for one in request.config.pluginmanager.get_plugins() if getattr(one, "__file__", "") == path)
    monkeypatch.delenv("SLOW_TESTS_UNTIL", raising=False)
    if until is not None:
        monkeypatch.setenv("SLOW_TESTS_UNTIL", until)
    item = SimpleNamespace(nodeid="a_test", get_closest_marker=lambda name: name in marks)
    if begins:
        conftest.pytest_runtest_setup(item)
    else:
        with pytest.raises(pytest.skip.Exception, match="a_test"):
            conftest.pytest_runtest_setup(item)
