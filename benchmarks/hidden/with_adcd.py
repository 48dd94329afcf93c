"""The same cases by ADCD, which looks for one correction of a static law, and its own scenarios.

    y = y_known(x) + Δ(x)   or   y_known(x) (1 + Δ(x)),   Δ → 0 where a signal goes to its classical limit

ADCD has no time: on a hidden-effect case y is the smoothed derivative of the fastest state, x its signals, and y_known
the physics with its numbers refitted to the derivatives (`with_pysindy.py`). It must be told which signal's limit makes
the correction vanish: each is tried, at zero, and the lowest BIC is taken, where it is lower than without a correction.
Source: Erdita, Anomaly-Driven Correction Discovery, https://pypi.org/project/adcd.
"""

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from pgrssnn_jax.physics.base import Physics

from . import bench, duffing, with_pysindy
from .case import Case, Catalogue
from .nominal import nominal
from .score import Row
from .suite import Plan
from .terms import Term, library

SYSTEMS = ("pendulum", "duffing", "servo", "hysteretic")  # one equation, of signals that are all measured
NOISE = 0.01  # of ADCD's own data as a share; of the motions in m
_WINDOW = 15  # samples of the smoothing: ADCD has none of its own
# ADCD's laws of a force as accelerations beside m dv/dt = u - c v - k q, and the names that are right ((): none is).
Law = Callable[[bench.Numbers, np.ndarray, np.ndarray], np.ndarray]
LAWS: dict[str, tuple[Law, tuple[str, ...]]] = {
    "Anharmonic Spring": (lambda n, q, v: 4 * 0.15 * q**3 / n["m"], ("cubic_spring",)),  # of the energy 0.15 q⁴
    "Nonlinear Drag": (lambda n, q, v: 0.25 * np.abs(v) * v / n["m"], ("quadratic_drag",)),
    "Mystery-C": (lambda n, q, v: n["k"] * q * (_log_mean(np.abs(q) / 2) - 1) / n["m"], ()),
    "Blind-6: Magnus Wind-Tunnel": (lambda n, q, v: 0.4 * n["c"] * np.abs(v) ** 1.5 * v / n["m"], ()),
}
# Why the others are no motion with an input, by the beginning of their names.
NO_MOTION = {
    "an energy or a force by values drawn at random, no signal of a motion": (
        *("Relativistic KE", "Yukawa Gravity", "Screened Coulomb", "Mystery-A", "Mystery-B", "Blind-4", "Blind-5"),
        *("Blind-7", "MV-1", "MV-3"),
    ),
    "a law of gases or radiation, without any rate": (
        *("Net Radiation", "Blind-1", "Blind-2", "Blind-3", "Blind-8", "MV-2", "MV-4"),
    ),
    "a correction below the rounding of double precision": ("Blind-9",),
}


def _log_mean(z: np.ndarray) -> np.ndarray:
    """log(1 + z) / z, 1 at zero."""
    return np.where(z > 0, np.log1p(z) / np.where(z > 0, z, 1.0), 1.0)


def corrections(case: Case, seed: int) -> tuple[list[tuple[Term, float]], Physics]:
    """The term that ADCD finds, if any, and the physics with it. Raises `ImportError` without adcd."""
    import adcd

    physics = nominal(case)
    with jax.enable_x64(True):
        data = with_pysindy.measured(physics, case, _WINDOW)
        known = with_pysindy.Regression(with_pysindy.Ahead(physics, library(physics, data.z)), case.train, data)
    names = [signal.name for signal in (*physics.states, *physics.inputs)]
    x = dict(zip(names, data.z[:, data.inside], strict=True))
    y, y_known = known.slopes[0, data.inside], known.known[0, data.inside]

    def bic(fit: Any) -> float:
        return adcd.bic_score(fit.best_nmse_residual, len(fit.best_theta), len(y)) if fit.best_expr else np.inf

    fits = []
    for name in names:
        with _quiet():
            fit = adcd.fit(dict(x), y, y_known, name, "0", correction_mode="additive", verbose=False, seed=seed)
        fits.append(fit.search_result)
    best = min(fits, key=bic)
    terms = []
    if bic(best) < adcd.bic_score(1.0, 0, len(y)):
        terms = [(_term(best.best_expr, best.best_theta, physics), 1.0)]
    return terms, with_pysindy.corrected(physics, terms, known.theta)


def _term(expression: str, theta: dict[str, float], physics: Physics) -> Term:
    """The only equation's; a power of one signal has that shape, anything else bends it."""
    import sympy

    signals = [*physics.states, *physics.inputs]
    symbols = [sympy.Symbol(signal.name) for signal in signals]
    formula = sympy.sympify(expression, {str(s): s for s in symbols}).subs(theta)
    used = [i for i, symbol in enumerate(symbols) if symbol in formula.free_symbols]
    role, shape = "", "" if used else "1"
    if len(used) == 1:
        i, rates = used[0], {state.rate_of for state in physics.states}
        role = "input" if i >= len(physics.states) else "position" if signals[i].name in rates else "rate"
        factor, power = formula.as_coeff_exponent(symbols[i])
        alone = symbols[i] not in factor.free_symbols
        shape = f"z^{round(float(power))}".replace("z^1", "z") if alone else "sign(z)" if role == "input" else ""
    equation = next(i for i, state in enumerate(physics.states) if state.rate_of)
    function = sympy.lambdify(symbols, formula, "jax")
    return Term(equation, role, shape, f"{formula} in {signals[equation].name}'", lambda z: function(*z))


def law(name: str, seed: int) -> tuple[Plan, Case]:
    """A record of a mass on a spring and a damper whose force follows one of ADCD's laws."""
    extra, names = LAWS[name]
    plant = duffing.PLANT._replace(
        catalogue=Catalogue({name: "law"}, duffing.CATALOGUE.noises, identical={name: names}),
        draws={name: lambda rng: {}},
        slope=lambda n, x, u: duffing.slope(n, x, u) - np.stack([np.zeros_like(x[0]), extra(n, *x)]),
        reach=3.0,  # m, the largest extension in ADCD's data of the anharmonic spring
    )
    case = bench.build(plant, seed, (name,), noise=NOISE)
    return Plan("duffing", seed, "single" if names else "unnamed", (name,), (), NOISE), case


def scenarios() -> dict[str, Any]:
    """ADCD's own, by name; none without adcd."""
    try:
        import adcd
    except ImportError as missing:
        print(f"adcd: not installed: {missing}")
        return {}
    return {scenario.name: scenario for scenario in adcd.get_all_scenarios()}


def at_home(name: str, seed: int) -> Row:
    """ADCD on its own data; right: the class of the correction, by its own classification."""
    import adcd

    scenario = scenarios()[name]
    with _quiet():
        result = adcd.discover_correction(
            scenario, NOISE, correction_mode=scenario.correction_type, verbose=False, seed=seed
        )
    found = adcd.classify_structure(result.best_expr, result.best_theta) if result.best_expr else "none"
    return {
        "expression": result.best_expr,
        "theta": result.best_theta,
        "right": found == scenario.correction_class,
    }


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    logging.disable(logging.WARNING)
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(logging.NOTSET)
