"""Tasks that are timed in several uses, and the contenders of this package and of plain JAX."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import math
import shutil
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ...scalar.backends import Backend
from ...scalar.graph import TooLarge
from ..harness import timing
from ..harness.timing import Timed, compiled
from .cases import EvaluatedFunction

#: Calls from Python that are timed together.
CALLS = 20
#: What a loop feeds back is multiplied by this: it changes nothing, and no compiler can know.
TINY = 1e-200
#: Bytes that a program may need beside its arguments and results.
_MEMORY = 8e9

#: Three vectors to arrays, traceable; one after the other along the last axis they are the result.
Function = Callable[[Any, Any, Any], list[Any]]


class Lacks(Exception):
    """A contender has no such task; the message says why."""


def values(timed: Timed) -> NDArray[np.float64]:
    """The results of a call as one array: what comes in parts is joined here, where nothing is timed."""
    parts = jax.tree.leaves(timed.result())
    return np.concatenate([np.asarray(part, np.float64) for part in parts], axis=-1)


def relative_difference(results: NDArray[np.float64], reference: NDArray[np.float64], rank: int) -> float:
    """The largest difference of entries over the largest of the reference, the worst of all points.

    Infinite where shapes differ or something is not finite. The rank is that of one result.
    """
    if results.shape != reference.shape or not np.all(np.isfinite(results)):
        return math.inf
    axes = tuple(range(results.ndim - rank, results.ndim))
    return float(np.max(np.max(np.abs(results - reference), axis=axes) / np.max(np.abs(reference), axis=axes)))


class DerivativeKind(NamedTuple):
    """What is evaluated of a function: its value, its Jacobian or a gradient."""

    name: str  # for tables
    title: str  # for the page
    shape: Callable[[EvaluatedFunction], tuple[int, ...]]  # of the result of a case
    by_jax: Callable[[Function], Function]  # of a traceable function


def _jacobian(function: Function) -> Function:
    slopes = jax.jacfwd(lambda a, b, c: jnp.concatenate(function(a, b, c), axis=-1), argnums=(0, 1))
    return lambda a, b, c: list(slopes(a, b, c))


def _gradient(function: Function) -> Function:
    slopes = jax.grad(lambda a, b, c: sum(map(jnp.sum, function(a, b, c))), argnums=(0, 1))
    return lambda a, b, c: list(slopes(a, b, c))


_SLOPES, _TOTAL = "Jacobian by the first two arguments", "gradient of the sum of the results by the first two arguments"
VALUE = DerivativeKind("value", "value", lambda case: (case.results,), lambda function: function)
JACOBIAN = DerivativeKind("jacobian", _SLOPES, lambda case: (case.results, sum(case.sizes[:2])), _jacobian)
GRADIENT = DerivativeKind("gradient", _TOTAL, lambda case: (sum(case.sizes[:2]),), _gradient)
QUANTITIES = (VALUE, JACOBIAN, GRADIENT)

# ---- uses and tasks -------------------------------------------------------------------------------------------------

#: A quantity of a case by a contender: `single()`, `loop(steps)` and `batch(count)`, or they raise `Lacks`.
Task = Any


@dataclasses.dataclass(frozen=True)
class Use:
    """How a task is called: once, in a loop or as a batch."""

    name: str
    of: Callable[[Task], Timed]
    count: int = 0  # of points at once; zero if it is no batch


def batch(count: int) -> Use:
    """The use of a task for many points at once."""
    return Use(f"batch of {count:,}", lambda task: task.batch(count), count)


SINGLE = Use("single call", lambda task: task.single())
LOOP = Use("in a loop", lambda task: task.loop(1000))
USES: tuple[Use, ...] = (SINGLE, LOOP, *map(batch, (64, 4096, 65536)))


class JaxTask:
    """A traceable function under jit, scan and vmap, all as JAX does it by default. It gives the parts of the result.

    It is made anew for each use, so that what is found when it is traced counts as compiling.

    Args:
        around: what becomes of the whole, the loop or the batch too.
    """

    def __init__(
        self, case: EvaluatedFunction, make: Callable[[], Function], around: Callable[[Any], Any] = jax.jit
    ) -> None:
        self._case, self._make, self._around = case, make, around

    def single(self) -> Timed:
        """`CALLS` calls from Python, one after the other, each waited for."""
        return self._compiled(lambda function: function, calls=CALLS)

    def loop(self, steps: int) -> Timed:
        """A compiled loop in which each evaluation waits for the one before."""

        def looped(function: Function) -> Callable[..., Any]:
            def step(carry: tuple[Any, Any], _: None) -> tuple[Any, None]:
                arguments, _before = carry
                result = function(*arguments)
                # The first part is as long as any argument.
                fed = result[0].reshape(-1)
                return (tuple(a + TINY * fed[: a.size] for a in arguments), result), None

            def run(*point: Any) -> Any:
                first = jax.tree.map(lambda r: jnp.zeros(r.shape, r.dtype), jax.eval_shape(function, *point))
                return jax.lax.scan(step, (point, first), None, length=steps)[0][1]

            return run

        return self._compiled(looped, evaluations=steps)

    def batch(self, count: int) -> Timed:
        """Many points at once."""
        return self._compiled(jax.vmap, count, evaluations=count)

    def in_place(self, count: int) -> Timed:
        """Many points at once, where a call writes its results over those of the call before."""
        return timing.batch(self._make(), *self._case.points(count))

    def _compiled(self, use: Callable[[Function], Any], points: int = 0, **counts: int) -> Timed:
        arguments = [jnp.asarray(a if points else a[0]) for a in self._case.points(points or 1)]
        begin = time.perf_counter()
        function = self._around(use(self._make()))
        made = time.perf_counter() - begin
        timed = compiled(function, *arguments, **counts)
        timed.compile_seconds += made
        if timed.memory > _MEMORY:
            raise Lacks(f"it would need {timed.memory / 1e9:.0f} GB")
        return timed


@dataclasses.dataclass(frozen=True, eq=False)
class Contender:
    """A package, or a backend of ours, that evaluates dynamics. Its sentence on the page stands in `sections.toml`."""

    name: str  # in tables
    colour: str  # in figures
    task: Callable[[EvaluatedFunction, DerivativeKind], Task]  # raises `Lacks` where there is none
    package: str = ""  # needed, as pip calls it
    module: str = ""  # and as Python does, if another name
    tool: str = ""  # needed, as the command line calls it

    def absent(self) -> str | None:
        """Why it cannot take part on this machine; None if it can."""
        if self.package and importlib.util.find_spec(self.module or self.package) is None:
            return f"{self.package} is not installed"
        return f"there is no {self.tool}" if self.tool and shutil.which(self.tool) is None else None


def _twistax(backend: Backend, case: EvaluatedFunction, quantity: DerivativeKind) -> Task:
    """This package with a backend; derivatives by JAX where it does not unroll them itself."""
    system = case.system()

    def make() -> Function:
        dynamics = tx.compile(system, backend=backend)
        if quantity is JACOBIAN and not isinstance(backend, tx.JAX) and _unrolls(dynamics, case):

            def slopes(a: Any, b: Any, c: Any) -> list[jax.Array]:
                blocks = dynamics.jacobian(0.0, *case.inputs(a, b, c), wrt=case.by)
                return [blocks[kind] for kind in case.by]

            return slopes
        return quantity.by_jax(case.run_by(dynamics))

    return JaxTask(case, make)


def _unrolls(dynamics: tx.Dynamics, case: EvaluatedFunction) -> bool:
    """Whether `dynamics.jacobian` is of use: it unrolls all scalars, which takes a compiler long beyond some."""
    arguments, inside = [points[0] for points in case.points(1)], dynamics.functions
    try:
        slopes, _ = inside.rate_jacobian(inside.prepare(0.0, *case.inputs(*arguments)), case.by)
    except TooLarge:
        return False
    return slopes.program.operations <= tx.XLA().largest


SCALARS = Contender("twistax XLA", "C0", functools.partial(_twistax, tx.XLA()))
NATIVE = Contender("twistax native", "C3", functools.partial(_twistax, tx.Native()), package="llvmlite")
NATIVE_ALONE = Contender(
    "twistax native, one thread", "C8", functools.partial(_twistax, tx.Native(threads=1)), package="llvmlite"
)
ARRAYS = Contender("twistax arrays", "C9", functools.partial(_twistax, tx.JAX()))


def _plain(case: EvaluatedFunction, quantity: DerivativeKind) -> Task:
    return JaxTask(case, lambda: quantity.by_jax(functools.partial(case.by_hand, jnp)))


PLAIN = Contender("plain JAX", "C7", _plain)
