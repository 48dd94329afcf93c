"""The published figures, from `published.yaml` beside this file, under the names that the configuration has for things.

A `Variant` is one cell of the paper's tables: a model, the physics it was given, and the samples it was trained on.
"""

from collections.abc import Mapping
from functools import cache
from importlib import resources
from itertools import product
from typing import Any, Literal, NamedTuple

from omegaconf import OmegaConf

PLACE, FILE = "pgrssnn_jax.paper", "published.yaml"


class Variant(NamedTuple):
    """n_train: samples to train on; None: all that the system has."""

    model: str
    physics: str
    n_train: int | None


class Value(NamedTuple):
    """A published mean over `finished` of `runs` runs; mean None: no run finished; best None: not published."""

    mean: float | None
    runs: int
    finished: int
    best: float | None


class Model(NamedTuple):
    title: str
    kind: Literal["guided", "black_box", "baseline", "physics"]


class System(NamedTuple):
    """merit: the figure that its tables hold; runs, physics, n_train: those of the paper's table 1."""

    title: str
    merit: Literal["rmse", "nrmse"]
    unit: str
    runs: int
    physics: str
    n_train: int | None


class Experiment(NamedTuple):
    """A table of the paper: the variants it holds, in order. quoted: figures of others that stand below them."""

    title: str
    system: str
    variants: tuple[Variant, ...]
    quoted: Mapping[str, float]


class Paper(NamedTuple):
    """values and reasons: by system and variant. rounding: the last printed digit, in the unit of the figure."""

    source: str
    rounding: float
    models: dict[str, Model]
    systems: dict[str, System]
    physics: dict[str, str]
    experiments: dict[str, Experiment]
    values: dict[tuple[str, Variant], Value]
    reasons: dict[tuple[str, Variant], str]

    def title(self, model: str) -> str:
        return self.models[model].title if model in self.models else model


@cache
def read_paper() -> Paper:
    found: Any = OmegaConf.to_container(
        OmegaConf.create(resources.files(PLACE).joinpath(FILE).read_text(encoding="utf-8"))
    )
    systems = {name: System(**entry) for name, entry in found["systems"].items()}
    models = {name: Model(**entry) for name, entry in found["models"].items()}

    def place(entry: Mapping[str, Any]) -> tuple[str, Variant]:
        system = systems[entry["system"]]
        physics, n_train = entry.get("physics", system.physics), entry.get("n_train", system.n_train)
        return entry["system"], Variant(entry["model"], physics, n_train)

    def value(system: str, entry: Mapping[str, Any]) -> Value:
        runs = systems[system].runs
        return Value(entry["mean"], runs, entry.get("finished", runs), entry.get("best"))

    def experiment(entry: Mapping[str, Any]) -> Experiment:
        system = systems[entry["system"]]
        axes = (entry.get("n_train") or [system.n_train], entry.get("physics") or [system.physics])
        variants = tuple(
            Variant(model, physics, n_train) for n_train, physics, model in product(*axes, entry["models"] or models)
        )
        return Experiment(
            entry["title"],
            entry["system"],
            variants,
            found["quoted"][entry["system"]] if entry.get("quoted") else {},
        )

    columns = found["table1"]["systems"]
    cells = [
        {"system": system, "model": model, **(cell if isinstance(cell, dict) else {"mean": cell})}
        for model, row in found["table1"]["means"].items()
        for system, cell in zip(columns, row, strict=True)
        if cell is not None
    ]
    reasons = [
        (place({"system": entry["system"], "model": model}), f"{entry['why']} {rest}".rstrip())
        for entry in found["reasons"]
        for model, rest in entry["models"].items()
    ]
    return Paper(
        found["source"],
        found["rounding"],
        models,
        systems,
        found["physics"],
        {name: experiment(entry) for name, entry in found["experiments"].items()},
        {place(entry): value(entry["system"], entry) for entry in [*cells, *found["elsewhere"]]},
        dict(reasons),
    )
