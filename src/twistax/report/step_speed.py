"""What a step costs: tableaus and charts on one body, its loop as one small function and as XLA compiles it by default.

`python -m twistax.report.step_speed` prints a table. Exit status 1 if the loops disagree or compiling misses its bar.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..expr import State
from ..expr.lie import AdjointDual, wrench
from ..expr.solve import Solve
from ..groups import SE3
from ..integrators import RKMK, VectorField
from ..integrators.charts import Ambient, Chart, Exponential, SplitExponential
from ..integrators.tableaus import DOP853, RK4, TSIT5
from ..lowering import Dynamics, compile
from ..lowering.small_call import small_call
from ..system import System
from .machine import machine

__all__ = ["COMPILE_BAR", "Row", "body", "main", "measure"]

COMPILE_BAR = 2.0
"""Seconds to trace and compile a flight of one body with 13 states."""

_STEP = 1e-5
_ROUNDS = 5


@dataclass(frozen=True)
class Row:
    """One method: seconds to compile, microseconds a step of both loops, and how far apart they end."""

    method: RKMK
    compile_seconds: float
    small: float
    plain: float
    difference: float


def body() -> Dynamics:
    """A heavy asymmetric body: a pose and a twist, gravity in the body frame."""
    M = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    g, V = State("g", group=SE3), State("V", shape=(6,))
    weight = wrench(force=g[:3, :3].T @ np.array([0.0, 0.0, -19.62]), torque=np.array([0.0, 0.0, 0.1]))
    return compile(System(rates={g: V, V: Solve(M, weight - AdjointDual(V, M @ V))}))


def methods() -> list[RKMK]:
    """Three tableaus in every chart."""
    found = []
    for tableau in (RK4, TSIT5, DOP853):
        commutators = tableau.order - 2
        charts: list[Chart] = [Exponential(commutators), Exponential(), SplitExponential(commutators), Ambient()]
        found += [RKMK(tableau, chart) for chart in charts]
    return found


def _flight(dynamics: Dynamics, method: RKMK, small: bool) -> Any:
    local = method.coordinates(dynamics)

    def loop(x: Any, steps: jax.Array) -> Any:
        def advance(i: jax.Array, y: Any) -> Any:
            return method.advance(VectorField(dynamics, lambda t: {}, {}), i * _STEP, y, jnp.asarray(_STEP))

        return local.value(jax.lax.fori_loop(0, steps, advance, local.enter(x)))

    return jax.jit((lambda x, steps: small_call(loop, x, steps)) if small else loop)


def measure(method: RKMK, dynamics: Dynamics, steps: int) -> Row:
    """Both loops from the same start, rounds in turn so that load falls on both alike."""
    x = {"g": jnp.eye(4), "V": jnp.array([0.1, 0.2, 0.3, 1.0, 0.5, -0.3])}
    count = jnp.asarray(steps)
    flights = {small: _flight(dynamics, method, small) for small in (True, False)}
    begin = time.perf_counter()
    compiled = {True: flights[True].lower(x, count).compile()}
    seconds = time.perf_counter() - begin
    compiled[False] = flights[False].lower(x, count).compile()
    ends = {small: jax.block_until_ready(run(x, count)) for small, run in compiled.items()}
    times: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(_ROUNDS):
        for small, run in compiled.items():
            begin = time.perf_counter()
            jax.block_until_ready(run(x, count))
            times[small].append((time.perf_counter() - begin) / steps * 1e6)
    apart = float(jnp.stack([jnp.abs(ends[True][name] - ends[False][name]).max() for name in x]).max())
    return Row(method, seconds, median(times[True]), median(times[False]), apart)


def main() -> int:
    """Prints the table."""
    jax.config.update("jax_enable_x64", True)
    dynamics = body()
    print(machine())
    print(
        f"one body, 13 states, float64; medians of {_ROUNDS} rounds in turn; compiling has a bar of {COMPILE_BAR:g} s"
    )
    print(f"{'tableau':<16}{'chart':<34}{'compile, s':>11}{'a step, us':>12}{'default loop':>14}{'ratio':>8}")
    good = True
    for method in methods():
        row = measure(method, dynamics, 20_000)
        good = good and row.difference < 1e-12 and row.compile_seconds < COMPILE_BAR
        print(
            f"{method.tableau.name:<16}{method.chart!r:<34}{row.compile_seconds:>11.2f}{row.small:>12.3f}"
            f"{row.plain:>14.3f}{row.small / row.plain:>8.2f}"
        )
    print("all bars hold" if good else "A BAR IS MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
