"""What training minimises, for one member.

    L(θ) = Σ_t ((y_t - ŷ_t(θ)) / s_y)²,     mean over sequences; ŷ is a free run, only measured samples count

θ: network weights, and, where asked, physics parameters and the initial states of the training sequences.
Source: Li, Seth, Kok, IFAC 2026, section 4.

With `ModelSpec.regularisation` λ, training alone adds for its time of T samples (Liu, Tóth, Schoukens, SYSID 2024)

    λ T mean_j w(z_j) (|f_nn(z_j)|² + |g_nn(z_j)|²),     w(z): how scarce the samples [u_t, x_t] are near z

at surrogate points z_j over the range of the scaled signals: where the data says little, the physics stands.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from pgrssnn_jax.models.initial_state import InitialState, first_output_states, least_squares_states, start_state
from pgrssnn_jax.models.model import Model, ModelParams
from pgrssnn_jax.models.networks import scaled_heads
from pgrssnn_jax.models.radial import scarcity, surrogate_points
from pgrssnn_jax.models.rollout import Route, Trajectory, rollout
from pgrssnn_jax.physics.base import is_parameter
from pgrssnn_jax.records.record import Array, Record, continues, valid_mask
from pgrssnn_jax.records.scaling import Scaling


class Trainable(NamedTuple):
    """θ of one member. physics: (p - p_nominal) / size per parameter, so that one learning rate suits all; x0:
    scaled x_0 `[seq, x]` of the training sequences; both None when they are not trained."""

    network: Any
    physics: Any
    x0: Any


class Choice(NamedTuple):
    """Settings of one member as numbers, so that one program trains members that differ in them. correction: f_nn is
    multiplied by it; networks: 0 where the physics stands alone, else 1; the others as in `settings.py` and `spec.py`,
    with `physics_trained` and `start_trained` (x_0 of the training sequences) true or false; the latter None where no
    member trains it."""

    correction: Float[Array, ""]
    networks: Float[Array, ""]
    start_from_physics: Bool[Array, ""]
    learning_rate: Float[Array, ""]
    patience: Int[Array, ""]
    physics_trained: Bool[Array, ""]
    start_trained: Bool[Array, ""] | None


class MemberData(NamedTuple):
    """What stays fixed for one member: its records and scaling, and the epoch at which training ends at the latest.
    choice: its own settings, None where all members share those of the fit."""

    train: Record
    validation: Record
    scaling: Scaling
    last_epoch: Int[Array, ""]
    choice: Choice | None = None


class Loss(NamedTuple):
    """total: L(θ); mean: mean squared scaled error; finite: did every state stay in the floating-point range?"""

    total: Float[Array, ""]
    mean: Float[Array, ""]
    finite: Bool[Array, ""]


class PhysicsUnits(NamedTuple):
    """Trees of the shape of `Physics.params`: nominal value, size (|nominal|, or 1 at zero), bounds, may it move? A
    limit that is not there (infinite) does not."""

    nominal: Any
    size: Any
    low: Any
    high: Any
    free: Any


class Objective(NamedTuple):
    """The objective of one model, as pure functions of θ and a member's data; route, devices: of its rollouts."""

    model: Model
    initial: InitialState
    physics: PhysicsUnits
    train_physics: bool
    route: Route | None
    devices: int = 1

    def begin(self, key: jax.Array, data: MemberData) -> Trainable:
        """θ before training: fresh weights, nominal physics, and the first guess of trained initial states."""
        physics = jax.tree.map(jnp.zeros_like, self.physics.nominal) if self.train_physics else None
        x0 = None
        network = self.model.init(key)
        if self.initial.trained or (data.choice is not None and data.choice.start_trained is not None):
            x0 = data.scaling.x.to_scaled(self._first_states(network, data))
        if data.choice is not None:
            drawn = jnp.where(data.choice.start_from_physics, 0.0, 1.0)
            network = scaled_heads(network, drawn, drawn)
        return Trainable(network, physics, x0)

    def _first_states(self, network: Any, data: MemberData) -> Float[jax.Array, "seq x"]:
        """x_0 of the training sequences before training."""
        guess, trained, nominal = first_output_states(self.model, data.train), data.choice, self.physics.nominal
        if self.initial.kind == "estimated":
            return guess
        params = ModelParams(scaled_heads(network, 0.0, 0.0), nominal, data.scaling)
        fitted = guess
        if self.model.physics.differentiable and self.model.spec.guided:
            fitted = least_squares_states(self.model, params, data.train, data.train.u.shape[1], guess)
        if trained is None or trained.start_trained is None:
            return fitted
        return jnp.where(trained.start_trained, fitted, start_state(self.model, params, data.train, self.initial))

    def alone(self, theta: Trainable, data: MemberData) -> Trainable:
        """θ of the physics alone: heads that give zero, nominal parameters, and the starts before training."""
        begun = self.begin(jax.random.key(0), data)
        return begun._replace(network=scaled_heads(theta.network, 0.0, 0.0))

    def assemble(self, theta: Trainable, scaling: Scaling, choice: Choice | None = None) -> ModelParams:
        """The numbers of a rollout."""
        physics, network = self.physics.nominal, theta.network
        if theta.physics is not None:
            physics = jax.tree.map(lambda p, s, z: p + s * z, physics, self.physics.size, theta.physics)
        if choice is not None:
            network = scaled_heads(network, choice.networks * choice.correction, choice.networks)
        return ModelParams(network, physics, scaling)

    def within_bounds(self, theta: Trainable) -> Trainable:
        """θ with every physics parameter inside its bounds, and at its nominal value if it may not move."""
        if theta.physics is None:
            return theta
        moved = jax.tree.map(
            lambda z, p, s, lo, hi, free: jnp.where(
                free & jnp.isfinite(p), jnp.clip(z, (lo - p) / s, (hi - p) / s), jnp.zeros_like(z)
            ),
            theta.physics,
            *self.physics,
        )
        return theta._replace(physics=moved)

    def on_train(self, theta: Trainable, data: MemberData) -> Loss:
        params = self.assemble(theta, data.scaling, data.choice)
        predicted = self._predicted(params, data.train, self._train_state(theta, params, data))
        loss = _loss(params, data.train, predicted)
        if not (self.model.spec.regularisation and self.model.spec.guided):
            return loss
        return loss._replace(total=loss.total + self._penalty(params, data.train, predicted.x))

    def on_validation(self, theta: Trainable, data: MemberData) -> Loss:
        return _loss(self.assemble(theta, data.scaling, data.choice), data.validation, self.validate(theta, data))

    def validate(self, theta: Trainable, data: MemberData) -> Trajectory:
        """The free run over the validation record. One that is the training record with other samples measured starts
        as that does. Where starts are estimated, one that was measured right after the training record needs none: the
        run over the training record goes on."""
        params, record = self.assemble(theta, data.scaling, data.choice), data.validation
        if record.info.same_run:
            whole = record._replace(mask=record.mask | data.train.mask)  # what others leave out is predicted too
            return self._predicted(params, whole, self._train_state(theta, params, data))
        if not self.initial.trained or not continues(data.train, record):
            return self._predicted(params, record, start_state(self.model, params, record, self.initial))
        before = data.train.u.shape[1]
        u = jnp.concatenate([jnp.asarray(data.train.u), jnp.asarray(record.u)], 1)
        whole = self._rollout(params, u, self._train_state(theta, params, data), None)
        return Trajectory(whole.y[:, before:], whole.x[:, before:], jnp.maximum(whole.first_bad - before, 0))

    def as_tested(self, theta: Trainable, data: MemberData) -> Trajectory:
        """The validation run as it would be of a record that nothing was fitted to: where starts are estimated, a
        record that is the training record itself starts from its first n_init samples, as a test record does."""
        record = data.validation
        if not self.starts_as_tested(record):
            return self.validate(theta, data)
        params = self.assemble(theta, data.scaling, data.choice)
        whole = record._replace(mask=record.mask | data.train.mask)
        return self._predicted(params, whole, start_state(self.model, params, whole, self.initial))

    def starts_as_tested(self, validation: Record) -> bool:
        """Do `validate` and `as_tested` start differently?"""
        return self.initial.trained and not self.initial.shared and validation.info.same_run

    def trained_start(self, theta: Trainable, data: MemberData) -> Float[Array, " x"]:
        """x_0 of the first training sequence."""
        return self._train_state(theta, self.assemble(theta, data.scaling, data.choice), data)[0]

    def test_state(
        self, theta: Trainable, scaling: Scaling, start: Float[Array, " x"], test: Record
    ) -> Float[Array, "seq x"]:
        """x_0 of the test sequences: `start`, the training record's, where the benchmark says that it is shared."""
        if self.initial.shared:
            return jnp.broadcast_to(start[None], (test.u.shape[0], self.model.n_x))
        return start_state(self.model, self.assemble(theta, scaling), test, self.initial)

    def _train_state(self, theta: Trainable, params: ModelParams, data: MemberData) -> jax.Array:
        if theta.x0 is None:
            return start_state(self.model, params, data.train, self.initial)
        return params.scaling.x.to_physical(theta.x0)

    def _predicted(self, params: ModelParams, record: Record, x0: jax.Array) -> Trajectory:
        return self._rollout(params, record.u, x0, valid_mask(record))

    def _rollout(self, params: ModelParams, u: Array, x0: jax.Array, valid: Array | None) -> Trajectory:
        devices = min(self.devices, len(u))
        return rollout(self.model, params, u, x0, route=self.route, valid=valid, devices=devices)

    def _penalty(self, params: ModelParams, record: Record, x: Array) -> Float[jax.Array, ""]:
        """The weighted regularisation of a fed-back model that predicts the states x `[seq, time, x]` of a record."""
        networks, u = self.model.networks(params), record.u
        if networks is None:
            return jnp.zeros((), x.dtype)
        n_u, n_z = u.shape[-1], u.shape[-1] + len(self.model.seen)
        seen = self.model.seen_of(params.scaling.x.to_scaled(x))
        samples = jnp.concatenate([params.scaling.u.to_scaled(u), seen], -1)
        points, valid = jnp.asarray(surrogate_points(n_z), x.dtype), valid_mask(record)
        counted = jnp.ones(u.shape[:2], bool) if valid is None else jnp.asarray(valid)
        # which states are visited is not to be moved by the penalty
        weight = scarcity(points, jax.lax.stop_gradient(samples.reshape(-1, n_z)), counted.ravel())
        f_nn = networks.f_nn(None, networks.features_u(points))
        g_nn = networks.g_nn(points[:, n_u:], points[:, :n_u])
        squares = jnp.sum(f_nn**2, -1) + jnp.sum(g_nn**2, -1)
        return self.model.spec.regularisation * u.shape[1] * jnp.mean(weight * squares)


def _loss(params: ModelParams, record: Record, predicted: Trajectory) -> Loss:
    y = params.scaling.y
    error = jnp.where(record.mask, y.to_scaled(record.y) - y.to_scaled(predicted.y), 0.0)
    squares = jnp.sum(error**2)
    n_seq, time = record.u.shape[:2]
    return Loss(squares / n_seq, squares / jnp.sum(record.mask), jnp.all(predicted.first_bad == time))


def build_objective(
    model: Model,
    initial: InitialState,
    *,
    train_physics: bool = False,
    route: Route | None = None,
) -> Objective:
    """train_physics: are the physics parameters part of θ?"""
    nominal = jax.tree.map(jnp.asarray, model.physics.params)
    size = jax.tree.map(lambda p: jnp.where((p == 0) | jnp.isinf(p), 1.0, jnp.abs(p)), nominal)
    low, high, free = (
        jax.tree.map(of, model.physics.parameters, is_leaf=is_parameter)
        for of in (lambda p: p.bounds[0], lambda p: p.bounds[1], lambda p: p.trainable)
    )
    return Objective(model, initial, PhysicsUnits(nominal, size, low, high, free), train_physics, route)
