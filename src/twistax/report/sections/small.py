"""Loops and batches of small matrices by `tx.fast`, beside the same in C and by JAX alone."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ..checks import Check, Section, agree, at_most, between
from ..timing import Repeats, Timed, in_turn
from .steps import FLAGS, apart, in_c

_REPEATS = Repeats(9, 5)
_STEPS = 10_000


@functools.cache
def loops(n: int) -> dict[str, Timed]:
    """10,000 products of n x n matrices, each of which waits for the one before."""
    matrix = 0.99 * np.eye(n) + 0.01 / n

    def products(matrix: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda c, _: (matrix @ c, None), jnp.eye(n), None, length=_STEPS)[0]

    def by_c(flags: tuple[str, ...]) -> Timed:
        loop = in_c(Path(__file__).with_name("powers.c"), *flags, f"-DN={n}").powers
        array = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
        loop.argtypes, loop.restype = [array, array, ctypes.c_long], None

        def call() -> np.ndarray:
            product = np.eye(n)
            loop(matrix, product, _STEPS)
            return product

        return Timed(call, _STEPS)

    given = jnp.asarray(matrix)
    fast, plain = tx.fast(products), jax.jit(products)
    found = {"tx.fast": Timed(lambda: fast(given), _STEPS), "JAX": Timed(lambda: plain(given), _STEPS)}
    in_turns = [by_c(flags) for flags in FLAGS]
    for each in (*found.values(), *in_turns):
        agree(apart(each.result(), in_turns[0].result()), 1e-12)
    in_turn([*found.values(), *in_turns], _REPEATS)
    return found | {"C": min(in_turns, key=lambda each: each.seconds)}


@functools.cache
def solves() -> dict[str, Timed]:
    """10,000 systems of three equations at once."""
    random = np.random.default_rng(0)
    a, b = jnp.asarray(random.normal(size=(_STEPS, 3, 3))), jnp.asarray(random.normal(size=(_STEPS, 3)))
    plain, fast = (jax.jit(jax.vmap(solve)) for solve in (jnp.linalg.solve, tx.fast(jnp.linalg.solve)))
    found = {"tx.fast": Timed(lambda: fast(a, b), _STEPS), "JAX": Timed(lambda: plain(a, b), _STEPS)}
    # Some of the matrices are nearly singular.
    agree(apart(found["tx.fast"].result(), found["JAX"].result()) / float(jnp.abs(plain(a, b)).max()), 1e-9)
    in_turn(list(found.values()), _REPEATS)
    return found


def _over_c(n: int, by: str) -> float:
    return loops(n)[by].seconds / loops(n)["C"].seconds


SMALL: Section = [
    *(
        Check(f"products of {n}x{n} in a scan: time over C", by, bar, _over_c, n, by)
        for n in (3, 6)
        for by, bar in (("tx.fast", at_most(1.5)), ("JAX", between()))
    ),
    Check(
        "10,000 solves of 3x3: time over `jax.vmap`",
        "tx.fast",
        at_most(0.2),
        lambda: solves()["tx.fast"].seconds / solves()["JAX"].seconds,
    ),
]
