"""Discoveries made up for tests of figures and pages: tanks, an arm, and some in which much is missing."""

from typing import Any

import numpy as np

STAGES = ("before", "recalibrated", "after")


def tank_discovery(samples: int = 400, **changes: Any) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Like two tanks whose upper one spills into the lower: a patch of error at high levels and pump voltages."""
    rng = np.random.default_rng(5)
    train, test = (_tank_record(rng, samples) for _ in range(2))
    arrays = {
        f"{name}_{part}": signal
        for part, record in (("train", train), ("test", test))
        for name, signal in record.items()
    }
    lack = 0.018 * np.maximum(train["x_after"][..., 0] - 7.5, 0)
    correction = np.stack([-lack + 0.003 * rng.normal(size=lack.shape), np.full(lack.shape, np.nan)])
    x_edges, u_edges = np.linspace(0, 11, 17), np.linspace(0, 9, 13)
    x, u = np.meshgrid((x_edges[:-1] + x_edges[1:]) / 2, (u_edges[:-1] + u_edges[1:]) / 2, indexing="ij")
    count = np.round(60 * np.exp(-(((x - 5 - 0.5 * (u - 4)) / 3.0) ** 2) - ((u - 4.5) / 2.6) ** 2))
    error = 0.006 / np.sqrt(np.maximum(count, 1))
    arrays |= {
        "correction": correction,
        "correction_std": np.stack([np.full(lack.shape, 0.004), np.full(lack.shape, np.nan)]),
        "map_x_edges": x_edges,
        "map_u_edges": u_edges,
        "map_mean": -0.018 * np.maximum(x - 7.5, 0) + error * rng.normal(size=x.shape),
        "map_std_error": error,
        "map_count": count,
        "map_equation": np.array("upper_level"),
        "map_a": np.array("upper_level"),
        "map_b": np.array("pump_voltage"),
        "null_law": np.abs(0.02 * rng.normal(size=200)),
    }
    high = train["x_after"][0, :, 0] > 7.5
    edges = np.flatnonzero(np.diff(np.r_[0, high, 0]))
    spans = [[4.0 * a, 4.0 * b] for a, b in edges.reshape(-1, 2).tolist()]
    error = {s: {p: _rmse(arrays, s, p) for p in ("train", "test")} for s in STAGES}
    overflow = {
        "name": "overflow_1to2",
        "title": "the upper tank spills over, a share lands in the lower one",
        "equation": "dx1/dt −= q,  dx2/dt += s·q,  q = k·max(x1 − h, 0)",
        "cause": "more water is pumped in than the outlet lets through, and the rim is reached",
        "acts_on": "dynamics",
        "channels": "",
        "parameters": {
            "level": {"value": 7.493, "std": 0.041, "unit": "V", "symbol": "h"},
            "rate": {"value": 0.01802, "std": 0.0006, "unit": "1/s", "symbol": "k"},
            "share": {"value": 0.71, "std": None, "unit": "", "symbol": "s"},
        },
        "region": "upper_level above 7.49 V",
        "active_fraction": 0.231,
        "intervals_s": spans,
        "p_value": 0.00498,
        "gain_train": 0.953,
        "gain_test": 0.914,
        "runner_up": {"name": "overflow_lost", "gain": 0.402},
        "command": "python discover.py data=cascaded_tank 'discovery.effects=[overflow_1to2]'",
    }
    names = ["overflow_1to2", "overflow_lost", "tank2_overflow", "pump_saturation", "sensor_gain", "leak_tank1"]
    names += ["input_delay", "bypass", "outlet_exponent", "sensor_offset", "input_dead_zone", "input_offset"]
    gains = [0.93, 0.402, 0.22, 0.18, 0.06, 0.031, 0.02, 0.011, 0.004, -0.003, -0.02, -0.051]
    found = {
        "schema": 1,
        "system": "tanks",
        "data": {"source": "file", "origin": "dataBenchmark.csv", "n_train": samples, "n_test": samples, "dt": 4.0},
        "verdict": "effect_found",
        "sentence": "The upper tank spills over above 7.49 V and 71 % of the water lands in the lower tank;"
        " with it the error on test data falls from 0.52 V to 0.05 V.",
        "effects": [overflow],
        "alternatives": [],
        "untestable": [{"name": "pump_dead_zone", "reason": "the pump never runs below 0.8 V"}],
        "formula": None,
        "spectrum": None,
        "disagreement": [
            {
                "equation": "upper_level",
                "region": {"upper_level": [7.5, None], "pump_voltage": [3.0, 9.0]},
                "rule": "upper_level > 7.5 and pump_voltage > 3",
                "share_of_error": 0.82,
                "share_of_samples": 0.231,
                "intervals_s": spans,
            },
        ],
        "recalibration": {
            "k1": {"before": 0.0464, "after": 0.0551, "std": 0.0008, "unit": "sqrt(V)/s"},
            "k2": {"before": 0.0003, "after": 0.00041, "std": 0.0001, "unit": "1/s"},
            "k3": {"before": 0.0412, "after": 0.0395, "std": 0.0003, "unit": "1/s"},
            "k4": {"before": 0.0586, "after": 0.0569, "std": 0.0011, "unit": "sqrt(V)/s"},
            "k5": {"before": 0.0, "after": 0.0009, "std": 0.0004, "unit": "1/s"},
        },
        "parameters": {
            "k1": {"value": 0.0467, "std": 0.0004, "unit": "sqrt(V)/s"},
            "k2": {"value": 0.00031, "std": 0.00006, "unit": "1/s"},
            "k3": {"value": 0.0411, "std": 0.0002, "unit": "1/s"},
            "k4": {"value": 0.0589, "std": 0.0005, "unit": "sqrt(V)/s"},
            "k5": {"value": 0.0002, "std": 0.0004, "unit": "1/s"},
        },
        "gap": {
            "metric": "RMSE",
            "unit": "V",
            **error,
            "test_interval": {s: [0.8 * error[s]["test"], 1.25 * error[s]["test"]] for s in STAGES},
            "floor": 0.0301,
            "closed_fraction": 0.914,
        },
        "ranking": [
            {"name": n, "gain": g, "p_value": 0.00498 if k < 4 else 0.3, "chosen": k == 0}
            for k, (n, g) in enumerate(zip(names, gains, strict=True))
        ],
        "network": {"share_before": 0.212, "share_after": 0.018, "rmse_before": 0.21, "rmse_after": 0.047, "unit": "V"},
        "null": {"threshold": 0.051, "draws": 200},
        "seconds": {"load": 0.4, "locate": 3.2, "search": 41.7, "prove": 17.5, "total": 62.8},
        "inputs": [{"name": "pump_voltage", "unit": "V"}],
        "outputs": [{"name": "level_voltage", "unit": "V"}],
        "states": [{"name": "upper_level", "unit": "V"}, {"name": "lower_level", "unit": "V"}],
    }
    return {**found, **changes}, arrays


def _tank_record(rng: np.random.Generator, samples: int) -> dict[str, np.ndarray]:
    t = np.arange(samples)
    a, b = rng.uniform(0, 6, size=2)
    u = 4.5 + 1.8 * np.sin(2 * np.pi * t / 160 + a) + 1.6 * np.sin(2 * np.pi * t / 67 + b)
    x = 5.2 + 2.7 * np.sin(2 * np.pi * t / 160 + a - 0.7) + 1.4 * np.sin(2 * np.pi * t / 67 + b - 0.6)
    y = np.convolve(np.r_[np.full(20, x[0]), x], np.full(21, 1 / 21), "valid")
    spill = np.convolve(np.r_[np.zeros(20), np.maximum(x - 7.5, 0)], np.full(21, 1 / 21), "valid")
    noise = 0.03 * rng.normal(size=samples)
    drift = 0.25 * np.sin(2 * np.pi * t / 310)
    simulated = {
        "before": y - 0.9 * spill + drift,
        "recalibrated": y - 0.6 * spill + 0.3 * drift,
        "after": y + 0.1 * drift,
    }
    record = {f"y_{stage}": value[None, :, None] for stage, value in simulated.items()}
    record |= {"y": (y + noise)[None, :, None], "u": u[None, :, None], "mask": np.ones((1, samples, 1), bool)}
    return {**record, "time": 4.0 * t, "x_after": np.stack([x, y], -1)[None]}


def _rmse(arrays: dict[str, np.ndarray], stage: str, part: str) -> float:
    return float(np.sqrt(np.nanmean((arrays[f"y_{part}"] - arrays[f"y_{stage}_{part}"]) ** 2)))


def arm_discovery(samples: int = 300, sequences: int = 3) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Like a six-axis arm whose second and third joint rub: corrections of six velocities, none of positions."""
    rng = np.random.default_rng(6)
    arrays: dict[str, np.ndarray] = {}
    for part in ("train", "test"):
        t = 0.1 * np.arange(samples)
        phase = rng.uniform(0, 6, size=(sequences, 1, 6))
        y = np.sin(2 * np.pi * t[None, :, None] / 9 + phase) * np.array([1.2, 0.6, 0.7, 1.5, 1.0, 2.0])
        drift = np.cumsum(rng.normal(size=y.shape), axis=1) * 0.004 * np.array([1, 5, 4, 1, 1, 0.6])
        arrays |= {
            f"y_{part}": y + 0.001 * rng.normal(size=y.shape),
            f"time_{part}": t,
            f"mask_{part}": np.ones(y.shape, bool),
        }
        for stage, share in zip(STAGES, (1.0, 0.7, 0.08), strict=True):
            arrays[f"y_{stage}_{part}"] = y + share * drift
        arrays[f"u_{part}"], arrays[f"x_after_{part}"] = np.gradient(y, axis=1), np.concatenate([y, y], -1)
    velocity = np.gradient(arrays["y_train"], 0.1, axis=1)
    friction = -1.4 * np.sign(velocity) * np.array([0.1, 1, 0.8, 0.1, 0.1, 0.1])
    lack = np.moveaxis(friction + 0.15 * rng.normal(size=friction.shape), -1, 0)
    nothing = np.full(lack.shape, np.nan)
    x_edges, u_edges = np.linspace(-0.5, 0.5, 15), np.linspace(-900, 900, 11)
    x = np.broadcast_to(((x_edges[:-1] + x_edges[1:]) / 2)[:, None], (14, 10))
    count = rng.integers(0, 40, size=(14, 10))
    arrays |= {
        "correction": np.concatenate([nothing, lack]),
        "correction_std": np.concatenate([nothing, np.full(lack.shape, 0.25)]),
        "map_x_edges": x_edges,
        "map_u_edges": u_edges,
        "map_mean": np.where(count > 3, -1.4 * np.sign(x) + 0.2 * rng.normal(size=x.shape), np.nan),
        "map_std_error": 0.3 / np.sqrt(np.maximum(count, 1)),
        "map_count": count,
        "map_equation": np.array("velocity_2"),
        "map_a": np.array("velocity_2"),
        "map_b": np.array("torque_2"),
        "null_law": np.abs(0.01 * rng.normal(size=100)),
    }
    joints = [2, 3]
    friction_found = {
        "name": "coulomb_friction",
        "title": "dry friction in the joints",
        "equation": "τ ← τ − c·sign(q̇)",
        "cause": "gears and seals rub with a force that does not depend on speed",
        "acts_on": "dynamics",
        "channels": "joint",
        "joints": joints,
        "parameters": {"c": {"value": [812.4, 655.1], "std": [14.2, 19.9], "unit": "Nm", "symbol": "c"}},
        "region": "wherever joint 2 or 3 moves",
        "active_fraction": 0.97,
        "intervals_s": [],
        "p_value": 0.0099,
        "gain_train": 0.89,
        "gain_test": 0.871,
        "runner_up": {"name": "viscous_friction", "gain": 0.61},
        "command": "python discover.py data=robot_real",
    }
    error = {s: {p: _rmse(arrays, s, p) for p in ("train", "test")} for s in STAGES}
    numbers = [f"{what}_{j}" for what in ("mass", "com_x", "com_z", "inertia", "ratio") for j in range(1, 7)]
    shift = dict(zip(numbers, rng.normal(size=30) * 0.1, strict=True))
    found = {
        "schema": 1,
        "system": "arm",
        "data": {"source": "simulated", "origin": "KUKA KR300, dry friction", "n_train": 900, "n_test": 900, "dt": 0.1},
        "verdict": "effect_found",
        "sentence": "Joints 2 and 3 rub: dry friction of 812 Nm and 655 Nm closes 87 % of the gap on test data.",
        "effects": [friction_found],
        "disagreement": [
            {
                "equation": f"velocity_{j}",
                "region": {},
                "rule": f"velocity_{j} > 0",
                "share_of_error": share,
                "share_of_samples": 0.5,
                "intervals_s": [[3.0, 6.5], [12.0, 15.5]],
            }
            for j, share in ((3, 0.3), (2, 0.55))
        ],
        "recalibration": {n: {"before": 1.0, "after": 1 + s, "std": 0.02, "unit": "kg"} for n, s in shift.items()},
        "parameters": {n: {"value": 1 + 0.2 * s, "std": 0.01, "unit": "kg"} for n, s in shift.items()},
        "gap": {"metric": "RMSE", "unit": "rad", **error, "test_interval": None, "closed_fraction": 0.871},
        "ranking": [
            {"name": "coulomb_friction joints 2, 3", "gain": 0.88, "p_value": 0.0099, "chosen": True},
            {"name": "viscous_friction joints 2, 3", "gain": 0.61, "p_value": 0.0099, "chosen": False},
            {"name": "payload", "gain": 0.02, "p_value": None, "chosen": False},
        ],
        "null": {"threshold": 0.024, "draws": 100},
        "seconds": {"total": 512.0},
        "outputs": [{"name": f"position_{j}", "unit": "rad"} for j in range(1, 7)],
        "states": [
            {"name": f"{name}_{j}", "unit": unit}
            for name, unit in (("position", "rad"), ("velocity", "rad/s"))
            for j in range(1, 7)
        ],
    }
    return found, arrays


def bare_discovery() -> dict[str, Any]:
    """A discovery that found nothing and lists nothing: every figure null, every list empty."""
    found, _ = tank_discovery(samples=30)
    nothing = {name: [] for name in ("effects", "alternatives", "untestable", "disagreement", "ranking")}
    nothing |= {"recalibration": {}, "parameters": {}, "network": None, "seconds": {}, "null": {"threshold": None}}
    blank = {"train": None, "test": None}
    gap = {"metric": "RMSE", "unit": "V", **dict.fromkeys(STAGES, blank), "floor": None, "closed_fraction": None}
    return {**found, **nothing, "gap": gap, "verdict": "no_discrepancy", "sentence": "Nothing is missing."}


def only_signals(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: a for name, a in arrays.items() if name.endswith(("_train", "_test"))}


def without_values(name: str, array: np.ndarray) -> np.ndarray:
    """All NaN, but for what the axes need and what is no number."""
    axis = name.startswith("time") or name.endswith(("_edges", "_count"))
    return array if axis or array.dtype.kind != "f" else np.full(array.shape, np.nan)


TANK, ARM = tank_discovery(samples=120), arm_discovery(samples=40, sequences=2)
SAD = {
    "nothing found, signals only": (bare_discovery(), only_signals(TANK[1])),
    "no arrays at all": (bare_discovery(), {}),
    "one sample": tank_discovery(samples=1),
    "every value NaN": (TANK[0], {n: without_values(n, a) for n, a in TANK[1].items()}),
    "null law and threshold missing": (TANK[0] | {"null": None}, {n: a for n, a in TANK[1].items() if n != "null_law"}),
    "nothing measured": (TANK[0], TANK[1] | {f"mask_{p}": np.zeros((1, 120, 1), bool) for p in ("train", "test")}),
    "a simulation that overflows": (TANK[0], TANK[1] | {"y_before_test": np.full((1, 120, 1), np.inf)}),
}
