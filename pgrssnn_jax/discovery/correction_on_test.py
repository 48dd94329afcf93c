"""A correction without a name on the test record: like effects, it must predict better there."""

from pgrssnn_jax.discovery.candidates import Candidate
from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.noise import longest_memory
from pgrssnn_jax.discovery.nonparametric import Corrections
from pgrssnn_jax.discovery.problem import carried
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.discovery.validate import validations_on_test


def improvement_by_correction(
    corrections: Corrections, one: Candidate, nominal: Guess, final: Guess, setup: Setup
) -> tuple[float, float]:
    """95 % interval of the fall of the error by a fitted correction, below the better one of the nominal physics and
    the model with the named effects, if any."""
    assert one.model is not None
    problem, fitted = corrections.by(one.name), one.model.estimate
    start = corrections.signals(problem).start

    def there(guess: Guess) -> Guess:
        return Guess(guess.active, *carried(corrections.problem, problem, guess.theta, guess.x0, start))

    guesses, memory = (there(nominal), there(final), fitted.guess), longest_memory(fitted.error)
    return validations_on_test(problem, setup, guesses, {}, corrections.settings, memory).improvement
