"""The same cases by sparse regression on derivatives (PySINDy), as a practitioner would use it beside a known physics.

    r_i = dx_i/dt - f_i(θ, x, u) ≈ Σ_j c_ij φ_j(x, u),   c by STLSQ beside a refit of θ

x: outputs and their rates by PySINDy's smoothed differences. A state that is neither is given as it is in the
simulator, without noise: no user has that. φ: the library in `terms.py`. The derivatives of f with respect to θ are
columns that no threshold touches, so that a wrong parameter is no term. Smoothing and threshold are chosen by left-out
blocks, each simulated from its first state: the best model is taken, or of those within a standard error of it the one
with the fewest terms.
"""

import warnings
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from pgrssnn_jax.physics.base import Physics, extension_of, measured_rate
from pgrssnn_jax.physics.integrate import held
from pgrssnn_jax.records.record import Record

from . import bench, chain, circuit, reactor
from .case import Case
from .nominal import nominal
from .rig import HISTORY, Rig, levels
from .terms import Term, library

SYSTEMS = ("pendulum", "duffing", "servo", "drive", "hysteretic", "tanks", "chain", "circuit", "reactor")
WINDOWS = (9, 15, 25, 41)  # samples of the smoothing
THRESHOLDS = (*np.geomspace(0.03, 0.6, 8), np.inf)  # of a term's RMS in that of the residual; the last: no term
_BLOCKS, _FOLDS = 20, 5  # contiguous blocks, that take turns in being left out
_OWN = 1e-3  # of a term that is no combination of the physics' own: with less it is not told from them
_PLANTS = {"chain": chain.PLANT, "circuit": circuit.PLANT, "reactor": reactor.PLANT}


class Found(NamedTuple):
    """terms: largest first, with coefficients; physics: with them and its own numbers refitted; given: states from the
    simulator; window: samples; threshold: inf for no term."""

    terms: list[tuple[Term, float]]
    physics: Physics
    given: list[str]
    window: int
    threshold: float


class Fit(NamedTuple):
    """theta: over the size of the nominal numbers; share: of each term in the RMS of the residual."""

    threshold: float
    coefficients: np.ndarray
    theta: np.ndarray
    share: np.ndarray


class Data(NamedTuple):
    """z `[signal, time]`, slope `[state, time]` at the samples; inside: where smoothing has both its sides."""

    z: np.ndarray
    slope: np.ndarray
    inside: np.ndarray


def regressed(case: Case, allowed: float = 1.0) -> Found:
    """allowed: standard errors by which a sparser model may be worse than the best.

    Raises `ImportError` without pysindy (`pip install -e '.[compare]'`)."""
    physics = nominal(case)
    with jax.enable_x64(True), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a threshold that leaves nothing
        smoothed = {window: measured(physics, case, window) for window in WINDOWS}
        ahead = Ahead(physics, library(physics, smoothed[WINDOWS[1]].z))
        tried = {window: Regression(ahead, case.train, data) for window, data in smoothed.items()}
        models = [(w, fit) for w, one in tried.items() for fit in one.fits()]
        errors = np.concatenate([one.left_out() for one in tried.values()])
    best, count = errors[np.argmin(errors.mean(1))], [np.count_nonzero(fit.coefficients) for _, fit in models]
    worse = errors - best
    near = np.flatnonzero(worse.mean(1) <= allowed * worse.std(1) / _BLOCKS**0.5)
    window, fit = models[min(near, key=lambda k: (count[k], errors[k].mean()))]
    order = [int(j) for j in np.argsort(-fit.share) if fit.share[j] > 0]
    terms = [(ahead.terms[j], float(fit.coefficients[j])) for j in order]
    return Found(terms, corrected(physics, terms, fit.theta), unmeasured(physics), window, fit.threshold)


def corrected(physics: Physics, terms: list[tuple[Term, float]], theta: np.ndarray) -> Physics:
    """theta: its numbers over the size of the nominal ones."""
    ahead = Ahead(physics, [term for term, _ in terms])
    step = ahead.step([c for _, c in terms])
    return physics._replace(params=ahead.params(theta), step=step, extension=None, origin=None)


def unmeasured(physics: Physics) -> list[str]:
    """States that are neither an output nor the rate of one."""
    read = _readings(physics)
    return [s.name for i, s in enumerate(physics.states) if i not in read and measured_rate(physics, s) is None]


def _readings(physics: Physics) -> dict[int, int]:
    """Which output reads a state."""
    n, m = len(physics.states), len(physics.inputs)
    slope = jax.jacobian(lambda x: physics.measure(physics.params, x, jnp.ones(m)))(jnp.ones(n))
    return {int(np.argmax(row)): j for j, row in enumerate(np.asarray(slope))}


def measured(physics: Physics, case: Case, window: int) -> Data:
    import pysindy  # an optional extra

    y, u = case.train.y[0].T, case.train.u[0].T
    time, read = physics.dt * np.arange(y.shape[1]), _readings(physics)
    smooth = pysindy.SmoothedFiniteDifference(smoother_kws={"window_length": window, "polyorder": 3})

    def rate(signal: np.ndarray) -> np.ndarray:
        return np.asarray(smooth(signal[:, None], time))[:, 0]

    outputs = {output.name: y[j] for j, output in enumerate(physics.outputs)}
    x = [np.empty(0)] * len(physics.states)
    for i, state in enumerate(physics.states):
        of = measured_rate(physics, state)
        if i in read:
            x[i] = savgol_filter(y[read[i]], window, 3)
        else:
            x[i] = _simulated(case)[i] if of is None else rate(outputs[of])
    held_until = np.append(u[:, 1:], u[:, -1:], axis=1)  # y_t is read between the spans of u_t and u_t+1
    inside = np.zeros(y.shape[1], bool)
    inside[window : -window - 1] = True
    return Data(np.stack([*x, *((u + held_until) / 2)]), np.stack([rate(one) for one in x]), inside)


def _simulated(case: Case) -> np.ndarray:
    """States `[state, time]` of the estimation record without noise. What a delayed actuator still had to run before
    the record began is not known, and taken as its first input."""
    sizes = {k: v for k, v in case.magnitudes.items() if k not in ("parameters", "start")}
    numbers, starts = case.magnitudes["parameters"] | sizes, case.magnitudes["start"]
    u = np.pad(case.train.u[0, :, 0], (HISTORY, 0), mode="edge")
    if case.system == "tanks":
        return np.stack(levels(Rig(**numbers), u, starts[0]))
    still = np.zeros((2, case.train.u.shape[1]))
    return bench.simulate(_PLANTS[case.system], numbers, np.stack([u, u]), np.array(starts).T, still)[0].T


class Ahead:
    """The physics with terms, simulated. theta: its numbers over the size of the nominal ones."""

    def __init__(self, physics: Physics, terms: list[Term]) -> None:
        self.physics, self.terms, self.points = physics, terms, extension_of(physics).points
        self.size = {name: abs(float(value)) for name, value in physics.params.items()}
        self.blocks = jax.jit(jax.vmap(jax.vmap(self._run, (None, None, 0, 0)), (0, 0, None, None)))

    def params(self, theta: Any) -> dict[str, Any]:
        return {name: share * size for (name, size), share in zip(self.size.items(), theta, strict=True)}

    def step(self, coefficients: Any) -> Any:
        def derivative(params: Any, x: Any, u: Any) -> Any:
            slope, z = self.points.derivative(params, x, u), jnp.concatenate([x, u])
            for c, term in zip(coefficients, self.terms, strict=True):
                slope = slope.at[term.equation].add(c * term.value(z))
            return slope

        return held(self.points._replace(derivative=derivative))

    def _run(self, coefficients: Any, theta: Any, x: Any, u: Any) -> Any:
        """Outputs `[time, y]` of a free run from x."""
        params, step = self.params(theta), self.step(coefficients)

        def body(x: Any, u_t: Any) -> tuple[Any, Any]:
            x = step(params, x, u_t)
            return x, self.physics.measure(params, x, u_t)

        return jax.lax.scan(body, x, u)[1]


class Regression:
    """One smoothing of one record: the residuals of all equations under each other, each over its deviation, with the
    columns of the physics' own numbers and of the terms. theta: refitted, over the size of the nominal numbers;
    slopes, known: measured, and those of the physics, `[equation, time]`."""

    def __init__(self, ahead: Ahead, record: Record, data: Data) -> None:
        self.ahead, self.record, self.z, physics = ahead, record, data.z, ahead.physics
        n, inside = len(physics.states), data.inside
        equations = sorted({term.equation for term in ahead.terms})
        derivative = jax.vmap(ahead.points.derivative, (None, 1, 1), 1)

        @jax.jit
        def field(theta: Any) -> Any:
            return derivative(ahead.params(theta), data.z[:n], data.z[n:])[np.array(equations)]

        slopes = data.slope[equations]
        deviation = slopes[:, inside].std(axis=1, keepdims=True)

        def misfit(theta: np.ndarray) -> np.ndarray:
            return np.ravel(((slopes - field(theta)) / deviation)[:, inside])

        limits = np.array([np.array(physics.parameters[name].bounds) / size for name, size in ahead.size.items()]).T
        start = np.sign([float(value) for value in physics.params.values()])
        self.theta = least_squares(misfit, start, bounds=tuple(limits)).x
        self.slopes, self.known = slopes, np.asarray(field(self.theta))
        left = self.slopes - self.known
        scale = left[:, inside].std(axis=1, keepdims=True)
        self.residual = (left / scale)[:, inside].ravel()
        self.own = (np.asarray(jax.jacfwd(field)(self.theta)) / scale[..., None])[:, inside].reshape(-1, len(limits.T))
        library = np.zeros((len(ahead.terms), *left.shape))
        for term, column in zip(ahead.terms, library, strict=True):
            i = equations.index(term.equation)
            column[i] = term.value(data.z) / scale[i]
        self.library = library[:, :, inside].reshape(len(library), -1).T
        block = np.arange(len(inside)) * _BLOCKS // len(inside)
        self.fold = np.tile(block[inside] % _FOLDS, len(equations))
        self.begins, self.length = np.searchsorted(block, np.arange(_BLOCKS)), int(np.bincount(block).min())

    def fits(self, rows: Any = slice(None)) -> list[Fit]:
        """By these rows, one for each threshold."""
        import pysindy

        data = np.column_stack([self.own, self.library, self.residual])[rows]
        data, p = np.linalg.qr(data, mode="r"), self.own.shape[1]  # as good for least squares, and short
        own, library, target = data[:, :p], data[:, p:-1], data[:, -1]
        basis = np.linalg.qr(own)[0]
        alone, rest = library - basis @ (basis.T @ library), target - basis @ (basis.T @ target)
        size = np.linalg.norm(alone, axis=0)
        usable, share = size > _OWN * np.linalg.norm(library, axis=0), size / np.linalg.norm(rest)
        found = []
        for threshold in THRESHOLDS:
            coefficients = np.zeros(library.shape[1])
            if np.isfinite(threshold):
                model = pysindy.STLSQ(threshold=threshold).fit(alone[:, usable] / share[usable], rest[:, None])
                coefficients[usable] = np.ravel(model.coef_) / share[usable]
            shift = np.linalg.lstsq(own, target - library @ coefficients, rcond=None)[0]
            found.append(Fit(threshold, coefficients, self.theta + shift, np.abs(coefficients) * share))
        return found

    def left_out(self) -> np.ndarray:
        """Mean square error `[threshold, block]` of each block, simulated by the models of the other folds, over the
        output's variance."""
        errors, u, y = np.empty((len(THRESHOLDS), _BLOCKS)), self.record.u[0], self.record.y[0]
        for fold in range(_FOLDS):
            fits, begins = self.fits(self.fold != fold), self.begins[fold::_FOLDS]
            u_ahead, y_ahead = (np.stack([a[b + 1 : b + self.length] for b in begins]) for a in (u, y))
            coefficients, theta = np.stack([fit.coefficients for fit in fits]), np.stack([fit.theta for fit in fits])
            found = np.asarray(self.ahead.blocks(coefficients, theta, self.z[: -u.shape[1], begins].T, u_ahead))
            errors[:, fold::_FOLDS] = np.mean(((y_ahead - found) / y.std(axis=0)) ** 2, axis=(2, 3))
        return np.nan_to_num(errors, nan=1e6, posinf=1e6)
