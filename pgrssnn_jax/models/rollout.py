"""Free run of a model: outputs predicted from the inputs and an initial state, nothing measured fed in.

Three routes with equal results (to rounding):
    fused  one scan whose body does physics, GRU and networks; needed when the state is fed back
    split  without feedback f_nn depends on u alone: feature layers, input projections, heads and measurement networks
           are batched over time, and only the GRU recurrence and the physics step stay in scans
    native split, with GRU and dense layers in C++ kernels (`acceleration/native.py`)

Each can take a long record in chunks of samples: what is batched over time then stays in the processor's cache.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from pgrssnn_jax.acceleration.devices import over_devices
from pgrssnn_jax.acceleration.native import missing_kernels
from pgrssnn_jax.models.gru import delayed
from pgrssnn_jax.models.model import Model, ModelParams
from pgrssnn_jax.models.networks import Networks
from pgrssnn_jax.records.arguments import check_kind
from pgrssnn_jax.records.record import Array

Route = Literal["fused", "split", "native"]
_CACHED = 2**20  # bytes of a GRU's projected input, the widest signal: from 64 kB to 2 MB all are as fast (LGSSM)


class _State(NamedTuple):
    """What a sample hands on to the next: x `[seq, x]`, and h `[seq, hidden]` of every GRU layer."""

    x: jax.Array
    h: tuple[jax.Array, ...]


class Trajectory(NamedTuple):
    """y `[seq, time, y]` and x `[seq, time, x]` (state after u_t acted) in physical units; first_bad `[seq]`: index of
    the first sample at which x or y is not finite, `time` if none."""

    y: Float[Array, "seq time y"]
    x: Float[Array, "seq time x"]
    first_bad: Int[Array, " seq"]


def rollout(
    model: Model,
    params: ModelParams,
    u: Float[Array, "seq time u"],
    x0: Float[Array, "seq x"],
    *,
    route: Route | None = None,
    valid: Bool[Array, "seq time"] | None = None,
    chunk: int | Literal["auto"] | None = None,
    devices: int = 1,
) -> Trajectory:
    """Predicts every sequence of one member. u and x0 in physical units; the GRU starts at zero.

    The physics is computed in the precision of x0. route None takes `split` wherever it is possible. A state that
    leaves the floating-point range does not raise; it is reported in `first_bad`. valid (`records.valid_mask`): where
    it is False the physics' state is held, so that padding can neither fail nor spoil a gradient. chunk: samples that
    are batched at a time, `auto` as many as stay in the cache, None all; results are equal to rounding. devices: JAX
    devices that share the sequences; call it inside `jax.jit`, or every call compiles. Raises `ValueError` for an
    unknown or unavailable route, for another route than `fused` with a feedback model, and for shapes other than the
    model's.
    """
    check_kind("rollout: model", model, Model, "a model, ensemble.model say")
    _check_how(model, route, chunk, devices)
    u, x0 = jnp.asarray(u), jnp.asarray(x0)
    valid = None if valid is None else jnp.asarray(valid)
    x0 = x0 if jnp.issubdtype(x0.dtype, jnp.floating) else x0.astype(jnp.float32)
    _check_shapes(model, u, x0, valid)
    if devices > 1:
        shared = partial(rollout, model, params, route=route, chunk=chunk)
        return over_devices(lambda u, x0, valid: shared(u, x0, valid=valid), devices)(u, x0, valid)
    if chunk == "auto":
        chunk = max(1, _CACHED // (4 * 3 * model.spec.hidden * len(u)))
    networks = model.networks(params)
    params = params._replace(physics=jax.tree.map(lambda p: jnp.asarray(p, x0.dtype), params.physics))
    native, fused = route == "native", route == "fused" or model.spec.feedback
    states = partial(_fused if fused else partial(_split, native=native), model, params, networks)

    def run(start: _State, signals: tuple[jax.Array, jax.Array | None]) -> tuple[_State, tuple[jax.Array, jax.Array]]:
        end, x = states(start, *signals)
        read = x if model.physics.output_timing == "after_step" else jnp.concatenate([start.x[None], x[:-1]])
        return end, (x, _measure(model, params, networks, read, signals[0], native=native))

    layers = len(networks.gru) if networks is not None else 0
    start = _State(x0, (jnp.zeros((len(x0), model.spec.hidden), x0.dtype),) * layers)
    held = None if valid is None else ~jnp.swapaxes(valid, 0, 1)
    found = _in_chunks(run, start, (jnp.swapaxes(u, 0, 1), held), chunk)
    x, y = (jnp.swapaxes(a, 0, 1) for a in found)
    return Trajectory(y, x, first_not_finite(x, y))


def _check_how(model: Model, route: Any, chunk: Any, devices: Any) -> None:
    if route not in (None, "fused", "split", "native"):
        raise ValueError(f"rollout: route: expected 'fused', 'split', 'native' or None, found {route!r}")
    if route in ("split", "native") and model.spec.feedback:
        raise ValueError(f"rollout: route: expected 'fused' for a model with state feedback, found {route!r}")
    if route == "native" and (missing := missing_kernels()):
        raise ValueError(f"rollout: route: expected 'split' or None here, found 'native': {missing}")
    if not (chunk in (None, "auto") or (_is_count(chunk) and chunk >= 1)):
        raise ValueError(f"rollout: chunk: expected at least 1 sample, 'auto' or None, found {chunk!r}")
    if not (_is_count(devices) and 1 <= devices <= jax.device_count()):
        raise ValueError(f"rollout: devices: expected 1 to {jax.device_count()}, found {devices!r}")


def _is_count(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _in_chunks(run: Callable[[_State, Any], tuple[_State, Any]], start: _State, signals: Any, chunk: int | None) -> Any:
    """What `run` gives of signals `[time, ...]` in pieces, each from the state in which the one before it ended."""
    time = len(jax.tree.leaves(signals)[0])
    if chunk is None or chunk >= time:
        return run(start, signals)[1]
    whole = time - time % chunk
    pieces = jax.tree.map(lambda a: a[:whole].reshape(-1, chunk, *a.shape[1:]), signals)
    state, found = jax.lax.scan(run, start, pieces)
    found = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), found)
    if whole == time:
        return found
    rest = run(state, jax.tree.map(lambda a: a[whole:], signals))[1]
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), found, rest)


def _check_shapes(model: Model, u: jax.Array, x0: jax.Array, valid: Array | None) -> None:
    n_u, n_x = len(model.physics.inputs), model.n_x
    if u.ndim != 3 or u.shape[-1] != n_u or not u.size:
        raise ValueError(f"rollout: u: expected [sequence, time, {n_u}], found shape {u.shape}")
    for name, shape, found in (
        ("x0", (len(u), n_x), x0.shape),
        ("valid", u.shape[:2], u.shape[:2] if valid is None else valid.shape),
    ):
        if found != shape:
            raise ValueError(f"rollout: {name}: expected shape {shape}, found {found}")


def first_not_finite(x: Float[Array, "seq time x"], y: Float[Array, "seq time y"]) -> Int[jax.Array, " seq"]:
    """Index of the first sample at which x or y is not finite, the number of samples if none."""
    finite = jnp.isfinite(x).all(-1) & jnp.isfinite(y).all(-1)
    return jnp.where(finite.all(1), finite.shape[1], jnp.argmin(finite, axis=1)).astype(jnp.int32)


def _physics_step(model: Model, params: ModelParams, x: jax.Array, u: jax.Array) -> jax.Array:
    """f_phy for `[seq, x]`; a black box's is zero."""
    if not model.spec.guided:
        return jnp.zeros_like(x)
    return jax.vmap(model.physics.step, (None, 0, 0))(params.physics, x, u)


def _fused(
    model: Model, params: ModelParams, networks: Networks | None, start: _State, u: jax.Array, held: jax.Array | None
) -> tuple[_State, jax.Array]:
    """x `[time, seq, x]` by one scan; the carry is one packed array `[seq, x + layers · hidden]`."""
    n_x, hidden, layers = model.n_x, model.spec.hidden, len(start.h)
    u_scaled = params.scaling.u.to_scaled(u)

    def parts(carry: jax.Array) -> list[jax.Array]:
        return jnp.split(carry, [n_x + i * hidden for i in range(layers)], axis=1) if layers else [carry]

    def body(carry: jax.Array, inputs: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
        u_t, u_t_scaled, *held_t = inputs
        x, *h = parts(carry)
        new = _physics_step(model, params, x, u_t)
        if networks is not None:
            seen = u_t_scaled
            if model.spec.feedback:
                seen = jnp.concatenate([seen, model.seen_of(params.scaling.x.to_scaled(x))], -1)
            phi = networks.phi_u(seen)
            correction = model.whole(networks.f_nn(h[-1] if h else None, phi))
            new = new + params.scaling.x.unscale_difference(correction)
            below = phi
            for i, layer in enumerate(networks.gru):
                h[i] = below = layer.step(h[i], layer.project(below))
        new = _hold(held_t, x, new)
        return jnp.concatenate([new, *h], -1), new

    packed = jnp.concatenate([start.x, *start.h], -1)
    end, found = jax.lax.scan(body, packed, (u, u_scaled) if held is None else (u, u_scaled, held))
    x, *h = parts(end)
    return _State(x, tuple(h)), found


def _split(
    model: Model,
    params: ModelParams,
    networks: Networks | None,
    start: _State,
    u: jax.Array,
    held: jax.Array | None,
    *,
    native: bool,
) -> tuple[_State, jax.Array]:
    """x `[time, seq, x]` with everything but the two recurrences batched over time."""
    last = []
    if networks is None:
        correction = jnp.zeros((*u.shape[:2], model.n_x), start.x.dtype)
    else:
        phi = networks.phi_u(params.scaling.u.to_scaled(u), native=native)
        states, before = phi, None
        for layer, h in zip(networks.gru, start.h, strict=True):
            begun = h.astype(states.dtype)  # the state may be in another precision than the networks
            states = layer.scan(states, begun, native=native)
            before = delayed(states, begun)
            last.append(states[-1].astype(h.dtype))
        correction = params.scaling.x.unscale_difference(model.whole(networks.f_nn(before, phi, native=native)))
    if not model.spec.guided:
        return _State(correction[-1], tuple(last)), correction

    def body(x: jax.Array, inputs: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
        u_t, correction_t, *held_t = inputs
        x = _hold(held_t, x, _physics_step(model, params, x, u_t) + correction_t)
        return x, x

    x, found = jax.lax.scan(body, start.x, (u, correction) if held is None else (u, correction, held))
    return _State(x, tuple(last)), found


def _hold(held: list[jax.Array], old: jax.Array, new: jax.Array) -> jax.Array:
    return jnp.where(held[0][:, None], old, new) if held else new


def _measure(
    model: Model, params: ModelParams, networks: Networks | None, x: jax.Array, u: jax.Array, *, native: bool
) -> jax.Array:
    """y `[time, seq, y]` = g_phy(x, u) + s_y g_nn(x, u), batched over time; a black box's g_phy is the mean of y."""
    scaling = params.scaling
    if model.spec.guided:
        y = jax.vmap(jax.vmap(model.physics.measure, (None, 0, 0)), (None, 0, 0))(params.physics, x, u)
    else:
        y = scaling.y.to_physical(jnp.zeros((*x.shape[:2], len(model.physics.outputs)), x.dtype))
    if networks is None:
        return y
    return y + scaling.y.unscale_difference(
        networks.g_nn(model.seen_of(scaling.x.to_scaled(x)), scaling.u.to_scaled(u), native=native)
    )
