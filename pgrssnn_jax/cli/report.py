"""What `report.py` does: run folders -> tables -> files, figures and one page, and the tables in the terminal; or runs
that are evaluated again and compared with the figures in their folders."""

import shlex
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from matplotlib.figure import Figure
from omegaconf import DictConfig
from rich.console import Console

from pgrssnn_jax.cli.entry import Work
from pgrssnn_jax.cli.plan import plain_config
from pgrssnn_jax.cli.process import Interrupted, say
from pgrssnn_jax.paper.collect import MARKS, FoundRun, collect
from pgrssnn_jax.paper.figures import box_figure, can_be_curves, efficiency_figure, overlay_figure
from pgrssnn_jax.paper.page import Pictures, evidence_page
from pgrssnn_jax.paper.published import Paper, read_paper
from pgrssnn_jax.paper.rows import EvidenceTable, evidence_tables
from pgrssnn_jax.paper.tables import frame, latex, markdown, terminal_table
from pgrssnn_jax.reports.write import save_figures
from pgrssnn_jax.results.verify import verify
from pgrssnn_jax.training.run_folder import RunFolder, short_path

_KEYS = {"runs", "out", "verify"}
_DIFFERENT = 3  # exit code of a run that could not be reproduced

FIGURES: dict[str, tuple[Callable[[EvidenceTable, Paper], Figure], str, str]] = {
    "boxes": (
        box_figure,
        "seeds",
        "Test error of every finished member. Boxes hold the middle half of the members, whiskers all of them; diamonds"
        " are the published means. The right margin states how many members finished, and which failed.",
    ),
    "samples": (
        efficiency_figure,
        "error and correlation against the training samples",
        "Means over finished members; the bands hold all of them, dots are single ones.",
    ),
    "overlay": (
        overlay_figure,
        "predictions with the fewest samples",
        "Free run over the test record: a part from its middle, sample by sample, and the whole record.",
    ),
}
"""By the end of a file's name: how a figure is made, and what its page says of it."""


def prepare_report(config: DictConfig) -> Work:
    """Reads every run; what it returns writes. Raises `ValueError` for bad input, and leaves nothing."""
    settings = plain_config(config)
    if unknown := sorted(settings.keys() - _KEYS):
        raise ValueError(f"configuration: expected the keys {sorted(_KEYS)}, found {unknown[0]!r}")
    if (settings["runs"] is None) == (settings["verify"] is None):
        raise ValueError(
            "configuration: expected runs=FOLDER or verify=RUN, found "
            + ("neither" if settings["runs"] is None else "both")
        )
    if settings["verify"] is not None:
        folders = run_roots(settings["verify"], "verify")
        return Work(folders[0], partial(verify_runs, folders, Console(highlight=False)))
    roots = run_roots(settings["runs"])
    out = Path(str(settings["out"])) if settings["out"] else roots[0]
    if found := sorted(name for name in MARKS if (out / name).exists()):
        raise ValueError(
            f"out: expected a folder that is not a run's, whose own page would be replaced, found {found[0]} "
            f"in {str(out)!r}"
        )
    if out.exists() and not out.is_dir():
        raise ValueError(f"out: expected a folder, found the file {str(out)!r}")
    paper = read_paper()
    runs = collect(roots, paper)
    command = shlex.join(["python", "report.py", *HydraConfig.get().overrides.task])
    do = partial(report_run, evidence_tables(runs, paper), runs, paper, out, Console(highlight=False), command)
    return Work(out, do)


def run_roots(given: Any, key: str = "runs") -> list[Path]:
    """A folder, folders with commas between them, or a list. Raises `ValueError` where one is not there."""
    words = [str(one) for one in given] if isinstance(given, Sequence) and not isinstance(given, str) else [str(given)]
    if len(words) == 1 and not Path(words[0]).is_dir():
        words = words[0].split(",")
    for word in words:
        if not word or not Path(word).is_dir():
            raise ValueError(f"{key}: expected a folder, or several with commas between them, found {word!r}")
    return [Path(word) for word in words]


def report_run(
    tables: Sequence[EvidenceTable],
    runs: Sequence[FoundRun],
    paper: Paper,
    out: Path,
    console: Console,
    command: str,
    stop: threading.Event,
) -> None:
    """Writes tables, figures and page into `out`, and shows the tables. stop: never asked, this takes seconds."""
    folder = RunFolder(out)
    folder.write_text("tables.md", markdown(tables, paper))
    folder.write_csv("tables.csv", frame(tables))
    folder.write_text("tables.tex", latex(tables, paper))
    pictures = draw(tables, paper, folder)
    folder.write_text("report.html", evidence_page(tables, runs, paper, pictures, command))
    for table in tables:
        console.print(terminal_table(table, paper))
    console.print(
        f"page: {short_path(out / 'report.html')}   tables: {short_path(out)}/tables.md, .csv, .tex", soft_wrap=True
    )


def verify_runs(folders: Sequence[Path], console: Console, stop: threading.Event) -> None:
    """A line per run; exit code 3 when one differs, 2 when one cannot be read. Writes nothing."""
    found = []
    for folder in folders:
        if stop.is_set():
            raise Interrupted("stopped between two runs")
        try:
            found.append(verify(folder))
        except ValueError as problem:
            sys.exit(say(str(problem)))
        console.print(f"{short_path(folder)}: {found[-1]}", soft_wrap=True)
    if not all(one.equal for one in found):
        sys.exit(_DIFFERENT)


def draw(tables: Sequence[EvidenceTable], paper: Paper, run: RunFolder) -> Pictures:
    """Writes the figures that each table has."""
    pictures: dict[str, list[tuple[str, str, Path]]] = {}
    for table in tables:
        ends = FIGURES if can_be_curves(table) else ("boxes",)
        files = save_figures(run, {f"{table.slug}-{end}": FIGURES[end][0](table, paper) for end in ends})
        titles = [(f"{table.title}: {title}", caption) for _, title, caption in (FIGURES[end] for end in ends)]
        pictures[table.slug] = [(*words, path) for words, path in zip(titles, files.values(), strict=True)]
    return pictures
