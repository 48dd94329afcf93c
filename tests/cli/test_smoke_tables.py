"""Every table of the paper from one command, small: each experiment whole, and the report of what it wrote."""

import itertools

import pandas as pd
import pytest
from commands import ROOT, command
from omegaconf import OmegaConf

EXPERIMENTS = sorted(path.stem for path in (ROOT / "conf/experiment").glob("*.yaml") if "sweeper" in path.read_text())


def jobs(experiment: str) -> set[frozenset[str]]:
    """Names of the runs that the experiment sweeps over."""
    swept = OmegaConf.load(ROOT / f"conf/experiment/{experiment}.yaml").hydra.sweeper.params
    values = [[f"{name}={value.strip()}" for value in str(text).split(",")] for name, text in swept.items()]
    return {frozenset(job) for job in itertools.product(*values)}


def test_all_tables_and_figures_of_the_paper_are_here():
    assert len(EXPERIMENTS) == 7


@pytest.mark.slow
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_a_table_runs_whole_within_its_smallest_budget_and_is_reported(tmp_path, experiment):
    code, out, err = command("-m", f"+experiment={experiment}", "budget=smoke", cwd=tmp_path, seconds=1500)
    assert code == 0, out + err
    folders = [path for path in (tmp_path / f"runs/{experiment}_smoke").iterdir() if path.is_dir()]
    assert {frozenset(path.name.split(",")) for path in folders} == jobs(experiment)
    assert all((path / "DONE").exists() for path in folders)
    code, out, err = command(f"runs=runs/{experiment}_smoke", cwd=tmp_path, script="report.py")
    assert code == 0, out + err
    (table,) = tmp_path.rglob("tables.csv")
    rows = pd.read_csv(table).dropna(subset="folder")  # the others are quoted
    assert sorted(rows["folder"]) == sorted(f"{experiment}_smoke/{path.name}" for path in folders)
    assert (rows["finished"] + rows["failed"] == rows["planned"]).all()
    assert set(rows["planned"]) <= {1, 2}
    assert rows.loc[rows["finished"] > 0, "mean"].gt(0).all()
