"""Compiler options: asked for only where this XLA knows them, and never before they are needed."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pgrssnn_jax.acceleration import compiler as compilation
from pgrssnn_jax.acceleration.compiler import known, optimised, quick_jit


def test_an_option_that_this_xla_does_not_have_is_unknown():
    assert known({"xla_backend_optimization_level": 0})
    assert not known({"xla_cpu_no_such_option": False})


def test_only_the_lowest_level_asks_for_the_older_emitters():
    assert optimised(None) is None
    assert optimised(2) == {"xla_backend_optimization_level": 2}
    lowest = optimised(0)
    assert lowest is not None
    assert lowest["xla_backend_optimization_level"] == 0
    assert known(lowest)


def test_quick_compilation_gives_the_same_numbers_and_traces_once_per_static_argument():
    traced = []

    def power(n, x):
        traced.append(n)
        return jax.lax.scan(lambda c, _: (jnp.sin(c) ** n, c), x, None, length=20)

    quickly = quick_jit(static_argnums=0)(power)
    found = {n: quickly(n, 0.7) for n in (2, 3, 2)}
    assert traced == [2, 3]
    assert quickly.__name__ == "power"
    for n, both in found.items():
        for got, expected in zip(both, jax.jit(power, static_argnums=0)(n, 0.7), strict=True):
            np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_arguments_may_ask_for_the_usual_compilation(monkeypatch):
    """Options that this XLA does not have tell which way a program went."""
    monkeypatch.setattr(compilation, "_quick", lambda: {"no_such_option": True})
    twice = quick_jit(lambda scale, x: scale > 2, static_argnums=0)(lambda scale, x: 2 * scale * x)
    assert float(twice(3, jnp.asarray(0.5))) == 3.0
    with pytest.raises(jax.errors.JaxRuntimeError, match="No such compile option"):
        twice(2, jnp.asarray(0.5))


def test_importing_discovery_leaves_the_devices_to_be_set():
    code = (
        "import pgrssnn_jax.discovery.discover, jax; jax.config.update('jax_num_cpu_devices', 3);"
        "assert jax.device_count() == 3"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
