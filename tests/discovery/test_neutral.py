"""Effects of the user's own that act at their neutral numbers too are refused, and only those."""

import jax.numpy as jnp
import numpy as np
import pytest

from pgrssnn_jax.discovery.neutral import check_neutral
from pgrssnn_jax.effects import catalogue
from pgrssnn_jax.effects.base import Effect, after_step, on_input, on_output
from pgrssnn_jax.effects.memory import with_memory
from pgrssnn_jax.physics.base import Parameter, Signal
from pgrssnn_jax.physics.tanks import cascaded_tanks

DRAW = np.random.default_rng(0)
X, INPUTS = DRAW.uniform(1.0, 8.0, (50, 2)), DRAW.uniform(1.0, 4.0, (50, 1))
LEVEL = {"level": Parameter("a", "V", bounds=(0.0, 5.0), neutral=0.0)}


def own(wrap, meanings=LEVEL) -> Effect:
    return Effect("own", meanings, wrap)


def remembering(initial: float) -> Effect:
    """The pump gets the mean of this and the last input, `level` of it."""

    def advance(n, memory, u):
        return u + n["level"] * (memory - u) + initial * memory, u

    memory = (Signal("last_input", "V", memory_of="pump_voltage"),)
    return own(lambda physics: with_memory(physics, "own", memory, advance))


SPEAKING = {
    "an input moved by more than its number": (
        own(lambda physics: on_input(physics, "own", lambda n, u: u + n["level"] + 0.5)),
        "state 'upper_level' changed by up to 0.08",
    ),
    "an output of half its size": (
        own(lambda physics: on_output(physics, "own", lambda n, y: 0.5 * y + n["level"])),
        "output 'level_voltage' changed by up to",
    ),
    "a step that ends with NaN": (
        own(lambda physics: after_step(physics, "own", lambda n, own, x, u, new: new + n["level"] / n["level"])),
        "changed by up to inf V",
    ),
    "a drift in one place of the record": (
        own(lambda p: after_step(p, "own", lambda n, own, x, u, new: jnp.where(u[0] >= INPUTS.max(), new - 1e-3, new))),
        "changed by up to 0.001 V",
    ),
    "a memory that acts": (remembering(0.1), "state 'upper_level' changed"),
}


@pytest.mark.parametrize(("effect", "found"), SPEAKING.values(), ids=SPEAKING)
def test_an_effect_that_acts_at_its_neutral_value_is_refused(effect, found):
    with pytest.raises(ValueError, match="^[^\n]*$") as caught:
        check_neutral(cascaded_tanks(), [effect], X, INPUTS)
    assert str(caught.value).startswith(
        "effects: own: expected that it changes nothing at its neutral value, level=0, "
    )
    assert found in str(caught.value)
    assert str(caught.value).endswith(" in a step")


def rounded(n, own, x, u, new):
    """Computed in float32."""
    return (new.astype(jnp.float32) - n["level"].astype(jnp.float32) * jnp.float32(0.1)).astype(new.dtype)


def test_an_effect_that_changes_nothing_is_taken():
    physics = cascaded_tanks()
    silent = [remembering(0.0), own(lambda physics: after_step(physics, "own", rounded))]
    for effect in (*silent, *catalogue(physics)):
        check_neutral(physics, [effect], X, INPUTS)
    check_neutral(physics, [], X, INPUTS)


def test_every_number_is_said_with_its_neutral_value():
    gain = Parameter("k", bounds=(0.1, 10.0), neutral=1.0)
    limit = Parameter("m", "V", bounds=(0.0, np.inf), neutral=np.inf)
    effect = own(
        lambda physics: on_output(physics, "own", lambda n, y: jnp.minimum(n["gain"] * y + 0.1, n["limit"])),
        {"gain": gain, "limit": limit},
    )
    with pytest.raises(ValueError, match=r"neutral value, gain=1, limit=inf, found output 'level_voltage' changed"):
        check_neutral(cascaded_tanks(), [effect], X, INPUTS)
