"""Is a line in the spectrum of the errors more than a resonance of the noise?

    p = n_bins P(χ²_2s ≥ 2 (log L₁ - log L₀))        L₁: with a sinusoid of its period in every of s sequences

A random disturbance excites the modes of the dynamics, and the spectrum of errors with a resonance has a maximum that
looks like a line. The likelihoods are those of that disturbance (`process_noise.py`) or of coloured noise, whichever is
likelier.
"""

import numpy as np
from scipy import stats

from pgrssnn_jax.discovery.estimate import Estimate, Settings
from pgrssnn_jax.discovery.likelihood import Linearisation, noise_of
from pgrssnn_jax.discovery.linearise import linearised
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.process_noise import likelier, models_along, process_noise
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.spectrum import Line, has_lines, spectral_line


def line_beside_noise(
    problem: Problem, signals: Signals, estimate: Estimate, settings: Settings, criteria: Criteria, *, clear: bool
) -> Line | None:
    """The line that the errors of a model have beside their noise, if any. clear: they are clearly above white noise.
    Near it an input with lines of its own has harmonics in a curved or quantised sensor."""
    line = spectral_line(estimate.error, signals.u)
    if line is None or (not clear and has_lines(signals.u)):
        return None
    at, _ = linearised(problem, signals, estimate.guess, settings)
    coloured = noise_of(at)
    more = with_sinusoid(at, line)
    if found := likelier(models_along(problem, signals, estimate.guess), at, coloured):
        tried, disturbed = found
        gain = process_noise(tried.like(disturbed.filter), more).likelihood - disturbed.likelihood
    else:
        gain = noise_of(more).likelihood(at.measured) - coloured.likelihood(at.measured)
    n_seq, time = signals.u.shape[:2]
    return line if time / 2 * stats.chi2.sf(2.0 * max(gain, 0.0), 2 * n_seq) <= criteria.p_value else None


def with_sinusoid(at: Linearisation, line: Line) -> Linearisation:
    """With an amplitude and a phase in every sequence."""
    n_seq, time, n_y = at.error.shape
    angle = 2.0 * np.pi * np.arange(time) / line.period
    columns = np.zeros((n_seq, time, n_y, n_seq, 2))
    for i in range(n_seq):
        columns[i, :, line.output, i] = np.stack([np.cos(angle), np.sin(angle)], -1)
    columns = columns.reshape(n_seq, time, n_y, 2 * n_seq) * at.error.std()
    none = np.zeros(2 * n_seq)
    return at._replace(
        columns=np.concatenate([at.columns, columns], -1),
        precision=np.concatenate([at.precision, none]),
        pull=np.concatenate([at.pull, none]),
    )
