"""Hydra's basic sweeper for runs that are named by content: finished ones are skipped, failures stop nothing.

Hydra takes sweepers from the namespace package `hydra_plugins` only, and imports it at every start: the work is done by
`pgrssnn_jax.cli.sweep_jobs`.
"""

from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser


class ResumableSweeper(BasicSweeper):
    def sweep(self, arguments: list[str]) -> Any:
        from pgrssnn_jax.cli.sweep_jobs import run_sweep

        assert self.hydra_context is not None
        parser = OverridesParser.create(config_loader=self.hydra_context.config_loader)
        parsed = parser.parse_overrides([*self._parse_config(), *arguments])
        (combinations,) = self.split_arguments(parsed, None)
        return run_sweep(self, parsed, combinations)
