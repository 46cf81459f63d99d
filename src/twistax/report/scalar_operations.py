"""How many scalar operations dynamics take once zeros, ones and repeated parts are gone, and whether the numbers agree.

`python -m twistax.report.scalar_operations` prints the table. Exit status 1 if a bar is missed. Operations are
additions, subtractions, products, divisions, changes of sign, sines and cosines; all agreement is with plain JAX
arrays, relative to the largest entry, over random states.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..expr import Control, Expr, State
from ..groups import SE3
from ..integrators.ambient import Ambient
from ..lowering import compile, lower
from ..lowering.scalar.derivatives import cotangent_program, jacobian
from ..lowering.scalar.primitive import Derived, call_program
from ..lowering.scalar.program import ScalarProgram, scalarize
from ..mechanics import SpatialInertia, chain_models, forward_dynamics, inverse_dynamics
from ..system import System
from .machine import machine

__all__ = ["Case", "cases", "main"]

#: Arrays to a list of arrays.
Function = Callable[..., list[jax.Array]]

VALUE_BAR, JACOBIAN_BAR = 1e-13, 1e-12
_STATES = 20


@dataclasses.dataclass(frozen=True)
class Case:
    """A function, and the bars of its scalar program.

    Attributes:
        name: as in the table.
        function: the dynamics in arrays.
        sizes: of its arguments, all vectors.
        bar: operations; None where there is none.
        seconds_bar: to write it out.
    """

    name: str
    function: Function
    sizes: tuple[int, ...]
    bar: int | None = None
    seconds_bar: float | None = None


def cases() -> list[Case]:
    """A free body with thirteen numbers, and chains of 7 and 30 links."""
    found = [Case("free body, quaternion", free_body(), (7, 6, 6), bar=230)]
    for links, chain in ((7, chain_models.panda()), (30, chain_models.equal_links(30))):
        names = ("q", "qd", "qdd"), ("q", "qd", "tau")
        seconds = 0.1 if links == 7 else 1.0
        rnea = _of_vectors(lambda a, b, c, chain=chain: inverse_dynamics(chain, a, b, c), names[0], links)
        aba = _of_vectors(lambda a, b, c, chain=chain: forward_dynamics(chain, a, b, c), names[1], links)
        found.append(Case(f"RNEA {links}", rnea, (links,) * 3, 1020 if links == 7 else None, seconds))
        found.append(Case(f"ABA {links}", aba, (links,) * 3, 1800 if links == 7 else None, seconds))
    return found


def free_body() -> Function:
    """Rates of a rigid body with full inertia and offset centre of mass, under weight and a wrench."""
    tensor = np.array([[0.05, 0.004, 0.002], [0.004, 0.04, 0.003], [0.002, 0.003, 0.03]])
    body = SpatialInertia(mass=2.3, center_of_mass=(0.05, -0.02, 0.08), inertia=tensor)
    g, V, F = State("g", group=SE3), State("V", shape=(6,)), Control("F", shape=(6,))
    rate = body.acceleration(V, F + body.weight(g, np.array([0.0, 0.0, -9.81])))
    ambient = Ambient(compile(System(rates={g: V, V: rate})), True)

    def function(g: jax.Array, V: jax.Array, F: jax.Array) -> list[jax.Array]:
        rates = ambient.vector_field(jnp.zeros(()), {"g": g, "V": V}, ({"F": F}, {}))
        return [rates["g"], rates["V"]]

    return function


def _of_vectors(dynamics: Callable[..., Expr], names: tuple[str, ...], size: int) -> Function:
    leaves = [State(name, shape=(size,)) for name in names]
    lowered = lower(dynamics(*leaves))
    return lambda *values: [lowered(0.0, dict(zip(names, values, strict=True)))]


def _disagreement(program: ScalarProgram, case: Case) -> tuple[float, float]:
    """The largest differences of values and of Jacobians from those of the arrays."""
    derived = Derived(program)

    def flat(function: Function) -> Callable[[jax.Array], jax.Array]:
        splits = np.cumsum(case.sizes)[:-1]
        return lambda z: jnp.concatenate(function(*jnp.split(z, splits)))

    scalars, arrays = flat(lambda *a: call_program(derived, *a)), flat(case.function)
    points = jnp.asarray(np.random.default_rng(0).normal(size=(_STATES, sum(case.sizes))))

    def worst(a: Any, b: Any) -> float:
        axes = tuple(range(1, a.ndim))
        return float(np.max(np.max(np.abs(a - b), axis=axes) / np.max(np.abs(b), axis=axes)))

    values = [np.asarray(jax.jit(jax.vmap(f))(points)) for f in (scalars, arrays)]
    slopes = [np.asarray(jax.jit(jax.vmap(jax.jacfwd(f)))(points)) for f in (scalars, arrays)]
    return worst(*values), worst(*slopes)


def _row(case: Case) -> bool:
    """Prints a row of the table; whether its bars hold."""
    shapes = [jax.ShapeDtypeStruct((n,), float) for n in case.sizes]
    closed = jax.make_jaxpr(case.function)(*shapes)
    seconds = min(_timed(lambda: scalarize(closed)) for _ in range(3))
    program = scalarize(closed)
    checks = [(program.operations, case.bar), (seconds, case.seconds_bar)]
    print(f"{case.name}: {program.operations} operations{_bar(case.bar)}", end="")
    print(f", unrolled in {seconds:.2f} s{_bar(case.seconds_bar)}", flush=True)
    if case.name == "ABA 7":
        slopes = jacobian(program, [0, 1])
        matrix = program.restricted([np.array(list(slopes.values()))]).operations
        gradient = cotangent_program(program, range(3)).operations
        print(f"  Jacobian by q and qd: {matrix}{_bar(16500)}; gradient of a weighted sum: {gradient}{_bar(5600)}")
        checks += [(matrix, 16500), (gradient, 5600)]
    if case.sizes[0] < 30:
        value, slope = _disagreement(program, case)
        print(
            f"  against arrays: values {value:.0e}{_bar(VALUE_BAR)}, Jacobian {slope:.0e}{_bar(JACOBIAN_BAR)}",
            flush=True,
        )
        checks += [(value, VALUE_BAR), (slope, JACOBIAN_BAR)]
    return all(bar is None or figure <= bar for figure, bar in checks)


def _timed(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _bar(bar: float | None) -> str:
    return "" if bar is None else f" (bar {bar:g})"


def main() -> int:
    """Prints the table; exit status 1 if a bar is missed."""
    jax.config.update("jax_enable_x64", True)
    print(machine())
    rows = [_row(case) for case in cases()]
    held = all(rows)
    print("all bars hold" if held else "A BAR IS MISSED")
    return 0 if held else 1


if __name__ == "__main__":
    raise SystemExit(main())
