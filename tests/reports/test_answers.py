"""The first screen of a discovery's page: four questions, each with its answer."""

import re

import pytest
from discovery_samples import SAD, TANK

from pgrssnn_jax.reports.answers import answers
from pgrssnn_jax.reports.pages import discovery_html


def test_the_first_screen_answers_what_how_sure_how_much_and_what_next():
    gap = TANK[0]["gap"] | {"open_fraction": 0.086, "improvement_interval": [0.1, 0.3]}
    told = TANK[0] | {"gap": gap, "remaining": {"rule": "upper_level above 9 V: 80 % of the error", "region": {}}}
    told |= {"alternatives": [{"name": "leak_tank1", "gain": 0.4, "experiment": "a step with the pump off"}]}
    told |= {"undetermined": [{"changes": {"k2": 0.3, "k5": -1.0}, "left": 1.0}]}
    first, _, _ = discovery_html(told, {}, config_text="", environment={}).partition('<dl class="cards">')
    text = " ".join(re.sub("<[^>]+>", "", first).split())
    expected = {
        "What is missing?": ["spills over", "h = 7.493 ± 0.041 V", "k = 0.01802 ± 0.00060 1/s"],
        "How sure is it?": [
            "p = 0.005",
            "91.4 % by overflow_1to2",
            "overflow_lost would close 40.2 %",
            "0.1000 to 0.3000 V",
        ],
        "What stays open, and where?": ["8.6 % of the gap", "Most of it: upper_level above 9 V"],
        "What to measure next?": [
            "leak_tank1",
            "a step with the pump off",
            "The pump never runs below 0.8 V",
            "k2, k5",
        ],
    }
    for question, lines in expected.items():
        answer = text.split(question)[1].split("?")[0]
        assert all(line in answer for line in lines), (question, answer)


def test_a_gain_of_the_test_record_in_the_likelihood_is_told_where_torques_are_compared():
    gap = TANK[0]["gap"] | {"likelihood_gain": {"value": 644.3, "std_error": 83.1}}
    for effects, said in ((TANK[0]["effects"], True), ([], False)):
        lines = answers(TANK[0] | {"gap": gap, "effects": effects})["How sure is it?"]
        assert ("The log-likelihood of the test record rises by 644.3 ± 83.10 with the effects." in lines) is said


@pytest.mark.parametrize("name", SAD)
def test_every_question_has_an_answer(name):
    for question, lines in answers(SAD[name][0]).items():
        assert lines, question
        assert not {"nan", "None"} & set(" ".join(lines).split())


def test_alternatives_name_the_effect_that_they_would_replace():
    rows = [{"name": name, "instead_of": found, "experiment": "a step"} for name, found in (("b", "a"), ("d", "c"))]
    said = answers(TANK[0] | {"alternatives": rows})["What to measure next?"]
    assert "To distinguish b from a: a step." in said
    assert "To distinguish d from c: a step." in said


def test_gains_that_are_not_known_do_not_disturb_the_order():
    effects = [{"name": name, "title": name, "gain_test": gain} for name, gain in (("a", 0.1), ("b", None), ("c", 0.5))]
    (line,) = [one for one in answers(TANK[0] | {"effects": effects})["How sure is it?"] if "Share of the gap" in one]
    assert line == "Share of the gap closed on test data: 50 % by c, 10 % by a."


@pytest.mark.parametrize(("region", "said"), [({}, False), ({"level": [7.0, 9.0]}, True)])
def test_unexplained_errors_ask_for_samples_where_they_are_known_to_be(region, said):
    nothing_else = {"alternatives": [], "untestable": [], "undetermined": [], "verdict": "unexplained"}
    told = TANK[0] | nothing_else | {"remaining": {"rule": "everywhere", "region": region}}
    lines = answers(told)["What to measure next?"]
    assert ("More samples where the errors are: level." in lines) == said
    assert any("tell them apart" in line for line in lines) != said


def test_a_page_without_an_effect_says_nothing_of_effects_or_of_a_gap():
    gap = {"metric": "NRMSE", "unit": "", "open_fraction": 1.0, "improvement_interval": [0.0, 0.0], "floor": 0.0101}
    found = {"verdict": "no_discrepancy", "effects": [], "gap": {**gap, "after": {"test": 0.0099}}}
    told = answers({**found, "remaining": {"rule": "level above 9.4 cm"}})
    assert told["What stays open, and where?"] == ["Test NRMSE 0.009900 recalibrated; the noise is about 0.01010."]
    assert not any("falls" in sentence for sentence in told["How sure is it?"])


def test_errors_that_are_everywhere_alike_have_no_place():
    told = answers(TANK[0] | {"remaining": {"rule": "everywhere: no more than the noise", "region": {}}})
    assert not any("Most of it" in line for line in told["What stays open, and where?"])


def test_errors_that_nothing_explains_are_an_open_gap():
    gap = {"metric": "NRMSE", "unit": "", "open_fraction": 1.0, "floor": 0.01, "after": {"test": 0.05}}
    told = answers({"verdict": "unexplained", "effects": [], "gap": gap, "remaining": {"rule": "level above 9.4 cm"}})
    assert told["What stays open, and where?"][0].startswith("100 %")
    assert told["What stays open, and where?"][-1] == "Most of it: level above 9.4 cm."


@pytest.mark.parametrize("output", ["angle", None])
def test_a_line_in_the_errors_is_missing_and_the_next_thing_to_measure(output):
    line = {"period_s": 0.1031, "amplitude": 0.0046, "unit": "rad", "share": 0.3, "output": output}
    gap = {"metric": "RMSE", "unit": "rad", "open_fraction": 1.0, "floor": 0.005, "after": {"test": 0.006}}
    where = {"rule": "speed above 0.6 rad/s", "region": {"speed": [0.6, 2.0]}}
    told = answers({"verdict": "unknown_effect", "effects": [], "gap": gap, "spectrum": line, "remaining": where})
    of = " of angle" if output else ""
    expected = f"The residual{of} repeats with a period of 0.103 s and an amplitude of 0.004600 rad."
    assert expected in told["What is missing?"]
    (said,) = told["What to measure next?"]
    assert "0.103 s" in said, "more samples would not help"


@pytest.mark.parametrize(
    ("verdict", "formula"), [("unknown_effect", ""), ("unknown_effect", "d(x)/dt"), ("effect_found", "")]
)
def test_errors_that_follow_the_signals_are_told_where_no_formula_says_more(verdict, formula):
    told = TANK[0] | {"verdict": verdict, "formula": formula, "follows": {"share": 0.67, "p_value": 0.005}}
    lines = answers(told)["What is missing?"]
    expected = verdict == "unknown_effect" and not formula
    assert ("The remaining errors follow the signals: 67 % of their energy." in lines) is expected
    assert any("spills over" in line or "verflow" in line for line in lines), "the names stay"
