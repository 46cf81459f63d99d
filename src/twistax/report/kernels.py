"""What native kernels cost and give: to build them, to call one, to fly many bodies in one; how exact their sine is.

`python -m twistax.report.kernels` prints a line each; it takes minutes. Exit status 1 if a bar is missed; without
llvmlite there is nothing to measure, which it says, with status 0. Needs mpmath.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..expr import Control, Cos, Sin, State
from ..integrators import Result, integrate
from ..lowering import XLA, Dynamics, Native, compile
from ..lowering.backends import Backend
from ..lowering.native.backend import installed
from ..lowering.scalar.derivatives import jacobian
from ..lowering.scalar.passes import one_by_one
from ..lowering.scalar.program import ScalarProgram, scalarize
from ..mechanics import chain_models, forward_dynamics
from ..system import System
from .c_speed import body
from .digits import mpmath
from .machine import machine
from .scalar_operations import cases

__all__ = ["Figure", "above_an_empty_call", "angles", "build_seconds", "flights", "main", "units_off"]

_STEP = 1e-3  # s
_CALLS, _ROUNDS = 200, 31


@dataclass(frozen=True)
class Figure:
    """A line: what was measured, and the bar."""

    text: str
    found: float
    bar: float

    def __str__(self) -> str:
        return f"{self.text}: {self.found:.3g} (bar {self.bar:g})"


def build_seconds(program: ScalarProgram) -> float:
    """From the scalars to a kernel for many bodies that was compared with NumPy, s."""
    begin = time.perf_counter()
    if Native().prepare(program, single=False) is None:
        raise RuntimeError("no kernel came of the program")
    return time.perf_counter() - begin


def programs() -> dict[str, ScalarProgram]:
    """The Panda's forward dynamics, and its derivatives by positions and velocities."""
    case = next(each for each in cases() if each.name == "ABA 7")
    program = scalarize(case.function, *(jax.ShapeDtypeStruct((n,), float) for n in case.sizes))
    slopes = one_by_one(program.restricted([np.array(list(jacobian(program, [0, 1]).values()))]))
    return {"the Panda's ABA": program, "its Jacobian": slopes}


def above_an_empty_call() -> float:
    """What a jitted call of the Panda's forward dynamics takes beyond one that adds the three vectors, us."""
    arm = chain_models.panda()
    q, qd, tau = State("q", shape=(7,)), State("qd", shape=(7,)), Control("tau", shape=(7,))
    dynamics = compile(System(rates={q: qd, qd: forward_dynamics(arm, q, qd, tau)}), backend=Native())
    point = [jnp.asarray(each) for each in np.random.default_rng(0).normal(size=(3, 7))]
    full = _native(jax.jit(lambda q, qd, tau: dynamics(0.0, {"q": q, "qd": qd}, {"tau": tau})["qd"]), *point)
    empty = jax.jit(lambda q, qd, tau: q + qd + tau)
    pairs = [[_seconds(partial(_waited, run, point, _CALLS)) for run in (full, empty)] for _ in range(_ROUNDS)]
    return median(own - other for own, other in pairs[1:]) / _CALLS * 1e6


def flights(count: int, steps: int, rounds: int) -> tuple[float, float]:
    """A batch of RKMK4 flights of one body: time in a kernel over that by XLA's loop, and how far the ends are apart.

    Raises:
        RuntimeError: no kernel runs them, or not all are finished.
    """
    V = np.array([1.0, 0.5, -0.3, 0.4, 1.2, -0.7]) + np.random.default_rng(0).normal(scale=0.1, size=(count, 6))
    start = {"g": jnp.broadcast_to(jnp.eye(4), (count, 4, 4)), "V": jnp.asarray(V)}
    runs = [_native(_flown(body(Native()), steps), start), _flown(body(XLA()), steps)]
    (ends, codes), (others, other_codes) = (run(start) for run in runs)
    if not (jnp.all(codes == Result.SUCCESS) and jnp.all(other_codes == Result.SUCCESS)):
        raise RuntimeError("not all flights were finished")
    # NumPy's maximum hands on what is not a number; Python's loses it.
    apart = float(np.max([jnp.abs(ends[name] - others[name]).max() for name in ends]))
    pairs = [[_seconds(partial(_waited, run, [start])) for run in runs] for _ in range(rounds)]
    return median(own / other for own, other in pairs), apart


def _waited(run: Callable[..., Any], arguments: list[Any], calls: int = 1) -> None:
    for _ in range(calls):
        jax.block_until_ready(run(*arguments))


def _native(run: Any, *arguments: Any) -> Any:
    """The same jitted function, seen to call a kernel."""
    if "custom_call @twistax_" not in run.lower(*arguments).as_text():
        raise RuntimeError("no kernel runs the function")
    return run


def _flown(dynamics: Dynamics, steps: int) -> Callable[[Any], Any]:
    def fly(start: Any) -> Any:
        flight = integrate(dynamics, start, t1=steps * _STEP, steps=steps, throw=False)
        return flight.xs, flight.result

    return jax.jit(jax.vmap(fly))


def angles(count: int) -> NDArray[np.float64]:
    """Angles of all sizes to 1e9 rad, and those nearest to multiples of a quarter turn, where most cancels."""
    mp = mpmath()
    random = np.random.default_rng(1)
    sizes = random.choice([-1.0, 1.0], count) * 10.0 ** random.uniform(-9.0, 9.0, count)
    with mp.workdps(50):
        near = np.array([float(mp.pi * int(k) / 2) for k in random.integers(1, 600_000_000, count)])
    return np.concatenate([sizes, near, np.nextafter(near, 0.0)])


def units_off(x: NDArray[np.float64], backend: Backend) -> float:
    """The worst sine or cosine, in units in the last place, against 50 digits."""
    mp = mpmath()
    s, c = State("s"), State("c")
    dynamics = compile(System(rates={s: Sin(s), c: Cos(c)}), backend=backend)
    run = jax.jit(jax.vmap(lambda a: dynamics(0.0, {"s": a, "c": a})))
    found = (_native(run, x) if isinstance(backend, Native) else run)(jnp.asarray(x))
    errors = []
    with mp.workdps(50):
        for name, function in (("s", mp.sin), ("c", mp.cos)):
            for angle, own in zip(x.tolist(), np.asarray(found[name]).tolist(), strict=True):
                exact = function(mp.mpf(angle))
                errors.append(float(abs(own - exact)) / float(np.spacing(abs(float(exact)))))
    return float(np.max(errors))


def _seconds(call: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def main() -> int:
    """Prints the figures."""
    jax.config.update("jax_enable_x64", True)
    print(machine())
    if not installed():
        print("native kernels: absent, because llvmlite is not installed")
        return 0
    build_seconds(scalarize(lambda x: [jnp.sin(x)], jax.ShapeDtypeStruct((2,), float)))  # LLVM is awake then
    made = programs()
    figures = [
        Figure(f"kernel of {name}, {program.operations:,} operations, built in s", build_seconds(program), bar)
        for (name, program), bar in zip(made.items(), (0.4, 4.0), strict=True)
    ]
    figures.append(
        Figure("a call of the Panda's ABA above one that adds its arguments, us", above_an_empty_call(), 1.0)
    )
    ratio, apart = flights(65_536, 1_000, rounds=1)
    figures.append(Figure("65,536 flights of 1,000 RKMK4 steps, time over that of XLA's loop", ratio, 0.3))
    figures.append(Figure("their ends apart, in entries of pose and twist", apart, 1e-11))
    count = 30_000
    figures.append(
        Figure(f"sine and cosine of {3 * count:,} angles, worst, in last places", units_off(angles(count), Native()), 2)
    )
    print("\n".join(map(str, figures)))
    held = all(each.found <= each.bar for each in figures)
    print("all bars hold" if held else "A BAR IS MISSED")
    return 0 if held else 1


if __name__ == "__main__":
    raise SystemExit(main())
