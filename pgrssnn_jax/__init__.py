"""Physics-guided recurrent state-space neural networks, as pure functions in JAX."""

__version__ = "0.1.0"
