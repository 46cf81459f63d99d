"""How exact the closed-form derivatives of a step are, and what they cost.

`python -m twistax.report.linearisation` prints the table. Exit status 1 if a figure is above its bar.

The references are the derivative (`jax.jacfwd`) of the logarithm of the difference between two flights, and Richardson
finite differences of it. The case is a rocket stage: a pose, a body twist and a mass under thrust, 0.5 s from rest to
where it turns by a few degrees.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..integrators import RKMK, VectorField
from ..integrators.tableaus import RK4
from ..lowering import Dynamics, compile
from ..scenes.powered_descent import Start, Vehicle, initial, system
from ..trajectory import discretize

__all__ = ["DIFFERENCES_BAR", "LOGARITHM_BAR", "Row", "main", "measured"]

LOGARITHM_BAR = 1e-12
"""Against the derivative of the logarithm; largest entry, unknowns in their scales."""

DIFFERENCES_BAR = 1e-8
"""Against Richardson finite differences; largest entry, unknowns in their scales."""

_STEP = 0.5  # s
_BATCH = 24


@dataclass(frozen=True)
class Row:
    """One way to get A, B and the derivative with respect to the step's length.

    Attributes:
        way: its name.
        error: largest difference from the closed form; nan for the closed form itself.
        bar: the largest allowed.
        compile_seconds: of a batch of 24 intervals, tracing included.
        microseconds: an interval, run in such a batch.
    """

    way: str
    error: float
    bar: float
    compile_seconds: float
    microseconds: float

    @property
    def holds(self) -> bool:
        return not self.error > self.bar


def measured() -> list[Row]:
    """The closed form, the derivative of the logarithm, and finite differences. Needs JAX's x64 switch."""
    dynamics, scale = compile(system()), np.concatenate([_lengths(), [_STEP]])
    xs, us = _points(dynamics)
    closed, *closed_cost = _timed(jax.vmap(lambda x, u: _closed(dynamics, x, u)), xs, us)
    log, *log_cost = _timed(jax.vmap(lambda x, u: _by_logarithm(dynamics, x, u)), xs, us)
    rich, *rich_cost = _timed(jax.vmap(lambda x, u: _by_differences(dynamics, jnp.asarray(scale), x, u)), xs, us)
    rows = scale[: dynamics.dimension, None]

    def apart(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.max(np.abs(a - b) * scale / rows))

    return [
        Row("closed form", float("nan"), float("nan"), *closed_cost),
        Row("jacfwd of the logarithm", apart(closed, log), LOGARITHM_BAR, *log_cost),
        Row("Richardson differences", apart(closed, rich), DIFFERENCES_BAR, *rich_cost),
    ]


def _lengths() -> np.ndarray:
    leaves = (*system().states, *system().controls)
    return np.concatenate([np.broadcast_to(np.asarray(leaf.scale), _size(leaf)).ravel() for leaf in leaves])


def _size(leaf: Any) -> tuple[int, ...]:
    return (leaf.group.dimension,) if hasattr(leaf, "group") else leaf.shape


def _points(dynamics: Dynamics) -> tuple[dict[str, Any], dict[str, Any]]:
    """States around the start of the descent and thrusts around 60 %, leading axis the batch."""
    rng, vehicle = np.random.default_rng(0), Vehicle()
    lengths = _lengths()
    moves = 0.3 * rng.normal(size=(_BATCH, dynamics.dimension)) * lengths[: dynamics.dimension]
    start = initial(Start(), vehicle)
    xs = jax.jit(jax.vmap(dynamics.retract, (None, 0)))(start, moves)
    thrust = vehicle.max_thrust * (np.array([0.0, 0.0, 0.6]) + 0.1 * rng.normal(size=(_BATCH, 3)))
    return xs, {"T": jnp.asarray(thrust)}


def _closed(dynamics: Dynamics, x: Any, u: Any) -> jax.Array:
    step = discretize(dynamics, 0.0, x, u, _STEP)
    return jnp.concatenate([step.A, step.B, step.h_derivative[:, None]], axis=1)


def _moved_end(dynamics: Dynamics, x: Any, u: Any) -> Callable[[jax.Array], jax.Array]:
    """The tangent from the planned end to the end of the flight that starts at x (+) d under u + du, h + dh."""
    n = dynamics.dimension

    def end(z: jax.Array) -> Any:
        inputs = dynamics._functions.prepare(0.0, dynamics.retract(x, z[:n]), {"T": u["T"] + z[n : n + 3]})
        control = dict(inputs.u)
        field = VectorField(dynamics, lambda _: control, dict(inputs.params))
        return RKMK(RK4).step(field, inputs.t, dict(inputs.x), _STEP + z[n + 3])

    planned = end(jnp.zeros(n + 4))
    return lambda z: dynamics.difference(planned, end(z))


def _by_logarithm(dynamics: Dynamics, x: Any, u: Any) -> jax.Array:
    return jax.jacfwd(_moved_end(dynamics, x, u))(jnp.zeros(dynamics.dimension + 4))


def _by_differences(dynamics: Dynamics, scale: jax.Array, x: Any, u: Any) -> jax.Array:
    end = jax.vmap(_moved_end(dynamics, x, u))

    def central(size: float) -> jax.Array:
        steps = size * jnp.diag(scale)
        return (end(steps) - end(-steps)).T / (2.0 * size * scale[None, :])

    return (4.0 * central(5e-4) - central(1e-3)) / 3.0


def _timed(function: Callable[..., jax.Array], *arguments: Any) -> tuple[Any, float, float]:
    """The result, seconds to trace and compile, and microseconds an interval at best of five runs."""
    begin = time.perf_counter()
    compiled = jax.jit(function).lower(*arguments).compile()
    seconds = time.perf_counter() - begin
    result = np.asarray(compiled(*arguments))
    runs = []
    for _ in range(5):
        begin = time.perf_counter()
        jax.block_until_ready(compiled(*arguments))
        runs.append(time.perf_counter() - begin)
    return result, seconds, min(runs) / _BATCH * 1e6


def main() -> int:
    """Prints the table; exit status 1 if a figure is above its bar."""
    jax.config.update("jax_enable_x64", True)
    rows = measured()
    print(f"{'A, B, dx/dh of an RKMK4 step by':<28}{'from the closed form':>22}{'bar':>9}{'compile':>10}{'a step':>11}")
    for row in rows:
        error, bar = ("-", "-") if np.isnan(row.error) else (f"{row.error:.1e}", f"{row.bar:.0e}")
        print(f"{row.way:<28}{error:>22}{bar:>9}{row.compile_seconds:>8.2f} s{row.microseconds:>8.1f} us")
    held = all(row.holds for row in rows)
    print("all bars hold" if held else "A BAR IS MISSED")
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
