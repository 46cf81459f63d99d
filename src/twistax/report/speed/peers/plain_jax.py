"""jax.numpy by hand."""

from __future__ import annotations

from ..case import Case
from ..contender import Contender
from ..quantity import Quantity
from ..task import JaxTask, Task
from .algebra import JaxAlgebra

__all__ = ["PlainJax"]


class PlainJax(Contender):
    name, colour = "plain JAX", "C7"
    how = (
        "jax.numpy as one writes it by hand, in 6x6 matrices, lists and Python loops (`peers/recursions.py`). "
        "Derivatives by `jax.jacfwd` and `jax.grad`."
    )

    def task(self, case: Case, quantity: Quantity) -> Task:
        algebra = JaxAlgebra()
        return JaxTask(case, lambda: quantity.by_jax(lambda a, b, c: case.by_hand(algebra, a, b, c)))
