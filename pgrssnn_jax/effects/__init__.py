"""Named physical effects that a model may lack: `catalogue(physics)` lists them, `add_effect` adds one by its name."""

from pgrssnn_jax.effects.base import Effect, Needs, add, after_step, at_point, on_input, on_output
from pgrssnn_jax.effects.memory import with_memory
from pgrssnn_jax.effects.systems import add_effect, catalogue

__all__ = [
    "Effect", "Needs", "add", "add_effect", "after_step", "at_point", "catalogue", "on_input", "on_output",
    "with_memory",
]  # fmt: skip
