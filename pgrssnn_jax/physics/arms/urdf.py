"""Any arm of revolute joints on a fixed base, from its URDF file, through Pinocchio's parser."""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - its files are in a folder of their own

from pgrssnn_jax.physics.arms.tables import ArmTables, tables_of
from pgrssnn_jax.records.arguments import first_line


def read_urdf(file: str | Path, lock: Sequence[str] = ()) -> ArmTables:
    """Tables of a URDF; lock: names of joints that are held at their neutral position (a gripper's fingers, say).

    Gear ratios are 1, motors have no inertia, friction and limits are those of the URDF; limits of zero width, which
    many files carry where nobody knew better, are none. Raises `ValueError` for a file that Pinocchio cannot read, and
    for joints that are not revolute or mimic others.
    """
    path = Path(file).expanduser()
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise ValueError(f"physics.urdf: expected a URDF file, found {found}: {file}")
    try:
        with _silence():  # the parser writes lines of its own
            model = pin.buildModelFromUrdf(str(path), mimic=True)
    except Exception as problem:  # Pinocchio's parser raises what it likes
        expected = "a URDF that Pinocchio can read"
        raise ValueError(f"physics.urdf: {file}: expected {expected}, found {first_line(problem)}") from None
    names = list(model.names)[1:]
    if isinstance(lock, str):
        raise ValueError(f"physics.lock: expected a list of joint names, [{lock}] say, found {lock!r}")
    for name in lock:
        if name not in names:
            raise ValueError(f"physics.lock: expected names among {names}, found {name!r}")
    if lock:
        held = [model.getJointId(name) for name in dict.fromkeys(lock)]
        model = pin.buildReducedModel(model, held, pin.neutral(model))
    tables = tables_of(model, f"physics.urdf: {file}: ")
    frozen = tables.position_max == tables.position_min
    return tables._replace(
        position_min=np.where(frozen, -np.inf, tables.position_min),
        position_max=np.where(frozen, np.inf, tables.position_max),
        velocity_max=np.where(tables.velocity_max > 0, tables.velocity_max, np.inf),
    )


@contextmanager
def _silence() -> Iterator[None]:
    """Sends what C++ writes to standard error away."""
    sys.stderr.flush()
    before, away = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(away, 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
        os.close(away)
