import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import quick_jit, spec, toy_model, toy_params, toy_signals

from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.training.members import MemberMapping, choose_mapping, jit_members, map_members, repeat, select

MAPPINGS = [
    MemberMapping(how, sub_batch, devices)
    for how, sub_batch in [("vmap", None), ("vmap", 1), ("vmap", 2), ("vmap", 3), ("vmap", 99), ("loop", None)]
    for devices in (1, 2)
]


def one(tree, scalar):
    """Matrices of a member's own, a scalar, and results of several shapes and dtypes."""
    moved = jnp.tanh(tree["a"] @ tree["b"] + scalar)
    return {"moved": moved, "sum": (moved.sum(), jnp.argmax(moved))}


def trees(count):
    draw = np.random.default_rng(count)
    a, b, s = (draw.normal(size=(count, *shape)).astype(np.float32) for shape in ((2, 3), (3,), ()))
    return {"a": jnp.asarray(a), "b": jnp.asarray(b)}, jnp.asarray(s)


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("mapping", MAPPINGS, ids=str)
def test_every_mapping_gives_each_member_its_own_result(mapping, count):
    args = trees(count)
    expected = [one(*select(args, i)) for i in range(count)]
    found = quick_jit(map_members(one, mapping))(*args)
    assert jax.tree.structure(found) == jax.tree.structure(expected[0])
    for i in range(count):
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected[i]), strict=True):
            assert (a.shape, a.dtype) == ((count, *b.shape), b.dtype)
            np.testing.assert_allclose(a[i], b, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    "fields",
    [ModelSpec(networks=False), pytest.param(spec("PG-RSSNN"), marks=pytest.mark.compiles)],
    ids=["physics", "PG-RSSNN"],
)
def test_rollouts_and_gradients_of_members_are_those_of_each(key, fields):
    model = toy_model(fields)
    u, x0 = toy_signals(2, 4)
    members = [toy_params(model, k) for k in jax.random.split(key, 3)]
    members = [jax.tree.map(lambda a, i=i: (1.0 + 0.1 * i) * a, member) for i, member in enumerate(members)]
    together = jax.tree.map(lambda *a: jnp.stack(a), *members)

    def loss(params, u):
        return jnp.sum(rollout(model, params, u, x0).y ** 2)

    step = jax.value_and_grad(loss)
    inputs = jnp.stack([u, 2 * u, -u])
    single = quick_jit(step)
    expected = [single(params, inputs[i]) for i, params in enumerate(members)]
    for mapping in (MemberMapping("loop"), MemberMapping("vmap", None, 2)):
        found = quick_jit(map_members(step, mapping))(together, inputs)
        for i in range(3):
            for a, b in zip(jax.tree.leaves(select(found, i)), jax.tree.leaves(expected[i]), strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4 * max(1.0, np.abs(b).max()), err_msg=str(mapping))


@pytest.mark.parametrize("devices", [1, 2])
def test_members_bring_their_own_random_keys(key, devices):
    keys = jax.random.split(key, 3)
    found = map_members(lambda k: jax.random.normal(k, (2,)), MemberMapping(devices=devices))(keys)
    for i in range(3):
        np.testing.assert_allclose(found[i], jax.random.normal(keys[i], (2,)), rtol=1e-6)


def test_a_member_that_is_not_a_number_leaves_the_others_alone():
    tree, scalar = trees(5)
    spoilt = {**tree, "b": tree["b"].at[4].set(jnp.nan)}  # the last member is the one that pads
    for devices in (1, 2):
        run = jax.jit(map_members(one, MemberMapping(devices=devices)))
        good, bad = run(tree, scalar), run(spoilt, scalar)
        np.testing.assert_array_equal(good["moved"][:4], bad["moved"][:4])
        assert np.isnan(bad["moved"][4]).all()


def test_two_devices_share_the_members():
    found = jax.jit(map_members(one, MemberMapping(devices=2)))(*trees(4))
    assert len(found["moved"].sharding.device_set) == 2


@pytest.mark.parametrize("devices", [0, -1, 3])
def test_devices_that_are_not_there_are_named(devices):
    assert jax.device_count() == 2
    with pytest.raises(ValueError, match=f"members: devices: expected 1 to 2, found {devices}"):
        map_members(one, MemberMapping(devices=devices))


@pytest.mark.parametrize("level", [0, 3])
def test_machine_code_that_is_optimised_less_or_more_gives_the_same_results(level):
    expected = quick_jit(map_members(one, MemberMapping()))(*trees(3))
    found = jit_members(one, MemberMapping(optimisation=level), donated=1)(*trees(3))
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6)


def test_a_level_of_optimisation_that_is_none_is_named():
    with pytest.raises(ValueError, match="members: optimisation: expected null or 0 to 3, found 4"):
        jit_members(one, MemberMapping(optimisation=4))


def test_an_empty_sub_batch_is_named():
    with pytest.raises(ValueError, match="members: sub_batch: expected at least 1, found 0"):
        map_members(one, MemberMapping(sub_batch=0))


def test_repeat_and_select():
    tree = {"a": jnp.arange(3.0), "b": 2.0}
    three = repeat(tree, 3)
    assert (three["a"].shape, three["b"].shape) == ((3, 3), (3,))
    for i in range(3):
        np.testing.assert_array_equal(select(three, i)["a"], tree["a"])
        assert select(three, i)["b"] == 2.0


def test_chosen_mapping_never_asks_for_more_devices_than_members():
    assert choose_mapping(1, 1, 2) == MemberMapping("vmap", None, 1)
    assert choose_mapping(50, 31, 2) == MemberMapping("loop", None, 2)
    assert choose_mapping(10, 1, 2) == MemberMapping("vmap", None, 2)
