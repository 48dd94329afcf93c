"""The discovery page and its summary: all inside, all escaped, the numbers of discovery.json, and no gap stops them."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
from commands import without_pictures
from discovery_samples import ARM, SAD, TANK, bare_discovery
from rich.console import Console
from test_report_page import Reader

from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.reports import content
from pgrssnn_jax.reports import discovery_facts as facts
from pgrssnn_jax.reports.discovery_tables import discovery_summary
from pgrssnn_jax.reports.pages import discovery_html
from pgrssnn_jax.reports.write import write_discovery_report
from pgrssnn_jax.training.run_folder import RunFolder

EVIL = "<script>alert(1)</script>\"'&"
ENVIRONMENT = {"commit": "0123abcd", "command": "python discover.py", "packages": {"jax": "0.10.2"}}


def write(folder: Path, run, config: str = "seed: 0\n") -> str:
    place = RunFolder(folder)
    place.write_json("discovery.json", run[0])
    place.write_arrays("discovery.npz", run[1])
    place.write_text("config.yaml", config)
    place.write_json("environment.json", ENVIRONMENT)
    write_discovery_report(place)
    return (folder / "report.html").read_text(encoding="utf-8")


def page(discovery, **changes) -> str:
    return discovery_html(discovery, {}, **{"config_text": "", "environment": {}, **changes})


def printed(discovery, width: int = 80) -> str:
    paper = io.StringIO()
    Console(file=paper, width=width, color_system=None).print(discovery_summary(discovery))
    return paper.getvalue()


@pytest.mark.parametrize("run", [TANK, pytest.param(ARM, marks=pytest.mark.slow)], ids=["tank", "arm"])
def test_the_page_holds_everything_itself(tmp_path, run):
    text = write(tmp_path, run)
    reader = Reader(text)
    assert len(reader.loads) == 5
    assert all(source.startswith("data:image/png;base64,") for source in reader.loads)
    assert all(anchor.startswith("#") and anchor[1:] in reader.ids for anchor in reader.anchors)
    assert len(reader.ids) == len(set(reader.ids))
    assert not reader.tags & {"script", "link", "iframe", "object"}
    for outside in ("http://", "https://", "url(", "@import", str(tmp_path)):
        assert outside not in text
    assert sorted(p.name for p in (tmp_path / "figures").iterdir()) == sorted(
        f"{name}.png" for name in ("simulation", "disagreement", "map", "candidates", "shifts")
    )
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    "name", [name if i < 2 else pytest.param(name, marks=pytest.mark.slow) for i, name in enumerate(SAD)]
)
def test_gaps_in_the_data_do_not_stop_the_page(tmp_path, name):
    text = Reader(write(tmp_path, SAD[name])).text
    assert "nan" not in text.lower()
    assert "None" not in text


def poisoned(tree):
    """The same tree with every text replaced; the texts that choose between paths stay."""
    if isinstance(tree, dict):
        kept = ("source", "verdict", "metric")
        return {name: value if name in kept else poisoned(value) for name, value in tree.items()}
    if isinstance(tree, list):
        return [poisoned(value) for value in tree]
    return EVIL if isinstance(tree, str) else tree


def test_everything_given_is_escaped():
    listed = {"alternatives": [{"name": "a", "gain": 0.5, "experiment": "b"}], "formula": "c"}
    listed |= {"spectrum": {"period_s": 3.0, "amplitude": 0.2, "unit": "V"}}
    found = poisoned(TANK[0] | listed)
    found["parameters"] = {EVIL: found["parameters"]["k1"]}
    found["seconds"] = {EVIL: 1.0}
    found["effects"][0]["parameters"] = {EVIL: {"value": [1.0], "std": [0.1], "unit": EVIL, "symbol": EVIL}}
    found["disagreement"].append({"equation": EVIL, "region": {EVIL: [0.0, 1.0]}})
    reader = Reader(page(found, config_text=EVIL, environment={"commit": EVIL, "command": EVIL}))
    assert "script" not in reader.tags
    assert reader.text.count(EVIL) > 30


def test_the_numbers_are_those_of_the_discovery(tmp_path):
    found, _ = TANK
    with without_pictures():
        reader = Reader(write(tmp_path, TANK))
    effect, gap = found["effects"][0], found["gap"]
    shown = [gap[s][p] for s in ("before", "recalibrated", "after") for p in ("train", "test")]
    shown += [v for interval in gap["test_interval"].values() for v in interval] + [gap["floor"]]
    shown += [p["value"] for p in effect["parameters"].values()]
    shown += [row["before"] for row in found["recalibration"].values()]
    shown += [row[n] for row in found["recalibration"].values() for n in ("before", "after")]
    shown += [row["value"] for row in found["parameters"].values()]
    shown += [found["network"][f"rmse_{s}"] for s in ("before", "after")]
    shares = [effect["gain_test"], effect["gain_train"], effect["runner_up"]["gain"], gap["closed_fraction"]]
    shares += [row["gain"] for row in found["ranking"]] + [row.size for row in facts.shifts(found)[:4]]
    shares += [found["disagreement"][0][n] for n in ("share_of_error", "share_of_samples")]
    shares += [found["network"][f"share_{s}"] for s in ("before", "after")]
    assert all(content.number(value) in reader.text for value in shown)
    assert all(content.percent(share) in reader.text for share in shares)
    assert all(facts.chance(row["p_value"]) in reader.text for row in found["ranking"])
    assert content.duration(found["seconds"]["total"]) in reader.text


@pytest.mark.parametrize("verdict", facts.VERDICTS)
def test_every_verdict_has_its_heading(verdict):
    text = Reader(page(bare_discovery() | {"verdict": verdict})).text
    assert facts.VERDICTS[verdict] in text
    assert "Nothing is missing." in text
    assert facts.VERDICTS[verdict].upper() in printed(bare_discovery() | {"verdict": verdict})


def test_several_findings_are_counted_and_each_has_its_card():
    found = TANK[0] | {"effects": [TANK[0]["effects"][0], ARM[0]["effects"][0]]}
    html = page(found)
    assert html.count('<article class="finding">') == 2
    text = Reader(html).text
    assert "2 missing effects were found" in text
    for effect in found["effects"]:
        for name in ("name", "title", "equation", "cause", "region", "command"):
            assert effect[name] in text


ONE = [[1.0, 0.0], [0.0, 1.0]]
EFFECTS = [
    pytest.param(effect, id=f"{physics.name} {effect.name}")
    for physics in (cascaded_tanks(), lgssm(A=ONE, B=ONE, C=ONE, inputs=["f", "g"], outputs=["p", "q"]), arm())
    for effect in catalogue(physics)
]


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_of_every_catalogue_can_be_told(effect):
    """One row for every number, whatever its shape, each with a name of its own."""
    numbers = effect.neutral()
    parameters = {
        key: {"value": n.tolist(), "std": (0.5 + np.zeros_like(n)).tolist(), "unit": effect.parameters[key].unit}
        for key, n in numbers.items()
    }
    told = {"name": effect.name, "title": effect.title, "channels": effect.channels, "parameters": parameters}
    rows = facts.quantities(told)
    assert len({row.name for row in rows}) == len(rows) == sum(n.size for n in numbers.values())
    np.testing.assert_array_equal([row.value for row in rows], np.concatenate([n.ravel() for n in numbers.values()]))
    shown = printed({**TANK[0], "effects": [told]}, width=200)
    assert all(name in shown for name in (*(row.name for row in rows), "gap closed"))
    assert effect.title in Reader(page({**TANK[0], "effects": [told]})).text


def test_a_matrix_names_both_ends_of_its_numbers_and_what_is_at_its_bound():
    parameter = {"value": [[1.0, 2.0], [3.0, 4.0]], "std": [[0.1, 0.2], [0.3, 0.0]], "symbol": "D"}
    told = {
        "parameters": {"D": {**parameter, "at_bound": [[False, False], [False, True]]}},
        "channels": "output, input",
    }
    rows = facts.quantities(told)
    assert [row.name for row in rows] == [f"D, output {i}, input {k}" for i in (1, 2) for k in (1, 2)]
    assert [row.words for row in rows] == [
        "1.000 ± 0.100",
        "2.000 ± 0.200",
        "3.000 ± 0.300",
        "4.000, at its bound",
    ]


def test_numbers_of_the_physics_at_their_bounds_are_listed():
    parameters = {
        "k1": {"value": 0.0, "std": 0.0, "at_bound": True},
        "k2": {"value": 0.1, "std": 0.2, "at_bound": False},
    }
    found = {**TANK[0], "parameters": parameters}
    for text in (printed(found, width=200), Reader(page(found)).text):
        assert "At their bounds, beyond which the fit may want to go: k1." in text
    assert "At their bounds" not in Reader(page({**TANK[0], "parameters": {}})).text


@pytest.mark.parametrize("verdict", ["unknown_effect", "unexplained"])
def test_named_effects_beside_what_they_do_not_explain_are_called_stand_ins(verdict):
    assert facts.STAND_INS not in Reader(page(TANK[0])).text
    assert "What helps:" not in Reader(page(TANK[0])).text
    found = {**TANK[0], "verdict": verdict}
    assert f"{facts.VERDICTS[verdict]}. What helps:" in Reader(page(found)).text
    for text in (printed(found, width=200), Reader(page(found)).text):
        assert facts.STAND_INS in text


def test_what_could_not_be_told_is_told():
    number = {"value": [0.0123], "std": [0.0004], "unit": "1/s", "symbol": "r"}
    row = {"name": "leak_tank1", "gain": 0.4, "experiment": "a step with the pump off", "parameters": {"rate": number}}
    told = {"alternatives": [row]}
    told |= {"formula": "-0.02 max(x1 - 7.5, 0)", "spectrum": {"period_s": 12.5, "amplitude": 0.2, "unit": "V"}}
    for text in (Reader(page(TANK[0] | told)).text, printed(TANK[0] | told, 120)):
        for words in (
            "leak_tank1",
            "0.0123",
            "a step with the pump off",
            "-0.02 max(x1 - 7.5, 0)",
            "never runs below 0.8 V",
        ):
            assert words in text
    assert "period of 12.5 s" in Reader(page(TANK[0] | told)).text


def test_simulated_data_are_loud():
    assert "SIMULATED DATA." in Reader(page(ARM[0])).text
    assert "SIMULATED DATA" in printed(ARM[0])
    assert "SIMULATED" not in Reader(page(TANK[0])).text


def test_numbers_that_began_at_zero_stand_in_the_table_and_the_largest_shift_comes_first():
    rows = facts.shifts(TANK[0])
    assert [row.name for row in rows] == ["k2", "k1", "k3", "k4", "k5"]
    assert rows[0].size == pytest.approx(0.00011 / 0.0003)
    lists = {"p": {"before": [1.0, 2.0], "after": [1.5, 2.0], "std": [0.1, 0.1], "unit": "m"}}
    rows = facts.shifts({"recalibration": lists, "parameters": {"new": {"value": 3.0, "std": 0.1, "unit": ""}}})
    assert [row.name for row in rows] == ["p[1]", "p[2]", "new"]


def test_a_long_table_is_folded_but_all_there():
    html = page(ARM[0])
    assert "All 30 rows" in html
    assert all(name in html for name in ARM[0]["parameters"])


def test_reproducing_names_the_commit_and_the_configuration(tmp_path):
    with without_pictures():
        text = Reader(write(tmp_path, TANK, config="seed: 7\n")).text
    assert "git checkout 0123abcd" in text
    assert "python discover.py" in text
    assert "seed: 7" in text
    assert '"jax": "0.10.2"' in text


def test_intervals_name_their_sequence_where_it_is_not_the_first():
    spans = [[0.0, 8.0], [12.0, 20.0]]
    assert (
        facts.intervals({"intervals_s": spans, "sequence": 1})
        == facts.intervals({"intervals_s": spans})
        == "0 to 8 s, 12 to 20 s"
    )
    assert facts.intervals({"intervals_s": spans[:1], "sequence": 3}) == "0 to 8 s of sequence 3"
    assert facts.intervals({"intervals_s": [], "sequence": 3}) == ""


@pytest.mark.parametrize("discovery", [TANK[0], ARM[0], bare_discovery()], ids=["tank", "arm", "bare"])
def test_the_summary_fits_eighty_columns_and_says_the_verdict_and_the_gap(discovery):
    said = printed(discovery)
    assert "…" not in said
    assert "nan" not in said.lower()
    assert "None" not in said
    assert facts.heading(discovery).upper() in said
    for stage in ("before", "recalibrated", "after"):
        error = discovery["gap"][stage]["test"]
        assert (f"{error:#.4g}" if error else "–") in said
    for effect in discovery["effects"]:
        assert effect["name"] in said


def test_square_brackets_are_no_markup():
    found = json.loads(json.dumps(TANK[0]))
    found["sentence"] = found["effects"][0]["cause"] = found["untestable"][0]["reason"] = "[red]x[/red] [/]"
    assert printed(found, 120).count("[red]x[/red] [/]") == 3
