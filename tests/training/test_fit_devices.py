"""Members that are sharded over devices train to the numbers of one device."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small import small_fit
from toys import quick_jit

from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.training.members import Member, MemberMapping, keys_of, map_members
from pgrssnn_jax.training.optimise import MemberStatus
from pgrssnn_jax.training.settings import FitSettings

FED_BACK = ModelSpec(recurrent=False, feedback=True, hidden=4)
ALONE = ModelSpec(networks=False)


@pytest.mark.parametrize(
    ("spec", "how", "rtol"),
    [
        pytest.param(ALONE, "loop", 1e-6, marks=pytest.mark.compiles),
        # products of matrices: a program for two devices, or of another width, sums in another order
        pytest.param(FED_BACK, "vmap", 1e-4, marks=pytest.mark.slow),
    ],
    ids=["physics-loop", "networks-vmap"],
)
def test_an_odd_number_of_members_with_a_failing_one_trains_alike_on_one_and_two_devices(spec, how, rtol):
    """Five members on two devices: the last one, which fails, is also the one that pads."""
    settings = FitSettings(
        epochs=6, validate_every=3, chunk_epochs=6, guard="none", learning_rate=1e-2,
        physics_parameters="fixed" if spec.networks else "trained",
    )  # fmt: skip
    fit, data = small_fit(spec=spec, settings=settings, members=5)
    louder = np.linspace(0.8, 1.2, 5, dtype=np.float32)[:, None, None, None]
    data = data._replace(train=data.train._replace(u=louder * data.train.u))
    state = quick_jit(map_members(fit.begin, MemberMapping("loop")))(keys_of([Member(i, 0) for i in range(5)]), data)
    state = state._replace(theta=jax.tree.map(lambda a: a.at[4].set(jnp.nan), state.theta))
    (one, its), (two, others) = (
        quick_jit(map_members(fit.advance, MemberMapping(how, None, devices)))(state, data) for devices in (1, 2)
    )
    assert len(two.best_loss.sharding.device_set) == 2
    assert one.outcome.tolist() == two.outcome.tolist() == [0, 0, 0, 0, MemberStatus.STATE_NOT_FINITE]
    assert one.epoch.tolist() == two.epoch.tolist() == [6, 6, 6, 6, 0]
    assert one.best_epoch.tolist() == two.best_epoch.tolist()
    for a, b in zip(jax.tree.leaves((its, one.best_loss)), jax.tree.leaves((others, two.best_loss)), strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol)
    # every member has trained, on data of its own
    assert len(np.unique(one.best_loss)) == 5
    assert (its.train[:4, -1, -1] < its.train[:4, 0, 0]).all()


@pytest.mark.parametrize(
    ("spec", "physics_parameters"),
    [(ALONE, "trained"), pytest.param(ModelSpec(hidden=4), "fixed", marks=pytest.mark.slow)],
    ids=["physics", "networks"],
)
def test_sequences_shared_by_two_devices_train_alike(spec, physics_parameters):
    """Five sequences: one device computes a copy of the last, which must not count."""
    settings = FitSettings(
        epochs=6, validate_every=3, chunk_epochs=6, learning_rate=1e-2, physics_parameters=physics_parameters
    )
    fit, data = small_fit(spec=spec, settings=settings, members=5)
    data = jax.tree.map(lambda a: a[:1], data)._replace(train=jax.tree.map(lambda a: a.swapaxes(0, 1), data.train))
    data = data._replace(
        train=data.train._replace(y=data.train.y * np.linspace(0.9, 1.1, 5)[:, None, None].astype(np.float32))
    )
    found = []
    for devices in (1, 2):
        own = fit._replace(objective=fit.objective._replace(devices=devices))
        state = quick_jit(map_members(own.begin, MemberMapping()))(keys_of([Member(0, 0)]), data)
        found.append(quick_jit(map_members(own.advance, MemberMapping()))(state, data)[1])
    one, two = found
    assert (one.train[:, -1, -1] < one.train[:, 0, 0]).all()
    for a, b in zip(one, two, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4)
