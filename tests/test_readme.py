"""The README is true: its commands compose, its Python runs, its own-physics example trains."""

import json
import re
import shlex

import jax.numpy as jnp
import numpy as np
import pytest
from commands import ROOT, called, command, composed

from pgrssnn_jax.data.csv_files import write_csv
from pgrssnn_jax.records.arguments import call_with
from pgrssnn_jax.records.record import Channel, RecordInfo, record

README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", README, flags=re.M | re.S)
COMMANDS = sorted(
    {
        line.split("#")[0].strip()
        for language, block in BLOCKS
        if language == "bash"
        for line in block.splitlines()
        if line.startswith(("python train.py", "python discover.py"))
    }
)
EXAMPLE = next(block for language, block in BLOCKS if language == "python" and "# my_physics.py" in block)


def test_the_own_physics_example_is_short():
    assert len(EXAMPLE.strip().splitlines()) <= 30


@pytest.mark.parametrize("line", [line for line in COMMANDS if "resume=" not in line])
def test_every_command_composes(line):
    words = [word for word in shlex.split(line)[2:] if word != "-m" and not word.startswith("hydra.")]
    name = line.split()[1].removesuffix(".py")
    config = composed(*(word.split(",")[0] if "=" in word and "[" not in word else word for word in words), name=name)
    assert config["physics"]["_target_"]


def test_every_path_it_names_is_there():
    for path in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize("target", re.findall(r"^make (\w+)", README, flags=re.M))
def test_every_make_target_is_there(target):
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), flags=re.M)


def pendulum_csv(path, physics, samples: int, seed: int):
    """A pendulum simulated by its own physics with drag that the model does not know."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-3, 3, (samples // 10, 1)), 10, axis=0)
    x, y = jnp.zeros(2), []
    for u_t in u:
        x = physics.step(physics.params, x, jnp.asarray(u_t, jnp.float32))
        x = x.at[1].add(-0.02 * x[1] * jnp.abs(x[1]))
        y.append(physics.measure(physics.params, x, u_t))
    info = RecordInfo((Channel("torque", "Nm"),), (Channel("angle", "rad"),), physics.dt, "simulated")
    write_csv(path, record(u, np.asarray(y, np.float64), info))


def test_the_own_physics_example_trains_on_own_data(tmp_path):
    (tmp_path / "my_physics.py").write_text(EXAMPLE)
    namespace: dict = {}
    exec(compile(EXAMPLE, "my_physics.py", "exec"), namespace)
    physics = call_with(namespace["pendulum"], {}, "physics")
    pendulum_csv(tmp_path / "A.csv", physics, 200, 0)
    pendulum_csv(tmp_path / "B.csv", physics, 100, 1)
    code, _, err = command(
        "physics._target_=my_physics.pendulum", "data=csv", "data.train=A.csv", "data.test=B.csv",
        "n_seeds=2", "fit.epochs=100", "fit.learning_rate=0.01", "model.hidden=6", "hydra.run.dir=run", cwd=tmp_path,
    )  # fmt: skip
    assert code == 0, err
    metrics = json.loads((tmp_path / "run/metrics.json").read_text())
    assert metrics["system"] == "pendulum"
    assert metrics["outputs"] == [{"name": "angle", "unit": "rad"}]
    assert metrics["summary"]["finished"] == 2
    code, _, err = called(
        "physics._target_=my_physics.pendulum", "+physics.length=0.5", "data=csv", "data.train=A.csv",
        "data.test=C.csv", cwd=tmp_path,
    )  # fmt: skip
    assert code == 2
    assert "C.csv" in err
