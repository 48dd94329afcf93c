"""Find what a physics lacks: python discover.py +experiment=cascaded_tank [discovery.without=[overflow_1to2]]."""

from typing import Any

from pgrssnn_jax.cli import packages

packages.check_packages()

import hydra  # noqa: E402
from omegaconf import DictConfig  # noqa: E402

from pgrssnn_jax.cli import entry  # noqa: E402


@hydra.main(version_base="1.3", config_path="conf", config_name="discover")
def main(config: DictConfig) -> Any:
    from pgrssnn_jax.cli.discover import prepare_discovery

    return entry.run(prepare_discovery, config)


if __name__ == "__main__":
    entry.call(main)
