"""Made-up run folders of sweeps: only the files that a report of many runs reads, with the errors that a test wants."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

SYSTEMS: dict[str, tuple[str, str, str, int]] = {  # data name: physics' name, output, unit, outputs
    "cascaded_tank": ("tanks", "level_voltage", "V", 1),
    "lgssm": ("lgssm", "y", "", 1),
    "robot_simulated": ("arm", "position", "rad", 6),
    "robot_real": ("arm", "position", "rad", 6),
}
REASON = "failed: a predicted state left the floating-point range"


def write_run(
    folder: Path,
    values: Sequence[float | None],
    *,
    model: str = "pg_rssnn",
    system: str = "cascaded_tank",
    cc: float = 0.9,
    seconds: float = 10.0,
    samples: int = 40,
    asked: str = "",
    config: Mapping[str, Any] | None = None,
    **changes: Any,
) -> Path:
    """A finished run whose members have the given test errors, None where one failed; `changes` go to the metrics."""
    name, output, unit, n_y = SYSTEMS[system]
    outputs = [{"name": output if n_y == 1 else f"{output}_{k + 1}", "unit": unit} for k in range(n_y)]
    members = [member(seed, value, n_y, cc) for seed, value in enumerate(values)]
    done = [value for value in values if value is not None]
    t = np.arange(samples)
    y = np.broadcast_to(5 + 2 * np.sin(t / 25)[None, :, None], (1, samples, n_y))
    error = np.array([np.nan if value is None else value for value in values])[:, None, None, None]
    y_hat = y + error * np.cos(t / 17 + len(model))[None, None, :, None]
    mean = np.mean([one for one, value in zip(y_hat, values, strict=True) if value is not None] or [y * np.nan], 0)
    metrics = {
        "schema": 1,
        "system": name,
        "model": model,
        "data": system,
        "source": "file",
        "origin": "made up",
        "n_init": 0,
        "dt": 4.0,
        "outputs": outputs,
        "members": members,
        "summary": {
            "planned": len(values),
            "finished": len(done),
            "failed": len(values) - len(done),
            "rmse_ensemble": float(np.mean(done)) * 0.9 if done else None,
        },
        "seconds": {"train": seconds - 1, "total": seconds},
        **changes,
    }
    begin_run(folder, model=model, system=system, n_seeds=len(values), asked=asked, config=config)
    (folder / "metrics.json").write_text(json.dumps(metrics), encoding="utf-8")
    arrays = {"y": y, "mask": np.ones(y.shape, bool), "y_hat": y_hat, "ensemble_mean": mean, "ensemble_std": 0 * mean}
    np.savez(folder / "predictions.npz", **arrays)
    (folder / "DONE").touch()
    return folder


def begin_run(
    folder: Path,
    *,
    model: str = "pg_rssnn",
    system: str = "cascaded_tank",
    n_seeds: int = 10,
    asked: str = "",
    config: Mapping[str, Any] | None = None,
) -> Path:
    """A run that has begun and not finished."""
    folder.mkdir(parents=True)
    lines = [f"n_seeds: {n_seeds}", "model:", f"  name: {model}", f"  networks: {str(model != 'physics_only').lower()}"]
    lines += ["data:", f"  name: {system}", *(f"  {key}: {value}" for key, value in (config or {}).items())]
    (folder / "config.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    command = f"python train.py {folder.name.replace(',', ' ')} {asked}".strip()
    (folder / "environment.json").write_text(json.dumps({"commit": "0123abcd", "command": command}), encoding="utf-8")
    return folder


def fail_run(folder: Path, reason: str = "data.n_train: expected at most 768, found 9999") -> Path:
    """A job of a sweep that could not begin."""
    folder.mkdir(parents=True)
    (folder / "FAILED").write_text(f"{reason}\n", encoding="utf-8")
    return folder


def member(seed: int, value: float | None, n_y: int, cc: float) -> dict[str, Any]:
    fields = {"seed": seed, "dataset": 0, "best_epoch": 40, "epochs": 60}
    if value is None:
        return {**fields, "status": "failed", "reason": REASON, "test": None}
    # The outputs differ, their mean does not.
    each = [value * (1 + 0.5 * (k - (n_y - 1) / 2) / n_y) for k in range(n_y)]
    test = {"rmse": each, "nrmse": each, "fit_percent": [10.0] * n_y, "cc": [cc] * n_y}
    return {**fields, "status": "ok", "reason": "trained to the last epoch", "test": test}


def spread_over(mean: float, std: float, count: int, failed: Sequence[int] = ()) -> list[float | None]:
    """Errors with exactly this mean and standard deviation (n - 1), over the members that did not fail."""
    left = count - len(failed)
    steps = np.arange(left) - (left - 1) / 2
    scaled = iter((mean + std * steps / steps.std(ddof=1)).tolist())
    return [None if k in failed else next(scaled) for k in range(count)]
