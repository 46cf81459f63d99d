"""This package, with each of its backends."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import jax

import twistax as tx

from ...lowering.backends import Backend
from ...lowering.scalar.graph import TooLarge
from .case import Case
from .contender import Contender
from .quantity import JACOBIAN, Quantity
from .task import JaxTask, Task

__all__ = ["Arrays", "Native", "Scalars"]


class _Own(Contender):
    @abstractmethod
    def backend(self) -> Backend: ...

    def task(self, case: Case, quantity: Quantity) -> Task:
        system = case.system()
        return JaxTask(case, lambda: self._function(system, case, quantity))

    def _function(self, system: tx.System, case: Case, quantity: Quantity) -> Callable[..., Any]:
        dynamics = tx.compile(system, backend=self.backend())
        if quantity is JACOBIAN and self._writes_out(dynamics, case):

            def slopes(a: Any, b: Any, c: Any) -> list[jax.Array]:
                blocks = dynamics.jacobian(0.0, *case.inputs(a, b, c), wrt=case.by)
                return [blocks[kind] for kind in case.by]

            return slopes

        def function(a: Any, b: Any, c: Any) -> list[jax.Array]:
            rates = dynamics(0.0, *case.inputs(a, b, c))
            return [rates[name] for name in case.rates]

        return quantity.by_jax(function)

    def _writes_out(self, dynamics: tx.Dynamics, case: Case) -> bool:
        """Whether `dynamics.jacobian` is of use: it writes all scalars out, which takes a compiler long beyond some."""
        arguments = [points[0] for points in case.points(1)]
        try:
            found, _ = dynamics._functions.rate_jacobian(
                dynamics._functions.prepare(0.0, *case.inputs(*arguments)), case.by
            )
        except TooLarge:
            return False
        return found.program.operations <= tx.XLA().largest


class Scalars(_Own):
    name, colour = "twistax XLA", "C0"
    how = (
        "`tx.compile(system, backend=tx.XLA())`: scalars where it writes functions out, arrays below. Jacobians by "
        "`dynamics.jacobian` up to 30,000 operations, by `jax.jacfwd` beyond; gradients by `jax.grad`."
    )

    def backend(self) -> Backend:
        return tx.XLA()


class Arrays(_Own):
    name, colour = "twistax arrays", "C9"
    how = "`tx.compile(system, backend=tx.JAX())`: small arrays as they are written. Derivatives by JAX."

    def backend(self) -> Backend:
        return tx.JAX()

    def _writes_out(self, dynamics: tx.Dynamics, case: Case) -> bool:
        return False


class Native(_Own):
    name, colour = "twistax native", "C3"
    how = "`tx.compile(system, backend=tx.Native())`: kernels compiled in process. Derivatives as with XLA."
    packages = (("llvmlite", "llvmlite"),)

    def backend(self) -> Backend:
        return tx.Native()
