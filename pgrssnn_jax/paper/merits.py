"""The figures of one run, and how far they are from the published ones.

For a member's figure e (test RMSE, or NRMSE where there are several outputs), over the n finished members of a run:

    mean,  std s (n - 1),  median,  best;  ensemble: the error of the mean prediction
    difference = (mean - published) / sqrt(s² (1/n + 1/n_p) + d²/12)

The paper prints means of n_p runs without their deviation, rounded to d: s stands for the deviation of its runs too,
and d²/12 is the variance of rounding. With fewer than two finished members there is no s, hence no difference.
"""

import math
import statistics
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgrssnn_jax.paper.collect import FoundRun
from pgrssnn_jax.paper.published import Value
from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.content import MemberRow
from pgrssnn_jax.training.metrics import nrmse


class Figures(NamedTuple):
    """NaN for what does not exist; cc: mean over members."""

    mean: float
    std: float
    median: float
    best: float
    ensemble: float
    cc: float


NOTHING = Figures(*[math.nan] * 6)


def figures_of(run: FoundRun, finished: Sequence[MemberRow], merit: str) -> tuple[Figures, str]:
    """The figures of a finished run over its finished members, and what could not be found."""
    if not finished:
        return NOTHING, ""
    values = [getattr(member, merit) for member in finished]
    median, best = (math.nan, math.nan) if any(map(math.isnan, values)) else (statistics.median(values), min(values))
    ensemble, problem = _ensemble(run, merit)
    cc = statistics.fmean(member.cc for member in finished)
    return Figures(statistics.fmean(values), spread(values), median, best, ensemble, cc), problem


def spread(values: Sequence[float]) -> float:
    """Standard deviation with n - 1; NaN for fewer than two values."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else math.nan


def difference(figures: Figures, n: int, published: Value | None, rounding: float) -> float:
    """(measured - published) in combined standard errors; NaN where one of them is missing."""
    if published is None or published.mean is None or not published.finished or not math.isfinite(figures.std):
        return math.nan
    variance = figures.std**2 * (1 / n + 1 / published.finished) + rounding**2 / 12
    return (figures.mean - published.mean) / math.sqrt(variance)


def _ensemble(run: FoundRun, merit: str) -> tuple[float, str]:
    """The error of the mean prediction, and why it cannot be had; NaN where members have test records of their own.

    The NRMSE is not in the metrics of a run: it is found from its predictions.
    """
    assert run.metrics is not None
    if merit == "rmse":
        return content.headline(run.metrics).ensemble, ""
    try:
        with np.load(run.path / "predictions.npz") as stored:
            y, mask, mean = (stored[name] for name in ("y", "mask", "ensemble_mean"))
        if not np.isfinite(mean).all():
            return math.nan, ""
        return float(nrmse(measured=y, predicted=mean, mask=mask, n_init=run.metrics["n_init"]).mean()), ""
    except Exception as problem:  # a damaged archive fails in many ways, and the row has its other figures
        return math.nan, f"no ensemble, predictions.npz cannot be read ({type(problem).__name__})"
