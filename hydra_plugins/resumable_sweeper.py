"""Hydra's basic sweeper for runs that are named by content: finished ones are skipped, failures stop nothing.

Hydra takes sweepers from the namespace package `hydra_plugins` only, and imports it at every start: the work is done by
`pgrssnn_jax.cli.sweep_jobs`.
"""

from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser


class ResumableSweeper(BasicSweeper):
    def sweep(self, arguments: list[str]) -> Any:
        from pgrssnn_jax.cli.sweep_jobs import Sweep, run_sweep

        assert self.config is not None
        assert self.hydra_context is not None
        assert self.launcher is not None
        parser = OverridesParser.create(config_loader=self.hydra_context.config_loader)
        parsed = parser.parse_overrides([*self._parse_config(), *arguments])
        (combinations,) = self.split_arguments(parsed, None)
        sweep = Sweep(self.config, self.hydra_context, self.launcher, self.max_batch_size)
        return run_sweep(sweep, parsed, combinations)
