"""Training of all members in one compiled program.

    minimise over θ   Σ_t ((y_t - ŷ_t(θ)) / s_y)²,     mean over sequences, ŷ a free run

A block is `validate_every` epochs followed by one validation; a chunk is some blocks in one compiled call. Early
stopping, best parameters and failure are data of each member: a member that has stopped or failed is frozen by
selection and never disturbs the others. Sources: Li, Seth, Kok, IFAC 2026, section 4; Kingma and Ba 2015 (Adam);
Loshchilov and Hutter 2019 (AdamW).
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int

from pgrssnn_jax.initial_state import InitialState, first_output_states, start_state
from pgrssnn_jax.model import Model, ModelParams
from pgrssnn_jax.physics.base import is_parameter
from pgrssnn_jax.records import Record
from pgrssnn_jax.rollout import Route, rollout
from pgrssnn_jax.scaling import Scaling


class Outcome(IntEnum):
    """How training of a member ended; `sentence` is shown to people."""

    TRAINING = 0
    STOPPED_EARLY = 1
    STATE_NOT_FINITE = 2
    LOSS_NOT_FINITE = 3
    GRADIENT_NOT_FINITE = 4

    @property
    def failed(self) -> bool:
        return self >= Outcome.STATE_NOT_FINITE

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


_SENTENCES = {
    Outcome.TRAINING: "trained to the last epoch",
    Outcome.STOPPED_EARLY: "stopped early: validation no longer improved",
    Outcome.STATE_NOT_FINITE: "failed: a predicted state left the floating-point range",
    Outcome.LOSS_NOT_FINITE: "failed: the loss left the floating-point range",
    Outcome.GRADIENT_NOT_FINITE: "failed: the gradient left the floating-point range",
}


@dataclass(frozen=True)
class FitSettings:
    """optimizer with learning_rate, weight_decay (adamw only) and clip_norm (gradient norm, None: off); at most
    `epochs`, validated every `validate_every`, stopped `patience` epochs after the best; `chunk_epochs` per compiled
    call. physics_parameters: trained or fixed at their values."""

    epochs: int = 1000
    optimizer: Literal["adam", "adamw"] = "adamw"
    learning_rate: float = 1e-3
    weight_decay: float = 1e-2
    clip_norm: float | None = 1.0
    validate_every: int = 5
    patience: int = 100
    chunk_epochs: int = 20
    physics_parameters: Literal["fixed", "trained"] = "fixed"

    def __post_init__(self) -> None:
        for name in ("validate_every", "patience", "chunk_epochs"):
            if getattr(self, name) < 1:
                raise ValueError(f"fit: {name}: expected at least 1, found {getattr(self, name)}")
        if self.epochs < 0:
            raise ValueError(f"fit: epochs: expected 0 or more, found {self.epochs}")
        if not self.learning_rate > 0:
            raise ValueError(f"fit: learning_rate: expected a positive number, found {self.learning_rate}")

    @property
    def blocks(self) -> int:
        """Validations per compiled chunk."""
        return max(1, self.chunk_epochs // self.validate_every)


class Trainable(NamedTuple):
    """θ of one member. physics: (p - p_nominal) / size per parameter, so that one learning rate suits all; x0:
    scaled x_0 `[seq, x]` of the training sequences; both None when they are not trained."""

    network: Any
    physics: Any
    x0: Any


class MemberData(NamedTuple):
    """What stays fixed for one member: its records and scaling, and the epoch at which training ends at the latest."""

    train: Record
    validation: Record
    scaling: Scaling
    last_epoch: Int[Array, ""]


class MemberState(NamedTuple):
    trainable: Trainable
    optimizer: Any
    best: Trainable
    best_loss: Float[Array, ""]
    best_epoch: Int[Array, ""]
    epoch: Int[Array, ""]
    outcome: Int[Array, ""]


class History(NamedTuple):
    """Mean squared scaled error: train `[blocks, validate_every]`, validation `[blocks]`; NaN where a member was
    frozen."""

    train: Float[Array, "blocks epochs"]
    validation: Float[Array, " blocks"]


class Fit(NamedTuple):
    """Training of one member as pure functions, to be mapped over members and compiled by the caller."""

    begin: Callable[[jax.Array, MemberData], MemberState]
    advance: Callable[[MemberState, MemberData], tuple[MemberState, History]]
    assemble: Callable[[Trainable, Scaling], ModelParams]
    test_state: Callable[[Trainable, MemberData, Record], jax.Array]


class Evaluation(NamedTuple):
    loss: Float[Array, ""]
    mean: Float[Array, ""]
    finite: Bool[Array, ""]


def build_optimizer(settings: FitSettings) -> optax.GradientTransformation:
    if settings.optimizer == "adam":
        update = optax.adam(settings.learning_rate)
    else:
        # the decay pulls weights to zero; an initial state or a physical constant has no reason to go there
        decayed = Trainable(True, False, False)
        update = optax.adamw(settings.learning_rate, weight_decay=settings.weight_decay, mask=lambda _: decayed)
    if settings.clip_norm is None:
        return update
    return optax.chain(optax.clip_by_global_norm(settings.clip_norm), update)


def build_fit(model: Model, settings: FitSettings, initial: InitialState, *, route: Route | None = None) -> Fit:
    """`begin(key, data)` draws a member's weights; `advance(state, data)` runs one chunk; `assemble(trainable,
    scaling)` gives the numbers for a rollout. Nothing raises: a failure is an `Outcome` in the state."""
    optimizer = build_optimizer(settings)
    nominal, size, bounds, movable = _physics_units(model)

    def assemble(trainable: Trainable, scaling: Scaling) -> ModelParams:
        physics = nominal
        if trainable.physics is not None:
            physics = jax.tree.map(lambda p, s, z: p + s * z, nominal, size, trainable.physics)
        return ModelParams(trainable.network, physics, scaling)

    def train_state(trainable: Trainable, params: ModelParams, data: MemberData) -> jax.Array:
        if trainable.x0 is None:
            return start_state(model, params, data.train, initial)
        return params.scaling.x.to_physical(trainable.x0)

    def test_state(trainable: Trainable, data: MemberData, test: Record) -> jax.Array:
        params = assemble(trainable, data.scaling)
        if not initial.shared:
            return start_state(model, params, test, initial)
        start = train_state(trainable, params, data)[:1]
        return jnp.broadcast_to(start, (test.u.shape[0], model.n_x))

    def evaluate(params: ModelParams, record: Record, x0: jax.Array) -> Evaluation:
        predicted = rollout(model, params, record.u, x0, route=route)
        y = params.scaling.y
        error = jnp.where(record.mask, y.to_scaled(record.y) - y.to_scaled(predicted.y), 0.0)
        total = jnp.sum(error**2)
        n_seq, time = record.u.shape[:2]
        return Evaluation(total / n_seq, total / jnp.sum(record.mask), jnp.all(predicted.first_bad == time))

    def on_train(trainable: Trainable, data: MemberData) -> Evaluation:
        params = assemble(trainable, data.scaling)
        return evaluate(params, data.train, train_state(trainable, params, data))

    def on_validation(trainable: Trainable, data: MemberData) -> Evaluation:
        params = assemble(trainable, data.scaling)
        return evaluate(params, data.validation, start_state(model, params, data.validation, initial))

    def begin(key: jax.Array, data: MemberData) -> MemberState:
        physics = jax.tree.map(jnp.zeros_like, nominal) if settings.physics_parameters == "trained" else None
        x0 = None
        if initial.kind == "estimated":
            x0 = data.scaling.x.to_scaled(first_output_states(model, data.train))
        trainable = Trainable(model.init(key), physics, x0)
        at_start = on_validation(trainable, data)
        loss = jnp.where(jnp.isfinite(at_start.mean), at_start.mean, jnp.inf)
        zero = jnp.zeros((), jnp.int32)
        return MemberState(trainable, optimizer.init(trainable), trainable, loss, zero, zero, zero)

    def epoch(state: MemberState, data: MemberData) -> tuple[MemberState, jax.Array]:
        def objective(trainable: Trainable) -> tuple[jax.Array, Evaluation]:
            result = on_train(trainable, data)
            return result.loss, result

        gradient, result = jax.grad(objective, has_aux=True)(state.trainable)
        updates, optimizer_state = optimizer.update(gradient, state.optimizer, state.trainable)
        updated = _within_bounds(optax.apply_updates(state.trainable, updates))
        problem = jnp.where(
            ~result.finite,
            Outcome.STATE_NOT_FINITE,
            jnp.where(
                ~jnp.isfinite(result.loss),
                Outcome.LOSS_NOT_FINITE,
                jnp.where(jnp.isfinite(optax.global_norm(gradient)), Outcome.TRAINING, Outcome.GRADIENT_NOT_FINITE),
            ),
        ).astype(jnp.int32)
        active = (state.outcome == Outcome.TRAINING) & (state.epoch < data.last_epoch)
        good = active & (problem == Outcome.TRAINING)
        trainable, optimizer_state = _choose(good, (updated, optimizer_state), (state.trainable, state.optimizer))
        state = state._replace(
            trainable=trainable,
            optimizer=optimizer_state,
            epoch=state.epoch + good,
            outcome=jnp.where(active, problem, state.outcome),
        )
        return state, jnp.where(active, result.mean, jnp.nan)

    def block(state: MemberState, data: MemberData) -> tuple[MemberState, tuple[jax.Array, jax.Array]]:
        before = state.epoch
        state, train = jax.lax.scan(lambda s, _: epoch(s, data), state, None, length=settings.validate_every)
        result = on_validation(state.trainable, data)
        active = (state.outcome == Outcome.TRAINING) & (state.epoch > before)
        better = active & result.finite & (result.mean < state.best_loss)
        best, best_loss, best_epoch = _choose(
            better, (state.trainable, result.mean, state.epoch), (state.best, state.best_loss, state.best_epoch)
        )
        overdue = state.epoch - best_epoch >= settings.patience
        outcome = jnp.where(
            result.finite, jnp.where(overdue, Outcome.STOPPED_EARLY, Outcome.TRAINING), Outcome.STATE_NOT_FINITE
        ).astype(jnp.int32)
        state = state._replace(
            best=best, best_loss=best_loss, best_epoch=best_epoch, outcome=jnp.where(active, outcome, state.outcome)
        )
        return state, (train, jnp.where(active, result.mean, jnp.nan))

    def advance(state: MemberState, data: MemberData) -> tuple[MemberState, History]:
        state, (train, validation) = jax.lax.scan(lambda s, _: block(s, data), state, None, length=settings.blocks)
        return state, History(train, validation)

    def _within_bounds(trainable: Trainable) -> Trainable:
        if trainable.physics is None:
            return trainable
        low, high = bounds
        moved = jax.tree.map(
            lambda z, p, s, lo, hi, free: jnp.clip(z, (lo - p) / s, (hi - p) / s) if free else jnp.zeros_like(z),
            trainable.physics, nominal, size, low, high, movable,
        )  # fmt: skip
        return trainable._replace(physics=moved)

    return Fit(begin, advance, assemble, test_state)


def _choose(condition: jax.Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


def _physics_units(model: Model) -> tuple[Any, Any, tuple[Any, Any], Any]:
    """Nominal value, size (|nominal|, or 1 at zero), bounds and freedom of every physics parameter."""
    parameters = model.physics.parameters
    nominal = jax.tree.map(jnp.asarray, model.physics.params)
    size = jax.tree.map(lambda p: jnp.where(p == 0, 1.0, jnp.abs(p)), nominal)
    low = jax.tree.map(lambda p: p.bounds[0], parameters, is_leaf=is_parameter)
    high = jax.tree.map(lambda p: p.bounds[1], parameters, is_leaf=is_parameter)
    movable = jax.tree.map(lambda p: p.trainable, parameters, is_leaf=is_parameter)
    return nominal, size, (low, high), movable
