"""The command from end to end, as a user types it: files, pictures, tables on the screen, and bad input."""

import csv
import io
import threading

import pytest
from commands import called, command, composed
from omegaconf import OmegaConf
from paper_samples import begin_run, spread_over, write_run
from rich.console import Console

from pgrssnn_jax.cli.report import prepare_report, report_run, run_roots
from pgrssnn_jax.paper.collect import collect
from pgrssnn_jax.paper.published import read_paper
from pgrssnn_jax.paper.rows import evidence_tables
from pgrssnn_jax.reports.rendering import PNG_SIGNATURE
from report import as_typed


@pytest.fixture
def sweeps(tmp_path):
    write_run(tmp_path / "table1_tank/model=pg_rssnn", spread_over(0.39, 0.05, 10))
    begin_run(tmp_path / "table1_tank/model=rssnn", model="rssnn")
    (write_run(tmp_path / "table1_tank/model=fcssnn", [1.0], model="fcssnn") / "metrics.json").write_text("oops")
    write_run(tmp_path / "data_efficiency_tank/data.n_train=128,model=rssnn", [0.9, 1.0], model="rssnn")
    return tmp_path


def test_two_folders_become_tables_figures_and_a_page(sweeps):
    before = set(sweeps.rglob("*"))
    code, out, err = command("runs=table1_tank,data_efficiency_tank", "out=made", cwd=sweeps, script="report.py")
    assert code == 0, err
    assert err == ""
    made = {
        str(path.relative_to(sweeps / "made")) for path in sweeps.rglob("*") if path not in before and path.is_file()
    }
    figures = {
        f"figures/{name}.png"
        for name in (
            "table1-tank-boxes",
            "data-efficiency-tank-boxes",
            "data-efficiency-tank-samples",
            "data-efficiency-tank-overlay",
        )
    }
    assert made == {"tables.md", "tables.csv", "tables.tex", "report.html"} | figures
    for name in figures:
        assert (sweeps / "made" / name).read_bytes().startswith(PNG_SIGNATURE)
    text = (sweeps / "made/tables.csv").read_text(encoding="utf-8")
    rows = {row["folder"]: row for row in csv.DictReader(io.StringIO(text))}
    assert rows["table1_tank/model=pg_rssnn"]["finished"] == "10"
    assert rows["table1_tank/model=fcssnn"]["state"] == "damaged"
    assert rows["table1_tank/model=rssnn"]["state"] == "unfinished"
    assert "0.3900 ± 0.0500" in out
    assert "FCSSNN: damaged: metrics.json: expected JSON" in out
    assert "page: made/report.html" in out


def test_the_same_runs_make_the_same_report(sweeps):
    paper, roots = read_paper(), [sweeps / "table1_tank"]

    def report() -> dict[str, bytes]:
        runs = collect(roots, paper)
        screen = Console(file=io.StringIO(), width=100)
        report_run(evidence_tables(runs, paper), runs, paper, roots[0], screen, "python report.py", threading.Event())
        files = [path for path in roots[0].rglob("*") if path.suffix in (".md", ".csv", ".tex", ".html", ".png")]
        return {str(path.relative_to(roots[0])): path.read_bytes() for path in files}

    first = report()
    assert sorted(first) == ["figures/table1-tank-boxes.png", "report.html", "tables.csv", "tables.md", "tables.tex"]
    assert report() == first


@pytest.mark.parametrize(
    "text", ["a", "a,b", "runs/data.n_train=128,model=rssnn", "a b", 'a"b', "[a,b]", "'a,b'", "2026", "~/x", "{a}"]
)
def test_a_folder_is_read_as_it_was_typed(text):
    """An = or a comma means something to Hydra; lists and quoted text are Hydra's."""
    typed = as_typed(f"runs={text}")
    config = composed(typed, name="report")
    expected = ["a", "b"] if text == "[a,b]" else "a,b" if text == "'a,b'" else text
    assert (config["runs"] if text != "2026" else str(config["runs"])) == expected
    assert as_typed("hydra.verbose=a,b") == "hydra.verbose=a,b"
    assert as_typed("runs=") == "runs="


def test_folders_as_text_with_commas_or_as_a_list(sweeps, monkeypatch):
    monkeypatch.chdir(sweeps)
    for given in ("table1_tank,data_efficiency_tank", ["table1_tank", "data_efficiency_tank"]):
        assert [path.name for path in run_roots(given)] == ["table1_tank", "data_efficiency_tank"]
    for given in ("table1_tank,nowhere", ["nowhere"], "table1_tank,", ""):
        with pytest.raises(ValueError, match="runs: expected a folder, or several with commas between them, found '"):
            run_roots(given)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"runs": "empty"}, "runs: expected a folder with runs of train.py, found none below empty"),
        ({"runs": "table1_tank/model=fcssnn", "out": "x"}, "metrics.json: expected JSON"),
        ({"runs": "table1_tank/model=pg_rssnn"}, "out: expected a folder that is not a run's"),
        ({"runs": "table1_tank", "out": "file"}, "out: expected a folder, found the file 'file'"),
        ({"runs": "table1_tank", "size": 3}, "expected the keys .'out', 'runs', 'verify'., found 'size'"),
        ({"runs": "???"}, "runs: expected a value"),
        ({}, "configuration: expected runs=FOLDER or verify=RUN, found neither"),
        ({"runs": "table1_tank", "verify": "table1_tank"}, "expected runs=FOLDER or verify=RUN, found both"),
        ({"verify": "nowhere"}, "verify: expected a folder, or several with commas between them, found 'nowhere'"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(sweeps, monkeypatch, settings, message):
    monkeypatch.chdir(sweeps)
    (sweeps / "empty").mkdir()
    (sweeps / "file").touch()
    before = sorted(sweeps.rglob("*"))
    with pytest.raises(ValueError, match=message) as problem:
        prepare_report(OmegaConf.create({"runs": None, "verify": None, "out": None, **settings}))
    assert "\n" not in str(problem.value)
    assert sorted(sweeps.rglob("*")) == before


def test_bad_input_ends_with_exit_code_2(tmp_path):
    code, _, err = called("runs=nowhere", cwd=tmp_path, script="report.py")
    assert code == 2
    assert err == "error: runs: expected a folder, or several with commas between them, found 'nowhere'\n"
    assert list(tmp_path.iterdir()) == []
