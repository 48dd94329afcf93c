"""The programs of a look at the catalogue, compiled before they are needed (`acceleration/background.py`)."""

import jax

from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate, fit_all
from pgrssnn_jax.discovery.null import what_is_added
from pgrssnn_jax.discovery.problem import Problem, Signals


def compile_look(problem: Problem, signals: Signals, settings: Settings) -> None:
    """The programs of one look at a catalogue (`look.look_at`), by fits that take no step."""
    with jax.enable_x64(True):  # holds for one thread
        guess = Guess((), problem.theta, signals.start)
        fit_all(problem, signals, [guess] * settings.lanes, settings, steps=0)
        what_is_added(problem, signals, evaluate(problem, signals, guess), [guess], settings)
