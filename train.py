"""Train a model: python train.py +experiment=cascaded_tank [model=rssnn] [fit.epochs=200] [-m ...]."""

from typing import Any

from pgrssnn_jax.cli import packages

packages.check_packages()

import hydra  # noqa: E402
from omegaconf import DictConfig  # noqa: E402

from pgrssnn_jax.cli import entry  # noqa: E402


@hydra.main(version_base="1.3", config_path="conf", config_name="train")
def main(config: DictConfig) -> Any:
    from pgrssnn_jax.cli.train import prepare_training

    return entry.run(prepare_training, config)


if __name__ == "__main__":
    entry.call(main)
