"""Tables print the numbers of metrics.json, all counts, the source, and never hide a failure."""

import io
import re

import pytest
from report_samples import arm, lgssm, tanks
from rich.console import Console

from pgrssnn_jax.reports import content, tables
from pgrssnn_jax.reports.tables import Table


def printed(table: Table, width: int = 80) -> str:
    paper = io.StringIO()
    Console(file=paper, width=width, color_system=None).print(table)
    return paper.getvalue()


def lines(text: str, start: str) -> list[list[str]]:
    return [line.split() for line in text.splitlines() if re.match(rf"\s*{start}\s", line)]


def test_summary_has_one_row_per_n_init_with_the_numbers_of_metrics():
    metrics = tanks(samples=120, members=3).metrics
    said = printed(tables.summary_table(metrics))
    names = ("rmse_mean", "rmse_std", "rmse_median", "rmse_best", "rmse_ensemble", "nrmse_mean")
    for n_init in ("0", "5", "50"):
        (cells,) = lines(said, n_init)
        figures = metrics["summary"]["by_n_init"][n_init]
        assert [float(cell) for cell in cells[1:]] == pytest.approx([figures[name] for name in names], rel=1e-3)
    assert "RMSE in V" in said
    assert "3 planned, 3 finished, 0 failed" in said
    assert "source: file, dataBenchmark.csv" in said


def test_the_headline_stands_even_without_other_windows():
    metrics = tanks(samples=30, members=2).metrics
    metrics["summary"].pop("by_n_init")
    assert [row.n_init for row in content.summary_rows(metrics)] == [0]
    assert content.headline(metrics).mean == metrics["summary"]["rmse_mean"]


def test_every_member_has_its_row():
    run = tanks(samples=120, members=5, failed=(1,))
    said = printed(tables.member_table(run.metrics))
    for member in run.metrics["members"]:
        (cells,) = lines(said, str(member["seed"]))
        if member["test"]:
            assert [float(cell) for cell in cells[4:8]] == pytest.approx(
                [member["test"][name][0] for name in ("rmse", "nrmse", "fit_percent", "cc")], rel=1e-3
            )
            assert cells[2:4] == ["ok", str(member["best_epoch"])]
        else:
            assert cells[2] == "failed"
    assert "a predicted state left the floating-point range (1 of 5)" in " ".join(said.split())


def test_a_long_table_says_what_it_leaves_out_and_never_hides_a_failure():
    metrics = lgssm(members=50, samples=60, failed=(3, 9)).metrics
    table = tables.member_table(metrics)
    said = " ".join(printed(table, 100).split())
    assert f"{50 - tables.SHOWN_MEMBERS} of 50 rows left out" in said
    assert "a predicted state left the floating-point range (2 of 50)" in said
    finished, failed = content.ranked(content.member_rows(metrics))
    assert [cells[0] for _, cells in table.rows] == [str(row.seed) for row in (*finished, *failed)]


def test_no_member_no_sample_no_number():
    metrics = tanks(members=2, samples=1, failed=(0, 1)).metrics
    for said in (printed(tables.summary_table(metrics)), tables.summary_table(metrics)._repr_html_()):
        assert "2 planned, 0 finished, 2 failed" in said
        assert "nan" not in said.lower()
        assert "None" not in said


def test_members_that_never_reported_are_counted():
    metrics = tanks(members=2, samples=20).metrics
    metrics["summary"]["planned"] = 5
    assert "5 planned, 2 finished, 0 failed, 3 without a result" in printed(tables.summary_table(metrics), 100)
    assert content.incomplete(metrics) == "3 of 5 members did not finish"


def test_square_brackets_are_no_markup():
    metrics = tanks(members=1, samples=20, origin="[red]file[/red] [/]").metrics
    assert "[red]file[/red] [/]" in printed(tables.summary_table(metrics), 120)
    metrics["members"][0]["reason"] = "[bold]why[/bold]"
    assert "[bold]why[/bold]" in printed(tables.member_table(metrics), 120)


@pytest.mark.parametrize("make", [tanks, lgssm, arm])
def test_tables_fit_eighty_columns(make):
    metrics = make(samples=70).metrics
    for table in (tables.summary_table(metrics), tables.member_table(metrics)):
        assert "…" not in printed(table, 80)


def test_several_outputs_are_averaged_and_said_so():
    metrics = arm(members=2, samples=30, sequences=1).metrics
    row = content.member_rows(metrics)[0]
    rmse = metrics["members"][0]["test"]["rmse"]
    assert row.rmse == pytest.approx(sum(rmse) / 6)
    assert "mean of 6 outputs" in printed(tables.summary_table(metrics), 100)


def test_a_table_shows_itself_in_a_notebook_escaped():
    table = Table(("name", "figure"), [("failed", ["<b>", content.number(0.123456)])], "a title", ["a line"], ["name"])
    assert table._repr_html_().replace("\n", "") == (
        '<h3>a title</h3><div class="scroll"><table><thead><tr><th class="words">name</th><th>figure</th></tr></thead>'
        '<tbody><tr class="failed"><td class="words">&lt;b&gt;</td><td>0.1235</td></tr>'
        '</tbody></table></div><ul class="notes"><li>a line</li></ul>'
    )
    assert lines(printed(table), "<b>") == [["<b>", "0.1235"]]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.25, "0.2500"),
        (1042.0, "1042"),
        (None, "–"),
        (float("nan"), "–"),
        (float("inf"), "–"),
        (0.0, "0.000"),
        (-3, "-3.000"),
    ],
)
def test_rounding(value, text):
    assert content.number(value) == text


def test_the_deviation_has_the_decimals_of_the_mean():
    assert content.number(0.1799, "V", std=0.03779) == "0.1799 ± 0.0378 V"
    assert content.number(0.1799, "V", std=float("nan")) == "0.1799 V"
    assert content.number(1e30, std=1e29) == "1.000e+30 ± 1e+29"
    assert content.number(0.1799, std=1.234e-6) == "0.1799 ± 1.2e-06"
    assert content.number(0.1799, std=0.0) == "0.1799 ± 0"


def test_mixed_units_have_no_common_unit():
    assert content.unit({"outputs": [{"name": "a", "unit": "V"}, {"name": "b", "unit": "m"}]}) == ""
