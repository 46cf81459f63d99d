"""What a term may do, as a plan: its code, the same by NumPy, and which operands it wants. Makers draw plans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from random import Random
from typing import Any

import numpy as np
from term import Shape

import twistax as tx


@dataclass(frozen=True)
class Graded:
    """Wanted as an operand: a leaf that is a matrix n x n of a large condition number."""

    n: int

    def matrix(self, source: Random) -> np.ndarray:
        generator = np.random.default_rng(source.getrandbits(32))
        left, right = (np.linalg.qr(generator.normal(size=(self.n, self.n)))[0] for _ in range(2))
        return (left * np.geomspace(1.0, 10.0 ** -source.uniform(4.0, 10.0), self.n)) @ right


@dataclass(frozen=True)
class Plan:
    """An operation that gives a wanted shape: code with a field for each operand, NumPy's function, the operands.

    An operand is wanted by its shape, or as a plan of the operands before it.

    Attributes:
        rounding: of the operands' values: how far rounding may move the result beyond a few units of its last place, in
            units of eps. None: no farther.
    """

    code: str
    numpy: Callable[..., Any]
    args: tuple[Operand, ...]
    setup: str = ""
    shape: Shape = ()
    rounding: Callable[..., Any] | None = None


Operand = Shape | Graded | Plan


Maker = Callable[[Random, Shape], Plan | None]
MAKERS: list[Maker] = []


def maker(function: Maker) -> Maker:
    MAKERS.append(function)
    return function


def smaller(source: Random, shape: Shape) -> Shape:
    """A shape that broadcasts to this one."""
    return source.choice([shape, shape, shape, (), shape[1:], tuple(1 if source.random() < 0.3 else n for n in shape)])


def summed(products: Callable[..., Any]) -> Callable[..., Any]:
    """The rounding of a sum of products, by the sum of their sizes: one of them may be rounded and the other not.

    n eps sum |a_i b_i| for n terms, of which there are at most six here, and one more for the product.
    Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), section 3.1.
    """
    return lambda *operands: 7.0 * products(*map(np.abs, operands))


@cache
def refused(code: str, shapes: tuple[Shape, ...]) -> bool:
    """Whether no such expression can be built."""
    leaves = [tx.State(f"a{k}", shape=shape) for k, shape in enumerate(shapes)]
    names = {f"a{k}": leaf for k, leaf in enumerate(leaves)}
    try:
        eval(code.format(*names), {"tx": tx, "np": np, **names})
    except (TypeError, ValueError):
        return True
    return False


def finite(A: Any) -> Any:
    """The array; nothing is expected of others."""
    if not np.all(np.isfinite(A)):
        raise np.linalg.LinAlgError("not finite")
    return A
