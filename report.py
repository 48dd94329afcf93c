"""Tables, figures and one page of many runs: python report.py runs=FOLDER[,FOLDER2] [out=FOLDER].

Or runs evaluated again and compared with the figures in their folders: python report.py verify=RUN."""

import sys

from pgrssnn_jax.cli import packages

packages.check_packages()

import hydra  # noqa: E402
from omegaconf import DictConfig  # noqa: E402

from pgrssnn_jax.cli import entry  # noqa: E402


@hydra.main(version_base="1.3", config_path="conf", config_name="report")
def main(config: DictConfig) -> None:
    from pgrssnn_jax.cli.report import prepare_report

    entry.run(prepare_report, config)


def as_typed(word: str) -> str:
    """Folders as text: to Hydra an = or a comma in one would mean something else. Lists and quoted text stay."""
    from pgrssnn_jax.cli.resume import override

    key, equals, text = word.partition("=")
    return (
        override(key, text) if key in ("runs", "out", "verify") and equals and text and text[0] not in "\"'[" else word
    )


if __name__ == "__main__":
    sys.argv[1:] = map(as_typed, sys.argv[1:])
    entry.call(main)
