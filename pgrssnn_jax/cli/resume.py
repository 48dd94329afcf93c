"""Going on with an interrupted run: its saved configuration rules, and the command line may only agree or prolong."""

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.types import Quote, QuotedString

from pgrssnn_jax.physics.library import library_builder

# how long to train and how members are mapped; everything else makes another run
FLEXIBLE = ("fit.epochs", "fit.checkpoint_seconds", "members.how", "members.sub_batch", "members.devices")


def resume_config(
    asked: Mapping[str, Any], saved: Mapping[str, Any], given: Sequence[str], folder: Path
) -> dict[str, Any]:
    """The saved configuration with those settings of the command line that may change.

    asked: the configuration that the command line composes to, missing values included; given: its overrides, of which
    those of Hydra's own and `resume` do not matter. Raises `ValueError` when they describe another run than the saved
    one.
    """
    names = [name for name in map(key_of, given) if name != "resume" and not name.startswith("hydra.")]
    found = {name: dict(part) if isinstance(part, Mapping) else part for name, part in saved.items()}
    before, now = _flat(saved), _flat(asked)
    for key in sorted(now):
        named = "experiment" in names or any(key == name or key.startswith(f"{name}.") for name in names)
        if not named or key == "resume" or now[key] == before.get(key):
            continue
        if key in FLEXIBLE and key not in names:
            continue  # a default of the experiment, not a wish
        if key not in FLEXIBLE:
            raise ValueError(
                f"resume: {key}: expected {before.get(key)!r} as in {folder.name}/config.yaml, found {now[key]!r}"
            )
        group, name = key.split(".")
        found[group][name] = now[key]
    return {**found, "resume": str(folder)}


def resumed_physics(config: Mapping[str, Any], asked: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The configuration from which the physics of a resumed run is built. The command line, never the folder, names a
    user's own physics, because building it executes code; `physics.json` in the folder holds the effects of the run.

    Raises `ValueError` for an own physics that the command line does not name.
    """
    target = str(config["physics"].get("_target_"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        known = library_builder(target) is not None
    if not known and asked["physics"].get("_target_") != target:
        raise ValueError(
            f"resume: physics._target_: expected the run's own physics on the command line, "
            f"{override('physics._target_', target)}, found {asked['physics'].get('_target_')!r}"
        )
    kept = folder / "physics.json"
    if config["physics"].get("effects") is None or not kept.is_file():
        return dict(config)
    return {**config, "physics": {**config["physics"], "effects": str(kept)}}


def key_of(text: str) -> str:
    """The key of an override."""
    return text.split("=")[0].lstrip("+~")


def override(key: str, text: str) -> str:
    """`key=text` as Hydra reads it back, whatever the text."""
    plain = re.fullmatch(r"(?!\.\d)[A-Za-z/._][A-Za-z0-9/._-]*", text)
    if not plain or text.lower() in ("null", "true", "false", "inf", "nan"):
        text = QuotedString(text, Quote.double).with_quotes()
    return f"{key}={text}"


def first_difference(before: Mapping[str, Any], now: Mapping[str, Any]) -> tuple[str, Any, Any] | None:
    """The first key, in the order of the alphabet, in which two configurations differ, with both values; a key that
    is not there counts as None only beside a value."""
    a, b = _flat(before), _flat(now)
    for key in sorted(a.keys() | b.keys()):
        if key not in a or key not in b or a[key] != b[key]:
            return key, a.get(key), b.get(key)
    return None


def _flat(tree: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(tree, Mapping) or not tree:
        return {prefix.rstrip("."): tree}
    return {key: value for name, part in tree.items() for key, value in _flat(part, f"{prefix}{name}.").items()}
