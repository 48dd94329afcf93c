"""The scripts of `benchmarks/` that take hours begin: what they import, and the functions they replace, are there."""

import subprocess
import sys

import pytest

SCRIPTS = ("discovery", "interval_coverage", "recipes", "sensitivity")


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_begins(script):
    done = subprocess.run(
        [sys.executable, f"benchmarks/{script}.py", "--help"], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert "--seed" in done.stdout
