"""The training figure: training and validation loss of every member against the epoch."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pgrssnn_jax.reports import content, style
from pgrssnn_jax.reports.content import MemberRow, Metrics

COLUMNS = ("epoch", "seed", "dataset", "train_loss", "validation_loss")
LOSS = "loss: mean squared scaled error (–)"


class Curve(NamedTuple):
    """The loss of one member at the epochs where it is a positive finite number."""

    epoch: np.ndarray
    loss: np.ndarray


def training_figure(history: pd.DataFrame, metrics: Metrics) -> Figure:
    """Training and validation loss against the epoch, on one logarithmic scale.

    history: columns epoch, seed, dataset, train_loss, validation_loss (NaN where not validated). A failed member ends
    in a cross; where its loss runs away it is cut off a little above the loss of the others.
    """
    missing = [name for name in COLUMNS if name not in history.columns]
    if missing:
        raise ValueError(f"training_figure: history: expected a column {missing[0]}, found {list(history.columns)}")
    rows = content.member_rows(metrics)
    kept = [row.best_epoch for row in rows if not row.failed and row.best_epoch is not None]
    epochs = f"{history['epoch'].to_numpy().max()} epochs at most" if len(history) else "no epochs"
    best = f" · parameters kept from epoch {int(np.median(kept))} (median of members)" if kept else ""
    seconds = content.duration(metrics["seconds"].get("train"))
    lines = [f"{content.counts(metrics)} · {epochs}{best} · training {seconds}", content.source(metrics)]
    figure = style.page(4.0, metrics, lines)
    left = figure.add_subplot(1, 2, 1)
    right = figure.add_subplot(1, 2, 2, sharex=left, sharey=left)
    style.quiet(left, title="training", x="epoch", y=LOSS)
    style.quiet(right, title="validation", x="epoch", y=LOSS)
    train, validation = curves(history, "train_loss"), curves(history, "validation_loss")
    finished = {(row.seed, row.dataset) for row in rows if not row.failed}
    usual = [c.loss.max() for one in (train, validation) for key, c in one.items() if key in finished]
    ceiling = 4.0 * float(max(usual)) if usual else np.inf
    _draw(left, train, rows, style.BLUE, ceiling)
    _draw(right, validation, rows, style.VERMILLION, ceiling)
    style.legend(figure, _handles(any(row.failed for row in rows), bool(kept)))
    return figure


def curves(history: pd.DataFrame, column: str) -> dict[tuple[int, int], Curve]:
    """The curve of every member, (seed, dataset), that has a point to draw."""
    epoch, seed, dataset, loss = (history[name].to_numpy() for name in ("epoch", "seed", "dataset", column))
    loss = loss.astype(np.float64)
    good = np.isfinite(loss) & (loss > 0)
    keys = sorted(set(zip(seed[good].tolist(), dataset[good].tolist(), strict=True)))
    where = {key: good & (seed == key[0]) & (dataset == key[1]) for key in keys}
    return {key: Curve(epoch[here], loss[here]) for key, here in where.items()}


def median(many: list[Curve]) -> Curve:
    """The median over the curves at every epoch that at least half of them reach."""
    epochs, place = np.unique(np.concatenate([c.epoch for c in many]), return_inverse=True)
    table = np.full((len(many), len(epochs)), np.nan)
    table[np.repeat(np.arange(len(many)), [len(c.epoch) for c in many]), place] = np.concatenate([c.loss for c in many])
    reached = 2 * np.isfinite(table).sum(0) >= len(many)
    return Curve(epochs[reached], np.nanmedian(table[:, reached], axis=0))


def _draw(ax: Axes, found: dict[tuple[int, int], Curve], rows: list[MemberRow], colour: str, ceiling: float) -> None:
    if not found:
        style.note(ax, "no finite loss was recorded")
        return
    ax.set_yscale("log")
    alpha = float(np.clip(3.0 / len(found), 0.10, 0.5))
    for row in rows:
        curve = found.get((row.seed, row.dataset))
        if curve is None:
            continue
        if row.failed:
            loss = np.minimum(curve.loss, ceiling)
            ax.plot(curve.epoch, loss, color=style.QUIET, linewidth=0.8, linestyle=(0, (4, 2)))
            ax.plot(curve.epoch[-1], loss[-1], "x", color=style.INK, markersize=6, markeredgewidth=1.6, gid="failed")
            continue
        ax.plot(*curve, color=colour, linewidth=0.7, alpha=alpha)
        best = curve.epoch == row.best_epoch
        look = {"color": style.INK, "markersize": 3.2, "alpha": 0.75, "zorder": 3}
        ax.plot(curve.epoch[best], curve.loss[best], "o", gid="kept", **look)
    middle = median(list(found.values()))
    ax.plot(*middle, color=colour, linewidth=2.0, marker="." if len(middle.epoch) == 1 else "")


def _handles(any_failed: bool, any_best: bool) -> list[Artist]:
    handles: list[Artist] = [
        style.key("training, median", style.BLUE, linewidth=2.0),
        style.key("validation, median", style.VERMILLION, linewidth=2.0),
        style.key("members", style.QUIET, linewidth=0.7, alpha=0.7),
    ]
    if any_best:
        handles.append(style.dots("parameters kept", style.INK, markersize=3.5))
    if any_failed:
        look = {"marker": "x", "markersize": 6, "markeredgewidth": 1.6, "linestyle": (0, (4, 2)), "linewidth": 0.8}
        handles.append(style.key("failed", style.INK, **look))
    return handles
