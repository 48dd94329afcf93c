"""The contract of everything physical: what is known of a system, as pure functions and data.

    x_t = step(params, x_{t-1}, u_t)            state after the input u_t has acted for dt seconds
    y_t = measure(params, x_t, u_t)             output_timing = "after_step"   (the published convention)
    y_t = measure(params, x_{t-1}, u_t)         output_timing = "before_step"  (a plant sampled before u_t acts)

States, inputs and outputs are in physical units; one sample at a time (`x [n_x]`, `u [n_u]`), vmapped over
the rest. A `Physics` never raises inside compiled code: a state that leaves the floating-point range is data.
"""

import inspect
import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, Literal, NamedTuple, ParamSpec, cast

import jax
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.integrate import DerivativePoints, Integrator, derivative_points, held
from pgrssnn_jax.physics.signals import Parameter, Signal, check_number, checked_signals, is_parameter, written
from pgrssnn_jax.records.arguments import check_kind, positive, shown
from pgrssnn_jax.records.units import with_unit

Params = Any
OutputTiming = Literal["after_step", "before_step"]
Step = Callable[[Params, Float[jax.Array, " x"], Float[jax.Array, " u"]], Float[jax.Array, " x"]]
Skeleton = Callable[[Float[np.ndarray, "*batch y"]], Float[np.ndarray, "*batch points 3"]]
Measure = Callable[[Params, Float[jax.Array, " x"], Float[jax.Array, " u"]], Float[jax.Array, " y"]]


class Origin(NamedTuple):
    """How a physics was built: `build(**settings)` builds it again. target: where `build` can be imported from, empty
    where nobody said; source: the function whose source tells this physics from others."""

    build: Callable[..., "Physics"]
    settings: Mapping[str, Any]
    target: str = ""
    source: Callable[..., Any] | None = None


class Extension(NamedTuple):
    """Extension points: the pure functions that step and measurement are made of, for effects that act inside a step.

        (step, measure) = assemble(points)

    points: a NamedTuple; what can be called in it takes the physics' params first, other fields are data about the
    system. made: the step and measurement of these points, by which `extension_of` knows whether they are still those
    of a physics.
    """

    points: Any
    assemble: Callable[[Any], tuple[Step, Measure]]
    made: tuple[Step, Measure]


class Physics(NamedTuple):
    """Known physics.

        x_t = step(params, x_{t-1}, u_t)        y_t = measure(params, x_t, u_t)

    `parameters` has the shape of `params`, leaf for leaf.

    output_timing: `before_step` where the plant is sampled before u_t acts. skeleton: shape of the system for pictures:
    points `[..., points, 3]` in m, z up, joined in their order by lines, from outputs `[..., y]`; None where there is
    nothing to draw. remark: a line for the user about the origin of the physics. differentiable: does `step` let
    gradients through? extension: where effects enter a step, None: only around it. origin: its builder and settings,
    None where they are not known. discovered: were its numbers fitted to a whole estimation record? optimism: how many
    times smaller its errors are there than on parts that were left out, None where that was not measured."""

    name: str
    step: Step
    measure: Measure
    params: Params
    parameters: Params
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    dt: float
    output_timing: OutputTiming = "after_step"
    skeleton: Skeleton | None = None
    remark: str = ""
    differentiable: bool = True
    extension: Extension | None = None
    origin: Origin | None = None
    discovered: bool = False
    optimism: float | None = None

    @property
    def settings(self) -> Mapping[str, Any]:
        """The settings that `variant` may change, with their present values."""
        return {} if self.origin is None else self.origin.settings

    def variant(self, **changes: Any) -> "Physics":
        """The same physics with other settings of its builder; numbers that these do not concern stay as they are, and
        so do its effects.

        Raises `ValueError` for a setting that the builder does not have.
        """
        for name in changes:
            if name not in self.settings:
                known = sorted(self.settings)
                raise ValueError(f"physics {self.name!r}: variant: expected settings among {known}, found {name!r}")
        if self.origin is None or not changes:
            return self
        settings = {**self.settings, **changes}
        before, after = self.origin.build(**self.settings), self.origin.build(**settings)
        begun = {state.name: state.start for state in self.states}
        return after._replace(
            params=_kept(self.params, before.params, after.params),
            states=tuple(s._replace(start=begun.get(s.name, s.start)) for s in after.states),
            origin=self.origin._replace(settings=settings),
            discovered=self.discovered,
            optimism=self.optimism,
        )

    def __repr__(self) -> str:
        """What a person asks of a physics, a line each: its signals with their units, and its numbers."""
        lines = [f"Physics {self.name!r}, one sample every {self.dt:g} s"]
        for what in ("inputs", "states", "outputs"):
            lines.append(f"  {what}: " + ", ".join(with_unit(s.name, s.unit) for s in getattr(self, what)))
        meanings = jax.tree.leaves(self.parameters, is_leaf=is_parameter)
        numbers = [
            f"{jax.tree_util.keystr(path, simple=True, separator='.')} = {written(value)} {meaning.unit}".rstrip()
            for (path, value), meaning in zip(jax.tree_util.tree_leaves_with_path(self.params), meanings, strict=False)
        ]
        return "\n".join([*lines, "  parameters: " + (", ".join(numbers) or "none")])


def _kept(present: Params, before: Params, after: Params) -> Params:
    """The numbers of `after`; where they do not differ from those of `before`, the present ones."""
    now, was = (dict(jax.tree_util.tree_leaves_with_path(tree)) for tree in (present, before))

    def chosen(path: Any, leaf: Any) -> Any:
        same = path in now and path in was and np.array_equal(was[path], leaf)
        return now[path] if same and np.shape(now[path]) == np.shape(leaf) else leaf

    return jax.tree_util.tree_map_with_path(chosen, after)


Settings = ParamSpec("Settings")


def remembered(build: Callable[Settings, Physics]) -> Callable[Settings, Physics]:
    """A builder of the library whose physics knows it and all its settings, defaults included."""

    @wraps(build)
    def built(*args: Settings.args, **kwargs: Settings.kwargs) -> Physics:
        physics = build(*args, **kwargs)
        given = inspect.signature(build).bind(*args, **kwargs)
        given.apply_defaults()
        target = f"pgrssnn_jax.physics.{build.__name__}"
        return physics._replace(origin=Origin(built, given.arguments, target, build))

    return built


def extended(physics: Physics, points: Any, assemble: Callable[[Any], tuple[Step, Measure]]) -> Physics:
    """The physics whose step and measurement are assembled from extension points."""
    made = assemble(points)
    return physics._replace(step=made[0], measure=made[1], extension=Extension(points, assemble, made))


def extension_of(physics: Physics) -> Extension | None:
    """Extension points of the physics; None where it has none, or where step or measurement were replaced since they
    were assembled, which assembling them again would undo."""
    known = physics.extension
    return known if known and known.made[0] is physics.step and known.made[1] is physics.measure else None


def measured_rate(physics: Physics, state: Signal) -> str | None:
    """The output whose time derivative a state is: the one that `rate_of` names, or that the state of this name is
    `like`; None where it is no rate, or that of something that is not measured."""
    if any(output.name == state.rate_of for output in physics.outputs):
        return state.rate_of
    return next((other.like for other in physics.states if other.name == state.rate_of), None)


def discrete(
    name: str,
    step: Step,
    measure: Measure,
    params: Mapping[str, Any],
    *,
    states: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    outputs: tuple[Signal, ...],
    dt: float,
    parameters: Mapping[str, Any] | None = None,
    output_timing: OutputTiming = "after_step",
    skeleton: Skeleton | None = None,
    remark: str = "",
    differentiable: bool = True,
    reads: str | None = None,
) -> Physics:
    """A `Physics` from a difference equation, x_t = step(params, x_{t-1}, u_t) and y_t = measure(params, x_t, u_t).

    dt: s; parameters: meanings of params, in the same tree; output_timing: `before_step` reads x_{t-1}; skeleton: draws
    a state; remark: told when a discovery begins; differentiable: has step derivatives? reads: old `output_timing`.

    Raises `ValueError` for parameters in another tree, a relation to a signal that does not exist, a name given twice,
    what is no number, function or `Signal`, and a dt that is not positive.
    """
    if reads is not None:
        warnings.warn("physics: 'reads' is now called 'output_timing'", FutureWarning, stacklevel=2)
        output_timing = cast(OutputTiming, reads)
    check_kind("physics: name", name, str, "text")
    dt = positive(f"physics {name!r}: dt", dt, "sample time in seconds")
    for what, function in (("step", step), ("measure", measure), ("skeleton", skeleton or len)):
        if not callable(function):
            raise ValueError(f"physics {name!r}: {what}: expected a function, found {shown(function)}")
    named = (("states", states), ("inputs", inputs), ("outputs", outputs))
    states, inputs, outputs = (checked_signals(f"physics {name!r}: {what}", given) for what, given in named)
    check_kind(f"physics {name!r}: params", params, Mapping, "numbers by their names, {'gain': 2.0} say")
    if absent := [key for key, value in params.items() if value is None]:
        raise ValueError(f"physics {name!r}: {absent[0]}: expected a number, found None")
    meanings = jax.tree.map(lambda _: Parameter(), params) if parameters is None else parameters
    found = jax.tree.structure(meanings, is_leaf=is_parameter)
    if found != jax.tree.structure(params):
        raise ValueError(
            f"physics {name!r}: parameters: expected the tree of params, {jax.tree.structure(params)}, found {found}"
        )
    leaves = jax.tree.leaves(meanings, is_leaf=is_parameter)
    for (path, value), leaf in zip(jax.tree_util.tree_leaves_with_path(params), leaves, strict=True):
        if not is_parameter(leaf):
            raise ValueError(f"physics {name!r}: parameters: expected a Parameter per number, found {leaf!r}")
        key = jax.tree_util.keystr(path, simple=True, separator=".")
        check_number(f"physics {name!r}: {key}", value, leaf)
    if output_timing not in ("after_step", "before_step"):
        raise ValueError(
            f"physics {name!r}: output_timing: expected after_step or before_step, found {output_timing!r}"
        )
    measured = {signal.name for signal in outputs}
    for state in states:
        others = measured | {signal.name for signal in states if signal is not state}
        driven = {signal.name for signal in (*inputs, *states) if signal is not state}
        kinds = (("like", measured), ("rate_of", others), ("memory_of", driven))
        for kind, known in kinds:
            other = getattr(state, kind)
            if other is not None and other not in known:
                raise ValueError(
                    f"physics {name!r}: state {state.name!r}: expected {kind} one of {sorted(known)}, found {other!r}"
                )
    return Physics(
        name,
        step,
        measure,
        dict(params),
        meanings,
        states,
        inputs,
        outputs,
        dt,
        output_timing,
        skeleton,
        remark,
        differentiable,
    )


def continuous(
    name: str,
    derivative: Step,
    measure: Measure,
    params: Mapping[str, Any],
    *,
    states: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    outputs: tuple[Signal, ...],
    dt: float,
    parameters: Mapping[str, Any] | None = None,
    output_timing: OutputTiming = "after_step",
    integrator: Integrator | str = "rk4",
    sub_steps: int = 1,
    **more: Any,
) -> Physics:
    """A `Physics` from dx/dt = derivative(params, x, u), u held over the sample.

    integrator: `euler`, `rk4` or `rosenbrock` (`integrate.py`); sub_steps: integration steps of dt / sub_steps seconds
    per sample. more: further arguments of `discrete`. Its extension points are `DerivativePoints`.
    """

    dt = positive(f"physics {name!r}: dt", dt, "sample time in seconds")
    signals = {"states": states, "inputs": inputs, "outputs": outputs}
    more |= {**signals, "parameters": parameters, "output_timing": output_timing}

    def build(integrator: Integrator | str, sub_steps: int) -> Physics:
        if not callable(derivative):
            raise ValueError(f"physics {name!r}: derivative: expected a function, found {shown(derivative)}")
        points = derivative_points(derivative, measure, dt=dt, integrator=integrator, sub_steps=sub_steps)
        physics = discrete(name, *assemble(points), params, dt=dt, **more)._replace(
            origin=Origin(build, {"integrator": integrator, "sub_steps": sub_steps}, source=derivative)
        )
        return extended(physics, points, assemble)

    def assemble(points: DerivativePoints) -> tuple[Step, Measure]:
        return held(points), points.measure

    return build(integrator, sub_steps)
