"""A record is brought to the signals of a physics, or refused with the name of what does not fit."""

import numpy as np
import pytest

from pgrssnn_jax.physics.base import Signal
from pgrssnn_jax.records.build import record_from
from pgrssnn_jax.records.matching import matched
from pgrssnn_jax.records.record import Channel, Record, stack

U, Y = (Signal("torque", "Nm"), Signal("pressure", "bar")), (Signal("angle", "rad"),)
DRAW = np.random.default_rng(0)


def measured(units=("Nm", "bar", "rad"), dt=0.1, names=("torque", "pressure", "angle")) -> Record:
    u, y = DRAW.normal(size=(2, 6, 2)), DRAW.normal(size=(2, 6, 1))
    y[1, 3] = np.nan
    named = list(zip(names, units, strict=True))
    return record_from(u, y, dt=dt, inputs=dict(named[:2]), outputs=dict(named[2:]), start="rest")


def match(record: Record) -> Record:
    return matched(record, U, Y, 0.1, where="data: train")


def test_a_record_in_the_units_of_the_physics_stays_as_it_is():
    record = measured()
    found = match(record)
    assert np.array_equal(found.u, record.u)
    assert np.array_equal(found.y, record.y)
    assert found.mask is record.mask
    assert found.info == record.info


@pytest.mark.parametrize("many", [False, True], ids=["record", "datasets"])
def test_every_channel_is_converted_by_its_own_factor(many):
    record = measured(("mNm", "mbar", "deg"))
    record = stack([record, record]) if many else record
    found = match(record)
    np.testing.assert_allclose(found.u, record.u * [1e-3, 1e-3], rtol=1e-12)
    np.testing.assert_allclose(found.y, np.deg2rad(record.y), rtol=1e-12)
    assert found.info.inputs == (Channel("torque", "Nm"), Channel("pressure", "bar"))
    assert found.info.outputs == (Channel("angle", "rad"),)
    assert np.array_equal(found.mask, record.mask)
    assert (found.info.start, found.info.dt) == ("rest", 0.1)
    again = match(found)
    assert np.array_equal(again.u, found.u)


def test_a_channel_of_its_own_keeps_its_factor():
    record = measured(("Nm", "kPa", "rad"))
    found = match(record)
    np.testing.assert_array_equal(found.u[..., 0], record.u[..., 0])
    np.testing.assert_allclose(found.u[..., 1], record.u[..., 1] / 100, rtol=1e-12)


def test_a_unit_that_nobody_said_is_taken_as_equal():
    record = measured(("", "bar", ""))
    found = match(record)
    np.testing.assert_array_equal(found.u, record.u)
    assert [channel.unit for channel in (*found.info.inputs, *found.info.outputs)] == ["Nm", "bar", "rad"]
    without = (Signal("torque"), Signal("pressure")), (Signal("angle"),)
    kept = matched(measured(), *without, 0.1, where="data: train")
    assert [channel.unit for channel in kept.info.inputs] == ["Nm", "bar"]


def test_the_validation_part_is_converted_too():
    record = measured()._replace(validation=measured(("mNm", "bar", "rad")))
    found = match(record)
    np.testing.assert_allclose(found.validation.u[..., 0], 1e-3 * record.validation.u[..., 0], rtol=1e-12)
    assert found.validation.info.inputs[0].unit == "Nm"
    wrong = measured()._replace(validation=measured(dt=0.2))
    with pytest.raises(ValueError, match=r"^data: train: validation: dt: expected 0.1 s, .*, found 0.2 s$"):
        match(wrong)


@pytest.mark.parametrize("dt", [0.0995, 0.1, 0.1005])
def test_clocks_are_no_better_than_a_percent(dt):
    match(measured(dt=dt))


@pytest.mark.parametrize(
    ("record", "sentence"),
    [
        (measured(dt=0.102), "dt: expected 0.1 s, the sample time of the physics, found 0.102 s"),
        (
            measured(names=("pressure", "torque", "angle")),
            r"inputs: expected those of the physics, \['torque', 'pressure'\], found \['pressure', 'torque'\]",
        ),
        (
            measured(names=("torque", "pressure", "position")),
            r"outputs: expected those of the physics, \['angle'\], found \['position'\]",
        ),
        (measured(("V", "bar", "rad")), "torque: expected a unit that converts to Nm, found V"),
        (measured(("Nm", "bar", "turns")), "angle: expected a unit that converts to rad, found turns"),
    ],
)
def test_what_does_not_fit_is_one_sentence(record, sentence):
    with pytest.raises(ValueError, match=f"^data: train: {sentence}$"):
        match(record)
