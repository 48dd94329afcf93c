"""The tables of `head_to_head.py` in Markdown, from its rows."""

from collections.abc import Callable, Sequence

import numpy as np
from hidden import with_adcd
from hidden.score import Row, share

from pgrssnn_jax.paper.published import read_paper

TITLES = {"ours": "pgrssnn_jax", "pysindy": "PySINDy", "pysindy_best": "PySINDy, best", "adcd": "ADCD"}
_BETTER = 0.98  # of the other's error
_BASELINES = "Champneys et al., arXiv:2405.10779"
# Free-run test RMSE in V of the measured tanks as others report it: usual run, best run, where.
_REPORTED = (
    ("NLSS2", "0.343", "", "Relan et al., IFAC-PapersOnLine 50(1), 2017"),
    ("GRU", "0.396", "", _BASELINES),
    ("CT-SUBNET", "0.298, median of 17 seeds", "0.217", "Beintema et al., ICLR 2023, and its files"),
    ("stable port-Hamiltonian networks", "0.336, mean of 20", "0.233", "Roth et al., arXiv:2502.02480"),
    ("pNARX", "0.413", "", _BASELINES),
    ("OLSTM", "0.471", "", _BASELINES),
    ("LSTM", "0.490", "", _BASELINES),
    ("ARX", "0.685", "", _BASELINES),
)


def tables(rows: Sequence[Row]) -> str:
    """Those of the parts that have rows."""
    parts = {name: [row for row in rows if row["part"] == name] for name in ("suite", "laws", "tanks")}
    made = {"suite": _suite, "laws": _laws, "tanks": _tanks}
    return "\n\n".join(made[name](some) for name, some in parts.items() if some)


def _suite(rows: Sequence[Row]) -> str:
    given = {row["system"] for row in rows if row.get("given")}
    groups = {
        "every state is measured, or the rate of a measured one": [r for r in rows if r["system"] not in given],
        "a state is not measured; PySINDy is given it without noise": [r for r in rows if r["system"] in given],
    }
    head = ("method", "right name first", "and no other", "parameter error", "test error left", "gap closed")
    found = []
    for title, some in groups.items():
        if not some:
            continue
        systems = ", ".join(dict.fromkeys(row["system"] for row in some))
        lines = [_figures(method, [r for r in some if r["method"] == method]) for method in TITLES]
        table = _table((*head, "false findings", "processor s"), [line for line in lines if line])
        found.append(f"### {title[0].upper()}{title[1:]}\n\nSystems: {systems}.\n\n{table}")
    return "\n\n".join([*found, f"### By effect\n\n{_by_effect(rows)}", f"### Case by case\n\n{_duels(rows)}"])


def _figures(method: str, rows: Sequence[Row]) -> tuple[str, ...] | None:
    """Test error left: in units of the noise, where an effect is hidden."""
    if not rows:
        return None
    one, none = ([row for row in rows if row["kind"] == kind] for kind in ("single", "none"))
    errors = [row["parameter_error"] for row in one if row["parameter_error"] is not None]
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None]
    left = [np.inf if row["after"] is None else row["after"] for row in one]
    return (
        TITLES[method],
        share(sum(row["first"] for row in one), len(one)),
        share(sum(row["right"] for row in one), len(one)),
        f"{100 * np.median(errors):.1f} % of {len(errors)}" if errors else "–",
        f"{np.median(left):.2f}",
        f"{100 * np.median([_closed(row) for row in one]):.0f} %",
        share(sum(row["found"] for row in none), len(none)),
        f"{np.median(seconds):.0f}" if 2 * len(seconds) > len(rows) else "–",
    )


def _closed(row: Row) -> float:
    """Of the error of the nominal physics above the noise, the part that is gone."""
    known = row["after"] is not None and row["before"] is not None
    return (row["before"] - row["after"]) / (row["before"] - 1.0) if known else -np.inf


def _by_effect(rows: Sequence[Row]) -> str:
    one = [row for row in rows if row["kind"] == "single"]
    lines = []
    for effect in sorted({row["truth"][0] for row in one}):
        own = [row for row in one if row["truth"] == [effect]]
        systems = ", ".join(sorted({row["system"] for row in own}))
        cells = [_count([row["right"] for row in own if row["method"] == method]) for method in TITLES]
        lines.append((effect, systems, *cells, "yes" if any(row.get("has_term") for row in own) else "no"))
    return _table(("hidden effect", "systems", *TITLES.values(), "in the library of terms"), lines)


def _count(right: Sequence[bool]) -> str:
    return f"{sum(right)}/{len(right)}" if right else "–"


def _duels(rows: Sequence[Row]) -> str:
    """Cases that both have done: who is right alone, and whose error is lower by more than 2 %."""
    lines = []
    for rival in list(TITLES)[1:]:
        pairs = [
            (a, b)
            for a in rows
            for b in rows
            if (a["method"], b["method"]) == ("ours", rival) and (a["system"], a["seed"]) == (b["system"], b["seed"])
        ]
        if not pairs:
            continue
        one = [pair for pair in pairs if pair[0]["kind"] == "single"]

        def known(key: str, some: list[tuple[Row, Row]] = pairs) -> list[tuple[Row, Row]]:
            return [(a, b) for a, b in some if a[key] is not None and b[key] is not None]

        none = [pair for pair in pairs if pair not in one]
        questions: dict[str, tuple[list[tuple[Row, Row]], Callable[[Row, Row], bool]]] = {
            "right, and the other is not": (one, lambda a, b: a["right"] and not b["right"]),
            "lower error on the test record, one effect": (one, _lower("after")),
            "lower error on the test record, nothing missing": (none, _lower("after")),
            "closer parameter, where both have the right one": (known("parameter_error"), _lower("parameter_error")),
            "less processor time": (known("seconds"), _lower("seconds")),
        }
        for title, (some, wins) in questions.items():
            ours, theirs = sum(wins(a, b) for a, b in some), sum(wins(b, a) for a, b in some)
            lines.append((TITLES[rival], title, str(len(some)), str(ours), str(theirs)))
    return _table(("against", "who has", "cases", TITLES["ours"], "the other"), lines)


def _lower(key: str) -> Callable[[Row, Row], bool]:
    def wins(a: Row, b: Row) -> bool:
        mine, other = (np.inf if row[key] is None else row[key] for row in (a, b))
        return mine < _BETTER * other

    return wins


def _laws(rows: Sequence[Row]) -> str:
    ours, adcd = ({r["truth"][0]: r for r in rows if r["method"] == method} for method in ("ours", "adcd"))
    lines = []
    for name, (_, accepted) in with_adcd.LAWS.items():
        own, other = ours.get(name), adcd.get(name)
        said = f"{own['verdict']} {', '.join(own['names'])}".strip() if own else "–"
        wanted = ", ".join(accepted) or "unknown_effect"
        lines.append((name, wanted, said, _formula(other), _yes(own), _yes(other)))
    head = ("scenario", "right here", "pgrssnn_jax says", "ADCD says", "right", "ADCD right")
    text = f"### ADCD's scenarios\n\n{_table(head, lines)}"
    if adcd:
        right = share(sum(row["right"] for row in adcd.values()), len(adcd))
        seconds = np.median([row["seconds"] for row in adcd.values()])
        text += (
            f"\n\nOn its own data (1 % noise) ADCD finds the class of the correction in {right} of its scenarios, in"
        )
        text += f" {seconds:.0f} processor seconds (median)."
    reasons = [(why, str(len(names)), ", ".join(names)) for why, names in with_adcd.NO_MOTION.items()]
    return f"{text}\n\n{_table(('no scenario for this project, because it is', 'how many', 'which'), reasons)}"


def _formula(row: Row | None) -> str:
    if row is None:
        return "–"
    text = row["expression"]
    for name, value in row["theta"].items():
        text = text.replace(name, f"{value:.3g}")
    return f"`{text.replace('|', '∣')}`"


def _yes(row: Row | None) -> str:
    return "–" if row is None else "yes" if row["right"] else "no"


def _tanks(rows: Sequence[Row]) -> str:
    row, paper = rows[-1], read_paper()
    gap, network = row["gap"], row["network"]
    lines = [
        ("physics alone, nominal", f"{gap['before']:.3f}", "", "measured"),
        ("physics alone, recalibrated", f"{gap['recalibrated']:.3f}", "", "measured"),
        ("physics with the discovered effects", f"{gap['after']:.3f}", "", "measured"),
        ("PG-RSSNN on it", f"{network['mean']:.3f} ± {network['std']:.3f}", f"{network['best']:.3f}", "measured"),
    ]
    for (system, variant), value in paper.values.items():
        whole = variant.n_train == paper.systems["cascaded_tank"].n_train
        if system == "cascaded_tank" and whole and value.mean is not None and variant.model in ("rssnn", "pg_rssnn"):
            best = "" if value.best is None else f"{value.best:.2f}"
            lines.append((paper.title(variant.model), f"{value.mean:.2f}, mean of {value.runs}", best, paper.source))
    lines += _REPORTED
    head = ("method", "RMSE (V)", "best run (V)", "source")
    return (
        f"### Measured tanks\n\nData: {row['source']}. Discovered: {', '.join(row['names'])}.\n\n{_table(head, lines)}"
    )


def _table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    ruled = [f"| {' | '.join(line)} |" for line in (head, *lines)]
    return "\n".join([ruled[0], "|" + "---|" * len(head), *ruled[1:]])
