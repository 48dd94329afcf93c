"""Effects that were hidden in simulated records are named, nothing is named where nothing is missing, and what the data
cannot tell is said."""

import jax.numpy as jnp
import numpy as np
import pytest
from discovery.small_cases import choices, discovered, fine_tanks, pump, setup_of, tank_record

import pgrssnn_jax as pg
from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.discover import Discovery, discover_in
from pgrssnn_jax.discovery.finding import fitted
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.serialise import discovery_json
from pgrssnn_jax.discovery.setup import Start
from pgrssnn_jax.discovery.untestable import untestable
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, record

pytestmark = pytest.mark.slow
TRUE = {"k1": 0.049, "k2": 0.0003, "k3": 0.043, "k4": 0.056, "k5": 0.0039}
U = pump(400, 7, high=5.0)
RIM = float(np.quantile(fine_tanks(U, k=TRUE, sub=4)[:, 0, 0], 0.75))


@pytest.fixture(scope="module")
def tanks() -> tuple[Problem, Problem]:
    physics = cascaded_tanks(integrator="rk4")
    names = ("overflow_1to2", "overflow_lost", "pump_saturation")
    problem = build_problem(physics, [e for e in catalogue(physics) if e.name in names])
    return problem, Corrected()


@pytest.mark.parametrize(
    ("hidden", "name", "number"),
    [
        ({"rim": RIM, "share": 0.8}, "overflow_1to2", ("level", RIM)),
        ({"most": 3.5}, "pump_saturation", ("voltage", 3.5)),
        ({}, None, None),
    ],
)
def test_hidden_effects_of_tanks_are_named_and_nothing_else(tanks, hidden, name, number):
    problem, corrected = tanks
    train, test = (tank_record(w, k=TRUE, seed=i, **hidden) for i, w in enumerate((U, pump(160, 8, high=5.0))))
    found = discovered(problem, train, test, choices(), corrected=corrected)
    selection = found.selection
    if name is None:
        assert found.judgement.verdict is Verdict.MISCALIBRATED
        assert selection.final.estimate.active == ()
        assert selection.first.rms() < 1.25 * selection.floor
        return
    assert found.judgement.verdict is Verdict.EFFECT_FOUND
    assert selection.final.estimate.active == (name,)
    assert selection.last.rms() < 1.25 * selection.floor < 0.3 * selection.first.rms()
    params = problem.params(selection.final.estimate.theta)
    assert float(params.effects[name][number[0]]) == pytest.approx(number[1], rel=0.03)
    assert float(params.own["k1"]) == pytest.approx(TRUE["k1"], rel=0.05)
    assert found.test.improvement[0] > 0.0


def test_an_elaborate_effect_is_found_where_the_others_leave_errors(tanks):
    problem, _ = tanks
    setup = setup_of(problem, *(tank_record(U, k=TRUE, seed=i, rim=RIM, share=0.8) for i in (0, 1)), choices())
    effects = tuple(e._replace(elaborate=e.name == "overflow_1to2") for e in problem.effects)
    setup, said = setup._replace(effects=effects), []
    first = build_problem(problem.physics, setup.first_effects)
    found = discover_in(first, setup, said.append)
    assert found.selection.final.estimate.active == ("overflow_1to2",)
    assert any("looking for overflow_1to2 too" in line for line in said)


A, B, C = np.array([[0.6, 0.7], [-0.1, 0.0]]), np.array([-1.1, 0.0]), np.array([0.9, -0.1])
LGSSM = RecordInfo((Channel("u"),), (Channel("y"),), 1.0, "simulated")


def linear_record(samples: int, seed: int, damping: float = 0.0, offset: float = 0.0) -> Record:
    draw = np.random.default_rng(seed)
    u, x, y = 2.0 * draw.standard_normal((samples, 1)), np.zeros(2), []
    for (v,) in u:
        x = A @ x + B * v - damping * np.abs(x) * x
        y.append([C @ x + offset + 0.02 * draw.standard_normal()])
    return record(u, np.array(y), LGSSM)


def linear_problem(*names: str, fixed: tuple[str, ...] = ()) -> Problem:
    physics = lgssm(A=A, B=B[:, None], C=C[None])
    return build_problem(physics, [e for e in catalogue(physics) if e.name in names], fixed=fixed)


def linear(problem: Problem, damping: float = 0.0, offset: float = 0.0, start: Start = Start.SHARED, **changes):
    data = (linear_record(n, seed, damping, offset) for n, seed in ((320, 1), (160, 2)))
    return discovered(problem, *data, choices(**changes), start)


def test_what_the_catalogue_lacks_is_not_called_nothing():
    """Quadratic damping hidden: named with it; without it in the catalogue still no `no_discrepancy`."""
    problem = linear_problem("quadratic_damping", "sensor_offset")
    nothing = linear(problem)
    assert nothing.judgement.verdict is Verdict.NO_DISCREPANCY
    assert nothing.selection.final.estimate.active == ()
    named = linear(problem, 0.06)
    assert named.judgement.verdict is Verdict.EFFECT_FOUND
    assert named.selection.final.estimate.active == ("quadratic_damping",)
    assert named.test.after.error < 0.3 * named.test.recalibrated.error
    assert named.test.after.error < named.test.without["quadratic_damping"]
    removed = linear(problem, 0.06, without=["quadratic_damping"])
    assert removed.judgement.verdict is Verdict.UNKNOWN_EFFECT
    assert "quadratic_damping" not in {c.name for c in removed.selection.first.candidates}
    assert removed.formula is not None
    assert removed.formula.target.startswith("x")


def driven_through_a_dead_zone(samples: int, seed: int, low: float, high: float) -> Record:
    draw = np.random.default_rng(seed)
    u, x, y = np.repeat(draw.uniform(low, high, samples // 5), 5)[:, None], np.zeros(2), []
    for (v,) in u:
        x = A @ x + B * np.sign(v) * max(abs(v) - 0.5, 0.0)
        y.append([C @ x + 0.02 * draw.standard_normal()])
    return record(u, np.array(y), LGSSM)


def test_a_stand_in_that_does_harm_on_the_test_record_is_left_out():
    """A dead zone that has no name here is an offset while the input is mostly positive; then it is negative."""
    problem = linear_problem("input_offset", fixed=("A", "B", "C"))
    records = [driven_through_a_dead_zone(n, n, *ends) for n, ends in ((400, (-1.0, 4.0)), (160, (-4.0, 1.0)))]
    found = discovered(problem, *records, choices())
    assert found.refuted == ("input_offset",)
    assert found.judgement.verdict is Verdict.UNKNOWN_EFFECT
    assert found.selection.final.estimate.active == ()
    assert found.test.after.error == pytest.approx(found.test.recalibrated.error)
    assert found.formula is not None
    assert "u" in found.formula.text
    told = discovery_json(found, setup_of(problem, *records, choices()), command="")
    assert told["refuted"] == ["input_offset"]
    assert told["effects"] == []
    assert "refuted by the test record, and left out: input_offset" in told["sentence"]


def test_a_correction_that_the_test_record_refutes_is_not_what_is_missing():
    """A dead zone without a name in the estimation record, and none in the test record. That errors follow the signals
    is still said."""
    problem = linear_problem(fixed=("A", "B", "C"))
    records = driven_through_a_dead_zone(400, 1, -2.0, 2.0), linear_record(160, 2)
    found = discovered(problem, *records, choices())
    assert found.judgement.verdict is Verdict.UNKNOWN_EFFECT
    assert found.judgement.unnamed is None
    assert found.formula is None
    (name,) = found.refuted
    told = discovery_json(found, setup_of(problem, *records, choices()), command="")
    assert f"refuted by the test record, and left out: {name}" in told["sentence"]


def linear_with_decoys(offset: float) -> Discovery:
    names = ("sensor_offset", "input_offset", "input_gain", "input_dead_zone")
    return linear(linear_problem(*names, fixed=("B",)), offset=offset, start=Start.UNKNOWN)


def test_offsets_before_and_behind_a_linear_system_are_ambiguous():
    """A constant at the input is one at the output, wherever the system starts."""
    found = linear_with_decoys(0.8)
    assert found.judgement.verdict is Verdict.AMBIGUOUS
    (named,) = found.selection.final.estimate.active
    (others,) = found.judgement.alternatives.values()
    assert {named, *(other.name for other in others)} == {"sensor_offset", "input_offset"}
    (other,) = others
    assert other.model is not None
    (number,) = fitted(found.problem, other.model, other.name).values()
    assert np.all(np.abs(number["value"]) > 5.0 * np.array(number["std"]))  # offsets of the input and the output differ


def test_a_gain_that_a_matrix_takes_up_is_untestable():
    found = linear_with_decoys(0.0)
    assert found.judgement.verdict is Verdict.NO_DISCREPANCY
    reasons = {entry["name"]: entry["reason"] for entry in untestable(found)}
    assert set(reasons) == {"input_gain"}
    assert "parameters" in reasons["input_gain"]


def oscillator(m: float, c: float, k: float) -> pg.Physics:
    return pg.continuous(
        "oscillator",
        lambda p, x, u: jnp.stack([x[1], (u[0] - p["c"] * x[1] - p["k"] * x[0]) / p["m"]]),
        lambda p, x, u: x[:1],
        {"m": m, "c": c, "k": k},
        parameters={name: pg.Parameter(name, bounds=(0.01, 20.0)) for name in ("m", "c", "k")},
        states=(pg.Signal("position", "m", like="position"), pg.Signal("velocity", "m/s", rate_of="position")),
        inputs=(pg.Signal("force", "N"),),
        outputs=(pg.Signal("position", "m"),),
        dt=0.05,
    )


def test_hysteresis_of_an_oscillator_is_named_with_its_numbers():
    """It is elaborate: simpler effects are tried first, and leave errors."""
    hidden, records = pg.add(oscillator(1.05, 0.42, 3.8), "hysteresis", k=3.0, s=0.25), []
    for seed in (0, 1):
        draw = np.random.default_rng(seed)
        u = np.repeat(draw.uniform(-2.5, 2.5, 40), 20)[:, None]
        y = np.asarray(pg.simulate(hidden, u, np.zeros(3)).y)
        noisy = y + 0.003 * draw.standard_normal(y.shape)
        records.append(pg.record(u, noisy, dt=0.05, inputs={"force": "N"}, outputs={"position": "m"}, start="unknown"))
    found = pg.discover(oscillator(1.0, 0.4, 4.0), *records, network_epochs=0, quiet=True)
    assert [effect.name for effect in found.effects] == ["hysteresis"]
    for name, true in (("k", 3.0), ("s", 0.25)):
        assert found.effects[0].parameters[name]["value"][0] == pytest.approx(true, rel=0.03)
