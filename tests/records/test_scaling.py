import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toys import small_record, spec, toy_model

from pgrssnn_jax.models.scaling import fit_scaling, model_scaling
from pgrssnn_jax.physics.base import Signal, discrete
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.record import cast, stack
from pgrssnn_jax.records.scaling import Affine, identity, in_units, measured_units, signal_scaling, standard_units

DRAW = np.random.default_rng(3)
U = DRAW.normal([1.0, -2.0], [0.5, 3.0], size=(2, 30, 2))
Y = DRAW.normal([4.0, 0.0], [2.0, 0.1], size=(2, 30, 2))


def moving(states):
    """x⁺ = (0.5 x + [u0, u1, 1, 1 ...]), outputs y0 and y1, sampled every 0.5 s."""

    def step(p, x, u):
        push = jnp.concatenate([u, jnp.ones(len(states) - 2, x.dtype)])
        return p["a"] * x + push

    return discrete(
        "moving",
        step,
        lambda p, x, u: x[:2],
        {"a": 0.5},
        states=states,
        inputs=(Signal("u0"), Signal("u1")),
        outputs=(Signal("y0"), Signal("y1")),
        dt=0.5,
    )


@settings(deadline=None, max_examples=40, derandomize=True)
@given(
    offset=st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=2),
    scale=st.lists(st.floats(1e-3, 1e3), min_size=2, max_size=2),
    value=st.floats(-1e3, 1e3),
)
def test_scaling_round_trip(offset, scale, value):
    with jax.enable_x64(True):
        affine = Affine(np.array(offset), np.array(scale))
        x = jnp.full((3, 2), value)
        tolerance = 1e-12 * (1 + np.abs(offset).max() + abs(value))
        np.testing.assert_allclose(affine.to_physical(affine.to_scaled(x)), x, rtol=0, atol=tolerance)
        expected = np.broadcast_to(np.array(offset) + np.array(scale) * value, (3, 2))
        np.testing.assert_allclose(affine.to_physical(x), expected, rtol=1e-12, atol=1e-12)
        # stretch carries differences
        difference = affine.to_physical(x + 1.0) - affine.to_physical(x)
        bound = 1e-12 * (1 + np.abs(offset).max() + np.abs(scale).max() * (1 + abs(value)))
        np.testing.assert_allclose(difference, affine.unscale_difference(jnp.ones((3, 2))), rtol=0, atol=bound)


def test_scaling_keeps_the_precision_of_the_signal():
    affine = Affine(np.array([1.0]), np.array([2.0]))
    with jax.enable_x64(True):
        for dtype in (jnp.float32, jnp.float64):
            x = jnp.ones((2, 3, 1), dtype)
            assert {f(x).dtype for f in (affine.to_scaled, affine.to_physical, affine.unscale_difference)} == {
                jnp.dtype(dtype)
            }


def test_identity_changes_nothing():
    x = jnp.asarray(DRAW.normal(size=(4, 3)), jnp.float32)
    np.testing.assert_array_equal(identity(3).to_scaled(x), x)
    np.testing.assert_array_equal(identity(3).to_physical(x), x)


def test_scaled_training_signals_have_mean_zero_and_deviation_one():
    with jax.enable_x64(True):
        for affine, signal in zip(signal_scaling(small_record(U, Y)), (U, Y), strict=True):
            scaled = np.asarray(affine.to_scaled(jnp.asarray(signal)))
            np.testing.assert_allclose(scaled.mean((0, 1)), 0.0, atol=1e-12)
            np.testing.assert_allclose(scaled.std((0, 1)), 1.0, rtol=1e-12)


def test_masked_samples_do_not_count():
    y, mask = Y.copy(), np.ones(Y.shape, bool)
    y[0, :10, 0], mask[0, :10, 0] = 1e6, False
    y[1, 25:, 1], mask[1, 25:, 1] = np.nan, False
    affine = signal_scaling(small_record(U, y, mask=mask))[1]
    for j in range(2):
        counted = y[..., j][mask[..., j]]
        np.testing.assert_allclose(affine.offset[j], counted.mean(), rtol=1e-12)
        np.testing.assert_allclose(affine.scale[j], counted.std(), rtol=1e-12)


def test_an_output_never_measured_is_left_alone():
    mask = np.ones(Y.shape, bool)
    mask[..., 1] = False
    affine = signal_scaling(small_record(U, Y, mask=mask))[1]
    assert (affine.offset[1], affine.scale[1]) == (0.0, 1.0)
    np.testing.assert_allclose(affine.scale[0], Y[..., 0].std(), rtol=1e-12)


@pytest.mark.parametrize("value", [0.0, 0.1, -7.3, 1e6 / 3])
def test_a_constant_channel_keeps_scale_one(value):
    u, y = U.copy(), Y.copy()
    u[..., 1], y[..., 0] = value, value
    for affine, j in zip(signal_scaling(small_record(u, y)), (1, 0), strict=True):
        np.testing.assert_allclose(affine.offset[j], value, rtol=1e-12)
        assert affine.scale[j] == 1.0
        assert affine.scale[1 - j] != 1.0


def test_a_constant_channel_keeps_scale_one_in_single_precision():
    u = np.stack([np.full(20_000, 0.1), DRAW.normal(size=20_000)], -1)
    affine = signal_scaling(cast(small_record(u, u), np.float32))[0]
    assert affine.scale[0] == 1.0


def test_a_state_like_an_output_shares_its_scaling():
    scaling = fit_scaling(small_record(U, Y), moving((Signal("a", like="y1"), Signal("b", like="y0"))))
    np.testing.assert_array_equal(scaling.x.offset, scaling.y.offset[::-1])
    np.testing.assert_array_equal(scaling.x.scale, scaling.y.scale[::-1])


RATE_STATES = (Signal("a", like="y0"), Signal("v", rate_of="y1"))


def ramps(samples: int = 30) -> np.ndarray:
    """y1 of the two sequences falls by 2 and rises by 4 per second, far from zero."""
    y = np.resize(Y, (2, samples, 2)) + 100.0
    y[0, :, 1] -= np.arange(samples) + y[0, :, 1]
    y[1, :, 1] += 2 * np.arange(samples) - y[1, :, 1]
    return y


def test_a_rate_is_scaled_by_differences_and_has_no_offset():
    # differences within sequences alone: the jump from the first to the second is no motion
    scaling = fit_scaling(small_record(U, ramps()), moving(RATE_STATES))
    assert scaling.x.offset[1] == 0.0
    np.testing.assert_allclose(scaling.x.scale[1], np.sqrt((2.0**2 + 4.0**2) / 2), rtol=1e-9)


def test_white_noise_of_the_measurement_does_not_count_as_motion():
    time = np.arange(20000)
    y = np.repeat(np.sin(0.02 * time)[None, :, None], 2, axis=2).repeat(2, axis=0)
    noisy = y + np.random.default_rng(0).normal(0, 0.1, y.shape)
    u = np.zeros(y.shape)
    clean, found = (fit_scaling(small_record(u, a), moving(RATE_STATES)).x.scale[1] for a in (y, noisy))
    np.testing.assert_allclose(clean, 0.02 / np.sqrt(2) / 0.5, rtol=1e-3)
    np.testing.assert_allclose(found, clean, rtol=0.2)
    assert np.diff(noisy[..., 1], axis=1).std() / 0.5 > 9 * clean  # what plain differences say


@pytest.mark.parametrize("kind", ["trembles", "fast"])
def test_a_rate_whose_differences_disagree_is_scaled_by_the_plain_ones(kind):
    wave = np.arange(30) % 2 if kind == "trembles" else np.sin(1.8 * np.arange(30))
    y = np.broadcast_to(wave[:, None], (2, 30, 2)) + 5.0
    scale = fit_scaling(small_record(U, y), moving(RATE_STATES)).x.scale[1]
    np.testing.assert_allclose(scale, np.sqrt(np.mean(np.diff(wave) ** 2)) / 0.5, rtol=1e-9)


def test_a_rate_can_take_its_outputs_scaling_as_published():
    scaling = fit_scaling(small_record(U, Y), moving(RATE_STATES), rates_like_outputs=True)
    assert (scaling.x.offset[1], scaling.x.scale[1]) == (scaling.y.offset[1], scaling.y.scale[1])


def test_a_rate_does_not_difference_over_a_gap():
    y, mask = ramps(), np.ones(Y.shape, bool)
    y[0, 10, 1], mask[0, 10, 1] = 1e5, False
    scaling = fit_scaling(small_record(U, y, mask=mask), moving((Signal("a"), Signal("v", rate_of="y1"))))
    # of the first sequence 27 steps of one and 26 of two samples are left, of the second 29 and 28
    one, two = (np.average([1.0, 4.0], weights=w) for w in ([27, 29], [26, 28]))
    np.testing.assert_allclose(scaling.x.scale[1], np.sqrt((4 * two - one) / 3) / 0.5, rtol=1e-9)


@pytest.mark.parametrize("case", ["one sample", "never measured"])
def test_a_rate_that_nobody_saw_keeps_scale_one(case):
    u, y = (U[:, :1], Y[:, :1]) if case == "one sample" else (U, Y)
    whole = small_record(u, y, mask=np.array(case == "one sample") & np.ones(y.shape, bool))
    assert fit_scaling(whole, moving((Signal("a"), Signal("v", rate_of="y1")))).x.scale[1] == 1.0


def test_any_other_state_is_scaled_by_simulation_from_zero():
    physics = moving((Signal("a"), Signal("b"), Signal("c")))
    scaling = fit_scaling(small_record(U, Y), physics)
    x, states = np.zeros((2, 3)), []
    for t in range(30):
        x = 0.5 * x + np.concatenate([U[:, t], np.ones((2, 1))], -1)
        states.append(x)
    states = np.array(states)
    np.testing.assert_allclose(scaling.x.offset, states.mean((0, 1)), rtol=1e-5)
    np.testing.assert_allclose(scaling.x.scale, states.std((0, 1)), rtol=1e-5)


def test_states_that_leave_the_floating_point_range_do_not_spoil_the_others():
    physics = lgssm(A=[[1e30, 0.0], [0.0, 0.5]], B=[[1.0], [1.0]], C=[[1.0, 0.0]])
    scaling = fit_scaling(small_record(U[..., :1], Y[..., :1]), physics)
    assert all(np.isfinite(a).all() for a in jax.tree.leaves(scaling))
    assert 0.1 < scaling.x.scale[1] < 10.0


def test_a_black_box_has_no_states_to_scale():
    whole = small_record(U, Y)
    scaling = model_scaling(toy_model(spec("RSSNN")), whole)
    np.testing.assert_array_equal(scaling.x, identity(3))
    for a, b in zip(jax.tree.leaves((scaling.u, scaling.y)), jax.tree.leaves(signal_scaling(whole)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_standard_units_are_those_of_every_datasets_own_training_record():
    """Two datasets: each is scaled by its own training record; other records follow, whatever they hold."""
    train = stack([small_record(U, Y), small_record(3 * U + 1, 5 * Y - 2)])
    other = stack([small_record(7 * U, 9 * Y), small_record(U - 50, Y + 50)])
    units = standard_units(train)
    scaled, scaled_other = in_units(train, units), in_units(other, units)
    for i in range(2):
        for name in "uy":
            raw = getattr(train, name)[i]
            mean, deviation = raw.mean((0, 1)), np.sqrt(np.mean([sequence.var(0) for sequence in raw], 0))
            for scaled_record, record in ((scaled, train), (scaled_other, other)):
                expected = (getattr(record, name)[i] - mean) / deviation
                np.testing.assert_allclose(getattr(scaled_record, name)[i], expected, rtol=1e-9, atol=1e-9)
            unit = getattr(units, name)
            back = unit.offset[i] + unit.scale[i] * getattr(scaled_other, name)[i]
            np.testing.assert_allclose(back, getattr(other, name)[i], rtol=1e-9, atol=1e-9)
    assert scaled.info == train.info
    np.testing.assert_array_equal(scaled_other.mask, other.mask)


def test_standard_units_do_not_count_what_was_not_measured():
    y, mask = Y.copy(), np.ones(Y.shape, bool)
    y[0, :10, 0], mask[0, :10, 0] = 1e6, False
    units = standard_units(stack([small_record(U, y, mask=mask)]))
    sequences = Y[0, 10:, 0], Y[1, :, 0]
    np.testing.assert_allclose(units.y.offset[0, 0], np.concatenate(sequences).mean(), rtol=1e-12)
    np.testing.assert_allclose(units.y.scale[0, 0], np.sqrt(np.mean([s.var() for s in sequences])), rtol=1e-12)


def test_measured_units_are_the_identity_of_every_dataset():
    train = stack([small_record(U, Y), small_record(3 * U + 1, 5 * Y - 2)])
    units = measured_units(train)
    for unit, n in zip(units, (train.u.shape, train.y.shape), strict=True):
        np.testing.assert_array_equal(unit.offset, np.zeros((2, n[-1])))
        np.testing.assert_array_equal(unit.scale, np.ones((2, n[-1])))
    same = in_units(train, units)
    np.testing.assert_array_equal(same.u, train.u)
    np.testing.assert_array_equal(same.y, train.y)
