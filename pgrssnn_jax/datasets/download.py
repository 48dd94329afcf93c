"""The cascaded-tanks records through the package `nonlinear_benchmarks`, which downloads them once and caches them.

That package prints, waits without a limit where a firewall swallows its requests, switches certificate checks off
while it downloads, and fails in many ways when there is no network or its cache is broken. So it runs in a process of
its own, silenced, with a time limit; whatever goes wrong there is one exception here.

    python -m pgrssnn_jax.datasets.download FILE.npz       what that process runs
"""

import os
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

_SOCKET_PATIENCE = 10.0  # s without an answer
_LONGEST = 100  # characters of somebody else's message


def download_tanks(patience: float) -> tuple[Float[np.ndarray, "time 4"], float]:
    """Columns u_est, u_test, y_est, y_test in V, and the sample time in s.

    patience: s after which the attempt ends. Raises `ConnectionError`, with the reason, if there is no such data.
    """
    # The other process must find what this one finds, in whatever way this one came to find it.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "tanks.npz"
        command = [sys.executable, "-P", "-m", __name__, str(file)]
        try:
            subprocess.run(command, env=environment, check=True, capture_output=True, timeout=patience)
            with np.load(file, allow_pickle=False) as arrays:
                columns, dt = np.asarray(arrays["columns"], float), float(arrays["dt"])
        except subprocess.TimeoutExpired:
            raise ConnectionError(f"no answer within {patience:g} s") from None
        except subprocess.CalledProcessError as error:
            raise ConnectionError(_last_line(error.stderr)) from None
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise ConnectionError(_last_line(str(error).encode())) from None
    if columns.ndim != 2 or columns.shape[1] != 4 or not len(columns) or not np.isfinite(columns).all():
        raise ConnectionError(f"expected four columns of finite numbers, found shape {columns.shape}")
    return columns, dt


def _last_line(text: bytes) -> str:
    lines = text.decode("utf-8", "replace").strip().splitlines() or ["no reason given"]
    return lines[-1].removeprefix("ValueError: ").partition(" with urls")[0][:_LONGEST]


def _fetch(file: str) -> None:
    import nonlinear_benchmarks

    socket.setdefaulttimeout(_SOCKET_PATIENCE)
    load: Any = nonlinear_benchmarks.Cascaded_Tanks
    try:
        train, test = load(atleast_2d=True)
    except Exception as error:
        if "unable to download" in str(error):
            raise
        # A cached file that cannot be read: an interrupted download looks like that. Fetch it anew, once.
        train, test = load(atleast_2d=True, force_download=True)
    columns = np.concatenate([train.u, test.u, train.y, test.y], axis=1)
    np.savez(file, columns=columns, dt=float(train.sampling_time))


if __name__ == "__main__":
    _fetch(sys.argv[1])
