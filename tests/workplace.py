"""What the pages take for granted: files of one's own, a physics, an effect, a robot and its log, and finished runs."""

import re
import shutil
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
from blocks import BLOCK, budget, saved_block
from commands import ROOT, called

import pgrssnn_jax as pg

SAMPLES = 400
_ONCE = tempfile.TemporaryDirectory(prefix="pgrssnn_jax_workplace_")


def furnish(folder: Path, page: Path) -> None:
    """The files, and the runs if the page speaks of any."""
    _files(folder)
    if any(re.search(r"runs/FOLDER|\bRUN\b|runs=runs", text) for _, text in BLOCK.findall(page.read_text())):
        shutil.copytree(_finished_runs(), folder / "runs")


def _files(folder: Path) -> None:
    (folder / "my_physics.py").write_text(saved_block(ROOT / "README.md", "my_physics.py"))
    (folder / "my_effects.py").write_text(saved_block(ROOT / "docs/own_system.md", "my_effects.py"))
    for seed, name in enumerate(("A.csv", "B.csv", "C.csv")):
        _measured(seed).to_csv(folder / name, index=False)
    for name in ("my_arm.urdf", "tx40.urdf"):
        (folder / name).write_text(_robot())
    _log().to_csv(folder / "log.csv", index=False)


def pendulum() -> pg.Physics:
    """The one of the README."""
    said: dict = {}
    exec(compile(saved_block(ROOT / "README.md", "my_physics.py"), "my_physics.py", "exec"), said)
    return said["pendulum"]()


def pendulum_csv(path: Path, physics: pg.Physics, samples: int, seed: int) -> None:
    """A pendulum simulated by its own physics with drag that the model does not know."""
    u, y = _swing(physics, samples, seed)
    columns = {"time": np.arange(samples) * physics.dt, "torque": u[:, 0], "angle": np.ravel(y)}
    pd.DataFrame(columns).to_csv(path, index=False)


def _swing(physics: pg.Physics, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    u = _steps(np.random.default_rng(seed), -3, 3, samples)
    return u, np.asarray(pg.simulate(pg.add(physics, "quadratic_drag", c=0.4), u, np.zeros(2)).y)


def _steps(random: np.random.Generator, low: float, high: float, samples: int = SAMPLES) -> np.ndarray:
    return np.repeat(random.uniform(low, high, (samples // 10, 1)), 10, axis=0)


def _measured(seed: int) -> pd.DataFrame:
    """Channels of the tanks, of the pendulum and of an arm with six joints; every physics ignores the others."""
    random = np.random.default_rng(seed)
    voltage, (torque, angle) = _steps(random, 1, 4), _swing(pendulum(), SAMPLES, seed)
    level = pg.simulate(pg.physics.cascaded_tanks(), voltage, np.array([3.0, 4.0])).y
    own = {"pump_voltage": voltage, "level_voltage": level, "torque": torque, "angle": angle}
    noisy = {name: np.ravel(values) + 0.003 * random.standard_normal(SAMPLES) for name, values in own.items()}
    position, torques = _motion(0.01 * np.arange(SAMPLES))
    return pd.DataFrame({**noisy, **_columns("position", position), **_columns("torque", torques / 100)})


def _motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and torques `[time, joint]` of the robot without its gears, with viscous friction of 3 Nm s."""
    rates = 1.0 + 0.3 * np.arange(1, 7)
    angle = np.outer(time, rates)
    q, v, a = 0.5 * np.sin(angle), 0.5 * rates * np.cos(angle), -0.5 * rates**2 * np.sin(angle)
    model = pin.buildModelFromXML(_robot())
    scratch = model.createData()
    return q, np.array([pin.rnea(model, scratch, *row) for row in zip(q, v, a, strict=True)]) + 3.0 * v


def _columns(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}_{i + 1}": values[:, i] for i in range(values.shape[1])}


def _log() -> pd.DataFrame:
    """In degrees and amperes of the motors, by the numbers of docs/arms.md."""
    time = 0.002 * np.arange(3000)
    q, torque = _motion(time)
    n, constant = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0]), [0.31, 0.31, 0.22, 0.19, 0.19, 0.15]
    n[5, 4] = 32.0
    noise = 1e-4 * np.random.default_rng(0).standard_normal(q.shape)  # rad
    motors = {
        **_columns("motor", np.rad2deg((q + noise) @ n.T)),
        **_columns("current", torque @ np.linalg.inv(n) / constant),
    }
    return pd.DataFrame({"time": time, **motors})


def _robot() -> str:
    """Six revolute joints about axes in turn."""
    link = (
        "<link name='l{0}'><inertial><origin xyz='0.1 0 0.2'/><mass value='2'/>"
        "<inertia ixx='.1' iyy='.1' izz='.1' ixy='0' ixz='0' iyz='0'/></inertial></link>"
    )
    joint = (
        "<joint name='j{0}' type='revolute'><parent link='l{1}'/><child link='l{0}'/><origin xyz='0 0 0.3'/>"
        "<axis xyz='{2}'/><limit lower='-3' upper='3' effort='100' velocity='5'/></joint>"
    )
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
    parts = [link.format(i) for i in range(7)] + [joint.format(i + 1, i, axis) for i, axis in enumerate(axes)]
    return f"<robot name='six'>{''.join(parts)}</robot>"


@cache
def _finished_runs() -> Path:
    """runs/tanks and runs/pendulum, and a discovery on the tanks in runs/found; each worker makes them once."""
    folder = Path(_ONCE.name)
    _files(folder)
    tanks, own = ["+experiment=cascaded_tank"], ["physics._target_=my_physics.pendulum", "data=csv"]
    files = ["data.train=A.csv", "data.test=B.csv"]
    for script, given, name in (
        ("train.py", tanks, "tanks"), ("discover.py", tanks, "found"), ("train.py", [*own, *files], "pendulum"),
    ):  # fmt: skip
        code, _, err = called(*given, *budget(script, given), f"hydra.run.dir=runs/{name}", cwd=folder, script=script)
        assert code == 0, err
    return folder / "runs"
