"""Benchmark records through the package `nonlinear_benchmarks`, which downloads them once and caches them.

That package prints, waits without a limit where a firewall swallows its requests, switches certificate checks off
while it downloads, and fails in many ways when there is no network or its cache is broken. So it runs in a process of
its own, silenced, with a time limit; whatever goes wrong there is one exception here.

    python -m pgrssnn_jax.data.download tanks|robot FILE.npz       what that process runs
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

_SOCKET_TIMEOUT = 10.0  # s without an answer
_LONGEST = 100  # characters of somebody else's message
_OFFLINE = ("unable to download", "Download failed")


def download_tanks(timeout: float) -> tuple[Float[np.ndarray, "time 4"], float]:
    """Columns u_est, u_test, y_est, y_test in V, and the sample time in s.

    timeout: s after which the attempt ends. Raises `ConnectionError`, with the reason, if there is no such data.
    """
    columns, dt = _download("tanks", ("columns", "dt"), timeout)
    if columns.ndim != 2 or columns.shape[1] != 4 or not len(columns) or not np.isfinite(columns).all():
        raise ConnectionError(f"expected four columns of finite numbers, found shape {columns.shape}")
    return columns, float(dt)


def download_robot(timeout: float) -> tuple[Float[np.ndarray, "train time 12"], Float[np.ndarray, "test time 12"]]:
    """Sequences for training and for testing; columns: six motor-side torques in Nm, six positions in degrees.

    The package's own form: u_t goes with y_{t+1}. Otherwise as `download_tanks`.
    """
    train, test = _download("robot", ("train", "test"), timeout)
    for part in (train, test):
        # Two samples are the least that leaves one after the alignment.
        shaped = part.ndim == 3 and part.shape[1:] == train.shape[1:] and part.shape[1] > 1 and part.shape[2] == 12
        if not shaped or not np.isfinite(part).all():
            raise ConnectionError(f"expected sequences of twelve columns of finite numbers, found shape {part.shape}")
    return train, test


def _download(system: str, names: tuple[str, ...], timeout: float) -> list[Float[np.ndarray, "..."]]:
    """The named arrays that the other process saves."""
    # The other process must find what this one finds, in whatever way this one came to find it.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{system}.npz"
        command = [sys.executable, "-P", "-m", __name__, system, str(file)]
        try:
            subprocess.run(command, env=environment, check=True, capture_output=True, timeout=timeout)
            with np.load(file, allow_pickle=False) as arrays:
                return [np.asarray(arrays[name], float) for name in names]
        except subprocess.TimeoutExpired:
            raise ConnectionError(f"no answer within {timeout:g} s") from None
        except subprocess.CalledProcessError as error:
            raise ConnectionError(_last_line(error.stderr)) from None
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise ConnectionError(_last_line(str(error).encode())) from None


def _last_line(text: bytes) -> str:
    lines = text.decode("utf-8", "replace").strip().splitlines() or ["no reason given"]
    return lines[-1].removeprefix("ValueError: ").partition(" with urls")[0][:_LONGEST]


def _fetch(system: str, file: str) -> None:
    import nonlinear_benchmarks

    socket.setdefaulttimeout(_SOCKET_TIMEOUT)
    benchmarks: Any = nonlinear_benchmarks
    if system == "tanks":
        train, test = _load(benchmarks.Cascaded_Tanks, atleast_2d=True)
        columns = np.concatenate([train.u, test.u, train.y, test.y], axis=1)
        np.savez(file, columns=columns, dt=float(train.sampling_time))
    else:
        train, test = _load(benchmarks.not_splitted_benchmarks.Industrial_robot)
        fitted, tested = (np.stack([np.hstack([one.u, one.y]) for one in part]) for part in (train, test))
        np.savez(file, train=fitted, test=tested)


def _load(load: Any, **options: Any) -> tuple[Any, Any]:
    try:
        return load(**options)
    except Exception as error:
        if any(words in str(error) for words in _OFFLINE):
            raise
        # A cached file that cannot be read: an interrupted download looks like that. Fetch it anew, once.
        return load(**options, force_download=True)


if __name__ == "__main__":
    _fetch(*sys.argv[1:])
