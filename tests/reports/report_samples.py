"""Made-up runs in the form that the experiments hand over: small or large, with failed members, without any."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from pgrssnn_jax.training import metrics as merits


class Run(NamedTuple):
    metrics: dict[str, Any]
    history: pd.DataFrame
    predictions: dict[str, np.ndarray]


CONFIG = "seed: 0\nmodel:\n  name: pg_rssnn # <script>alert('config')</script>\n"
ENVIRONMENT = {"versions": {"python": "3.12.1", "jax": "0.10.2"}, "device": "cpu", "commit": "0123abcd"}


def tanks(members: int = 10, samples: int = 1024, failed: tuple[int, ...] = (), **changes: Any) -> Run:
    """Like the cascaded tanks: slow, positive levels in volts that saturate at 10 V."""
    rng = np.random.default_rng(1)
    t = np.arange(samples)
    y = 5 + sum(a * np.sin(2 * np.pi * t / p + q) for a, p, q in ((2.6, 300, 0.4), (1.7, 131, 1.0), (0.9, 61, 2.0)))
    y = np.clip(y, 0.2, 10.0)[None, :, None]
    error = 0.2 * np.sin(2 * np.pi * t / 210)[None, None, :, None] * (1 + 0.4 * rng.normal(size=(members, 1, 1, 1)))
    error = error + _drift(rng, (members, 1, samples, 1), 0.006)
    system = {"system": "tanks", "outputs": [{"name": "level_voltage", "unit": "V"}], "dt": 4.0, "source": "file"}
    origin = "dataBenchmark.csv, published benchmark, cascaded tanks (estimation and test record)"
    return _run(rng, y, error, failed, {**system, "origin": origin, **changes})


def lgssm(members: int = 50, samples: int = 5000, failed: tuple[int, ...] = (), **changes: Any) -> Run:
    """Like the linear Gaussian system: a white-noise input, one noise realisation per member."""
    rng = np.random.default_rng(2)
    y = np.convolve(rng.normal(size=samples + 20), 0.8 ** np.arange(20), "same")[:samples][None, :, None]
    error = 0.4 * rng.normal(size=(1, 1, samples, 1)) + 0.1 * rng.normal(size=(members, 1, samples, 1))
    error = error * (1 + 0.3 * rng.normal(size=(members, 1, 1, 1)))
    system = {"system": "lgssm", "outputs": [{"name": "y", "unit": ""}], "dt": 1.0, "source": "simulated"}
    return _run(rng, y, error, failed, {**system, "origin": "lgssm with the published parameters", **changes})


def arm(members: int = 5, samples: int = 605, sequences: int = 6, failed: tuple[int, ...] = (), **changes: Any) -> Run:
    """Like the robot arm: six joint positions in six sequences, the last ones harder."""
    rng = np.random.default_rng(3)
    shape = (sequences, samples, 6)
    y = np.cumsum(_drift(rng, shape, 0.02), axis=1) / 12
    hardness = np.array([0.05, 0.06, 0.05, 0.10, 0.12, 0.25])
    error = _drift(rng, (members, *shape), 0.06) * hardness * (1 + 0.3 * rng.normal(size=(members, 1, 1, 1)))
    outputs = [{"name": f"position_{j}", "unit": "rad"} for j in range(1, 7)]
    system = {"system": "arm", "outputs": outputs, "dt": 0.1, "source": "file", "origin": "KUKA KR300, published"}
    return _run(rng, y, error, failed, {**system, **changes})


def with_skeleton(run: Run) -> Run:
    """The run with the poses of a six-axis arm of 2.7 m that moves as its outputs say."""
    poses = (_skeleton(run.predictions[name]) for name in ("y", "ensemble_mean"))
    return run._replace(
        predictions=run.predictions | dict(zip(("skeleton_measured", "skeleton_predicted"), poses, strict=True))
    )


def _skeleton(y: np.ndarray) -> np.ndarray:
    """Base, six joints, tip `[seq, time, 8, 3]`: swivel, shoulder, elbow and three wrist joints in one place."""
    middle, swing = np.array([0.3, -1.0, 1.1, 0.0, 0.4, 0.0]), np.array([1.3, 0.5, 0.5, 1.0, 0.8, 1.0])
    missing = ~np.isfinite(y).all(-1)
    angles = (middle + swing * np.tanh(np.where(missing[..., None], 0.0, y) / 3)).reshape(-1, 6)
    links = [(0, 0, 0.3), (0.35, 0, 0.375), (1.15, 0, 0), (1.0, 0, 0.04), (0, 0, 0), (0, 0, 0), (0.24, 0, 0.1)]
    turned, points = np.broadcast_to(np.eye(3), (len(angles), 3, 3)), [np.zeros((len(angles), 3))]
    for j, link in enumerate(links):
        points.append(points[-1] + turned @ np.array(link, float))
        if j < 6:
            turned = turned @ Rotation.from_euler("zyyxyx"[j], angles[:, j : j + 1]).as_matrix()
    poses = np.stack(points, 1).reshape(*y.shape[:2], 8, 3)
    return np.where(missing[..., None, None], np.nan, poses).astype(np.float32)


def _drift(rng: np.random.Generator, shape: tuple[int, ...], size: float) -> np.ndarray:
    walk = np.cumsum(rng.normal(size=shape), axis=-2) * size
    return walk - walk.mean(-2, keepdims=True)


def _run(rng: np.random.Generator, y: np.ndarray, error: np.ndarray, failed: tuple[int, ...], changes: Any) -> Run:
    count = len(error)
    y_hat = y[None] + error
    y_hat[list(failed)] = np.nan
    ok = [m for m in range(count) if m not in failed]
    mean = y_hat[ok].mean(0) if ok else np.full(y.shape, np.nan)
    std = y_hat[ok].std(0) if ok else np.full(y.shape, np.nan)
    noisy = y + 0.01 * rng.normal(size=y.shape)
    predictions = {"y": noisy, "mask": np.ones(y.shape, bool), "y_hat": y_hat, "u": y[..., :1]}
    predictions |= {"ensemble_mean": mean, "ensemble_std": std}
    lengths = rng.integers(120, 400, size=count)
    members = [_member(m, m in failed, int(lengths[m]), noisy, y_hat[m]) for m in range(count)]
    metrics = {
        "schema": 1,
        "model": "pg_rssnn",
        "n_init": 0,
        "members": members,
        "summary": {"planned": count, "finished": len(ok), "failed": len(failed), **_summary(members, noisy, mean, 0)},
        "seconds": {"load": 0.41, "compile": 12.7, "train": 184.2, "evaluate": 2.05, "total": 199.4},
        **changes,
    }
    windows = [n for n in (0, 5, 50) if n < y.shape[1]]
    metrics["summary"]["by_n_init"] = {str(n): _summary(members, noisy, mean, n) for n in windows}
    return Run(metrics, _history(rng, members), predictions)


def _member(m: int, failed: bool, epochs: int, y: np.ndarray, y_hat: np.ndarray) -> dict[str, Any]:
    member: dict[str, Any] = {"seed": m, "dataset": 0, "status": "failed" if failed else "ok", "epochs": epochs}
    if failed:
        reason = "failed: a predicted state left the floating-point range"
        return {**member, "reason": reason, "best_epoch": None, "test": None, "validation": None, "by_n_init": {}}
    windows = [n for n in (0, 5, 50) if n < y.shape[1]]
    by = {str(n): merits.all_metrics(measured=y, predicted=y_hat, n_init=n) for n in windows}
    reason = "stopped early: validation no longer improved"
    return {
        **member,
        "reason": reason,
        "best_epoch": 7 * epochs // 50 * 5,
        "test": by["0"],
        "validation": by["0"],
        "by_n_init": by,
    }


def _summary(members: list[dict[str, Any]], y: np.ndarray, mean: np.ndarray, n_init: int) -> dict[str, float | None]:
    done = [member["by_n_init"][str(n_init)] for member in members if member["test"]]
    names = ("rmse_mean", "rmse_std", "rmse_median", "rmse_best", "rmse_ensemble", "nrmse_mean")
    if not done:
        return dict.fromkeys(names)
    rmse = np.array([np.mean(figures["rmse"]) for figures in done])
    ensemble = merits.rmse(measured=y, predicted=mean, n_init=n_init).mean()
    nrmse = np.mean([np.mean(figures["nrmse"]) for figures in done])
    values = (rmse.mean(), rmse.std(), np.median(rmse), rmse.min(), ensemble, nrmse)
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _history(rng: np.random.Generator, members: list[dict[str, Any]]) -> pd.DataFrame:
    tables = []
    for member in members:
        failed = member["status"] == "failed"
        epoch = np.arange(1, (member["epochs"] // 4 if failed else member["epochs"]) + 1)
        floor = rng.uniform(0.006, 0.012)
        wobble = np.exp(0.06 * np.cumsum(rng.normal(size=len(epoch))) / np.sqrt(1 + np.arange(len(epoch)) / 10))
        train = (2.0 * np.exp(-epoch / rng.uniform(15, 35)) + floor) * wobble
        validation = np.where(epoch % 5 == 0, train * rng.uniform(1.2, 1.6) + 1e-5 * epoch, np.nan)
        if failed:
            train[-6:] *= np.geomspace(3, 1e5, 6)[: len(train[-6:])]
        rows = {"epoch": epoch, "seed": member["seed"], "dataset": member["dataset"]}
        tables.append(pd.DataFrame({**rows, "train_loss": train, "validation_loss": validation}))
    return pd.concat(tables, ignore_index=True)
