"""What every test of bad input shares: a folder of its own, and types that are not checked, as users have it."""

from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Iterator[Path]:
    """The current folder of the test. Types are checked in tests only: here what users get to see without."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PGRSSNN_DATA", raising=False)
    jaxtyping.config.update("jaxtyping_disable", True)
    yield tmp_path
    jaxtyping.config.update("jaxtyping_disable", False)
