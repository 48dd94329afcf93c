"""Logs in any form give the record of the joints that they were written from."""

import re
from itertools import pairwise

import numpy as np
import pytest

from pgrssnn_jax.data.arm_log import load_arm_log
from pgrssnn_jax.physics.arms.build import arm

DT, FINE = 0.02, 0.002  # s
N = np.array([[32.0, 0, 0], [0, -48.0, 0], [0, 20.0, 45.0]])  # the third motor turns with the second joint too
CONSTANT = np.array([0.3, -0.5, 0.2])  # Nm/A
ZERO = np.array([0.0, np.pi / 2, -1.0])
JOINTS = range(1, 4)


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    file = tmp_path_factory.mktemp("robot") / "three.urdf"
    link = (
        "<link name='{0}'><inertial><origin xyz='0.1 0 0.2'/><mass value='2'/>"
        "<inertia ixx='.1' iyy='.1' izz='.1' ixy='0' ixz='0' iyz='0'/></inertial></link>"
    )
    joint = "<joint name='j_{0}' type='continuous'><parent link='{1}'/><child link='{0}'/><axis xyz='0 1 0'/></joint>"
    names = ("base", "a", "b", "c")
    parts = [link.format(name) for name in names] + [joint.format(child, parent) for parent, child in pairwise(names)]
    file.write_text(f"<robot name='three'>{''.join(parts)}</robot>")
    return arm(urdf=file, gear_ratio=[32.0, -48.0, 45.0], dt=DT)


def motion(time):
    """Position, rad, speed and torque, Nm on the link side, of the joints at any times."""
    rates, phases = np.array([1.0, 2.3, 3.1]), np.array([0.0, 0.4, 1.0])
    angle = np.asarray(time)[:, None] * rates + phases
    return np.sin(angle), rates * np.cos(angle), 5.0 * np.cos(1.7 * angle)


def write(folder, time, position, torque, velocity=None, sequence=None):
    columns = {"t": time} if time is not None else {}
    if sequence is not None:
        columns["sequence"] = sequence
    for name, values in (("pos", position), ("cur", torque), ("vel", velocity)):
        if values is not None:
            columns |= {f"{name}{i}": values[:, i - 1] for i in JOINTS}
    file = folder / "log.csv"
    rows = zip(*(map(repr, np.asarray(column).tolist()) for column in columns.values()), strict=True)
    file.write_text("\n".join([",".join(columns), *(",".join(row) for row in rows)]).replace("'", ""))
    return file


NAMED = {"time": "t", "position": "pos%d", "torque": "cur%d"}


def whole(splits):
    """The estimation record, put together again."""
    return (np.concatenate([splits.train[k][0, 0], splits.validation[k][0, 0]]) for k in (0, 1))


def assert_inside(found, expected, atol):
    """But for the ends, where a filter knows one side."""
    np.testing.assert_allclose(found[20:-20], expected[20:-20], rtol=0, atol=atol)


def test_motors_degrees_currents_and_a_coupled_wrist(tmp_path, three):
    time = FINE * np.arange(4000)
    q, _, tau = motion(time)
    turned, currents = np.rad2deg((q - ZERO) @ N.T), np.linalg.solve(N.T, tau.T).T / CONSTANT
    splits = load_arm_log(
        train=write(tmp_path, time, turned, currents), physics=three, **NAMED, position_unit="deg",
        position_side="motor", position_zero=ZERO.tolist(), torque_constant=CONSTANT.tolist(), transmission=N.tolist(),
    )  # fmt: skip
    u, y = whole(splits)
    at = DT * np.arange(len(y))
    assert len(y) == round(400 * 2 / 3)
    assert_inside(y, motion(at)[0], 1e-3)
    assert_inside(u * three.params["G"], motion(at)[2], 5e-3)
    test_at = DT * (len(y) + np.arange(splits.test.u.shape[2]))
    assert_inside(splits.test.y[0, 0], motion(test_at)[0], 1e-3)
    assert "500 Hz, low-pass filtered at 20 Hz" in splits.train.info.origin
    assert splits.train.info.bandwidth == 20.0


def test_link_side_torques_are_those_of_the_motors_times_the_gears(tmp_path, three):
    time = DT * np.arange(60)
    q, _, tau = motion(time)
    splits = load_arm_log(train=write(tmp_path, time, q, tau), physics=three, **NAMED, torque_side="link")
    u, y = whole(splits)
    np.testing.assert_allclose(y, q[:40], rtol=1e-12)
    np.testing.assert_allclose(u * three.params["G"], tau[:40], rtol=1e-12)


def test_a_clock_that_jitters_is_made_even(tmp_path, three):
    draw = np.random.default_rng(0)
    time = FINE * (np.arange(4000) + draw.uniform(-0.3, 0.3, 4000))
    time -= time[0]
    q, v, tau = motion(time)
    settings = {"physics": three, **NAMED, "torque_side": "link"}
    plain = load_arm_log(train=write(tmp_path, time, q, tau), **settings)
    hermite = load_arm_log(train=write(tmp_path, time, q, tau, v), **settings, velocity="vel%d")
    for splits in (plain, hermite):
        _, y = whole(splits)
        assert_inside(y, motion(DT * np.arange(len(y)))[0], 1e-3)


def test_what_is_faster_than_the_new_rate_does_not_come_back_as_something_slow(tmp_path, three):
    time = FINE * np.arange(4000)
    q, _, tau = motion(time)
    hum = np.sin(2 * np.pi * 51.0 * time)[:, None]  # every 0.02 s it would be 1 Hz
    splits = load_arm_log(train=write(tmp_path, time, q, tau + hum), physics=three, **NAMED, torque_side="link")
    u, _ = whole(splits)
    assert_inside(u * three.params["G"], motion(DT * np.arange(len(u)))[2], 0.03)


def test_arrays_of_an_npz_file(tmp_path, three):
    time = DT * np.arange(60)
    q, _, tau = motion(time)
    np.savez(tmp_path / "log.npz", q=np.stack([q, 2 * q]), tau=np.stack([tau, tau]), other=np.array(["text"]))
    named = {"time": None, "sample_time": DT, "position": "q", "torque": "tau"}
    splits = load_arm_log(train=tmp_path / "log.npz", physics=three, **named, torque_side="link", test_share=0.5)
    assert splits.test.y.shape == (1, 1, 60, 3)
    np.testing.assert_allclose(splits.test.y[0, 0], 2 * q, rtol=1e-12)


def test_sequences_of_a_file_stay_apart(tmp_path, three):
    time, label = DT * np.tile(np.arange(30), 3), np.repeat([0, 1, 2], 30)
    q, _, tau = motion(time + label)
    splits = load_arm_log(train=write(tmp_path, time, q, tau, sequence=label), physics=three, **NAMED)
    assert [part.y.shape for part in splits] == [(1, 1, 30, 3)] * 3
    np.testing.assert_allclose(splits.test.y[0, 0], q[60:], rtol=1e-12)


BAD = {
    "a column": ({"position": "angle%d"}, "data.train: .*column 'angle1': expected a column of this name"),
    "a pattern": ({"position": ["pos1", "pos2"]}, "data.train: expected one column per joint, 3"),
    "a singular wrist": ({"transmission": [[1, 1, 0], [1, 1, 0], [0, 0, 1]]}, "data.transmission: .* can be inverted"),
    "ratios": ({"transmission": [1.0, 2.0]}, "data.transmission: expected 3 ratios"),
    "constants": ({"torque_constant": [1.0, 2.0]}, "data.torque_constant: expected one number or 3"),
    "a cut-off": ({"cutoff": 300.0}, "cutoff: expected more than 0 and less than 250 Hz, found 300"),
    "no rate": ({"time": None}, "data.sample_time: expected s per sample where data.time is null, found None"),
    "a share": ({"test_share": 1.5}, "data.test_share: expected more than 0 and less than 1, found 1.5"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_settings_say_what_is_wrong(name, tmp_path, three):
    settings, message = BAD[name]
    time = FINE * np.arange(200)
    q, _, tau = motion(time)
    with pytest.raises(ValueError, match=message):
        load_arm_log(train=write(tmp_path, time, q, tau), physics=three, **{**NAMED, **settings})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: np.where(t > 0.1, t + 0.5, t), "expected gaps up to 0.02 s (physics.dt), found 0.502 s at 0.1 s"),
        (lambda t: np.where(t > 0.1, t - 0.05, t), "expected times that grow, found 0.052 s twice or behind"),
        (lambda t: 100 * t, "expected a sample every 0.02 s (physics.dt) or more, found one every 0.2 s"),
    ],
)
def test_bad_clocks_are_refused(change, message, tmp_path, three):
    time = FINE * np.arange(200)
    q, _, tau = motion(time)
    with pytest.raises(ValueError, match=re.escape(message)):
        load_arm_log(train=write(tmp_path, change(time), q, tau), physics=three, **NAMED)
