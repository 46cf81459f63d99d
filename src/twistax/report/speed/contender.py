"""Who takes part: this package with each of its backends, plain jax.numpy, and what others derive from."""

from __future__ import annotations

import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any

import jax
import jax.numpy as jnp

import twistax as tx

from ...lowering.backends import Backend
from ...lowering.scalar.graph import TooLarge
from .by_hand import Matrices
from .case import Case
from .programs import JACOBIAN, JaxTask, Quantity, Task

__all__ = ["ARRAYS", "NATIVE", "PLAIN", "SCALARS", "Contender", "PlainJax", "Twistax"]


class Contender(ABC):
    """A way to have dynamics evaluated.

    Attributes:
        name: in tables.
        how: what is done, a sentence for the page.
        colour: in figures.
        packages: needed, as pip and as Python call them.
    """

    name: str
    how: str
    colour: str
    packages: Sequence[tuple[str, str]] = ()

    def absent(self) -> str | None:
        """Why it cannot take part on this machine; None if it can."""
        for package, module in self.packages:
            if importlib.util.find_spec(module) is None:
                return f"{package} is not installed"
        return None

    def versions(self) -> dict[str, str]:
        """Of what it needs, where it is there."""
        return {package: metadata.version(package) for package, _ in self.packages}

    @abstractmethod
    def task(self, case: Case, quantity: Quantity) -> Task:
        """Raises `Lacks` where it has none."""


class Twistax(Contender):
    """This package with a backend; derivatives by JAX where it does not unroll them itself."""

    def __init__(self, name: str, colour: str, backend: Backend, how: str, packages: Any = ()) -> None:
        self.name, self.colour, self._backend, self.packages = name, colour, backend, packages
        self.how = f"`tx.compile(system, backend=tx.{type(backend).__name__}())`: {how}"

    def task(self, case: Case, quantity: Quantity) -> Task:
        system = case.system()
        return JaxTask(case, lambda: self._function(system, case, quantity))

    def _function(self, system: tx.System, case: Case, quantity: Quantity) -> Callable[..., Any]:
        dynamics = tx.compile(system, backend=self._backend)
        if quantity is JACOBIAN and self._unrolls(dynamics, case):

            def slopes(a: Any, b: Any, c: Any) -> list[jax.Array]:
                blocks = dynamics.jacobian(0.0, *case.inputs(a, b, c), wrt=case.by)
                return [blocks[kind] for kind in case.by]

            return slopes

        def function(a: Any, b: Any, c: Any) -> list[jax.Array]:
            rates = dynamics(0.0, *case.inputs(a, b, c))
            return [rates[name] for name in case.rates]

        return quantity.by_jax(function)

    def _unrolls(self, dynamics: tx.Dynamics, case: Case) -> bool:
        """Whether `dynamics.jacobian` is of use: it unrolls all scalars, which takes a compiler long beyond some."""
        if isinstance(self._backend, tx.JAX):
            return False
        arguments = [points[0] for points in case.points(1)]
        try:
            inside = dynamics._functions
            found, _ = inside.rate_jacobian(inside.prepare(0.0, *case.inputs(*arguments)), case.by)
        except TooLarge:
            return False
        return found.program.operations <= tx.XLA().largest


class PlainJax(Contender):
    name, colour = "plain JAX", "C7"
    how = (
        "jax.numpy as one writes it by hand, in 6x6 matrices, lists and Python loops (`by_hand.py`). Derivatives by "
        "`jax.jacfwd` and `jax.grad`."
    )

    def task(self, case: Case, quantity: Quantity) -> Task:
        matrices = Matrices(jnp)
        return JaxTask(case, lambda: quantity.by_jax(lambda a, b, c: case.by_hand(matrices, a, b, c)))


SCALARS = Twistax(
    "twistax XLA",
    "C0",
    tx.XLA(),
    "scalars where it unrolls functions, arrays below. Jacobians by `dynamics.jacobian` up to 30,000 operations, by "
    "`jax.jacfwd` beyond; gradients by `jax.grad`.",
)
NATIVE = Twistax(
    "twistax native",
    "C3",
    tx.Native(),
    "kernels compiled in process. Derivatives as with XLA.",
    packages=(("llvmlite", "llvmlite"),),
)
ARRAYS = Twistax("twistax arrays", "C9", tx.JAX(), "small arrays as they are written. Derivatives by JAX.")
PLAIN = PlainJax()
