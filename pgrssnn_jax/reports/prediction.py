"""The prediction figure: measured against predicted, and what is left over, for one test sequence.

A record too long to read is shown through a window of stated range, with the residual of the whole record under it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pgrssnn_jax.reports import content, panels, style
from pgrssnn_jax.reports.content import Metrics, rounded

NO_HEADER = style.Header()


class Compared(NamedTuple):
    """What is compared with the measurement: members `[member, seq, time, y]`, their mean and std, and their names."""

    y_hat: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    label: str
    remark: str


def prediction_figure(
    predictions: Mapping[str, np.ndarray],
    metrics: Metrics,
    *,
    sequence: int = 0,
    window: tuple[int, int] | None = None,
) -> Figure:
    """The ensemble figure of a run: `ensemble_figure` with the facts of its metrics."""
    _check(predictions, metrics)
    shown, best, unit = compared(predictions, metrics), content.headline(metrics), content.unit(metrics)
    members = content.plus_minus(best.mean, best.std, unit)
    result = f"{content.merit(metrics)}: ensemble {rounded(best.ensemble, unit)} · members {members} (mean ± std)"
    return ensemble_figure(
        np.where(predictions["mask"], predictions["y"], np.nan),
        shown,
        dt=metrics["dt"],
        outputs=metrics["outputs"],
        n_init=metrics["n_init"],
        sequence=sequence,
        window=window,
        header=style.header(metrics, f"{result} · {content.counts(metrics)} · n_init {metrics['n_init']}"),
        panel_titles=_panel_titles(metrics),
    )


def ensemble_figure(
    measured: np.ndarray,
    predicted: Compared | np.ndarray,
    *,
    dt: content.Number,
    outputs: Sequence[Mapping[str, Any]],
    n_init: int = 0,
    sequence: int = 0,
    window: tuple[int, int] | None = None,
    header: style.Header = NO_HEADER,
    panel_titles: Sequence[str] = (),
) -> Figure:
    """One pair of panels per output, for the sequence `sequence` and the samples `window` (start, stop).

    measured: `[seq, time, y]`, NaN where nothing was measured; predicted: `[member, seq, time, y]`; outputs: `name` and
    `unit` of each. Without a window the whole sequence is shown up to 1500 samples, and the first 300 samples of a
    longer one. Raises `ValueError` where the sequence or the window is not in the record.
    """
    n_seq, time, n_y = measured.shape
    if not 0 <= sequence < n_seq:
        raise ValueError(f"ensemble_figure: sequence: expected 0 to {n_seq - 1}, found {sequence}")
    start, stop = window or (0, time if time <= panels.READABLE else panels.WINDOW)
    if not 0 <= start < stop <= time:
        raise ValueError(f"ensemble_figure: window: expected 0 <= start < stop <= {time}, found {(start, stop)}")
    if isinstance(predicted, np.ndarray):
        predicted = Compared(predicted, predicted.mean(0), predicted.std(0), "ensemble mean", "")
    ratios = [3.0, 1.3] if (start, stop) == (0, time) else [3.0, 1.3, 1.3]
    body = -(-n_y // min(n_y, 2)) * (sum(ratios) * (1.05 if n_y == 1 else 0.78) + 0.5)
    extent = predicted.remark + panels.extent(start, stop, time) + panels.which(sequence, n_seq)
    figure = style.headed(body, header.title, header.lines(extent), header.loud)
    y_hat, mean, std = (array[..., sequence, :, :] for array in predicted[:3])
    lines = {predicted.label: (mean, style.BLUE, style.VERMILLION)}
    signals = panels.signals_of(outputs, dt * np.arange(time), measured[sequence], lines, y_hat, std)
    for k, (axes, signal) in enumerate(zip(panels.pair_axes(figure, n_y, ratios), signals, strict=True)):
        panels.draw_signal(axes[0], signal.cut(start, stop), panel_titles[k] if panel_titles else "")
        panels.draw_residuals(axes[1], signal.cut(start, stop))
        if not len(y_hat):
            style.note(axes[0], "no finished member to show: measurement only")
        if start < n_init:
            for ax in axes[:2]:
                ax.axvspan(dt * start, dt * min(n_init, stop), color=style.QUIET, alpha=0.12, linewidth=0)
        for ax in axes[2:]:
            panels.draw_overview(ax, signal, start, stop)
    style.legend(figure, _handles(predicted))
    return figure


def _check(predictions: Mapping[str, np.ndarray], metrics: Metrics) -> None:
    y, outputs = predictions["y"].shape, len(metrics["outputs"])
    if len(y) != 3 or 0 in y or y[2] != outputs:
        raise ValueError(f"prediction_figure: y: expected [sequence, time, {outputs}], none of them empty, found {y}")
    shapes = {"mask": y, "ensemble_mean": y, "ensemble_std": y, "y_hat": (len(metrics["members"]), *y)}
    for name, expected in shapes.items():
        if predictions[name].shape != expected:
            raise ValueError(f"prediction_figure: {name}: expected {expected}, found {predictions[name].shape}")


def _panel_titles(metrics: Metrics) -> list[str]:
    """Each output and its own figures, as means over members; on a single output the header has said it all."""
    tests = [m["test"] for m in metrics["members"] if m.get("test")]
    titles = []
    for k, output in enumerate(metrics["outputs"]):
        rmse, nrmse = (content.over_outputs([test[name][k] for test in tests]) for name in ("rmse", "nrmse"))
        titles.append(
            f"{output['name']} · member mean: RMSE {rounded(rmse, output.get('unit', ''))}, NRMSE {rounded(nrmse)}"
        )
    return titles if len(titles) > 1 else []


def compared(predictions: Mapping[str, np.ndarray], metrics: Metrics) -> Compared:
    """The finished members and their ensemble.

    Where members were tested on different records there is no ensemble, and `y` is the record of the first member:
    then only members of its dataset belong to `y`, and their mean takes the place of the ensemble's.
    """
    members, y_hat = metrics["members"], np.asarray(predictions["y_hat"], np.float64)
    ok = np.array([member["status"] == "ok" for member in members], bool)
    mean, std = (np.asarray(predictions[name], np.float64) for name in ("ensemble_mean", "ensemble_std"))
    if not ok.any() or np.isfinite(mean).any():
        return Compared(y_hat[ok], mean, std, "ensemble mean", "")
    dataset = members[0]["dataset"]
    ok &= np.array([member["dataset"] == dataset for member in members], bool)
    remark = f"only dataset {dataset}: members have test records of their own, hence no ensemble · "
    if ok.any():
        mean, std = y_hat[ok].mean(0), y_hat[ok].std(0)
    return Compared(y_hat[ok], mean, std, f"mean of dataset {dataset}", remark)


def _handles(shown: Compared) -> list[Any]:
    predicted = [
        style.key(shown.label, style.BLUE, linewidth=1.4),
        Patch(facecolor=style.SKY, alpha=0.35, label="±1 std over members"),
        style.key("members", style.BLUE, linewidth=0.7, alpha=0.5),
        style.key(f"residual: measured − {shown.label}", style.VERMILLION, linewidth=1.2),
    ]
    return [style.key("measured", style.TRUTH, linewidth=2.8), *(predicted if len(shown.y_hat) else [])]
