"""Arrays sharded over several devices."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("llvmlite")


@pytest.mark.parametrize("more", [[], pytest.param(["--all"], marks=pytest.mark.slow)], ids=str)
def test_programs_of_sharded_arrays(more: list[str]) -> None:
    """In a process of its own, with 8 devices: values, where the results are, and that nothing is gathered."""
    script = Path(__file__).with_name("sharded_programs.py")
    environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, str(script), *more]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-3000:]
    assert ran.stdout.endswith("all agree\n")
