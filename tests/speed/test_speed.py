"""The benchmark of speed counts right, keeps its numbers equal, and runs."""

import contextlib
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiler import little_optimised

from benchmarks.speed import tables
from benchmarks.speed.cases import SYSTEMS, inputs, model_and_params, training
from benchmarks.speed.goals import GOALS, Goal
from benchmarks.speed.timing import compiled, count_compilations, interleaved
from benchmarks.speed.work import epoch_work, network_operations, operations, physics_operations
from pgrssnn_jax.models.rollout import rollout

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", ["tanks", pytest.param("arm", marks=pytest.mark.compiles)])
def test_products_counted_by_hand_are_those_of_the_program(name):
    system = SYSTEMS[name]
    model, params = model_and_params(system, system.physics())
    u, x0 = inputs(system, 2, 5, np.float32)

    def run(route):
        return operations(lambda u: rollout(model, params, u, x0, route=route).y, u, products_alone=True)

    by_hand, _ = network_operations(system.spec, model.physics)
    assert run("fused") == 2 * 5 * by_hand == run("split")


def test_an_epoch_counts_as_its_program_does():
    system = SYSTEMS["lgssm"]._replace(train=(3, 20))
    fit, data = training(system, system.physics())
    theta = fit.objective.begin(jax.random.key(0), data)
    of_program = operations(jax.grad(lambda theta: fit.objective.on_train(theta, data).total), theta)
    by_hand = epoch_work(system.spec, fit.objective.model.physics, 1, 3, 20).flops
    assert by_hand == pytest.approx(of_program, rel=0.15)


def test_loops_count_as_often_as_they_run():
    def run(x):
        return jax.lax.scan(lambda x, _: (x * 2.0 + 1.0, None), x, None, length=7)[0]

    assert operations(run, jnp.ones(3)) == 7 * 3 * 2
    assert operations(lambda a: a @ a, jnp.ones((4, 4))) == 2 * 4**3


def test_operations_refuses_what_hides_them():
    with pytest.raises(ValueError, match="found while"):
        operations(lambda x: jax.lax.while_loop(lambda x: x[0] < 9, lambda x: x + 1.0, x), jnp.ones(2))


def test_a_stopped_gradient_costs_no_derivative_of_the_physics():
    free, held = (SYSTEMS["arm"].physics(physics_gradient=gradient) for gradient in ("full", "stopped"))
    once, twice = physics_operations(held), physics_operations(free, derivative=True)
    assert 1.5 * once < twice < 5 * once
    assert epoch_work(SYSTEMS["arm"].spec, held, 4, 1, 10).stages == 40
    assert epoch_work(SYSTEMS["arm"].spec, free, 4, 1, 10).stages == 80


def test_calls_are_measured_in_turn_after_one_round_to_warm_up():
    seen = []
    found = interleaved({name: lambda name=name: seen.append(name) for name in "AB"}, 3)
    assert "".join(name for name, _ in itertools.groupby(seen)) == "AB" * 4
    assert len(seen) > 1000  # short calls are repeated within their turn
    assert [len(found[name]) for name in "AB"] == [3, 3]


def test_a_program_is_compiled_once_and_tells_its_memory():
    program = compiled(jax.jit(lambda a: a @ a + 3.25), jnp.ones((50, 50)))
    assert program.compilations == 1
    before = count_compilations()
    program.call()
    assert count_compilations() == before
    assert program.memory_mb >= 2 * 50 * 50 * 4 / 1e6


def test_a_ratio_is_the_median_over_rounds():
    measured = {"p": {"figures": {"a": {"ms": [9], "rounds": [10, 90, 12]}, "b": {"ms": [2], "rounds": [1, 9, 2]}}}}
    goal = Goal("", "p", "a", "b", 10, 90, more=True)
    assert goal.ratio(measured) == 100
    assert goal.reached(100)
    assert not goal.reached(80)
    assert goal._replace(over="c").ratio(measured) is None


def test_the_page_holds_the_tables_of_its_figures():
    found = json.loads((ROOT / "docs/performance.json").read_text(encoding="utf-8"))
    assert not any(part["quick"] for part in found["measured"].values())
    assert tables.page_text(found) in (ROOT / "docs/performance.md").read_text(encoding="utf-8")


def test_tables_go_between_the_marks_of_a_page(tmp_path):
    figures = {
        GOALS[0].over: {"ms": [1000, 1, 1], "rounds": [1000.0]},
        GOALS[0].under: {"ms": [2, 1, 3], "rounds": [2.0]},
    }
    part = {"cores": 2, "figures": figures, "machine": {"streaming, GB/s": 12.0}, "peak_memory_mb": 1.0}
    part["cpu"] = "a processor"
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- measured: begin -->\nold\n<!-- measured: end -->\nafter\n")
    tables.write({"measured": {GOALS[0].part: part}}, page)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert f"| {GOALS[0].what} | 500 | ≥ 600, missed |" in text
    page.write_text("no marks")
    with pytest.raises(ValueError, match="expected the lines"):
        tables.write({"cpu": "", "measured": {}}, page)


@contextlib.contextmanager
def on_one_core() -> Iterator[None]:
    """What is started inside inherits it."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(cores)[:1])
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["tanks", "arm", "gru", "mappings", "startup"])
def test_the_benchmark_runs(part, tmp_path):
    out = tmp_path / "figures.json"
    command = [sys.executable, "benchmarks/rollout.py", "--quick", "--only", part, "--json", str(out)]
    short = part == "arm" and hasattr(os, "sched_setaffinity")  # measured on one core and on two where there are two
    with on_one_core() if short else contextlib.nullcontext():
        subprocess.run(command, cwd=ROOT, check=True, env={**os.environ, **little_optimised()})
    for found in json.loads(out.read_text())["measured"].values():
        assert found["figures"]
        for figures in found["figures"].values():
            median, low, high = figures["ms"]
            assert 0 < low <= median <= high
            if "roof" in figures:
                assert 0 < figures["roof"]["reached"] < 1
