"""What a step costs beside the same loop in C.

`python -m twistax.report.c_speed` prints a table. Exit status 1 if the flights disagree or the ratio misses its bar;
without gcc there is nothing to compare with, which it says, with status 0.
"""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..expr import Concat, State
from ..expr.linalg import Cross
from ..groups import SE3, quaternions, se3
from ..integrators import integrate
from ..lowering import Dynamics, compile
from ..lowering.backends import Backend
from ..system import System
from .machine import machine

__all__ = ["AGREEMENT", "AIM", "BAR", "Row", "body", "compare", "gcc", "library", "main"]

BAR = 2.0
"""The largest ratio to C with the first of `FLAGS`."""

AIM = 1.2
"""The ratio aimed at."""

AGREEMENT = 1e-10
"""The largest difference of the end states, in m, m/s and rad/s; rotations by the entries of their matrices."""

SOURCE = Path(__file__).with_name("rkmk4.c")
FLAGS = (("-O3", "-march=native"), ("-O3", "-march=native", "-fno-tree-vectorize"))
"""What C is compiled with: the usual, and what is faster where the compiler's vectors of scalars do not pay."""

_STEP = 1e-5  # s
_ROUNDS = 7
_VELOCITY = np.array([1.0, 0.5, -0.3, 0.4, 1.2, -0.7])  # m/s, rad/s

Fly = Callable[[NDArray[Any], float, int], None]


@dataclass(frozen=True)
class Row:
    """One loop: microseconds a step (median), seconds to compile, and how far it ends from where ours does."""

    name: str
    step: float
    compile_seconds: float
    difference: float


def body(backend: Backend | Literal["auto"] = "auto") -> Dynamics:
    """The body of `rkmk4.c`: gravity, linear drag, principal moments of inertia 1, 2 and 3 kg m^2."""
    g, V, J = State("g", group=SE3), State("V", shape=(6,)), np.array([1.0, 2.0, 3.0])
    v, w = V[:3], V[3:]
    acceleration = g[:3, :3].T @ np.array([0.0, 0.0, -9.81]) - 0.1 * v - Cross(w, v)
    return compile(System(rates={g: V, V: Concat(acceleration, Cross(J * w, w) / J)}), backend=backend)


def gcc() -> str | None:
    """Where gcc is, if it is."""
    return shutil.which("gcc")


def library(compiler: str, flags: Sequence[str], folder: Path) -> tuple[Fly, float]:
    """`fly(y, h, steps)` of `rkmk4.c`, which moves y = [q, p, v, w] in place, and the seconds it took to compile."""
    target = folder / f"rkmk4{''.join(flags)}.so"
    begin = time.perf_counter()
    subprocess.run([compiler, *flags, "-shared", "-fPIC", "-o", str(target), str(SOURCE)], check=True)
    seconds = time.perf_counter() - begin
    compiled = ctypes.CDLL(str(target)).fly
    compiled.argtypes = [np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS"), ctypes.c_double, ctypes.c_long]
    compiled.restype = None
    return compiled, seconds


def compare(compiler: str, steps: int, rounds: int = _ROUNDS) -> list[Row]:
    """All flights from the same start, ours first, rounds in turn so that load falls on all alike.

    Needs JAX's x64 switch.
    """
    dynamics, start = body(), {"g": np.eye(4), "V": _VELOCITY}

    def ours() -> dict[str, jax.Array]:
        return jax.block_until_ready(integrate(dynamics, start, t1=steps * _STEP, steps=steps).xs)

    def in_c(fly: Fly) -> NDArray[Any]:
        y = np.concatenate([[1.0], np.zeros(6), _VELOCITY])
        fly(y, _STEP, steps)
        return y

    with tempfile.TemporaryDirectory() as folder:
        libraries = [library(compiler, flags, Path(folder)) for flags in FLAGS]
        flights: list[Callable[[], Any]] = [ours, *(functools.partial(in_c, fly) for fly, _ in libraries)]
        (first, xs), *ends = [_timed(flight) for flight in flights]
        times = [[_timed(flight)[0] for flight in flights] for _ in range(rounds)]
    seconds = [median(column) for column in zip(*times, strict=True)]
    rows = [Row("twistax", seconds[0] / steps * 1e6, first - seconds[0], 0.0)]
    for flags, (_, compiling), (_, y), taken in zip(FLAGS, libraries, ends, seconds[1:], strict=True):
        rows.append(Row(f"C {' '.join(flags)}", taken / steps * 1e6, compiling, _difference(xs, y)))
    return rows


def _difference(xs: dict[str, jax.Array], y: NDArray[Any]) -> float:
    """The largest difference of the entries of the pose and of the velocity."""
    pose = se3.transform(quaternions.to_rotation(jnp.asarray(y[:4])), jnp.asarray(y[4:7]))
    return max(float(jnp.abs(xs["g"][0] - pose).max()), float(jnp.abs(xs["V"][0] - y[7:]).max()))


def _timed(flight: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.perf_counter()
    found = flight()
    return time.perf_counter() - begin, found


def main() -> int:
    """Prints the table."""
    jax.config.update("jax_enable_x64", True)
    print(machine())
    compiler = gcc()
    if compiler is None:
        print("RKMK4 on one SE(3) body against C: absent, because there is no gcc on this machine.")
        return 0
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
    steps = 500_000
    rows = compare(compiler, steps)
    ratios = [rows[0].step / row.step for row in rows]
    print(f"RKMK4 on one SE(3) body, 13 states, float64, {steps:,} steps, medians of {_ROUNDS} rounds in turn")
    print(f"tx.integrate with its default method and settings; {version}")
    print(f"{'':<44}{'a step, us':>12}{'ratio':>8}{'compile, s':>12}{'ends apart':>12}")
    for row, ratio in zip(rows, ratios, strict=True):
        print(f"{row.name:<44}{row.step:>12.3f}{ratio:>8.2f}{row.compile_seconds:>12.2f}{row.difference:>12.1e}")
    print(f"bars: {BAR:g} against the first C, {AIM:g} aimed at; ends {AGREEMENT:g} apart")
    good = ratios[1] < BAR and max(row.difference for row in rows) < AGREEMENT
    print("all bars hold" if good else "A BAR IS MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
