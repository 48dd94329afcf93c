"""How much smaller the errors of a fitted physics are on its estimation record than on another one.

    optimism = sqrt(Σ_q Σ_{t in q} e_t(θ_q)² / Σ_t e_t(θ)²)        θ_q: fitted without quarter q

Quarters are contiguous, so that nothing around a sample holds the model in place; with four sequences or more, each
quarter consists of whole sequences. All runs begin at the initial state of the fit to the whole record. Where no effect
is missing, the ratio is that of Akaike's final prediction error; where the model is only near to the truth it is
larger. On the measured tanks it is 1.73 (with 2, 3, 5, 8 parts 1.79, 1.74, 1.66, 1.69); Akaike's is 1.15, and the error
of the test record is 1.95 times that of the fit.
"""

import numpy as np
from jaxtyping import Int

from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate, fit_all
from pgrssnn_jax.discovery.problem import HELD, Problem, Signals

_PARTS = 4


def optimism(problem: Problem, signals: Signals, guess: Guess, settings: Settings) -> float | None:
    """guess: at the optimum of the whole record. At least 1; None where a fit without a quarter leaves the range of
    floating-point numbers, or where nothing is left to compare with."""
    whole = evaluate(problem, signals, guess).cost
    held = signals._replace(start=guess.x0, precision=np.full_like(signals.precision, HELD))
    part, left = _parts(signals), 0.0
    for q in range(_PARTS):
        inside = (part == q)[..., None]
        rest, own = (held._replace(weight=np.where(chosen, signals.weight, 0.0)) for chosen in (~inside, inside))
        ((fitted, _),) = fit_all(problem, rest, [guess], settings)
        left += evaluate(problem, own, fitted).cost
    if not (whole > 0 and np.isfinite(left)):
        return None
    return max(1.0, float(np.sqrt(left / whole)))


def _parts(signals: Signals) -> Int[np.ndarray, "seq time"]:
    n_seq, time = signals.u.shape[:2]
    sequence = np.arange(n_seq)[:, None]
    place = sequence if n_seq >= _PARTS else sequence + np.arange(time) / time
    return np.broadcast_to(place / n_seq * _PARTS, (n_seq, time)).astype(int)
