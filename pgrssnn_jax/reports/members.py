"""The figures of the members of a run: how they were trained, how they compare, and which outputs are hard."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pgrssnn_jax.reports import content, style
from pgrssnn_jax.reports.content import MemberRow, Metrics, number

NAMED_MEMBERS = 30


def training_figure(history: pd.DataFrame, metrics: Metrics) -> Figure:
    """Training and validation loss against the epoch, on one logarithmic scale.

    history: columns epoch, seed, dataset, train_loss, validation_loss (NaN where not validated). A failed member ends
    in a cross; where its loss runs away it is cut off a little above the loss of the others.
    """
    rows = content.member_rows(metrics)
    kept = [row.best_epoch for row in rows if not row.failed and row.best_epoch is not None]
    epochs = f"{history['epoch'].max()} epochs at most" if len(history) else "no epochs"
    best = f" · parameters kept from epoch {int(np.median(kept))} (median of members)" if kept else ""
    seconds = content.duration(metrics["seconds"].get("train"))
    lines = [f"{content.counts(metrics)} · {epochs}{best} · training {seconds}", content.source(metrics)]
    figure = style.page(4.0, metrics, lines)
    tables = {kind: losses(history, f"{kind}_loss") for kind in ("train", "validation")}
    finished = [(row.seed, row.dataset) for row in rows if not row.failed]
    usual = [table[table.columns.intersection(finished)].to_numpy().ravel() for table in tables.values()]
    ceiling = 4.0 * float(np.nanmax(np.concatenate(usual), initial=0.0)) or np.inf
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    for ax, title, table, colour in zip(
        axes, ("training", "validation"), tables.values(), (style.BLUE, style.VERMILLION), strict=True
    ):
        style.quiet(ax, title=title, x="epoch", y="loss: mean squared scaled error (–)").tick_params(labelleft=True)
        _draw_losses(ax, table, rows, colour, ceiling, f"{title}, median")
    style.legend(figure)
    return figure


def losses(history: pd.DataFrame, column: str) -> pd.DataFrame:
    """The positive finite losses: one row per epoch, one column (seed, dataset) per member that has any."""
    table = history.pivot(index="epoch", columns=["seed", "dataset"], values=column).astype(float)
    return table.where((table > 0) & np.isfinite(table)).dropna(how="all").dropna(how="all", axis=1)


def median(table: pd.DataFrame) -> pd.Series:
    """The median over the members at every epoch that at least half of them reach."""
    return table[2 * table.count(axis=1) >= table.shape[1]].median(axis=1)


def _draw_losses(ax: Axes, table: pd.DataFrame, rows: list[MemberRow], colour: str, ceiling: float, label: str) -> None:
    if table.empty:
        style.note(ax, "no finite loss was recorded")
        return
    ax.set_yscale("log")
    alpha = float(np.clip(3.0 / table.shape[1], 0.10, 0.5))
    for row in rows:
        if (row.seed, row.dataset) not in table:
            continue
        loss = table[row.seed, row.dataset].dropna()
        if row.failed:
            loss = loss.clip(upper=ceiling)
            ax.plot(loss, color=style.QUIET, linewidth=0.8, linestyle=style.DASHED)
            look: dict[str, Any] = {"markersize": 6, "markeredgewidth": 1.6, "gid": "failed", "label": "failed"}
            ax.plot(loss[-1:], "x", color=style.INK, **look)
        else:
            ax.plot(loss, color=colour, linewidth=0.7, alpha=alpha, label="members")
            look = {"markersize": 3.2, "alpha": 0.75, "zorder": 3, "gid": "kept", "label": "parameters kept"}
            ax.plot(loss[loss.index == row.best_epoch], "o", color=style.INK, **look)
    middle = median(table)
    ax.plot(middle, color=colour, linewidth=2.0, marker="." if len(middle) == 1 else "", label=label)


def members_figure(metrics: Metrics) -> Figure:
    """Test RMSE of every member, best to worst, with mean, median and ensemble; failed members stand at the end.

    With several outputs a second panel shows the NRMSE of each, so that an output that is hard to predict shows.
    """
    several = len(metrics["outputs"]) > 1
    lines = [f"{content.counts(metrics)} · n_init {metrics['n_init']}", content.source(metrics)]
    figure = style.page(3.8, metrics, lines)
    axes = figure.subplots(1, 1 + several, width_ratios=[1.6, 1.0][: 1 + several], squeeze=False)[0]
    _draw_ranking(axes[0], metrics)
    if several:
        _draw_outputs(axes[1], metrics)
    style.legend(figure)
    return figure


def _draw_ranking(ax: Axes, metrics: Metrics) -> None:
    finished, failed = content.ranked(content.member_rows(metrics))
    summary, unit = content.headline(metrics), content.unit(metrics)
    order = [*finished, *failed]
    several, named = len({row.dataset for row in order}) > 1, 0 < len(order) <= NAMED_MEMBERS
    what = ("members by seed" + " / dataset" * several if named else "members") + ", best to worst"
    style.quiet(ax, x=what, y=style.label(f"test {content.merit(metrics)}", unit)).grid(False, axis="x")
    if named:
        names = [f"{row.seed}/{row.dataset}" if several else str(row.seed) for row in order]
        ax.set_xticks(range(1, len(order) + 1), names, rotation=60 if several and len(order) > 14 else 0)
    ax.set_xlim(0, max(len(order), 1) + 1)
    end = len(finished) + (0.5 if failed else 1.0) if finished else 0.0
    rmse = np.array([row.rmse for row in finished], float)
    usable = rmse[np.isfinite(rmse)]
    if len(usable) and usable.max() > 20 * np.median(usable) and usable.min() > 0:
        ax.set_yscale("log")
    look: dict[str, Any] = {"color": style.BLUE, "markersize": 6 if named else 4.5, "alpha": 0.9, "zorder": 3}
    ax.plot(range(1, len(rmse) + 1), rmse, "o", label="member", **look)
    if np.isfinite([summary.mean, summary.std]).all():
        low, high, name = summary.mean - summary.std, summary.mean + summary.std, f"mean ± std ({number(summary.std)})"
        ax.fill_between([0, end], low, high, color=style.SKY, alpha=0.16, linewidth=0, label=name)
    for name, colour, dash in (
        ("mean", style.INK, "-"),
        ("median", style.INK, style.DASHED),
        ("best", style.GREEN, style.DOTTED),
        ("ensemble", style.VERMILLION, "-"),
    ):
        if np.isfinite(value := getattr(summary, name)):
            label = f"{name} {number(value, unit)}"
            ax.plot([0, end], [value] * 2, color=colour, linestyle=dash, linewidth=1.3, zorder=2, label=label)
    if failed:
        ax.axvspan(end, len(order) + 1, color=style.VERMILLION, alpha=0.10, linewidth=0)
        places, look = np.arange(len(finished), len(order)) + 1, {"markersize": 7, "markeredgewidth": 1.8}
        look |= {"transform": ax.get_xaxis_transform(), "color": style.VERMILLION, "label": f"failed ({len(failed)})"}
        ax.plot(places, np.full(len(failed), 0.94), "x", **look)
    if not len(usable):
        ax.set_yticks([])
        style.note(ax, "no member finished")


def _draw_outputs(ax: Axes, metrics: Metrics) -> None:
    names = [output["name"] for output in metrics["outputs"]]
    tests = [member["test"]["nrmse"] for member in metrics["members"] if member.get("test")]
    values = np.array(tests, float).reshape(len(tests), len(names))
    style.quiet(ax, title="by output", x="output", y="test NRMSE (–)").grid(False, axis="x")
    ax.set_xticks(range(len(names)), list(map(style.plain, names)), rotation=30, ha="right", rotation_mode="anchor")
    ax.set_xlim(-0.6, len(names) - 0.4)
    for k, column in enumerate(values.T):
        column = column[np.isfinite(column)]
        if len(column):
            ax.plot(np.full(len(column), k), column, "o", color=style.BLUE, markersize=4, alpha=0.4, markeredgewidth=0)
            ax.plot([k - 0.25, k + 0.25], [np.median(column)] * 2, color=style.INK, linewidth=1.6)
    if not np.isfinite(values).any():
        style.note(ax, "no member finished")
