"""What the sentence says of the gap, and of where effects act."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from pgrssnn_jax.discovery.discover import Discovery
from pgrssnn_jax.discovery.sentence import sentence
from pgrssnn_jax.discovery.verdict import Clear, Verdict

OFFSET = {
    "name": "input_offset",
    "title": "Input offset",
    "channel_names": ["heat1", "heat2", "outdoor"],
    "acts_at": ["heat1"],
    "parameters": {},
}


BOTH = Clear(estimation=True, test=True)


def said(
    closed: float,
    at: list[str],
    verdict: Verdict = Verdict.EFFECT_FOUND,
    others: Sequence = (),
    improvement: tuple[float, float] = (0.1, 0.2),
    relative: float = 0.5,
    convention: str | None = None,
    clear: Clear = BOTH,
    refuted: tuple[str, ...] = (),
) -> str:
    error = np.random.default_rng(0).standard_normal((1, 200, 1))
    selection = SimpleNamespace(
        last=SimpleNamespace(rms=lambda: 3.0),
        floor=1.0,
        final=SimpleNamespace(estimate=SimpleNamespace(error=error, active=("input_offset",))),
    )
    test = SimpleNamespace(improvement=improvement, relative=relative)
    told = {
        "judgement": SimpleNamespace(verdict=verdict),
        "selection": selection,
        "test": test,
        "convention": convention,
        "clear": clear,
        "refuted": refuted,
    }
    found = Discovery._make(told.get(name) for name in Discovery._fields)
    errors = {name: {"test": value} for name, value in (("before", 3.0), ("recalibrated", 2.0), ("after", 1.0))}
    gap = {**errors, "metric": "RMSE", "unit": "K", "floor": 0.1, "closed_fraction": closed}
    return sentence(found, gap, [OFFSET | {"acts_at": at}] if at else [], others, [], "everywhere alike")


@pytest.mark.parametrize(("closed", "begins"), [(0.9, "Missing: "), (0.2, "Missing, but most of the gap stays open: ")])
def test_it_begins_with_what_stays_open_where_that_is_most(closed, begins):
    assert said(closed, ["heat1"]).startswith(f"{begins}input offset (heat1); ")
    assert f"{100 * closed:.0f} % of the gap above the noise closed" in said(closed, ["heat1"])


def test_names_that_close_little_help_but_do_not_explain():
    told = said(0.2, ["heat1"], Verdict.UNEXPLAINED)
    assert told.startswith("Errors stand 3.0 times above the white noise and nothing accounts for most of them: ")
    assert "with input offset (heat1), which helps but does not explain it" in told


def test_errors_of_the_test_record_alone_are_told():
    told = said(0.0, [], Verdict.UNEXPLAINED, clear=Clear(estimation=False, test=True))
    assert told.startswith("Errors stand 10.0 times above the white noise on the test record, and 3.0 times on the ")
    assert "nothing accounts" not in told


def test_refuted_names_leave_errors_that_may_be_an_effect_of_another_form():
    told = said(0.0, [], Verdict.UNEXPLAINED, refuted=("backlash", "hysteresis"))
    assert "an effect that no curve here describes, noise with a memory of " in told
    assert "refuted by the test record, and left out: backlash, hysteresis" in told
    assert "an effect that" not in said(0.0, [], Verdict.UNEXPLAINED)


def test_another_channel_of_the_same_effect_is_an_alternative():
    other = {"name": "input_offset", "instead_of": "input_offset", "acts_at": ["heat2"]}
    told = said(0.9, ["heat1"], Verdict.AMBIGUOUS, [other, {"name": "leak", "instead_of": "input_offset"}])
    assert "input offset (heat1), or, which these data cannot tell apart, input_offset (heat2), leak;" in told


def test_channels_are_named_where_there_are_others():
    assert "input offset;" in said(0.9, OFFSET["channel_names"])
    assert "input offset (heat1, outdoor);" in said(0.9, ["heat1", "outdoor"])


@pytest.mark.parametrize(
    ("improvement", "begins"),
    [
        ((0.1, 0.2), "Only parameters were wrong: test RMSE 3 K nominal, 2 K recalibrated"),
        ((-0.1, 0.2), "Only parameters were wrong: "),
        ((-0.2, -0.1), "Only parameters were wrong, but the test record refutes the new ones: "),
    ],
)
def test_a_recalibration_that_does_harm_on_the_test_record_is_told(improvement, begins):
    """A pendulum that turns over in the test record, and not in the other one."""
    assert said(0.0, ["heat1"], Verdict.MISCALIBRATED, improvement=improvement).startswith(begins)


@pytest.mark.parametrize(("relative", "told"), [(0.9, False), (40.0, True), (float("nan"), True)])
def test_a_model_that_is_no_better_than_the_mean_is_told(relative, told):
    """One that leaves its range in the test record has an error of any size, or none."""
    found = said(0.0, ["heat1"], Verdict.NOT_CONFIRMED, relative=relative)
    assert found.startswith("Found on the estimation record, not confirmed by the test record: input offset (heat1); ")
    assert ("1 K with it, no better than the mean of the test record." in found) is told


@pytest.mark.parametrize(
    ("verdict", "rest"),
    [(Verdict.MISCALIBRATED, "only parameters were wrong: "), (Verdict.NO_DISCREPANCY, "nothing is missing: ")],
)
def test_a_reading_convention_comes_first(verdict, rest):
    found = said(0.0, [], verdict, convention="input_delay")
    assert found.startswith(f"Outputs are read before the inputs act, one sample earlier. Beside that, {rest}")
    assert ", 1 K with that reading, noise about 0.1 K." in found
