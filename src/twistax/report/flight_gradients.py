"""The gradient of a whole flight: reverse against forward mode and differences, its memory, what compiling costs.

`python -m twistax.report.flight_gradients` prints a table: the rocket scene, 10 s, the gradient of a weighted sum of
its end with respect to the start (in the tangent space) and the final time. Exit status 1 if a bar is missed.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..integrators import RKMK, integrate
from ..integrators.tableaus import DOP853, RK4, TSIT5
from ..scenes.rocket import ROCKET as rocket
from .machine import machine

__all__ = ["AGREEMENT_BAR", "COMPILE_BAR", "Row", "main", "measure"]

AGREEMENT_BAR = 1e-8
"""Relative to the largest entry of the gradient: against forward mode and against differences."""
COMPILE_BAR = 10.0
"""Seconds to trace and compile the reverse gradient."""

_ROUNDS = 5
#: Step of the differences, of fourth order, in rad, m, m/s, kg and s.
_STEP = 2e-3


@dataclass(frozen=True)
class Row:
    """One way to fly: seconds to compile the gradient, milliseconds to run it and the flight, disagreements."""

    name: str
    compile_seconds: float
    gradient: float
    flight: float
    against_forward: float
    against_differences: float
    megabytes: float


def ways() -> dict[str, dict[str, Any]]:
    """Fixed and chosen steps; the tolerances are tight, since differences see how steps are chosen."""
    return {
        "RK4, 200 steps": {"steps": 200, "method": RKMK(RK4)},
        "RK4, 20,000 steps": {"steps": 20_000, "method": RKMK(RK4)},
        "TSIT5, 1e-11": {"rtol": 1e-11, "atol": 1e-11, "method": RKMK(TSIT5)},
        "DOP853, 1e-11": {"rtol": 1e-11, "atol": 1e-11, "method": RKMK(DOP853)},
    }


def flown(options: dict[str, Any]) -> tuple[Callable[[jax.Array], jax.Array], int]:
    """The weighted sum of the end as a function of (tangent of the start, final time), and how many numbers that is."""
    dynamics = rocket.dynamics
    start = {name: jnp.asarray(value) for name, value in rocket.start.items()}
    n = dynamics.dimension
    weights = jnp.asarray(np.random.default_rng(0).normal(size=n))

    def function(z: jax.Array) -> jax.Array:
        x = dynamics.retract(start, z[:n])
        sol = integrate(dynamics, x, t1=rocket.duration + z[n], u=rocket.u, params=rocket.params, **options)
        return weights @ dynamics.difference(start, {name: value[-1] for name, value in sol.xs.items()})

    return function, n + 1


def measure(name: str, options: dict[str, Any]) -> Row:
    """One row of the table."""
    function, size = flown(options)
    z = jnp.zeros(size)
    flight = jax.jit(function)
    begin = time.perf_counter()
    gradient = jax.jit(jax.grad(function)).lower(z).compile()
    seconds = time.perf_counter() - begin
    reverse = gradient(z)
    scale = float(jnp.abs(reverse).max())
    forward = jax.jit(jax.jacfwd(function))(z)
    differences = jnp.stack([_difference(flight, direction) for direction in jnp.eye(size)])
    return Row(
        name,
        seconds,
        1e3 * _time(gradient, z),
        1e3 * _time(flight, z),
        float(jnp.abs(reverse - forward).max()) / scale,
        float(jnp.abs(reverse - differences).max()) / scale,
        _megabytes(gradient),
    )


def _megabytes(compiled: Any) -> float:
    """What the program needs beside its arguments and results."""
    found = compiled.memory_analysis()
    return float("nan") if found is None else found.temp_size_in_bytes / 1e6


def _difference(function: Callable[[jax.Array], jax.Array], direction: jax.Array) -> jax.Array:
    """The central difference of fourth order."""
    h = _STEP * direction
    return (8.0 * (function(h) - function(-h)) - (function(2.0 * h) - function(-2.0 * h))) / (12.0 * _STEP)


def _time(function: Callable[[jax.Array], jax.Array], z: jax.Array) -> float:
    jax.block_until_ready(function(z))
    times = []
    for _ in range(_ROUNDS):
        begin = time.perf_counter()
        jax.block_until_ready(function(z))
        times.append(time.perf_counter() - begin)
    return median(times)


def main() -> int:
    """Prints the table."""
    jax.config.update("jax_enable_x64", True)
    print(machine())
    print(
        f"rocket, 10 s, float64; errors relative to the largest entry, bar {AGREEMENT_BAR:g}; "
        f"compiling has a bar of {COMPILE_BAR:g} s; medians of {_ROUNDS}"
    )
    print(
        f"{'steps':<20}{'compile, s':>11}{'gradient, ms':>14}{'flight, ms':>12}{'to forward':>12}"
        f"{'to differences':>16}{'memory, MB':>12}"
    )
    good = True
    for name, options in ways().items():
        row = measure(name, options)
        good = good and max(row.against_forward, row.against_differences) < AGREEMENT_BAR
        good = good and row.compile_seconds < COMPILE_BAR
        print(
            f"{row.name:<20}{row.compile_seconds:>11.1f}{row.gradient:>14.2f}{row.flight:>12.3f}"
            f"{row.against_forward:>12.1e}{row.against_differences:>16.1e}{row.megabytes:>12.2f}"
        )
    print("all bars hold" if good else "A BAR IS MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
