"""One quantity of one case as one contender does it, in each of the ways it is used."""

from __future__ import annotations

import dataclasses
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from .case import Case

__all__ = ["CALLS", "TINY", "JaxTask", "Lacks", "Program", "Task"]

#: Calls from Python that are timed together.
CALLS = 20

#: What a loop feeds back is multiplied by this: it changes nothing, and no compiler can know.
TINY = 1e-200

#: Bytes that a program may need beside its arguments and results, and for these.
_MEMORY = 8e9


class Lacks(Exception):
    """A contender has no such task; the message says why."""


@dataclasses.dataclass
class Program:
    """What is timed.

    Attributes:
        call: a call, its results waited for or to be waited for.
        evaluations: in one call.
        compile_seconds: from the expression to what can be called.
    """

    call: Callable[[], Any]
    evaluations: int
    compile_seconds: float

    def values(self) -> NDArray[np.float64]:
        """The results of a call as one array: what comes in parts is joined here, where nothing is timed."""
        parts = jax.tree.leaves(jax.block_until_ready(self.call()))
        return np.concatenate([np.asarray(part, np.float64) for part in parts], axis=-1)


class Task(ABC):
    """Ways of use. Each raises `Lacks` if there is none."""

    @abstractmethod
    def single(self) -> Program:
        """Calls from Python, one after the other, each waited for."""

    @abstractmethod
    def loop(self, steps: int) -> Program:
        """A compiled loop in which each evaluation waits for the one before."""

    @abstractmethod
    def batch(self, count: int) -> Program:
        """Many points at once."""


class JaxTask(Task):
    """A traceable function under jit, scan and vmap, all as JAX does it by default. It gives the parts of the result.

    Args:
        make: makes the function anew, so that what it works out when it is traced counts as compiling.
    """

    def __init__(self, case: Case, make: Callable[[], Callable[..., Any]]) -> None:
        self._case, self._make = case, make

    def single(self) -> Program:
        run, arguments, seconds = self._compiled(lambda function: function, *self._point())

        def calls() -> Any:
            for _ in range(CALLS):
                result = jax.block_until_ready(run(*arguments))
            return result

        return Program(calls, CALLS, seconds)

    def loop(self, steps: int) -> Program:
        def looped(function: Callable[..., Any]) -> Callable[..., Any]:
            def step(carry: tuple[Any, Any], _: None) -> tuple[Any, None]:
                arguments, _before = carry
                result = function(*arguments)
                # The first part is as long as any argument.
                fed = result[0].reshape(-1)
                return (tuple(a + TINY * fed[: a.size] for a in arguments), result), None

            def run(*arguments: Any) -> Any:
                first = jax.tree.map(lambda r: jax.numpy.zeros(r.shape, r.dtype), jax.eval_shape(function, *arguments))
                return jax.lax.scan(step, (arguments, first), None, length=steps)[0][1]

            return run

        run, arguments, seconds = self._compiled(looped, *self._point())
        return Program(lambda: run(*arguments), steps, seconds)

    def batch(self, count: int) -> Program:
        run, arguments, seconds = self._compiled(jax.vmap, *map(jax.numpy.asarray, self._case.points(count)))
        return Program(lambda: run(*arguments), count, seconds)

    def _point(self) -> list[jax.Array]:
        return [jax.numpy.asarray(each[0]) for each in self._case.points(1)]

    def _compiled(self, use: Callable[..., Any], *arguments: jax.Array) -> tuple[Any, Any, float]:
        begin = time.perf_counter()
        run = jax.jit(use(self._make()))
        compiled = run.lower(*arguments).compile()
        seconds = time.perf_counter() - begin
        needed = compiled.memory_analysis()
        if needed is not None and needed.temp_size_in_bytes + needed.output_size_in_bytes > _MEMORY:
            total = needed.temp_size_in_bytes + needed.output_size_in_bytes
            raise Lacks(f"it would need {total / 1e9:.0f} GB")
        return run, arguments, seconds
