"""What is timed: a quantity of a case, in one of its uses, as something to call."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..timing import Timed, compiled
from .cases import Case

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


# ---- quantities -----------------------------------------------------------------------------------------------------


class Quantity(NamedTuple):
    """Of a function."""

    name: str  # for tables
    title: str  # for the page
    shape: Callable[[Case], tuple[int, ...]]  # of the result of a case
    by_jax: Callable[[Function], Function]  # of a traceable function


def _jacobian(function: Function) -> Function:
    slopes = jax.jacfwd(lambda a, b, c: jnp.concatenate(function(a, b, c), axis=-1), argnums=(0, 1))
    return lambda a, b, c: list(slopes(a, b, c))


def _gradient(function: Function) -> Function:
    slopes = jax.grad(lambda a, b, c: sum(map(jnp.sum, function(a, b, c))), argnums=(0, 1))
    return lambda a, b, c: list(slopes(a, b, c))


_SLOPES, _TOTAL = "Jacobian by the first two arguments", "gradient of the sum of the results by the first two arguments"
VALUE = Quantity("value", "value", lambda case: (case.results,), lambda function: function)
JACOBIAN = Quantity("jacobian", _SLOPES, lambda case: (case.results, case.columns), _jacobian)
GRADIENT = Quantity("gradient", _TOTAL, lambda case: (case.columns,), _gradient)
QUANTITIES = (VALUE, JACOBIAN, GRADIENT)

# ---- uses and tasks -------------------------------------------------------------------------------------------------

#: A quantity of a case by a contender: `single()`, `loop(steps)` and `batch(count)`, or they raise `Lacks`.
Task = Any


@dataclasses.dataclass(frozen=True)
class Use:
    """What a task is asked for."""

    name: str
    of: Callable[[Task], Timed]
    count: int = 0  # of points at once; zero if it is no batch


def batch(count: int) -> Use:
    """For many points at once."""
    return Use(f"batch of {count:,}", lambda task: task.batch(count), count)


SINGLE = Use("single call", lambda task: task.single())
LOOP = Use("in a loop", lambda task: task.loop(1000))
USES: tuple[Use, ...] = (SINGLE, LOOP, *map(batch, (64, 4096, 65536)))


class JaxTask:
    """A traceable function under jit, scan and vmap, all as JAX does it by default. It gives the parts of the result.

    It is made anew for each use, so that what is found when it is traced counts as compiling.
    """

    def __init__(self, case: Case, make: Callable[[], Function]) -> None:
        self._case, self._make = case, make

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

    def _compiled(self, use: Callable[[Function], Any], points: int = 0, **counts: int) -> Timed:
        """For one point, or for a batch of them."""
        arguments = [jnp.asarray(each if points else each[0]) for each in self._case.points(points or 1)]
        begin = time.perf_counter()
        function = use(self._make())
        made = time.perf_counter() - begin
        timed = compiled(function, *arguments, **counts)
        timed.compile_seconds += made
        if timed.memory > _MEMORY:
            raise Lacks(f"it would need {timed.memory / 1e9:.0f} GB")
        return timed
