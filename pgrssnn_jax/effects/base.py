"""The contract of everything that may be missing from a physics: named effects as functions `Physics -> Physics`.

    Physics + Effect = Physics          with the effect's parameters at their neutral values it changes nothing

The numbers of effects live beside the physics' own ones, in `WithEffects`, so that no name of one meets the other's.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.base import Extension, Origin, Parameter, Physics, extended, extension_of

Numbers = Mapping[str, Any]
Map = Callable[[Any, jax.Array], jax.Array]
After = Callable[[Any, Any, jax.Array, jax.Array, jax.Array], jax.Array]
_SHARES = (0.0, 0.1, 0.5)  # of the way from neutral to the further bound: where fits begin unless the effect says


class WithEffects(NamedTuple):
    """Numbers (or their `Parameter`s) of a physics with effects. own: what its params are without any; effects: a flat
    dictionary of numbers or arrays (one number per channel or joint) by the name of the effect."""

    own: Any
    effects: Mapping[str, Mapping[str, Any]]


def own_of(params: Any) -> Any:
    """The physics' own numbers."""
    return params.own if isinstance(params, WithEffects) else params


def effects_of(params: Any) -> Mapping[str, Mapping[str, Any]]:
    """The numbers of effects by their names."""
    return params.effects if isinstance(params, WithEffects) else {}


class SignalRange(NamedTuple):
    """Where the data take the system: lowest and highest value of every state, input and output in a simulation of the
    physics that the effect is to be added to. Thresholds are looked for inside. lines: frequencies in Hz of lines in
    the spectrum of the errors of that simulation."""

    x: Float[np.ndarray, "2 x"]
    u: Float[np.ndarray, "2 u"]
    y: Float[np.ndarray, "2 y"]
    lines: tuple[float, ...] = ()


class Needs(NamedTuple):
    """Condition of an effect on its physics. words: for people, after "expected"; met: the condition."""

    words: str
    met: Callable[[Physics], bool]


def counted(n: int, word: str) -> str:
    return f"{n} {word}" if n == 1 else f"{n} {word}s"


ANY_PHYSICS = Needs("any physics", lambda physics: True)


class Effect(NamedTuple):
    """One named physical effect.

        wrap(physics).step(p, x, u) = physics.step(p, x, u)        where p.effects[name] is neutral; measure likewise

    name, parameters (what its numbers mean, each with its neutral value) and wrap are essential. wrap: from a physics
    whose params are `WithEffects` to the physics with the effect, by `on_input`, `on_output`, `after_step`,
    `with_memory`, `at_point`, or any other replacement of `step` and `measure` that calls those of the physics; its
    functions find the effect's numbers in `p.effects[name]` and the physics' own ones in `p.own`.

    title, equation, cause: for people, one line each; acts_on: where it enters; shapes: of the parameters that are
    arrays (per channel or joint); initial_guesses: starting values of fits for the range of the data, None: those of
    `guesses`; needs: which physics can take it; active: share of the samples in which it acts, from `(numbers, x, u)`
    with x `[time, x]`, u `[time, u]`, None where it always does; simpler: names of effects that are preferred to this
    one where they do as well; channels: the owner of one number of an array (`output`, `input`, `joint`; of a matrix
    `output, input`); elaborate: many numbers or long computations, which discovery tries only where other effects leave
    errors above the noise, and which must predict better by three standard errors; memory_guesses: where fits begin
    with states that begin anew in every record, by their names; credible: are numbers, beside the range of the data?
    """

    name: str
    parameters: Mapping[str, Parameter]
    wrap: Callable[[Physics], Physics]
    title: str = ""
    equation: str = ""
    cause: str = ""
    acts_on: Literal["input", "dynamics", "measurement"] = "dynamics"
    shapes: Mapping[str, tuple[int, ...]] = {}
    initial_guesses: Callable[[SignalRange], Sequence[Numbers]] | None = None
    needs: Needs = ANY_PHYSICS
    active: Callable[[Numbers, np.ndarray, np.ndarray], np.ndarray] | None = None
    simpler: tuple[str, ...] = ()
    channels: str = ""
    elaborate: bool = False
    memory_guesses: Mapping[str, Sequence[float]] = {}
    credible: Callable[[Numbers, SignalRange], bool] | None = None

    def neutral(self) -> dict[str, np.ndarray]:
        """Every number at the value at which the effect changes nothing.

        Raises `ValueError` for a parameter without such a value."""
        return self._filled(lambda p: p.neutral)

    def guesses(self, span: SignalRange) -> Sequence[Numbers]:
        """Starting values of fits: `initial_guesses`, or points between neutral and the further finite bound.

        Raises `ValueError` where neither is possible: for a threshold that is neutral at infinity."""
        if self.initial_guesses is not None:
            return self.initial_guesses(span)
        starts = [self._filled(lambda p, share=share: _towards_bound(p, share)) for share in _SHARES]
        if not all(np.isfinite(value).all() for start in starts for value in start.values()):
            raise ValueError(f"effects: {self.name}: expected initial_guesses beside an infinite neutral, found none")
        moved = any(np.any(value != starts[0][name]) for name, value in starts[1].items())
        return starts if moved else starts[:1]

    def _filled(self, value: Callable[[Parameter], float | None]) -> dict[str, np.ndarray]:
        for name, meaning in self.parameters.items():
            if meaning.neutral is None:
                raise ValueError(f"effects: {self.name}.{name}: expected a neutral value, found none")
        return {name: np.full(self.shapes.get(name, ()), value(p), np.float64) for name, p in self.parameters.items()}


def _towards_bound(p: Parameter, share: float) -> float:
    neutral = 0.0 if p.neutral is None else p.neutral
    further = max((end for end in p.bounds if np.isfinite(end)), key=lambda end: abs(end - neutral), default=neutral)
    return neutral + share * (further - neutral) if share else neutral


def add(physics: Physics, *effects: Effect, numbers: Mapping[str, Numbers] | None = None) -> Physics:
    """The physics with effects, in the order given; their numbers neutral where `numbers[effect.name]` says nothing.

    Its params are `WithEffects`. Raises `ValueError` for an effect that the physics cannot take, for one that is
    already there, and for numbers that are not the effect's.
    """
    numbers = numbers or {}
    for effect in effects:
        if effect.name in effects_of(physics.params):
            raise ValueError(f"effects: expected each effect once, found {effect.name!r} in physics {physics.name!r}")
        if not effect.needs.met(physics):
            raise ValueError(f"effects: {effect.name}: expected {effect.needs.words}, found physics {physics.name!r}")
        given = numbers.get(effect.name, {})
        for name in given:
            if name not in effect.parameters:
                raise ValueError(f"effects: {effect.name}: expected {sorted(effect.parameters)}, found {name!r}")
        values = {**effect.neutral(), **{name: np.asarray(v, np.float64) for name, v in given.items()}}
        for name, value in values.items():
            if value.shape != effect.shapes.get(name, ()):
                expected = effect.shapes.get(name, ())
                raise ValueError(f"effects: {effect.name}.{name}: expected shape {expected}, found {value.shape}")
            low, high = effect.parameters[name].bounds
            if not np.all((value >= low) & (value <= high)):
                unit = effect.parameters[name].unit
                raise ValueError(f"effects: {effect.name}.{name}: expected {low:g} to {high:g} {unit}, found {value}")
        inner = _beside_own(physics)
        (own, others), (own_meanings, meanings) = inner.params, inner.parameters
        physics = _wrapped(effect, inner)._replace(
            params=WithEffects(own, {**others, effect.name: values}),
            parameters=WithEffects(own_meanings, {**meanings, effect.name: dict(effect.parameters)}),
            origin=_with_effect(physics.origin, effect, values),
        )
    return physics


def _with_effect(origin: Origin | None, effect: Effect, values: Numbers) -> Origin | None:
    """Variants of a physics with an effect have it too."""
    if origin is None:
        return None

    @wraps(origin.build)
    def build(**settings: Any) -> Physics:
        return add(origin.build(**settings), effect, numbers={effect.name: values})

    return origin._replace(build=build)


def _beside_own(physics: Physics) -> Physics:
    """The same physics with a place for the numbers of effects."""
    if isinstance(physics.params, WithEffects):
        return physics

    def of_own(function: Any) -> Any:
        return (lambda p, *rest: function(p.own, *rest)) if callable(function) else function

    beside = physics._replace(
        step=of_own(physics.step),
        measure=of_own(physics.measure),
        params=WithEffects(physics.params, {}),
        parameters=WithEffects(physics.parameters, {}),
        extension=None,
    )
    known = extension_of(physics)
    return extended(beside, type(known.points)(*map(of_own, known.points)), known.assemble) if known else beside


def points_changed(physics: Physics, effect: Effect) -> frozenset[str] | None:
    """Names of the extension points that an effect changes; None where it acts around the step or on its signals."""
    inner = _beside_own(physics)
    wrapped, known = effect.wrap(inner), extension_of(inner)
    changed = extension_of(wrapped)
    if known is None or changed is None or wrapped.states != physics.states:
        return None
    pairs = zip(known.points, changed.points, strict=True)
    return frozenset(name for name, (a, b) in zip(known.points._fields, pairs, strict=True) if a is not b)


def _wrapped(effect: Effect, inner: Physics) -> Physics:
    """An effect around step and measurement stays around them when a later one changes the points inside."""
    wrapped, known = effect.wrap(inner), extension_of(inner)
    if known is None or wrapped.extension is not inner.extension:
        return wrapped

    def assemble(points: Any) -> tuple[Any, Any]:
        around = effect.wrap(extended(inner, points, known.assemble))
        return around.step, around.measure

    return wrapped._replace(extension=Extension(known.points, assemble, (wrapped.step, wrapped.measure)))


def at_point(physics: Physics, point: str, name: str, change: Callable[..., Any]) -> Physics:
    """v ← change(n, own, v, *arguments) inside the step, v: what an extension point (`Extension`) gives for its
    arguments; n: numbers of the effect, own: those of the physics.

    Raises `ValueError` for a physics without this point."""

    def around(n: Any, own: Any, inner: Callable[..., Any], *arguments: Any) -> Any:
        return change(n, own, inner(*arguments), *arguments)

    return around_point(physics, point, name, around)


def around_point(physics: Physics, point: str, name: str, around: Callable[..., Any]) -> Physics:
    """v ← around(n, own, inner, *arguments) inside the step, inner(*arguments): what an extension point gives for any
    arguments. `at_point` for an effect that changes the arguments too.

    Raises `ValueError` for a physics without this point."""
    known = extension_of(physics)
    found = getattr(known.points, point, None) if known else None
    if known is None or found is None:
        raise ValueError(f"effects: {name}: expected an extension point {point!r}, found physics {physics.name!r}")

    def changed(p: Any, *arguments: Any) -> Any:
        return around(p.effects[name], p.own, lambda *others: found(p, *others), *arguments)

    return extended(physics, known.points._replace(**{point: changed}), known.assemble)


def on_input(physics: Physics, name: str, change: Map) -> Physics:
    """u ← change(n, u) before it reaches the physics; n: numbers of the effect."""

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return physics.step(p, x, change(p.effects[name], u))

    def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return physics.measure(p, x, change(p.effects[name], u))

    return physics._replace(step=step, measure=measure)


def on_output(physics: Physics, name: str, change: Map) -> Physics:
    """y ← change(n, y) after the measurement equation; n: numbers of the effect."""
    return physics._replace(measure=lambda p, x, u: change(p.effects[name], physics.measure(p, x, u)))


def after_step(physics: Physics, name: str, change: After) -> Physics:
    """x_t ← change(n, own, x_{t-1}, u_t, x_t): an increment or a limit once the step is done; n: numbers of the effect,
    own: those of the physics."""

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return change(p.effects[name], p.own, x, u, physics.step(p, x, u))

    return physics._replace(step=step)
