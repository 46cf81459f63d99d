"""Small matrices by `tx.fast`: compared with C in a scan, and with JAX."""

import ctypes
import functools
import runpy
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ..harness.expected import Absent, at_most, between
from ..harness.measurement import Section, quick
from ..harness.timing import Race, Repeats, Timed
from ..speed.cases import FREE_BODY
from ..speed.contenders import VALUE, JaxTask
from ..speed.peers import CASADI
from .steps import C_ARRAY, FLAGS, c_loop

_STEPS, _REPEATS = 10_000, Repeats(9, 5)


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
    ours = {name: Timed(functools.partial(run, jnp.asarray(matrix)), _STEPS) for name, run in runs.items()}
    return {f"C {' '.join(flags)}": by_c(flags) for flags in FLAGS} | ours


def free_body() -> dict[str, Timed]:
    """A compiled free body in a scan of the user's, each evaluation waits for the one before; C is CasADi's."""
    if why := CASADI.absent():
        raise Absent(f"not run: {why}")
    make = lambda: FREE_BODY.run_by(tx.compile(FREE_BODY.system()))  # noqa: E731
    tasks = {"C": CASADI.task(FREE_BODY, VALUE)}
    tasks |= {name: JaxTask(FREE_BODY, make, around) for name, around in (("tx.fast", tx.fast), ("JAX", jax.jit))}
    return {name: task.loop(1000) for name, task in tasks.items()}


def _over_c(race: Race, name: str) -> float:
    return race.seconds(name) / min(race.seconds(c) for c in race.programs if c.startswith("C"))


#: The programs of `examples/small_matrices.py`, as it calls them.
_REPORTED = (
    "36799: 10,000 products of 3x3",
    "36799: 10,000 solves of 3x3",
    "40150: sixty scalars",
    "40150: their gradient",
    "26145: neuron",
    "26145: its gradient",
    "26145: 256 neurons",
    "26021: mass matrix of 20 joints",
)


@functools.cache
def _reported() -> dict[str, tuple[Any, ...]]:
    """What users of JAX reported as slow, by name: by `jax.jit`, by `tx.fast`, and the arguments."""
    path = Path(__file__).parents[4] / "examples" / "small_matrices.py"
    if not path.exists():
        raise Absent("not run: the examples are only in the repository of the package")
    return {name: case for name, *case in runpy.run_path(str(path))["cases"]()}


def reported(name: str) -> float:
    """The time of one of them by `tx.fast` over that by the JAX that is installed."""
    plain, fast, arguments = _reported()[name]
    programs = {"JAX": Timed(lambda: plain(*arguments)), "tx.fast": Timed(lambda: fast(*arguments))}
    # Relative to the largest: some of the matrices are nearly singular.
    scale = jnp.abs(plain(*arguments)).max()
    return Race(lambda: programs, 1e-9, _REPEATS, lambda result: result / scale).ratio("tx.fast", "JAX")


_RACES = {f"products of {n}x{n} in a scan": Race(functools.partial(loops, n), 1e-12, _REPEATS) for n in (3, 6)}
_RACES["free body in a scan"] = Race(
    free_body, 1e-12, _REPEATS, lambda end: np.concatenate(list(map(np.ravel, jax.tree.leaves(end))))
)

SMALL: Section = [
    *(
        quick(f"{what}: time over C", by, bar, _over_c, race, by)
        for what, race in _RACES.items()
        for by, bar in (("tx.fast", at_most(1.5)), ("JAX", between()))
    ),
    *(quick(f"{name}: time over JAX", "tx.fast", at_most(0.2), reported, name) for name in _REPORTED),
]
