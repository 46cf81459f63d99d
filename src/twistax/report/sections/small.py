"""Small matrices by `tx.fast`: beside C in a scan, and beside JAX in a batch."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ..checks import Absent, Check, Section, agree, apart, at_most, between, raced
from ..speed.cases import FREE_BODY
from ..speed.contenders import CASADI, VALUE, JaxTask
from ..timing import Repeats, Timed, in_turn
from .steps import C_ARRAY, FLAGS, c_loop

_STEPS = 10_000


@functools.cache
def loops(n: int) -> dict[str, Timed]:
    """10,000 products of n x n matrices, each of which waits for the one before."""
    matrix = 0.99 * np.eye(n) + 0.01 / n

    def products(matrix: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda c, _: (matrix @ c, None), jnp.eye(n), None, length=_STEPS)[0]

    def by_c(flags: tuple[str, ...]) -> Timed:
        source = Path(__file__).with_name("powers.c")
        loop = c_loop(source, "powers", [C_ARRAY, C_ARRAY, ctypes.c_long], *flags, f"-DN={n}")

        def call() -> np.ndarray:
            product = np.eye(n)
            loop(matrix, product, _STEPS)
            return product

        return Timed(call, _STEPS)

    runs = {"tx.fast": tx.fast(products), "JAX": jax.jit(products)}
    in_c = {" ".join(flags): by_c(flags) for flags in FLAGS}
    ours = {name: Timed(functools.partial(run, jnp.asarray(matrix)), _STEPS) for name, run in runs.items()}
    ways = raced(in_c | ours, 1e-12, Repeats(9, 5))
    return ways | {"C": min(in_c.values(), key=lambda each: each.seconds)}


@functools.cache
def free_body() -> dict[str, Timed]:
    """A compiled free body in a scan of the user's, each evaluation waits for the one before; C is CasADi's."""
    if why := CASADI.absent():
        raise Absent(f"not run: {why}")
    make = lambda: FREE_BODY.run_by(tx.compile(FREE_BODY.system()))  # noqa: E731
    tasks = {"C": CASADI.task(FREE_BODY, VALUE)}
    tasks |= {name: JaxTask(FREE_BODY, make, around) for name, around in (("tx.fast", tx.fast), ("JAX", jax.jit))}
    runs = {name: task.loop(1000) for name, task in tasks.items()}
    return raced(runs, 1e-12, Repeats(9, 5), lambda end: np.concatenate(list(map(np.ravel, jax.tree.leaves(end)))))


def solves() -> float:
    """10,000 systems of three equations at once: the time by `tx.fast` over that by JAX."""
    random = np.random.default_rng(0)
    a, b = jnp.asarray(random.normal(size=(_STEPS, 3, 3))), jnp.asarray(random.normal(size=(_STEPS, 3)))
    runs = [jax.jit(jax.vmap(solve)) for solve in (tx.fast(jnp.linalg.solve), jnp.linalg.solve)]
    timed = [Timed(functools.partial(run, a, b), _STEPS) for run in runs]
    fast, plain = (each.result() for each in timed)
    # Some of the matrices are nearly singular.
    agree(apart(fast, plain) / float(jnp.abs(plain).max()), 1e-9)
    in_turn(timed, Repeats(9, 5))
    return timed[0].seconds / timed[1].seconds


_over_c = lambda ways, by: ways()[by].seconds / ways()["C"].seconds  # noqa: E731
_RACES: dict[str, Callable[[], dict[str, Timed]]] = {
    f"products of {n}x{n} in a scan": functools.partial(loops, n) for n in (3, 6)
}
_RACES["free body in a scan"] = free_body

SMALL: Section = [
    *(
        Check(f"{what}: time over C", by, bar, _over_c, ways, by)
        for what, ways in _RACES.items()
        for by, bar in (("tx.fast", at_most(1.5)), ("JAX", between()))
    ),
    Check("10,000 solves of 3x3: time over `jax.vmap`", "tx.fast", at_most(0.2), solves),
]
