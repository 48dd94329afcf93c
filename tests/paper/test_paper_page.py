"""The page of many runs holds everything itself, escapes what it is given."""

import re

import pytest
from matplotlib.figure import Figure
from paper_samples import begin_run, fail_run, spread_over, write_run
from test_report_page import CHROMIUM, Reader, assert_no_wider_than_its_window

from pgrssnn_jax.paper.collect import collect
from pgrssnn_jax.paper.page import evidence_page
from pgrssnn_jax.paper.published import read_paper
from pgrssnn_jax.paper.rows import evidence_tables
from pgrssnn_jax.paper.tables import notes, problems
from pgrssnn_jax.reports.content import duration, number

PAPER = read_paper()
EVIL = "<script>alert(1)</script>\"'&"


def made(folder, *roots):
    runs = collect(roots, PAPER)
    tables = evidence_tables(runs, PAPER)
    png = folder / "figure.png"
    Figure((2, 1)).savefig(png)
    pictures = {table.slug: [(f"{table.title}: seeds", "what to look at", png)] for table in tables}
    return runs, tables, evidence_page(tables, runs, PAPER, pictures, f"python report.py runs={EVIL}")


@pytest.fixture
def sweep(tmp_path):
    folder = tmp_path / "table1_tank"
    write_run(folder / "model=pg_rssnn", spread_over(0.39, 0.05, 10))
    write_run(folder / "model=fcssnn", spread_over(1.9, 0.2, 10, failed=(3, 8)), model="fcssnn")
    begin_run(folder / "model=rssnn", model="rssnn")
    fail_run(folder / "model=rssnn_sgm", EVIL)
    write_run(tmp_path / "data_efficiency_tank/data.n_train=128,model=rssnn", [0.9, 1.0], model="rssnn")
    return tmp_path


def test_the_page_loads_nothing_and_escapes_everything(tmp_path, sweep):
    _, tables, page = made(tmp_path, sweep)
    reader = Reader(page)
    assert len(reader.loads) == len(tables)
    assert all(source.startswith("data:image/png;base64,") for source in reader.loads)
    assert all(anchor.startswith("#") and anchor[1:] in reader.ids for anchor in reader.anchors)
    assert len(reader.ids) == len(set(reader.ids))
    assert not reader.tags & {"script", "link", "iframe", "object"}
    assert not re.search(r"https?://|url\(|@import", page)
    assert str(tmp_path.parent) not in page
    assert reader.text.count(EVIL) == 3  # the reason in its table and among the runs, and the command


def test_every_row_note_and_run_is_there(tmp_path, sweep):
    runs, tables, page = made(tmp_path, sweep)
    text = Reader(page).text
    for table in tables:
        assert all(row.label in text for row in table.rows)
        assert all(line in text for line in [*problems(table), *notes(table, PAPER)])
    assert all(run.name in text for run in runs)
    assert "runs finished3 / 5" in text.replace("\n", "")
    assert "20 of 32" not in text
    assert "20 / 32" in text.replace("\n", "")  # members: 10 + 8 + 2 of 10 + 10 + 10 + 2
    assert "2 failed" in text


def test_the_numbers_are_those_of_the_tables(tmp_path, sweep):
    _, tables, page = made(tmp_path, sweep)
    text = Reader(page).text
    for row in (row for table in tables for row in table.measured):
        assert number(row.figures.mean, std=row.figures.std) in text
        assert all(number(value) in text for value in row.figures[2:5])
        assert duration(row.seconds) in text
        assert row.published is None or f"{row.published.mean:.2f}" in text


def test_quoted_failed_and_capped_rows_look_the_part(tmp_path, sweep):
    write_run(sweep / "table1_lgssm_smoke/model=rssnn", [1.4], model="rssnn", system="lgssm", source="simulated")
    _, _, page = made(tmp_path, sweep)
    assert re.search(r'<tr class="quoted"><td class="words">NLSS2 †</td>', page)
    assert re.search(r'<tr class="failed"><td class="words">RSSNN</td><td>unfinished</td>', page)
    text = Reader(page).text
    assert "SIMULATED DATA. In 1 of 4 runs" in text
    assert "CAPPED RUNS. Table 1 · LGSSM · budget smoke" in text


def test_a_good_report_has_no_banner(tmp_path):
    write_run(tmp_path / "free/mine", [0.5, 0.6], experiment="cascaded_tank")
    _, _, page = made(tmp_path, tmp_path)
    assert 'class="banner"' not in page
    assert "0 variants without any run" in page


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_nothing_is_wider_than_a_small_window(tmp_path, sweep):
    _, _, page = made(tmp_path, sweep)
    assert_no_wider_than_its_window(tmp_path, page)
