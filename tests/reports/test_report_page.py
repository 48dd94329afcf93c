"""The page holds everything itself, escapes what it is given, and prints the numbers of metrics.json."""

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from report_samples import CONFIG, ENVIRONMENT, Run, lgssm, tanks

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.pages import run_html
from pgrssnn_jax.reports.prediction import prediction_figure
from pgrssnn_jax.training.run_folder import RunFolder

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
VOID = {"meta", "img", "br", "link", "input", "hr"}


class Reader(HTMLParser):
    """Collects text, attributes that load something; asserts that tags nest."""

    def __init__(self, page: str):
        super().__init__()
        self.text, self.loads, self.anchors, self.ids = "", [], [], []
        self.tags, self.open = set(), []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        for name, value in attributes:
            if name in ("src", "srcset", "data", "action", "poster"):
                self.loads.append(value)
            if name == "href":
                self.anchors.append(value)
            if name == "id":
                self.ids.append(value)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def write(folder: Path, run: Run, **changes) -> str:
    png = folder / "figure.png"
    Figure((2, 1)).savefig(png)
    given = {"figures": {"Prediction": png, "Training": png}, "config_text": CONFIG, "environment": ENVIRONMENT}
    page = run_html(run.metrics, **{**given, **changes})
    RunFolder(folder).write_text("report.html", page)
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("run", [tanks(members=3, samples=60), lgssm(members=30, samples=60, failed=(2, 4))])
def test_the_page_loads_nothing_from_outside(tmp_path, run):
    page = write(tmp_path, run)
    reader = Reader(page)
    assert reader.loads
    assert all(source.startswith("data:image/png;base64,") for source in reader.loads)
    assert all(anchor.startswith("#") and anchor[1:] in reader.ids for anchor in reader.anchors)
    assert len(reader.ids) == len(set(reader.ids))
    assert "http://" not in page
    assert "https://" not in page
    assert "url(" not in page
    assert "@import" not in page
    assert not reader.tags & {"script", "link", "iframe", "object"}
    assert str(tmp_path) not in page


def test_everything_given_is_escaped(tmp_path):
    evil = "<script>alert(1)</script>\"'&"
    run = tanks(members=2, samples=60, failed=(1,), origin=evil, system=evil, outputs=[{"name": evil, "unit": evil}])
    run.metrics["members"][1]["reason"] = evil
    png = tmp_path / "f.png"
    Figure((2, 1)).savefig(png)
    page = write(tmp_path, run, figures={evil: png}, config_text=evil, environment={"commit": evil, "command": evil})
    reader = Reader(page)
    assert "script" not in reader.tags
    assert reader.text.count(evil) >= 8


def test_the_numbers_are_those_of_metrics(tmp_path):
    run = tanks(members=4, samples=60, failed=(3,))
    reader = Reader(write(tmp_path, run))
    summary = run.metrics["summary"]
    flat = [summary, *summary["by_n_init"].values()]
    shown = {v for table in flat for k, v in table.items() if k.startswith(("rmse", "nrmse"))}
    shown |= {v[0] for m in run.metrics["members"] if m["test"] for v in m["test"].values()}
    assert all(content.number(value) in reader.text for value in shown)
    assert f"{summary['finished']} / {summary['planned']}" in reader.text
    assert content.duration(run.metrics["seconds"]["total"]) in reader.text


def test_failed_members_and_simulated_data_are_loud(tmp_path):
    reader = Reader(write(tmp_path, lgssm(members=30, samples=60, failed=(2, 4))))
    assert "2 OF 30 MEMBERS FAILED." in reader.text
    assert "failed: a predicted state left the floating-point range (seed/dataset 2/0, 4/0)" in reader.text
    assert "SIMULATED DATA." in reader.text
    quiet = Reader(write(tmp_path, tanks(members=2, samples=60)))
    assert "FAILED" not in quiet.text
    assert "SIMULATED" not in quiet.text


def test_many_members_are_folded_but_all_there(tmp_path):
    page = write(tmp_path, lgssm(members=50, samples=60))
    assert "All 50 rows" in page


@pytest.mark.parametrize(
    "run",
    [tanks(members=2, samples=60, failed=(0, 1)), tanks(members=1, samples=1)],
    ids=["all failed", "one member, one sample"],
)
def test_small_and_sad_runs(tmp_path, run):
    reader = Reader(write(tmp_path, run, figures={}))
    assert "nan" not in reader.text.lower()
    assert "None" not in reader.text
    assert f"{run.metrics['summary']['failed']} failed" in reader.text


def test_missing_figures(tmp_path):
    run = tanks(members=2, samples=60)
    run.metrics["summary"] |= {"rmse_std": None, "rmse_ensemble": float("nan")}
    run.metrics["summary"]["by_n_init"] = {}
    run.metrics["seconds"] = {"total": None}
    text = Reader(write(tmp_path, run)).text
    assert "nan" not in text.lower()
    assert "None" not in text


def test_reproducing_names_the_commit_and_the_configuration(tmp_path):
    text = Reader(
        write(tmp_path, tanks(members=1, samples=60), environment={**ENVIRONMENT, "command": "train.py a=1"})
    ).text
    assert "git checkout 0123abcd" in text
    assert "train.py a=1" in text
    assert CONFIG.strip() in text
    assert '"jax": "0.10.2"' in text


def test_a_page_that_cannot_be_made_leaves_the_old_one(tmp_path):
    before = write(tmp_path, tanks(members=1, samples=60))
    (tmp_path / "no.png").write_bytes(b"GIF89a")
    for missing in (tmp_path / "no.png", tmp_path / "nothing.png"):
        with pytest.raises(ValueError, match="figures: expected a PNG file"):
            write(tmp_path, tanks(members=2, samples=60), figures={"x": missing})
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["figure.png", "no.png", "report.html"]


def browse(folder: Path, *arguments: str) -> str:
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    flags += " --disable-component-update --disable-sync --hide-scrollbars"
    command = [str(CHROMIUM), *flags.split(), f"--user-data-dir={folder / 'profile'}", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout


def assert_no_wider_than_its_window(folder, page):
    probe = "<script>document.body.dataset.width = document.documentElement.scrollWidth + ' ' + innerWidth</script>"
    allowed = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page).replace(
        "</body>", f"{probe}</body>"
    )
    (folder / "probe.html").write_text(allowed, encoding="utf-8")
    dom = browse(folder, "--dump-dom", "--window-size=500,900", f"file://{folder}/probe.html")
    found = re.search(r'data-width="(\d+) (\d+)"', dom)
    assert found is not None
    assert int(found[1]) <= int(found[2])


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_a_browser_shows_it_and_nothing_overflows(tmp_path):
    run = lgssm(members=30, samples=1600, failed=(2,))
    png = tmp_path / "p.png"
    prediction_figure(run.predictions, run.metrics).savefig(png)
    page = write(tmp_path, run, figures={"Prediction": png})
    browse(
        tmp_path, f"--screenshot={tmp_path / 'shot.png'}", "--window-size=1200,1600", f"file://{tmp_path}/report.html"
    )
    pixels = imread(tmp_path / "shot.png")[..., :3]
    assert pixels.shape[:2] == (1600, 1200)
    assert np.var(pixels) > 0
    assert_no_wider_than_its_window(tmp_path, page)
