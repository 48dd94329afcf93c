"""What is hidden in a small arm, simulated by Pinocchio in fine steps, is named, or said to be in no catalogue."""

import numpy as np
import pytest
from discovery.small_cases import choices, discovered

from benchmarks.hidden.arm_plant import Effects, controlled
from pgrssnn_jax.data.arm_simulator import planned
from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.discover import Discovery
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.setup import Start, _stretches
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.arms.tables import ArmTables
from pgrssnn_jax.physics.arms.urdf import read_urdf
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, record

SEQUENCES, SAMPLES, NOISE = 8, 120, 0.002  # rad
NEUTRAL = Effects(np.zeros(2), np.zeros(2), np.ones(2), np.zeros(2))
LINK = (
    "<link name='{}'><inertial><origin xyz='0.1 0 -0.3'/><mass value='8'/>"
    "<inertia ixx='.3' iyy='.3' izz='.3' ixy='0' ixz='0' iyz='0'/></inertial></link>"
)
JOINT = (
    "<joint name='{1}_joint' type='revolute'><parent link='{0}'/><child link='{1}'/><origin xyz='0 0 -0.5'/>"
    "<axis xyz='0 1 0'/><limit lower='-1.5' upper='1.5' velocity='3' effort='500'/>"
    "<dynamics damping='6' friction='2'/></joint>"
)


@pytest.fixture(scope="module")
def crane(tmp_path_factory) -> tuple[ArmTables, Problem, Problem]:
    """Two joints in a plane; its problem with the catalogue, and with corrections that have no name."""
    parts = [LINK.format(name) for name in ("boom", "jib")]
    parts += [JOINT.format(*pair) for pair in (("base", "boom"), ("boom", "jib"))]
    file = tmp_path_factory.mktemp("arm") / "crane.urdf"
    file.write_text(f"<robot name='crane'><link name='base'/>{''.join(parts)}</robot>")
    physics = arm(urdf=file, sub_steps=5, derivatives="forward")
    problem = build_problem(physics, catalogue(physics), fixed=["B", "Tc"])
    return read_urdf(file, ()), problem, Corrected()


def motions(known: ArmTables, effects: Effects, tables: ArmTables | None = None) -> tuple[Record, Record]:
    rng = np.random.default_rng(3)
    plan = planned(rng, known, SEQUENCES, SAMPLES)
    u, clean = controlled(known, tables or known, effects, plan)
    y = clean + NOISE * rng.standard_normal(clean.shape)
    channels = ([Channel(f"{what}_{i + 1}", unit) for i in range(2)] for what, unit in _SIGNALS)
    info = RecordInfo(*(tuple(c) for c in channels), 0.1, "simulated")
    return record(u[:6], y[:6], info), record(u[6:], y[6:], info)


_SIGNALS = (("torque", "Nm"), ("position", "rad"))


def found_in(crane, *data, **changes) -> Discovery:
    _, problem, corrected = crane
    chosen = choices(stretches=[60, 60], fixed=["B", "Tc"], steps=12, **changes)
    return discovered(problem, *data, chosen, Start.AT_REST, corrected)


def test_stretches_are_no_longer_than_the_record(crane):
    _, problem, _ = crane
    short, _ = motions(crane[0], NEUTRAL)
    assert _stretches("auto", problem.physics, short) == [SAMPLES, 60, SAMPLES]


@pytest.mark.compiles
@pytest.mark.parametrize(
    ("name", "effects", "numbers"),
    [
        ("torque_bias", {"bias": np.array([6.0, -3.0])}, {"theta": [6.0, -3.0]}),
        ("torque_gain", {"gain": np.array([0.85, 1.1])}, {"gain": [0.85, 1.1]}),
        ("velocity_disturbance", {"memory": np.array([0.1, -0.15])}, {"S": [0.1, -0.15]}),
        ("home_offset", {"home": np.array([0.08, -0.05])}, {"offset": [0.08, -0.05]}),
    ],
)
def test_a_hidden_effect_is_named_with_its_numbers_on_every_joint(crane, name, effects, numbers):
    found = found_in(crane, *motions(crane[0], NEUTRAL._replace(**effects)))
    assert found.selection.final.estimate.active == (name,)
    assert found.judgement.verdict in (Verdict.EFFECT_FOUND, Verdict.AMBIGUOUS)
    params = crane[1].params(found.selection.final.estimate.theta)
    for key, values in numbers.items():
        np.testing.assert_allclose(params.effects[name][key], values, rtol=0.15, atol=0.01)
    assert found.test.after.error < 0.5 * found.test.before.error


@pytest.mark.compiles
def test_nothing_is_named_where_nothing_is_hidden(crane):
    """Of few draws of the null one effect may look certain; the test record refutes it."""
    found = found_in(crane, *motions(crane[0], NEUTRAL))
    assert found.judgement.verdict in (Verdict.NO_DISCREPANCY, Verdict.NOT_CONFIRMED)


@pytest.mark.compiles
def test_what_the_catalogue_lacks_is_unknown(crane):
    data = motions(crane[0], NEUTRAL._replace(home=np.array([0.08, -0.05])))
    found = found_in(crane, *data, without=["home_offset", "sensor_offset"])
    assert found.judgement.verdict is Verdict.UNKNOWN_EFFECT
    assert found.formula is not None
