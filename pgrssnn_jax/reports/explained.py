"""What a page says of a run beside its errors: the interval, the networks' share, and how the settings were chosen."""

import shlex
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.content import Metrics, over_outputs, rounded
from pgrssnn_jax.reports.markup import Markup, banner, card, tag
from pgrssnn_jax.reports.tabular import Table

_OUTSIDE = 0.01  # of the samples; the largest value of a record is often a little outside that of another
_KEPT = ("+experiment", "experiment", "physics", "data")  # of a command of training, for one of discovery


def cards(metrics: Metrics) -> list[Markup]:
    """The interval and the share of the networks, where the run has them."""
    found = []
    if interval := metrics.get("interval"):
        width = over_outputs(interval["width"]) if content.unit(metrics) else float("nan")
        note = f"mean width {rounded(width, content.unit(metrics))}" if np.isfinite(width) else "mean of the outputs"
        held = f"{100 * over_outputs(interval['coverage']):.0f} %"
        found.append(card(f"{100 * interval['level']:g} % interval holds", held, f"of the test record; {note}"))
    if network := metrics.get("network"):
        found.append(card("networks supply", percent(over_outputs(network["share"])), "RMS / std of the output"))
    return found


def banners(metrics: Metrics, environment: Mapping[str, Any]) -> Iterator[Markup]:
    """Test samples outside the range of training, and an invitation to discovery where networks supply much."""
    away = {name: share for name, share in (metrics.get("outside") or {}).items() if share >= _OUTSIDE}
    if away:
        named = ", ".join(f"{name} in {percent(share)} of the samples" for name, share in away.items())
        yield banner("OUTSIDE THE RANGE OF TRAINING", f"{named}. There the model extrapolates.")
    share, error = over_outputs((metrics.get("network") or {}).get("share")), content.headline(metrics).nrmse
    if np.isfinite([share, error]).all() and share > error:
        words = (
            f"They supply {percent(share)} of the output's deviation, more than is left as error: the physics lacks "
        )
        yield banner(
            "THE NETWORKS DO MUCH OF THE WORK",
            words,
            "something. What it is: ",
            tag("code", discovery_command(environment)),
        )


def discovery_command(environment: Mapping[str, Any]) -> str:
    """The command that examines the physics and the data of a training run."""
    words = shlex.split(str(environment.get("command") or ""))
    if "train.py" not in words:
        return "pg.discover(physics, train, test)"
    kept = [
        word for word in words if word.partition("=")[0].partition(".")[0] in _KEPT and "physics.effects" not in word
    ]
    return shlex.join(["python", "discover.py", *kept])


def chosen_table(recipe: Mapping[str, Any], title: str) -> Table:
    """The candidates of `recipe=auto`, the chosen one first."""
    rows = [
        ("headline" if k == 0 else "", [rounded(one["left_out_nrmse"]), str(one["epochs"]), one["settings"]])
        for k, one in enumerate(recipe["tried"])
    ]
    footer = ["left-out NRMSE: geometric mean over members, each at the epoch that is best for the others"]
    if recipe.get("fell_back"):
        several = any(one["dataset"] for one in recipe["fell_back"])
        names = [f"{one['seed']}" + (f" of dataset {one['dataset']}" if several else "") for one in recipe["fell_back"]]
        which = ", ".join(names)
        footer.append(f"seeds that do not beat the physics on what they leave out, and are the physics alone: {which}")
    return Table(("left-out NRMSE", "epochs", "candidate"), rows, f"{title} · recipe=auto", footer)


def percent(share: float) -> str:
    return f"{100 * share:.3g} %" if np.isfinite(share) else content.MISSING
