"""The figures of the members of a run: how they were trained, how they compare, and which outputs are hard."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pgrssnn_jax.reports import content, style
from pgrssnn_jax.reports.content import MemberRow, Metrics, rounded

COLUMNS = ("epoch", "seed", "dataset", "train_loss", "validation_loss")
LOSS = "loss: mean squared scaled error (–)"
NAMED_MEMBERS = 30


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
    _draw_losses(left, train, rows, style.BLUE, ceiling)
    _draw_losses(right, validation, rows, style.VERMILLION, ceiling)
    style.legend(figure, _loss_handles(any(row.failed for row in rows), bool(kept)))
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


def _draw_losses(
    ax: Axes, found: dict[tuple[int, int], Curve], rows: list[MemberRow], colour: str, ceiling: float
) -> None:
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


def _loss_handles(any_failed: bool, any_best: bool) -> list[Artist]:
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


def members_figure(metrics: Metrics) -> Figure:
    """Test RMSE of every member, best to worst, with mean, median and ensemble; failed members stand at the end.

    With several outputs a second panel shows the NRMSE of each, so that an output that is hard to predict shows.
    """
    finished, failed = content.ranked(content.member_rows(metrics))
    several = len(metrics["outputs"]) > 1
    lines = [f"{content.counts(metrics)} · n_init {metrics['n_init']}", content.source(metrics)]
    figure = style.page(3.8, metrics, lines)
    grid = figure.add_gridspec(1, 2, width_ratios=[1.6, 1.0]) if several else figure.add_gridspec(1, 1)
    handles = _draw_ranking(figure.add_subplot(grid[0]), finished, failed, metrics)
    if several:
        _draw_outputs(figure.add_subplot(grid[1]), metrics)
    style.legend(figure, handles)
    return figure


def _draw_ranking(ax: Axes, finished: list[MemberRow], failed: list[MemberRow], metrics: Metrics) -> list[Artist]:
    summary, unit = content.headline(metrics), content.unit(metrics)
    order = [*finished, *failed]
    named = 0 < len(order) <= NAMED_MEMBERS
    several_datasets = len({row.dataset for row in order}) > 1
    what = "members by seed" + (" / dataset" if several_datasets else "") if named else "members, best to worst"
    label = style.label(f"test {content.merit(metrics)}", unit)
    style.quiet(ax, x=f"{what}, best to worst" if named else what, y=label)
    ax.grid(False, axis="x")
    if named:
        names = [f"{row.seed}/{row.dataset}" if several_datasets else str(row.seed) for row in order]
        ax.set_xticks(range(1, len(order) + 1), names, rotation=60 if several_datasets and len(order) > 14 else 0)
    ax.set_xlim(0, max(len(order), 1) + 1)
    end = len(finished) + (0.5 if failed else 1.0) if finished else 0.0

    rmse = np.array([row.rmse for row in finished], float)
    usable = rmse[np.isfinite(rmse)]
    if len(usable) and usable.max() > 20 * np.median(usable) and usable.min() > 0:
        ax.set_yscale("log")
    ax.plot(range(1, len(rmse) + 1), rmse, "o", color=style.BLUE, markersize=6 if named else 4.5, alpha=0.9, zorder=3)
    handles: list[Artist] = [style.dots("member", style.BLUE, markersize=5)]
    if np.isfinite([summary.mean, summary.std]).all():
        low, high = summary.mean - summary.std, summary.mean + summary.std
        ax.fill_between([0, end], low, high, color=style.SKY, alpha=0.16, linewidth=0)
        handles.append(Patch(facecolor=style.SKY, alpha=0.3, label=f"mean ± std ({rounded(summary.std)})"))
    lines: tuple[tuple[str, str, Any], ...] = (
        ("mean", style.INK, "-"),
        ("median", style.INK, (0, (4, 2))),
        ("best", style.GREEN, (0, (1, 1.5))),
        ("ensemble", style.VERMILLION, "-"),
    )
    for name, colour, dash in lines:
        value = getattr(summary, name)
        if np.isfinite(value):
            ax.hlines(value, 0, end, color=colour, linestyle=dash, linewidth=1.3, zorder=2)
            handles.append(style.key(f"{name} {rounded(value, unit)}", colour, linestyle=dash))
    if failed:
        ax.axvspan(end, len(order) + 1, color=style.VERMILLION, alpha=0.10, linewidth=0)
        places, top = np.arange(len(finished), len(order)) + 1, np.full(len(failed), 0.94)
        look = {"color": style.VERMILLION, "markersize": 7, "markeredgewidth": 1.8}
        ax.plot(places, top, "x", transform=ax.get_xaxis_transform(), **look)
        handles.append(style.dots(f"failed ({len(failed)})", style.VERMILLION, "x"))
    if not len(usable):
        ax.set_yticks([])
        style.note(ax, "no member finished")
    return handles


def _draw_outputs(ax: Axes, metrics: Metrics) -> None:
    names = [output["name"] for output in metrics["outputs"]]
    tests = [member["test"]["nrmse"] for member in metrics["members"] if member.get("test")]
    values = np.array(tests, float).reshape(len(tests), len(names))
    style.quiet(ax, title="by output", x="output", y="test NRMSE (–)")
    ax.grid(False, axis="x")
    ax.set_xticks(range(len(names)), list(map(style.plain, names)), rotation=30, ha="right", rotation_mode="anchor")
    ax.set_xlim(-0.6, len(names) - 0.4)
    for k, column in enumerate(values.T):
        column = column[np.isfinite(column)]
        if len(column):
            ax.plot(np.full(len(column), k), column, "o", color=style.BLUE, markersize=4, alpha=0.4, markeredgewidth=0)
            ax.plot([k - 0.25, k + 0.25], [np.median(column)] * 2, color=style.INK, linewidth=1.6)
    if not np.isfinite(values).any():
        style.note(ax, "no member finished")
