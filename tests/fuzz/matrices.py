"""Sums, products, solves and inverses."""

from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
import scipy.linalg
from plans import Graded, Plan, finite, maker, refused, summed
from term import Shape


def positive(a: Any) -> Any:
    return np.tanh(a) @ np.swapaxes(np.tanh(a), -1, -2) + 2.0 * np.eye(np.shape(a)[0])


POSITIVE = "(tx.Tanh({0}) @ tx.Tanh({0}).T + 2.0 * np.eye(%d))"


def _reduced(source: Random) -> Shape:
    return source.choice([(2,), (3,), (4,), (6,), (2, 2), (2, 3), (3, 3), (4, 4), (2, 2, 3)])


@maker
def reduction(source: Random, shape: Shape) -> Plan | None:
    if shape:
        return None
    whole = _reduced(source)
    found = [("tx.linalg.Sum({0})", np.sum, whole)]
    vector = source.choice([(2,), (3,), (6,)])
    found += [
        ("tx.linalg.Norm({0})", lambda a: np.linalg.norm(a), vector),
        ("tx.linalg.Norm({0}, 1)", lambda a: np.linalg.norm(a, 1), vector),
        ('tx.linalg.Norm({0}, "inf")', lambda a: np.linalg.norm(a, np.inf), vector),
        ("tx.linalg.Norm({0})", lambda a: np.linalg.norm(a), (3, 3)),
        ('tx.linalg.Norm({0}, "inf")', lambda a: np.linalg.norm(a, np.inf), (2, 3)),
        ("tx.linalg.Trace({0})", np.trace, source.choice([(2, 2), (3, 3)])),
        ("np.sum({0})", np.sum, whole),
        ("tx.linalg.Norm({0})", np.linalg.norm, whole if len(whole) < 3 else (6,)),
        (
            "tx.Interp({0}, axes=[-1.0, -0.2, 0.5, 1.0, 3.0], values=[2.0, -1, 0.5, 1.0, 4.0])",
            lambda a: np.interp(a, [-1.0, -0.2, 0.5, 1.0, 3.0], [2.0, -1, 0.5, 1.0, 4.0]),
            (),
        ),
        ("tx.Linterp({0}, [-1, 0.5, 3], [2.0, -1, 0.5])", lambda a: np.interp(a, [-1, 0.5, 3], [2, -1, 0.5]), ()),
    ]  # fmt: skip
    code, numpy, arg = source.choice(found)
    return Plan(code, numpy, (arg,))


def products(code: str, numpy: Callable[..., Any], *args: Shape) -> Plan:
    return Plan(code, numpy, args, rounding=summed(numpy))


@maker
def product(source: Random, shape: Shape) -> Plan | None:
    n = source.choice([2, 3, 4])
    if shape == ():
        code = source.choice(["{0} @ {1}", "tx.linalg.Dot({0}, {1})", "np.dot({0}, {1})"])
        return products(f"({code})", np.dot, (n,), (n,))
    if len(shape) == 1:
        a, b = source.choice([((*shape, n), (n,)), ((n,), (n, *shape))])
        return products(source.choice(["({0} @ {1})", "np.dot({0}, {1})"]), np.matmul, a, b)
    if len(shape) == 2:
        found = [
            products("({0} @ {1})", np.matmul, (shape[0], n), (n, shape[1])),
            products("np.dot({0}, {1})", np.dot, (shape[0], n), (n, shape[1])),
            Plan("tx.linalg.Outer({0}, {1})", np.outer, ((shape[0],), (shape[1],))),
            Plan("{0}.T", np.transpose, ((shape[1], shape[0]),)),
            Plan("np.transpose({0})", np.transpose, ((shape[1], shape[0]),)),
        ]
        if shape == (3, 3):
            found.append(Plan("tx.spatial.SSM({0})", lambda a: np.cross(np.eye(3), a), ((3,),)))
        if shape[0] == shape[1]:
            found.append(Plan("tx.linalg.Diag({0})", np.diag, ((shape[0],),)))
        return source.choice(found)
    return products("({0} @ {1})", np.matmul, (*shape[:-1], n), (*shape[:-2], n, shape[-1]))


@maker
def refusable(source: Random, shape: Shape) -> Plan | None:
    """What NumPy means by it, where this package takes it at all."""
    if shape:
        return None
    found: list[tuple[str, Callable[..., Any], tuple[Shape, ...]]] = [
        ("np.sum(np.dot({0}, {1}) ** 2)", lambda a, b: np.sum(np.dot(a, b) ** 2), ((2, 2, 3), (2, 3, 2))),
        ("np.sum(np.dot({0}, {1}) ** 2)", lambda a, b: np.sum(np.dot(a, b) ** 2), ((2, 2, 3), (3,))),
        ("np.sum(np.fmax({0}, {1}))", lambda a, b: np.sum(np.fmax(a, b)), ((3,), (3,))),
        ("np.max(np.block([[{0}, {1}]]))", lambda a, b: np.max(np.block([[a, b]])), ((2, 2), (2, 3))),
    ]
    code, numpy, args = source.choice(found)
    return None if refused(code, args) else Plan(code, numpy, args)


def solved(A: Any, b: Any) -> Any:
    """Of finite numbers: of infinite ones eliminations give this or that."""
    return np.linalg.solve(finite(A), b)


def inverted(A: Any) -> Any:
    return np.linalg.inv(finite(A))


def inverting(A: Any) -> Any:
    """How far apart two inverses may be by rounding, in units of eps, entry by entry.

    Elimination gives a column x of one as that of a matrix A + D, |D| <= 3 n eps |L||U|, another D for each column, for
    which XLA may compute the factors anew: x is off by |A^-1||D||x|, and a product with b by |A^-1||D||A^-1||b|,
    however small A^-1 b is.
    Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), theorem 9.4, section 14.2.
    """
    rows, lower, upper = scipy.linalg.lu(A)
    sizes = np.abs(np.linalg.inv(A))
    return 2.0 * 3.0 * len(A) * sizes @ (rows @ np.abs(lower) @ np.abs(upper)) @ sizes


@maker
def solve(source: Random, shape: Shape) -> Plan | None:
    """Of positive definite matrices, and of any."""
    if not shape or len(shape) > 2:
        return None
    n = shape[0]
    # Operands of their own, so that noise is put on them: the error of LAPACK itself is that of its matrix.
    square = ((n, n), Plan(POSITIVE % n, positive, (), shape=(n, n)))
    rough = ((n, n), Plan(f"({{0}} + 0.25 * np.eye({n}))", lambda a: a + 0.25 * np.eye(n), (), shape=(n, n)))
    found = [Plan("tx.linalg.Solve({1}, {2})", lambda a, m, b: solved(m, b), (*own, shape)) for own in (square, rough)]
    graded = Graded(n)
    if n < 5:
        # A right-hand side of a solution of size one: there the error of an algorithm shows.
        right = Plan("({0} @ {1})", np.matmul, (), shape=shape, rounding=summed(np.matmul))
        found += 2 * [Plan("tx.linalg.Solve({0}, {2})", lambda a, x, b: solved(a, b), (graded, shape, right))]
        if shape == (n,):
            of_first = {"numpy": lambda a, *_: inverted(a), "rounding": lambda a, *_: inverting(a)}
            inverse = Plan("tx.linalg.Inv({0})", args=(), shape=(n, n), **of_first)
            found.append(Plan("({3} @ {2})", lambda a, x, b, own: own @ b, (graded, shape, right, inverse)))
        if shape == (n, n):
            found.append(Plan("tx.linalg.Inv({0})", inverted, (graded,), rounding=inverting))
    if shape == (n, n):
        of_last = {"numpy": lambda a, m: inverted(m), "rounding": lambda a, m: inverting(m)}
        found += [Plan("tx.linalg.Inv({1})", args=own, **of_last) for own in (square, rough)]
    return source.choice(found)
