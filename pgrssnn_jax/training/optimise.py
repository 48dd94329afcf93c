"""Training of one member, to be mapped over all members in one compiled program.

A block is `validate_every` epochs followed by one validation; a chunk is some blocks in one compiled call. Early
stopping, best parameters and failure are data of each member: a member that has stopped or failed is frozen by
selection and never disturbs the others.

What happens when a predicted state, the loss or the gradient is not finite is the `guard`'s matter:
    none      the member has failed, as the paper counts
    rollback  it goes back to its best parameters with fresh moments and half the step, at most `ROLLBACKS` times
A member that never leaves the range trains to the same bits under both.
Sources: Li, Seth, Kok, IFAC 2026, section 4; Kingma and Ba 2015 (Adam); Loshchilov and Hutter 2019 (AdamW).
"""

from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int

from pgrssnn_jax.training.objective import Choice, Loss, MemberData, Objective, Trainable
from pgrssnn_jax.training.settings import FitSettings


class MemberStatus(IntEnum):
    """How training of a member ended; `sentence` is shown to people."""

    TRAINING = 0
    STOPPED_EARLY = 1
    STATE_NOT_FINITE = 2
    LOSS_NOT_FINITE = 3
    GRADIENT_NOT_FINITE = 4

    @property
    def failed(self) -> bool:
        return self >= MemberStatus.STATE_NOT_FINITE

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


_SENTENCES = (  # in the order of `MemberStatus`
    "trained to the last epoch",
    "stopped early: validation no longer improved",
    "failed: a predicted state left the floating-point range",
    "failed: the loss left the floating-point range",
    "failed: the gradient left the floating-point range",
)


class MemberState(NamedTuple):
    """Everything that the next chunk of a member depends on; rollbacks: how often it was rolled back; each halves
    the step."""

    theta: Trainable
    optimizer: Any
    best: Trainable
    best_loss: Float[Array, ""]
    best_epoch: Int[Array, ""]
    epoch: Int[Array, ""]
    outcome: Int[Array, ""]
    rollbacks: Int[Array, ""]


class History(NamedTuple):
    """Mean squared scaled error: train `[blocks, validate_every]`, validation `[blocks]`; NaN where a member was
    frozen."""

    train: Float[Array, "blocks epochs"]
    validation: Float[Array, " blocks"]


class Fit(NamedTuple):
    """Training of one member as pure functions of its state and data; nothing raises, a failure is a `MemberStatus`."""

    objective: Objective
    settings: FitSettings

    def begin(self, key: jax.Array, data: MemberData) -> MemberState:
        """A member before its first epoch; the untrained model is its best so far."""
        theta = self.objective.begin(key, data)
        loss = self.objective.on_validation(theta, data).mean
        zero = jnp.zeros((), jnp.int32)
        optimizer = build_optimizer(self.settings).init(theta)
        best_loss = jnp.where(jnp.isfinite(loss), loss, jnp.inf)
        return MemberState(theta, optimizer, theta, best_loss, zero, zero, zero, zero)

    def advance(self, state: MemberState, data: MemberData) -> tuple[MemberState, History]:
        """One chunk of epochs with its validations."""

        def epochs(state: MemberState, _: None) -> tuple[MemberState, jax.Array]:
            return self._epoch(state, data)

        def block(state: MemberState, _: None) -> tuple[MemberState, History]:
            before = state.epoch
            state, train = jax.lax.scan(epochs, state, None, length=self.settings.validate_every)
            state, validation = self._validated(state, data, advanced=state.epoch > before)
            return state, History(train, validation)

        return jax.lax.scan(block, state, None, length=self.settings.blocks)

    def _epoch(self, state: MemberState, data: MemberData) -> tuple[MemberState, jax.Array]:
        def objective(theta: Trainable) -> tuple[Any, Loss]:
            loss = self.objective.on_train(theta, data)
            return loss.total, loss

        gradient, loss = jax.grad(objective, has_aux=True)(state.theta)
        gradient = _of_moving(gradient, data.choice)
        optimizer = build_optimizer(self.settings, state.rollbacks, data.choice)
        updates, optimizer = optimizer.update(gradient, state.optimizer, state.theta)
        moved: Any = optax.apply_updates(state.theta, updates)
        theta = self.objective.within_bounds(moved)
        outcome = _outcome(loss, gradient)
        active = (state.outcome == MemberStatus.TRAINING) & (state.epoch < data.last_epoch)
        good = active & (outcome == MemberStatus.TRAINING)
        theta, optimizer = _choose(good, (theta, optimizer), (state.theta, state.optimizer))
        state = self._judged(state._replace(theta=theta, optimizer=optimizer), outcome, active)
        # an epoch that ended in a rollback counts, or the history and the epoch would part
        epoch = state.epoch + (active & (state.outcome == MemberStatus.TRAINING))
        return state._replace(epoch=epoch), jnp.where(active, loss.mean, jnp.nan)

    def _validated(self, state: MemberState, data: MemberData, advanced: jax.Array) -> tuple[MemberState, jax.Array]:
        loss = self.objective.on_validation(state.theta, data)
        active = (state.outcome == MemberStatus.TRAINING) & advanced
        better = active & loss.finite & (loss.mean < state.best_loss)
        best, best_loss, best_epoch = _choose(
            better, (state.theta, loss.mean, state.epoch), (state.best, state.best_loss, state.best_epoch)
        )
        patience = self.settings.patience if data.choice is None else data.choice.patience
        overdue = state.epoch - best_epoch >= patience
        ended = jnp.where(overdue, MemberStatus.STOPPED_EARLY, MemberStatus.TRAINING).astype(jnp.int32)
        outcome = _outcome(loss)
        state = state._replace(best=best, best_loss=best_loss, best_epoch=best_epoch)
        state = self._judged(state, jnp.where(outcome == MemberStatus.TRAINING, ended, outcome), active)
        return state, jnp.where(active, loss.mean, jnp.nan)

    def _judged(self, state: MemberState, outcome: Int[Array, ""], active: Bool[Array, ""]) -> MemberState:
        """The member after an epoch or a validation that went as `outcome` says: it goes on, stops, rollbacks or fails;
        untouched if not `active`."""
        back = active & (outcome >= MemberStatus.STATE_NOT_FINITE) & (state.rollbacks < self.settings.rollbacks)
        fresh = build_optimizer(self.settings).init(state.best)
        theta, optimizer = _choose(back, (state.best, fresh), (state.theta, state.optimizer))
        return state._replace(
            theta=theta,
            optimizer=optimizer,
            outcome=jnp.where(active & ~back, outcome, state.outcome),
            rollbacks=state.rollbacks + back,
        )


def _of_moving(gradient: Trainable, choice: Choice | None) -> Trainable:
    """A gradient that is zero for what a member of that choice does not train."""
    if choice is None:
        return gradient
    moving = Trainable(True, choice.physics_trained, choice.start_trained)
    return Trainable(
        *(jax.tree.map(lambda g, m=m: jnp.where(m, g, 0.0), part) for part, m in zip(gradient, moving, strict=True))
    )


def build_optimizer(
    settings: FitSettings, rollbacks: Int[Array, ""] | int = 0, choice: Choice | None = None
) -> optax.GradientTransformation:
    """The optimizer of a member that went back `rollbacks` times: learning rate / 2^rollbacks."""
    first: Any = settings.learning_rate if choice is None else choice.learning_rate
    learning_rate = first / (1 << rollbacks)
    if settings.optimizer == "adam":
        update = optax.adam(learning_rate)
    else:
        # the decay pulls weights to zero; an initial state or a physical constant has no reason to go there
        decayed = Trainable(True, False, False)
        update = optax.adamw(learning_rate, weight_decay=settings.weight_decay, mask=lambda _: decayed)
    if settings.clip_norm is None:
        return update
    return optax.chain(optax.clip_by_global_norm(settings.clip_norm), update)


def _outcome(loss: Loss, gradient: Trainable | None = None) -> Int[Array, ""]:
    """How an epoch, or a validation, went; the first cause first.

    A gradient whose elements are finite has not failed, though their norm may overflow: clipping then makes the step
    zero, in the published code too.
    """
    finite = [jnp.isfinite(g).all() for g in jax.tree.leaves(gradient)]
    problems = (
        (~loss.finite, MemberStatus.STATE_NOT_FINITE),
        (~jnp.isfinite(loss.total), MemberStatus.LOSS_NOT_FINITE),
        (~jnp.stack([*finite, jnp.bool_(True)]).all(), MemberStatus.GRADIENT_NOT_FINITE),
    )
    conditions, outcomes = zip(*problems, strict=True)
    return jnp.select(conditions, [jnp.int32(o) for o in outcomes], jnp.int32(MemberStatus.TRAINING))


def _choose(condition: jax.Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)
