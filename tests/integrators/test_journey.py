"""How far one reads: the files of the package whose functions a first call and a first integration enter.

`python tests/integrators/test_journey.py` prints them.
"""

import gc
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import twistax as tx

SOURCE = str(Path(tx.__file__).parent)


NATIVE = pytest.mark.skipif(importlib.util.find_spec("llvmlite") is None, reason="llvmlite is not installed")


def entered(call: Callable[[], Any]) -> list[str]:
    """The files in which a function is entered during the call; bodies of imported modules and finders do not count."""
    files = set()

    def look(frame: FrameType, event: str, argument: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_name not in ("<module>", "find_spec") and code.co_filename.startswith(SOURCE):
            files.add(code.co_filename[len(SOURCE) + 1 :])

    # What other tests left to be freed is freed first: its finalizers are functions too.
    gc.collect()
    gc.disable()
    before = sys.getprofile()
    sys.setprofile(look)
    try:
        call()
    finally:
        sys.setprofile(before)
        gc.enable()
    return sorted(files)


START = {"g": np.eye(4), "V": np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])}


def compiled(backend: Any) -> tx.Dynamics:
    """The body in the README."""
    g, V, F = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.Control("F", shape=(6,))
    M = tx.Parameter("M", shape=(6, 6), value=np.diag([1.0, 1.0, 1.0, 0.2, 0.3, 0.4]))
    body = tx.System(rates={g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V))})
    return tx.compile(body, backend=backend)


def journey(backend: Any, **steps: Any) -> tuple[list[str], list[str]]:
    """The files of a first and of a second integration."""
    dynamics, integrate = compiled(backend), tx.integrate

    def run() -> None:
        integrate(dynamics, START, t1=1.0, u={"F": np.zeros(6)}, **steps)

    return entered(run), entered(run)


@pytest.mark.parametrize(
    ("backend", "steps", "first_bar", "second_bar"),
    [
        # diffrax's own call of the same system enters 36 of its files.
        pytest.param(tx.JAX(), {"dt": 0.01}, 38, 13, id="fixed"),
        pytest.param(tx.JAX(), {"rtol": 1e-4}, 37, 12, id="adaptive"),
        # The default without llvmlite: what makes scalars of the rates comes on top.
        pytest.param(tx.XLA(), {"dt": 0.01}, 45, 13, id="fixed, as scalars"),
        # One file less where the kernel is on disk: only new ones are compared with NumPy.
        pytest.param(tx.Native(), {"rtol": 1e-4}, 59, 12, id="adaptive, as a kernel", marks=NATIVE),
    ],
)
def test_the_files_that_integrations_enter(
    backend: Any, steps: dict[str, Any], first_bar: int, second_bar: int
) -> None:
    first, second = journey(backend, **steps)
    assert len(first) <= first_bar, first
    assert len(second) <= second_bar, second


@pytest.mark.parametrize(("backend", "bar"), [(tx.JAX(), 21), ("auto", 35)], ids=["arrays", "default"])
def test_the_files_that_a_first_call_enters(backend: Any, bar: int) -> None:
    dynamics = compiled(backend)
    files = entered(lambda: dynamics(0.0, START, {"F": np.zeros(6)}))
    assert len(files) <= bar, files


if __name__ == "__main__":
    for backend in (tx.JAX(), tx.XLA(), tx.Native()):
        for steps in ({"dt": 0.01}, {"rtol": 1e-4}):
            for which, files in zip(("first", "second"), journey(backend, **steps)):
                print(f"{which}, {backend!r}, {steps}: {len(files)} files", *files, sep="\n  ")
