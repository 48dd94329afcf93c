"""The tables as text: every number where it belongs, nothing hidden, every format with its own escapes."""

import csv
import io
import re
import shutil
import subprocess

import pytest
from paper_samples import begin_run, fail_run, spread_over, write_run
from rich.console import Console

from pgrssnn_jax.paper import tables as text
from pgrssnn_jax.paper.collect import collect
from pgrssnn_jax.paper.published import Value, read_paper
from pgrssnn_jax.paper.rows import evidence_tables

PAPER = read_paper()
EVIL = r"50 % of $x_1^2$ & {a}|b# ~ \cmd <b>*[d](e)`f` -- \n ± Ω" + '"'


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """One of each: good, with failed members, unfinished, failed, damaged, missing."""
    folder = tmp_path_factory.mktemp("sweep") / "table1_tank"
    write_run(folder / "model=pg_rssnn", spread_over(0.39, 0.05, 10), seconds=20.0)
    write_run(folder / "model=fcssnn", spread_over(1.9, 0.2, 10, failed=(3, 8)), model="fcssnn", seconds=7200.0)
    write_run(folder / "model=physics_only", [0.852], model="physics_only", seconds=1.5)
    begin_run(folder / "model=rssnn", model="rssnn")
    fail_run(folder / "model=rssnn_sgm", EVIL)
    (write_run(folder / "model=rssnn_fb", [0.5], model="rssnn_fb") / "metrics.json").write_text("[]")
    return folder


@pytest.fixture(scope="module")
def table(sweep):
    (found,) = evidence_tables(collect([sweep], PAPER), PAPER)
    return found


def printed(table, width=130) -> str:
    paper = io.StringIO()
    Console(file=paper, width=width, color_system=None).print(text.terminal_table(table, PAPER))
    return paper.getvalue()


def flat(said: str) -> str:
    return " ".join(said.split())


def test_the_terminal_shows_every_row_with_its_counts(table):
    said = printed(table)
    rows = {line.split("  ")[1].strip(): line.split() for line in said.splitlines() if line.startswith("  ")}
    shown = rows["PG-RSSNN"]
    assert " ".join(shown[1:]) == "0.3900 ± 0.0500 10 / 10 0.44, best 0.34 -2.2"
    assert "1.70 (6/10)" in said
    assert rows["RSSNN"][1] == "unfinished"
    assert rows["RSSNN-sgm"][1] == "failed"
    assert rows["RSSNN(fb)"][1] == "damaged"
    assert rows["PG-FCSSNN"][1] == "missing"
    assert rows["W-PGNN"][-2:] == ["–", "–"]


def test_what_is_wrong_stands_below(table):
    lines = text.problems(table)
    assert "RSSNN: unfinished: stopped or still running, there is no DONE" in lines
    assert f"RSSNN-sgm: failed: {EVIL}" in lines
    assert any(line.startswith("RSSNN(fb): damaged: metrics.json: expected the form") for line in lines)
    assert "missing, no run folder: FCSSNN-sgm, PG-FCSSNN-sgm, PG-RSSNN-sgm, PG-FCSSNN, PG-RSSNN(fb), W-PGNN" in lines
    assert "FCSSNN: 2 of 10 members failed: a predicted state left the floating-point range (seed 3, 8)" in lines
    assert all(flat(line) in flat(printed(table)) for line in lines)


def test_the_rule_the_quotes_and_the_cost_are_stated(table):
    said = flat(printed(table))
    assert "(mean - published) / sqrt(std² (1/n + 1/n_p) + d²/12)" in said
    assert "(10 unless some failed)" in said
    assert "† quoted by the paper from the literature, not measured here" in said
    assert "NLSS2 † – – 0.34 –" in said
    assert "cost: 7222 s (2.0 h) in all, over 3 runs that tell their time" in said


@pytest.mark.parametrize("width", [60, 80, 100])
def test_a_narrow_terminal_loses_no_letter(table, width):
    said = printed(table, width)
    assert "…" not in said
    assert max(map(len, said.splitlines())) <= width
    for row in table.rows:
        assert all(word in said for word in row.label.split())
    assert {"0.3900", "0.0500"} <= set(said.split())


def test_members_that_never_reported_and_simulated_data_are_said(tmp_path):
    summary = {"planned": 5, "finished": 2, "failed": 0, "rmse_ensemble": 0.5}
    write_run(tmp_path / "table1_tank/model=rssnn", [0.5, 0.6], model="rssnn", summary=summary, source="simulated")
    (table,) = evidence_tables(collect([tmp_path], PAPER), PAPER)
    lines = text.problems(table)
    assert "RSSNN: 3 of 5 members without a result" in lines
    assert "SIMULATED DATA, generated here: RSSNN" in lines
    assert "2 / 5" in printed(table)


def test_many_failed_members_are_counted_and_the_first_ones_named(tmp_path):
    write_run(tmp_path / "table1_tank/model=rssnn", [None] * 20 + [0.5], model="rssnn")
    (table,) = evidence_tables(collect([tmp_path], PAPER), PAPER)
    (line,) = [line for line in text.problems(table) if line.startswith("RSSNN:")]
    assert line.startswith("RSSNN: 20 of 21 members failed: ")
    assert line.endswith("(seed 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11 and 8 more)")


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, "–"),
        (Value(0.44, 10, 10, 0.34), "0.44, best 0.34"),
        (Value(1.7, 10, 6, None), "1.70 (6/10)"),
        (Value(None, 10, 0, None), "– (0/10)"),
    ],
)
def test_published_figures_as_the_paper_prints_them(value, shown):
    assert text.published(value) == shown


def test_markdown_is_a_table_of_equal_columns_with_everything_escaped(table):
    said = text.markdown([table], PAPER)
    rows = [re.sub(r"\\.", "", line) for line in said.splitlines() if line.startswith("|")]
    assert len(rows) == 2 + len(table.rows)
    assert len({row.count("|") for row in rows}) == 1
    assert "| *NLSS2 †* |" in said
    (line,) = [line for line in said.splitlines() if line.startswith("- RSSNN-sgm")]
    assert re.sub(r"\\(?=[\\`*_\[\]<>#~|])", "", line) == f"- RSSNN-sgm: failed: {EVIL}"
    assert not re.search(r"(?<!\\)[<>`]", said)


def test_csv_is_tidy_and_unrounded(table):
    rows = list(csv.DictReader(io.StringIO(text.frame([table]).to_csv(index=False))))
    assert len(rows) == len(table.rows)
    found = {row["variant"]: row for row in rows}
    good = found["PG-RSSNN"]
    assert float(good["mean"]) == table.measured[-2].figures.mean
    assert (good["planned"], good["finished"], good["failed"], good["n_train"]) == ("10", "10", "0", "768")
    assert (good["published"], good["published_best"], good["merit"], good["unit"]) == ("0.44", "0.34", "rmse", "V")
    assert good["folder"] == "table1_tank/model=pg_rssnn"
    assert found["RSSNN-sgm"]["reason"] == EVIL
    assert found["FCSSNN"]["reason"] == "a predicted state left the floating-point range"
    assert found["PG-FCSSNN"]["state"] == "missing"
    assert found["PG-FCSSNN"]["mean"] == ""
    assert found["NLSS2"]["state"] == "quoted"


def test_latex_escapes_what_latex_would_obey():
    said = text.latex_escaped(EVIL)
    assert (
        r"50 \% of \$x\_1\textasciicircum{}2\$ \& \{a\}$|$b\# \textasciitilde{} \textbackslash{}cmd $<$b$>${*}" in said
    )
    assert r"-{}- \textbackslash{}n $\pm$ ?''" in said
    assert said.isascii()


def test_latex_has_one_float_per_table_with_caption_label_and_rules(table, sweep, tmp_path):
    write_run(tmp_path / "table1_lgssm/model=rssnn", [1.4, 1.5], model="rssnn", system="lgssm")
    both = evidence_tables(collect([sweep, tmp_path], PAPER), PAPER)
    said = text.latex(both, PAPER)
    assert said.count(r"\begin{table}") == said.count(r"\end{table}") == 2
    assert said.count(r"\toprule") == said.count(r"\midrule") == said.count(r"\bottomrule") == 2
    assert r"\caption{Table 1 $\cdot$ cascaded tanks: test RMSE in V, beside the figures of" in said
    assert r"\label{tab:table1-tank}" in said
    assert r"\textit{NLSS2 $^\dagger$} & " in said
    columns = re.search(r"\\begin\{tabular\}\{(\w+)\}", said)
    assert columns is not None
    body = [line for line in said.splitlines() if " & " in line]
    assert {len(re.findall(r"(?<!\\)&", line)) + 1 for line in body} == {len(columns[1])}


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no pdflatex here")
def test_latex_compiles_with_booktabs_alone(table, tmp_path):
    (tmp_path / "tables.tex").write_text(text.latex([table], PAPER), encoding="utf-8")
    frame = (
        "\\documentclass{article}\n\\usepackage{booktabs}\n\\begin{document}\n\\input{tables.tex}\n\\end{document}\n"
    )
    (tmp_path / "all.tex").write_text(frame)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Overfull" not in done.stdout
