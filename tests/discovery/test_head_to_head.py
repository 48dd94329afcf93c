"""The comparison with other methods: one small case of each, the mapping from terms to effects, and the page."""

import json
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec

import pytest
from commands import ROOT, command

from benchmarks.hidden import suite
from benchmarks.hidden.score import is_right
from benchmarks.hidden.suite import Plan
from benchmarks.hidden.terms import MEANING, size_of

SCRIPT = "benchmarks/head_to_head.py"
PAGE, ROWS = ROOT / "docs" / "head_to_head.md", ROOT / "docs" / "head_to_head.jsonl"
needs_pysindy = pytest.mark.skipif(find_spec("pysindy") is None, reason="pysindy is not installed: extra `compare`")
needs_adcd = pytest.mark.skipif(find_spec("adcd") is None, reason="adcd is not installed: extra `compare`")


@pytest.fixture
def tables(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return import_module("head_to_head_tables").tables


@needs_pysindy
@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "size"),
    [("input_offset", "u_offset"), ("quadratic_drag", "drag")],
)
def test_pysindy_names_an_effect_that_is_a_term(truth, size):
    from benchmarks.hidden import with_pysindy
    from benchmarks.hidden.nominal import nominal

    case = suite.build(Plan("duffing", 4, "single", (truth,), (), 0.0005))
    found = with_pysindy.regressed(case)
    term, c = found.terms[0]
    assert truth in MEANING[term.role, term.shape]
    estimate = size_of(truth, term, c, found.physics, nominal(case))
    assert estimate == pytest.approx(case.magnitudes[size], rel=0.15)
    assert found.given == []


@needs_pysindy
@pytest.mark.compiles
def test_pysindy_is_given_the_state_that_nobody_measures():
    from benchmarks.hidden import with_pysindy

    assert with_pysindy.regressed(suite.build(Plan("tanks", 4, "none", (), (), 0.005))).given == ["upper_level"]


@needs_pysindy
@pytest.mark.compiles
def test_the_script_goes_on_where_it_was(tmp_path):
    arguments = ["--only", "pysindy", "--parts", "suite", "--systems", "duffing", "--json", str(tmp_path / "rows")]
    for cases in (1, 2, 2):
        code, out, err = command(*arguments, "--cases", str(cases), cwd=tmp_path, script=SCRIPT)
        assert code == 0, err
        assert "| PySINDy |" in out
    rows = [json.loads(line) for line in (tmp_path / "rows").read_text().splitlines()]
    assert [row["kind"] for row in rows] == ["single", "none"]


@needs_adcd
@pytest.mark.slow
def test_adcd_finds_its_own_drag_and_every_scenario_is_accounted_for():
    """In a process of its own: importing adcd changes the precision of JAX."""
    code = (
        "import json; from benchmarks.hidden import with_adcd; row = with_adcd.at_home('Nonlinear Drag', 0);"
        "print(json.dumps([row['right'], list(with_adcd.scenarios()), list(with_adcd.LAWS), with_adcd.NO_MOTION]))"
    )
    run = subprocess.run([sys.executable, "-W", "ignore", "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    right, names, laws, others = json.loads(run.stdout.splitlines()[-1])
    assert right
    for name in names:
        reasons = [why for why, beginnings in others.items() if any(name.startswith(one) for one in beginnings)]
        assert (name in laws) + len(reasons) == 1, name


@pytest.mark.slow
def test_discovery_names_the_drag_of_adcd(tmp_path):
    code, _, err = command(
        *("--only", "ours", "--parts", "laws", "--most", "2", "--json", str(tmp_path / "rows")),
        cwd=tmp_path,
        script=SCRIPT,
        seconds=900,
    )
    assert code == 0, err
    rows = {row["truth"][0]: row for row in map(json.loads, (tmp_path / "rows").read_text().splitlines())}
    assert rows["Nonlinear Drag"]["names"] == ["quadratic_drag"]


def test_a_law_without_a_name_is_right_only_alone():
    case = suite.build(Plan("duffing", 4, "none", (), (), 0.0005))
    assert is_right(case, "unnamed", [], "unknown_effect")
    assert not is_right(case, "unnamed", ["hard_stop"], "unknown_effect")
    assert not is_right(case, "unnamed", [], "unexplained")


def test_tables_count_who_is_right_alone(tables):
    def row(method, seed, kind, **scores):
        known = {"part": "suite", "method": method, "system": "duffing", "seed": seed, "kind": kind}
        truth = ["cubic_spring"] if kind == "single" else []
        scores = {"first": False, "right": False, "found": False, "before": 9.0, "after": 1.0, "seconds": 2.0} | scores
        return known | {"truth": truth, "parameter_error": None, "given": []} | scores

    rows = [
        row("ours", 1, "single", first=True, right=True, parameter_error=0.02),
        row("pysindy", 1, "single", first=True, parameter_error=0.01, after=5.0),
        row("ours", 2, "none", right=True),
        row("pysindy", 2, "none", found=True, seconds=1.0),
    ]
    text = tables(rows)
    assert "| pgrssnn_jax | 1/1 (21–100 %) | 1/1 (21–100 %) | 2.0 % of 1 | 1.00 | 100 % | 0/1 (0–79 %) | 2 |" in text
    assert "| PySINDy | 1/1 (21–100 %) | 0/1 (0–79 %) | 1.0 % of 1 | 5.00 | 50 % | 1/1 (21–100 %) | 2 |" in text
    assert "| PySINDy | right, and the other is not | 1 | 1 | 0 |" in text
    assert "| PySINDy | closer parameter, where both have the right one | 1 | 0 | 1 |" in text
    assert "| PySINDy | less processor time | 2 | 0 | 1 |" in text


def test_the_page_holds_the_tables_of_its_rows(tables):
    text = tables([json.loads(line) for line in ROWS.read_text(encoding="utf-8").splitlines()])
    assert text in PAGE.read_text(encoding="utf-8")
