"""What the pages take for granted: files of one's own, a physics, an effect, a robot and its log, and finished runs."""

import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
from blocks import BLOCK, budget, saved_block
from commands import ROOT, called

import pgrssnn_jax as pg

SAMPLES = 400


def furnish(folder: Path, page: Path) -> None:
    """The files, and the runs if the page speaks of any."""
    (folder / "my_physics.py").write_text(saved_block(ROOT / "README.md", "my_physics.py"))
    (folder / "my_effects.py").write_text(saved_block(ROOT / "docs/own_system.md", "my_effects.py"))
    for seed, name in enumerate(("A.csv", "B.csv", "C.csv")):
        _measured(seed).to_csv(folder / name, index=False)
    for name in ("my_arm.urdf", "tx40.urdf"):
        (folder / name).write_text(_robot())
    _log().to_csv(folder / "log.csv", index=False)
    if any(re.search(r"runs/FOLDER|\bRUN\b|runs=runs", text) for _, text in BLOCK.findall(page.read_text())):
        _finished_runs(folder)


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
    return pd.DataFrame({**noisy, **_motion(0.01 * np.arange(SAMPLES), "torque_%d", "position_%d")})


def _motion(time: np.ndarray, torque: str, position: str) -> dict[str, np.ndarray]:
    """Torques and positions of six joints, which need not belong together."""
    joints = range(1, 7)
    positions = {position % joint: 0.5 * np.sin((1 + 0.3 * joint) * time) for joint in joints}
    return {**positions, **{torque % joint: 2.0 * np.cos((1 + 0.3 * joint) * time) for joint in joints}}


def _log() -> pd.DataFrame:
    time = 0.002 * np.arange(3000)
    return pd.DataFrame({"time": time, **_motion(time, "current_%d", "motor_%d")})


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


def _finished_runs(folder: Path) -> None:
    """runs/tanks, with a discovery in it, and runs/pendulum."""
    tanks, own = ["+experiment=cascaded_tank"], ["physics._target_=my_physics.pendulum", "data=csv"]
    files = ["data.train=A.csv", "data.test=B.csv"]
    for script, given, name in (
        ("train.py", tanks, "tanks"), ("discover.py", tanks, "found"), ("train.py", [*own, *files], "pendulum"),
    ):  # fmt: skip
        code, _, err = called(*given, *budget(script, given), f"hydra.run.dir=runs/{name}", cwd=folder, script=script)
        assert code == 0, err
    shutil.move(folder / "runs/found/discovery.json", folder / "runs/tanks/discovery.json")
    shutil.rmtree(folder / "runs/found")
