"""What a step costs inside diffrax: `LieSolver` against diffrax on quaternions, of one body.

`python -m twistax.report.bridge_speed` prints a table. Exit status 1 if a ratio misses its bar or the ends disagree.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import diffrax
import jax
import jax.numpy as jnp

from .. import diffrax as bridge
from ..integrators.charts import Ambient, Exponential
from .machine import machine
from .step_speed import body

__all__ = ["BAR", "Row", "main", "measure"]

BAR = 1.5
"""Time of a step of `LieSolver` over that of the same solver on quaternions."""

_STEP = 1e-3
_ROUNDS = 5
_ALLOWED = 1e-6


@dataclass(frozen=True)
class Row:
    """One solver: seconds to compile and microseconds a step of `LieSolver` and of quaternions, ends apart, steps."""

    name: str
    compile_seconds: tuple[float, float]
    lie: float
    plain: float
    apart: float
    steps: tuple[int, int]

    @property
    def ratio(self) -> float:
        return self.lie / self.plain


def _controllers(adaptive: bool) -> tuple[Any, Any]:
    """Of both flights; adaptive ones measure errors but may take one length only, so that both take the same steps."""
    if not adaptive:
        return diffrax.ConstantStepSize(), diffrax.ConstantStepSize()
    held: dict[str, Any] = {"dtmin": _STEP, "dtmax": _STEP}
    plain = diffrax.PIDController(rtol=_ALLOWED, atol=_ALLOWED, pcoeff=0.2, icoeff=0.6, **held)
    return bridge.controller(rtol=_ALLOWED, atol=_ALLOWED, **held), plain


def measure(solver: Any, chart: Any, adaptive: bool, steps: int) -> Row:
    """Both flights from the same start, rounds in turn so that load falls on both alike."""
    dynamics = body()
    x = {"g": jnp.eye(4), "V": jnp.array([0.1, 0.2, 0.3, 1.0, 0.5, -0.3])}
    quaternions, lie = bridge.ambient_term(dynamics), bridge.LieSolver(solver, dynamics, chart)
    of_group, plain = _controllers(adaptive)

    def flight(term: Any, own: Any, control: Any, read: Callable[[Any], Any], write: Callable[[Any], Any]) -> Any:
        def fly(x: Any, end: jax.Array) -> Any:
            sol = diffrax.diffeqsolve(
                term, own, jnp.zeros(()), end, _STEP, write(x), stepsize_controller=control, max_steps=steps + 16
            )
            return jax.vmap(read)(sol.ys), sol.stats["num_accepted_steps"]

        return jax.jit(fly)

    flights = {
        "lie": flight(bridge.lie_term(dynamics), lie, of_group, lambda y: y, lambda x: x),
        "plain": flight(quaternions, solver, plain, quaternions.from_ambient, quaternions.to_ambient),
    }
    end = jnp.asarray(_STEP * steps)
    compiled, seconds, ends = {}, {}, {}
    for name, run in flights.items():
        begin = time.perf_counter()
        compiled[name] = run.lower(x, end).compile()
        seconds[name] = time.perf_counter() - begin
        ends[name] = jax.block_until_ready(compiled[name](x, end))
    times: dict[str, list[float]] = {"lie": [], "plain": []}
    for _ in range(_ROUNDS):
        for name, run in compiled.items():
            begin = time.perf_counter()
            jax.block_until_ready(run(x, end))
            times[name].append((time.perf_counter() - begin) / steps * 1e6)
    apart = max(float(jnp.abs(ends["lie"][0][name] - ends["plain"][0][name]).max()) for name in x)
    name = f"{type(solver).__name__}, {lie.frame.chart!r}"
    taken = int(ends["lie"][1]), int(ends["plain"][1])
    found = median(times["lie"]), median(times["plain"])
    return Row(name, (seconds["lie"], seconds["plain"]), *found, apart, taken)


def main() -> int:
    """Prints the table."""
    jax.config.update("jax_enable_x64", True)
    print(machine())
    print(f"one body, 13 states, float64; medians of {_ROUNDS} rounds in turn; the ratio has a bar of {BAR:g}")
    print(
        f"{'solver, chart':<40}{'steps':<10}{'compile, s':>14}{'a step, us':>12}{'quaternions':>13}{'ratio':>8}"
        f"{'ends apart':>13}"
    )
    good = True
    for solver in (diffrax.Tsit5(), diffrax.Dopri8()):
        for chart in (None, Exponential(), Ambient()):
            for adaptive in (False, True):
                row = measure(solver, chart, adaptive, 2000)
                good = good and row.ratio <= BAR and row.apart < 1e-9 and row.steps[0] == row.steps[1]
                seconds = "{:.1f} / {:.1f}".format(*row.compile_seconds)
                print(
                    f"{row.name:<40}{'adaptive' if adaptive else 'constant':<10}{seconds:>14}{row.lie:>12.1f}"
                    f"{row.plain:>13.1f}{row.ratio:>8.2f}{row.apart:>13.1e}",
                    flush=True,
                )
    print("all bars hold" if good else "A BAR IS MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
