"""The page of a run: one HTML file with everything inside."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pgrssnn_jax.reports import content, explained, markup, tables
from pgrssnn_jax.reports.content import MISSING, Metrics, rounded
from pgrssnn_jax.reports.markup import Markup, banner, bullets, card, tag

CAPTIONS = {
    "Prediction": "Free-run simulation of the test record. What the model explains lies on the measured line; what it"
    " does not is left in the residual below. Thin lines are members. The band is the interval, calibrated on what"
    " members left out of training (in runs of before there was one, a standard deviation over members).",
    "Network": "What the networks add to the physics. Where the blue line follows the grey one, they supply what the"
    " physics lacks; the panels below show at which inputs and states. Effects that discovery can name look like this.",
    "Arm": "Poses of the arm at evenly spaced times of the sequence, all to one scale and seen from a little above: a"
    " wrong pose shows as blue beside the grey. The light line on the floor is the measured arm from above. The curve"
    " is the error that this makes at the tip; its numbered lines are the moments above.",
    "Training": "Each thin line is a member; the strong line is the median over members, drawn while at least half of"
    " them train. Dots mark the epoch whose parameters were kept: the lowest validation loss.",
    "Members": "Test error of every member, sorted. The ensemble is the error of the mean prediction, which can be"
    " lower than the error of any member.",
}
"""What to look at, by the title of a figure."""
MOVING = (
    "The same sequence in motion, over and over; the picture says how fast. The line that runs along the curve is the"
    " moment shown."
)


def run_html(
    metrics: Metrics,
    figures: Mapping[str, Path],
    *,
    config_text: str,
    environment: Mapping[str, Any],
    animation: str = "",
) -> str:
    """The HTML of the page.

    figures: title → PNG file, in the order of the page; animation: what `stick_animation` returned, taken over as it
    is, to stand below the figure "Arm". Raises `ValueError` if a figure is not a PNG file.
    """
    links = {f"figure-{k}": f"Figure {k}. {title}" for k, title in enumerate(figures, 1)}
    facts = [f"one sample every {metrics['dt']:g} s"]
    facts.append(f"first {metrics['n_init']} samples not counted" if metrics["n_init"] else "every sample counts")
    return markup.document(
        kind="Run report",
        title=content.heading(metrics),
        heading=content.heading(metrics),
        facts=[content.source(metrics), content.outputs(metrics), *facts],
        banners=[*_banners(metrics), *explained.banners(metrics, environment)],
        cards=_cards(metrics),
        links=links
        | {"numbers": "Numbers", "members": "Members, one by one"}
        | ({"choice": "How the settings were chosen"} if _choice(metrics) else {})
        | {"reproduce": "Reproduce"},
        sections=[
            *_figures(figures, animation),
            *_numbers(metrics),
            *_choice(metrics),
            markup.reproduce(config_text, environment),
        ],
        footer="Made by pgrssnn_jax from metrics.json, history.csv and predictions.npz of this run folder.",
    )


def _banners(metrics: Metrics) -> list[Markup]:
    banners = []
    if content.simulated(metrics):
        banners.append(banner("SIMULATED DATA", "No measurement stands behind these figures."))
    if content.incomplete(metrics):
        by_reason: dict[str, list[str]] = {}
        for row in content.member_rows(metrics):
            if row.failed:
                by_reason.setdefault(row.reason or "failed", []).append(f"{row.seed}/{row.dataset}")
        reasons = bullets(f"{why} (seed/dataset {', '.join(who)})" for why, who in by_reason.items())
        loud = content.incomplete(metrics).upper()
        banners.append(banner(loud, "Means are over finished members only.", reasons))
    return banners


def _cards(metrics: Metrics) -> list[Markup]:
    head, summary, unit = content.headline(metrics), metrics["summary"], content.unit(metrics)
    mean = content.plus_minus(head.mean, head.std, unit)
    finished, _ = content.ranked(content.member_rows(metrics))
    best = f"seed {finished[0].seed}, dataset {finished[0].dataset}" if finished else MISSING
    several = f"mean of {len(metrics['outputs'])} outputs; " if len(metrics["outputs"]) > 1 else ""
    done = f"{summary['finished']} / {summary['planned']}"
    return [
        card(f"{content.merit(metrics)}, mean ± std", mean, f"median {rounded(head.median, unit)}"),
        card("RMSE, best", rounded(head.best, unit), best),
        card("RMSE, ensemble", rounded(head.ensemble, unit), "error of the mean prediction"),
        card("NRMSE, mean", rounded(head.nrmse), f"{several}RMSE / std of the measured output"),
        *explained.cards(metrics),
        card("members finished", done, f"{summary['failed']} failed"),
        card("time", *content.spent(metrics["seconds"])),
    ]


def _figures(figures: Mapping[str, Path], animation: str) -> list[Markup]:
    blocks = [tag("h2", "Figures")] if figures else []
    for k, (title, path) in enumerate(figures.items(), 1):
        blocks.append(markup.numbered_figure(k, path, title, CAPTIONS.get(title, "")))
        if title == "Arm" and animation:
            blocks.append(markup.figure(Markup(animation), "The arm in motion", MOVING, look="moving"))
    return blocks


def _numbers(metrics: Metrics) -> list[Markup]:
    several = len(metrics["outputs"]) > 1
    note = "n_init: first samples of every sequence that do not count; the row of this run is bold."
    return [
        tag("h2", "Numbers", id="numbers"),
        tables.summary_table(metrics).html(),
        tag("p", note, look="note"),
        *([tables.output_table(metrics).html()] if several else []),
        tag("section", tables.member_table(metrics).html(), id="members"),
    ]


def _choice(metrics: Metrics) -> list[Markup]:
    """How `recipe=auto` chose the settings of the run, where it did."""
    recipe = metrics.get("recipe")
    if not recipe or not recipe.get("tried"):
        return []
    return [
        tag("h2", "How the settings were chosen", id="choice"),
        explained.chosen_table(recipe, content.heading(metrics)).html(),
    ]
