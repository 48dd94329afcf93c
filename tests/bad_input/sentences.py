"""Assertions on error messages; a small record and a physics for tests of bad input."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import pgrssnn_jax as pg

LONGEST = 700  # characters of a sentence, long lists of names included


def contents(folder: Path) -> dict[Path, bytes | None]:
    """Everything below a folder; None for a folder."""
    return {path: None if path.is_dir() else path.read_bytes() for path in folder.rglob("*")}


def assert_one_sentence(text: str, *words: str) -> None:
    """One line that names the expected and the found value."""
    assert "\n" not in text, text
    assert re.search("expected .+, found .+", text), text
    assert "Traceback" not in text
    assert len(text) < LONGEST
    for word in words:
        assert word in text, text


def refused(call: Callable[[], object], *words: str) -> None:
    """`ValueError` with one sentence, and nothing written into the current folder."""
    before = contents(Path.cwd())
    with pytest.raises(ValueError) as caught:
        call()
    assert_one_sentence(str(caught.value), *words)
    assert contents(Path.cwd()) == before


NAMES = {"inputs": {"pump_voltage": "V"}, "outputs": {"level_voltage": "V"}}
U = np.repeat(np.random.default_rng(0).uniform(1.0, 4.0, (20, 1)), 8, axis=0)  # [160, 1]
Y = 4.0 + np.convolve(U[:, 0] - 2.5, np.ones(10) / 10)[: len(U), None]


def but(values: np.ndarray, value: Any, at: int = 7) -> np.ndarray:
    """The same signal with another value of one sample."""
    changed = values.copy()
    changed[at] = value
    return changed


def record(u: Any = U, y: Any = Y, **changes: Any) -> pg.Record:
    return pg.record(u, y, **{"dt": 4.0, **NAMES, **changes})


def tanks(**settings: Any) -> pg.Physics:
    return pg.physics.cascaded_tanks(**settings)


def own(derivative: Any = None, measure: Any = None, params: Any = None, **changes: Any) -> pg.Physics:
    """dx/dt = -a x + u, y = x, with anything else in place of its parts."""
    usual = {
        "states": (pg.Signal("x", like="y"),),
        "inputs": (pg.Signal("u"),),
        "outputs": (pg.Signal("y"),),
        "dt": 1.0,
    }
    return pg.continuous(
        "own",
        derivative or (lambda p, x, u: -p["a"] * x + u),
        measure or (lambda p, x, u: x),
        {"a": 0.5} if params is None else params,
        **{**usual, **changes},
    )


def own_record(u: Any = U, y: Any = Y) -> pg.Record:
    return pg.record(u, y, dt=1.0, inputs={"u": ""}, outputs={"y": ""})


def shift(**fields: Any) -> pg.Effect:
    """An effect of one's own that adds a constant to every output."""
    meaning = {"by": pg.Parameter("b", "V", neutral=0.0)}
    usual = pg.Effect("shift", meaning, lambda p: pg.effects.on_output(p, "shift", lambda n, y: y + n["by"]))
    return usual._replace(**fields)


def not_a_number(p: Any, x: Any, u: Any) -> Any:
    return x * jnp.nan
