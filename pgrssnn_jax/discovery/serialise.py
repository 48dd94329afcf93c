"""What discovery says: `discovery.json` and the arrays of its pictures, from what was found out."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.candidates import Screening
from pgrssnn_jax.discovery.discover import Discovery
from pgrssnn_jax.discovery.finding import (
    acts_at,
    channel_names,
    finding,
    fitted,
    when,
    within_record,
)
from pgrssnn_jax.discovery.locate import Box, box, clear, signal_map
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.discovery.sentence import sentence
from pgrssnn_jax.discovery.serialise_numbers import (
    about_data,
    departures,
    initial_state,
    numbers,
    parameters,
    recalibration,
)
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.setup import Setup, Start
from pgrssnn_jax.discovery.untestable import untestable
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.effects.stored import physics_to_json


def discovery_json(found: Discovery, setup: Setup, *, command: str) -> dict[str, Any]:
    """The content of `discovery.json`; `numbers` and `physics` are what `physics.effects=FILE` reads."""
    problem = found.problem
    effects = [finding(found, name, command) for name in _by_gain(found) if name != found.convention]
    verdict = found.judgement.verdict
    return {
        "schema": 1,
        "system": problem.physics.name,
        "data": about_data(setup, "before_step" if found.convention else problem.physics.output_timing),
        "verdict": str(verdict),
        "sentence": sentence(
            found, _gap(found), effects, _alternatives(found), departures(found), remaining(found)["rule"]
        ),
        "effects": effects,
        "alternatives": _alternatives(found),
        "refuted": list(found.refuted),
        "untestable": untestable(found),
        "formula": _formula(found),
        "spectrum": _spectrum(found, setup),
        "follows": found.nameless.follows._asdict() if found.nameless.follows else None,
        "disagreement": disagreement(found),
        "remaining": remaining(found),
        "recalibration": recalibration(found),
        "parameters": parameters(found),
        "departures": departures(found),
        "undetermined": [one._asdict() for one in found.undetermined],
        "gap": _gap(found),
        "optimism": found.optimism,
        "ranking": _ranking(found),
        "network": None,
        "null": {
            "threshold": float(np.quantile(_law(found.selection.first), 1.0 - setup.settings.p_value)),
            "draws": len(found.selection.first.null.law),
        },
        "seconds": found.seconds,
        "inputs": [{"name": s.name, "unit": s.unit} for s in problem.physics.inputs],
        "outputs": [{"name": s.name, "unit": s.unit} for s in problem.physics.outputs],
        "states": [{"name": s.name, "unit": s.unit} for s in problem.physics.states],
        "physics": physics_to_json(setup.physics)["physics"],
        "numbers": numbers(found),
        "initial_state": initial_state(found) if setup.start is Start.SHARED else None,
    }


def _by_gain(found: Discovery) -> list[str]:
    """Names of the effects, the one without which most would be left unexplained first."""
    screenings = found.selection.screenings
    return sorted(found.selection.final.estimate.active, key=lambda name: screenings[name].base.score)


def _gap(found: Discovery) -> dict[str, Any]:
    test, train = found.test.models, found.train.models
    error = {name: {"train": train[name].error, "test": test[name].error} for name in test}
    closed = found.proved.closed_fraction
    missing = found.judgement.verdict not in (Verdict.NO_DISCREPANCY, Verdict.MISCALIBRATED)
    return {
        "metric": found.test.metric.name,
        "unit": found.test.metric.unit,
        **error,
        "test_interval": {name: list(one.interval) for name, one in test.items()},
        "improvement_interval": list(found.test.improvement),
        "n_init": found.test.metric.n_init,
        "floor": found.proved.floor,
        "closed_fraction": closed if missing else 0.0,
        "open_fraction": 1.0 - closed if missing else 0.0,
    }


def _ranking(found: Discovery) -> list[dict[str, Any]]:
    """The first screening of the whole catalogue: gain in parts of the energy of the innovations."""
    screening, active = found.selection.first, found.selection.final.estimate.active
    return [
        {
            "name": c.name,
            "gain": float(_energy(screening, c.gain)),
            "log_likelihood": c.gain,
            "cross_validated": c.model is not None,
            "p_value": screening.p_value(c),
            "chosen": c.name in active,
        }
        for c in screening.candidates
    ]


def _energy(screening: Screening, gain: Any) -> Any:
    """Part of the energy of the innovations that a gain of log-likelihood takes away."""
    return -np.expm1(-2.0 * np.maximum(gain, 0.0) / screening.size)


def _law(screening: Screening) -> Float[np.ndarray, " draw"]:
    """What the best effect gains by luck, in the scale of the effect that is ranked first."""
    best = next(iter(screening.candidates), None)
    return _energy(screening, screening.null.gains(best.name)) if best else np.zeros(1)


def _alternatives(found: Discovery) -> list[dict[str, Any]]:
    said = []
    for name, others in found.judgement.alternatives.items():
        for other in others:
            said.append(
                {
                    "name": other.name,
                    "instead_of": name,
                    "gain": float(_energy(found.selection.screenings[name], other.gain)),
                    "channel_names": channel_names(found.problem.physics, found.problem.effect(other.name)),
                    "acts_at": acts_at(found.problem, other.name, other.guess.theta),
                    "parameters": fitted(found.problem, other.model, other.name) if other.model else {},
                    "experiment": _experiment(found.problem, name, other.name),
                }
            )
    return said


_EXPERIMENTS = {
    "input": "inputs over a wider range, with steps at several levels, so that what reaches the system can be told",
    "dynamics": "a record in which the states rest at several levels while the input is constant",
    "measurement": "a reading of the sensor against a reference at several levels, with the system at rest",
}


_ONE_BY_ONE = "a measurement at these channels, or a record in which their signals change one at a time"


def _experiment(problem: Problem, one: str, other: str) -> str:
    """What would tell two effects apart, by where they act, or one at two channels."""
    if one == other:
        return _ONE_BY_ONE
    places = sorted({problem.effect(one).acts_on, problem.effect(other).acts_on}, key=list(_EXPERIMENTS).index)
    return "; or ".join(_EXPERIMENTS[place] for place in places)


def _formula(found: Discovery) -> str | None:
    if found.formula is None:
        return None
    return (
        f"{found.formula.text} (in free run it closes {100 * found.formula.closed:.0f} % of what the fitted curve does)"
    )


def _spectrum(found: Discovery, setup: Setup) -> dict[str, Any] | None:
    line = found.nameless.line
    if line is None:
        return None
    output, weight = setup.estimation.info.outputs[line.output], found.signals.weight[..., line.output].max()
    numbers = {"period_s": line.period * found.problem.physics.dt, "amplitude": line.amplitude / float(weight)}
    return {**numbers, "unit": output.unit, "share": line.share, "output": output.name}


def disagreement(found: Discovery) -> list[dict[str, Any]]:
    """One entry per state equation whose correction stands out, the likeliest first."""
    physics, correction = found.problem.physics, found.location.correction
    within = within_record(found.location.signals)
    values = np.concatenate([found.location.x[..., : len(physics.states)], found.location.signals.u], -1)[within]
    said = []
    for i in np.argsort(-correction.likelihood):
        acting = within & np.stack([clear(m, s) for m, s in zip(correction.mean[i], correction.std[i], strict=True)])
        if not acting.any() or not np.isfinite(correction.likelihood[i]) or correction.likelihood[i] <= 0:
            continue
        energy = np.where(acting, correction.mean[i] ** 2, 0.0)[within]
        where = box(energy, values, (*physics.states, *physics.inputs))
        said.append(
            {
                "equation": physics.states[i].name,
                **_boxed(where),
                **when(acting, physics.dt),
                "log_likelihood": float(correction.likelihood[i]),
            }
        )
    return said


def remaining(found: Discovery) -> dict[str, Any]:
    """Where the errors are that the final model leaves."""
    within = within_record(found.signals)
    physics, signals = found.problem.physics, found.signals
    error = np.where(signals.weight > 0, signals.weight * (signals.y - found.train.after.y), 0.0)
    values = np.concatenate([found.train.after.x[..., : len(physics.states)], signals.u], -1)
    energy = np.nan_to_num(error**2).sum(-1)
    selection = found.selection
    if selection.last.rms(selection.final) <= Criteria().above * selection.floor:
        return _boxed(Box({}, "everywhere: no more than the noise", 1.0, 1.0))
    return _boxed(box(energy[within], values[within], (*physics.states, *physics.inputs)))


def _boxed(where: Box) -> dict[str, Any]:
    region = {name: [_finite(edge) for edge in edges] for name, edges in where.region.items()}
    return {**where._asdict(), "region": region}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def discovery_arrays(found: Discovery, setup: Setup) -> dict[str, Any]:
    """The arrays of `discovery.npz`: simulations of both records, the correction signal, and its map."""
    physics = found.problem.physics
    arrays: dict[str, Any] = {}
    for part, record, runs in (("train", found.estimation, found.train), ("test", setup.test, found.test)):
        arrays[f"time_{part}"] = np.arange(record.u.shape[1]) * physics.dt
        arrays |= {f"u_{part}": record.u, f"y_{part}": record.y, f"mask_{part}": record.mask}
        arrays |= {f"y_{name}_{part}": one.y for name, one in runs.models.items()}
    arrays["x_after_train"] = found.train.after.x[..., : len(physics.states)]
    arrays["correction"], arrays["correction_std"] = found.location.correction.mean, found.location.correction.std
    arrays["null_law"] = _law(found.selection.first)
    return arrays | _map_arrays(found)


def _map_arrays(found: Discovery) -> dict[str, np.ndarray]:
    """The correction of the likeliest equation over the signal of its rule and one other."""
    physics = found.problem.physics
    named = disagreement(found)
    names = [s.name for s in (*physics.states, *physics.inputs)]
    equation = named[0]["equation"] if named else physics.states[0].name
    a = next(iter(named[0]["region"]), equation) if named else equation
    b = next((s.name for s in physics.inputs if s.name != a), names[0])
    values = np.concatenate([found.location.x[..., : len(physics.states)], found.location.signals.u], -1)
    i = [s.name for s in physics.states].index(equation)
    pair = (values[..., names.index(a)], values[..., names.index(b)])
    drawn = signal_map(found.location.correction.mean[i], *pair, (a, b), within_record(found.location.signals))
    return {
        "map_x_edges": drawn.a_edges, "map_u_edges": drawn.b_edges, "map_mean": drawn.mean,
        "map_std_error": drawn.std_error, "map_count": drawn.samples, "map_equation": np.array(equation),
        "map_a": np.array(a), "map_b": np.array(b),
    }  # fmt: skip
