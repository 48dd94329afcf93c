"""A benchmark that the tests of the commands share."""

from pathlib import Path

import pytest
from commands import write_benchmark


@pytest.fixture
def benchmark(tmp_path) -> Path:
    """A short file of the cascaded-tanks layout."""
    return write_benchmark(tmp_path / "tanks.csv", samples=160)
