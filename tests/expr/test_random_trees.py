"""Random trees: the value against an independent NumPy evaluation, and the canonical form against the original."""

from collections.abc import Callable
from random import Random
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import function_of
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from twistax import expr as tx

SHAPES: list[tuple[int, ...]] = [(), (3,), (3, 3)]
LEAVES: dict[tuple[int, ...], list[tx.Expr]] = {
    (): [tx.State("a"), tx.Control("b"), tx.Parameter("c", shape=())],
    (3,): [tx.State("u", shape=(3,)), tx.Control("v", shape=(3,)), tx.Parameter("w", shape=(3,))],
    (3, 3): [tx.State("M", shape=(3, 3)), tx.Parameter("N", shape=(3, 3))],
}
Build = Callable[[], tx.Expr]


class Forest:
    """Grows random expressions and values; every choice is drawn from one source."""

    def __init__(self, source: Random) -> None:
        self.source = source

    def array(self, shape: tuple[int, ...]) -> np.ndarray:
        """Quarters: exact in binary, so that comparisons of leaves do not depend on rounding."""
        size = int(np.prod(shape))
        return np.array([self.source.randint(-10, 10) / 4.0 for _ in range(size)]).reshape(shape)

    def values(self) -> dict[str, np.ndarray]:
        return {e.name: self.array(e.shape) for exprs in LEAVES.values() for e in exprs}

    def leaf(self, shape: tuple[int, ...]) -> tx.Expr:
        fixed = [np.zeros(shape), np.ones(shape), *([np.eye(3)] if shape == (3, 3) else [])]
        constant = self.source.choice([*fixed, self.array(shape)])
        return self.source.choice([*LEAVES[shape], tx.Constant(constant)])

    def condition(self, shape: tuple[int, ...]) -> tx.Expr:
        """A comparison of leaves only, whose outcome rounding cannot change."""
        a, b = self.leaf(shape), self.leaf(shape)
        return self.source.choice([a <= b, a >= b, a == b, a < b, a > b, ~(a <= b), ~(a == b)])

    def tree(self, shape: tuple[int, ...], depth: int) -> tx.Expr:
        if depth == 0 or (depth < 3 and self.source.random() < 0.1):
            return self.leaf(shape)
        builds = self.source.choice([self.unary, self.unary, self.binary, self.mixed, self.special, self.special])
        return self.source.choice(builds(shape, depth - 1))()

    def unary(self, shape: tuple[int, ...], depth: int) -> list[Build]:
        e = self.tree(shape, depth)
        return [
            lambda: tx.Sin(e), lambda: tx.Cos(e), lambda: tx.Tanh(e), lambda: tx.Atan(e), lambda: -e,
            lambda: tx.Square(e), lambda: tx.Abs(e), lambda: tx.PositivePart(e), lambda: tx.Huber(e),
            lambda: tx.Sqrt(1.0 + tx.Square(e)), lambda: tx.Log(2.0 + tx.Sin(e)), lambda: tx.Exp(tx.Tanh(e)),
            lambda: tx.Asin(0.9 * tx.Sin(e)), lambda: tx.SmoothReLU(e, c=0.5), lambda: e + 0.0, lambda: 1.0 * e,
            lambda: e - e, lambda: -(0.0 - e), lambda: e**2, lambda: e.T.T, lambda: tx.Exp(tx.Log(1.0 + tx.Abs(e))),
        ]  # fmt: skip

    def binary(self, shape: tuple[int, ...], depth: int) -> list[Build]:
        a, b = self.tree(shape, depth), self.tree(self.source.choice([shape, ()]), depth)
        return [
            lambda: a + b, lambda: b - a, lambda: a - b, lambda: a * b, lambda: tx.Max(a, b), lambda: tx.Min(b, a),
            lambda: a / (2.0 + tx.Cos(b)), lambda: tx.Atan2(a, 3.0 + tx.Sin(b)),
            lambda: tx.LogSumExp(tx.Tanh(a), tx.Sin(b)),
        ]  # fmt: skip

    def mixed(self, shape: tuple[int, ...], depth: int) -> list[Build]:
        a, b, c = self.tree(shape, depth), self.tree(shape, depth), self.tree((), depth)
        return [
            lambda: tx.Add(a, b, c), lambda: tx.Mul(c, a, b), lambda: tx.Max(tx.Max(a, b), c),
            lambda: tx.Where(self.condition(shape), a, b), lambda: tx.Cond(self.condition(()), a, b),
            lambda: tx.Cond(tx.All(self.condition(()), self.condition((3,))), a, b),
        ]  # fmt: skip

    def special(self, shape: tuple[int, ...], depth: int) -> list[Build]:
        """Nodes that give this shape from others."""
        return {(): self.scalars, (3,): self.vectors, (3, 3): self.matrices}[shape](depth)

    def scalars(self, depth: int) -> list[Build]:
        v, m, s = self.tree((3,), depth), self.tree((3, 3), depth), self.tree((), depth)
        i, j = self.source.randint(-3, 2), self.source.randint(-3, 2)
        return [
            lambda: tx.Dot(v, v), lambda: v @ v, lambda: tx.Sum(m), lambda: tx.Trace(m), lambda: v[i], lambda: m[i, j],
            lambda: tx.Norm(v), lambda: tx.Norm(v, 1), lambda: tx.Norm(v, "inf"), lambda: tx.Norm(m),
            lambda: tx.Linterp(s, [-1.0, 0.5, 3.0], [2.0, -1.0, 0.5]),
        ]  # fmt: skip

    def vectors(self, depth: int) -> list[Build]:
        v, w, m, s = self.tree((3,), depth), self.tree((3,), depth), self.tree((3, 3), depth), self.tree((), depth)
        i = self.source.randint(-3, 2)
        return [
            lambda: tx.Cross(v, w), lambda: m @ v, lambda: v @ m, lambda: tx.Solve(_positive(m), v),
            lambda: tx.Stack(s, w[i], s), lambda: tx.Concat(s, v[1:]), lambda: tx.Concat(v, w)[2:5], lambda: m[:, i],
            lambda: m[i], lambda: v[::-1], lambda: tx.Vmap(lambda row: row @ row, batch=m),
        ]  # fmt: skip

    def matrices(self, depth: int) -> list[Build]:
        m, n, v, s = self.tree((3, 3), depth), self.tree((3, 3), depth), self.tree((3,), depth), self.tree((), depth)
        return [
            lambda: m @ n, lambda: tx.Outer(v, m[0]), lambda: tx.Diag(v), lambda: tx.SSM(v), lambda: m.T,
            lambda: tx.Inv(_positive(m)), lambda: tx.Solve(_positive(m), n), lambda: tx.Stack(v, m[1], v),
            lambda: tx.Block([[s, v[None, 1:]], [v[:2][:, None], n[:2, :2]]]),
            lambda: tx.QDCM(tx.Concat(3.0 + tx.Sin(s), tx.Tanh(v))),
        ]  # fmt: skip


def _positive(m: tx.Expr) -> tx.Expr:
    """A well-conditioned matrix made of any."""
    return tx.Tanh(m) @ tx.Tanh(m).T + 2.0 * np.eye(3)


NUMPY: dict[type[tx.Expr], Callable[..., Any]] = {
    tx.Add: lambda _, *a: sum(a[1:], start=a[0]),
    tx.Sub: lambda _, a, b: a - b,
    tx.Mul: lambda _, *a: np.prod(np.broadcast_arrays(*a), axis=0),
    tx.Div: lambda _, a, b: a / b,
    tx.Neg: lambda _, a: -a,
    tx.Power: lambda _, a, b: a**b,
    tx.MatMul: lambda _, a, b: a @ b,
    tx.Sin: lambda _, a: np.sin(a),
    tx.Cos: lambda _, a: np.cos(a),
    tx.Tanh: lambda _, a: np.tanh(a),
    tx.Atan: lambda _, a: np.arctan(a),
    tx.Asin: lambda _, a: np.arcsin(a),
    tx.Atan2: lambda _, a, b: np.arctan2(a, b),
    tx.Exp: lambda _, a: np.exp(a),
    tx.Log: lambda _, a: np.log(a),
    tx.Sqrt: lambda _, a: np.sqrt(a),
    tx.Square: lambda _, a: np.square(a),
    tx.Abs: lambda _, a: np.abs(a),
    tx.PositivePart: lambda _, a: np.where(a > 0, a, 0.0),
    tx.Huber: lambda n, a: np.where(np.abs(a) <= n.delta, a**2 / 2, n.delta * (np.abs(a) - n.delta / 2)),
    tx.SmoothReLU: lambda n, a: np.sqrt(np.where(a > 0, a, 0.0) ** 2 + n.c**2) - n.c,
    tx.Max: lambda _, *a: np.max(np.broadcast_arrays(*a), axis=0),
    tx.Min: lambda _, *a: np.min(np.broadcast_arrays(*a), axis=0),
    tx.LogSumExp: lambda _, *a: np.log(np.sum(np.exp(np.broadcast_arrays(*a)), axis=0)),
    tx.Where: lambda _, c, a, b: np.where(c, a, b),
    tx.Cond: lambda n, c, a, b: np.broadcast_to(a if c else b, n.shape),
    tx.All: lambda _, *a: all(np.all(p) for p in a),
    tx.Inequality: lambda _, a, b: a <= b,
    tx.Equality: lambda _, a, b: a == b,
    tx.Less: lambda _, a, b: a < b,
    tx.Not: lambda _, a: np.logical_not(a),
    tx.Dot: lambda _, a, b: np.dot(a, b),
    tx.Cross: lambda _, a, b: np.cross(a, b),
    tx.Outer: lambda _, a, b: np.outer(a, b),
    tx.Sum: lambda _, a: np.sum(a),
    tx.Trace: lambda _, a: np.trace(a),
    tx.Norm: lambda n, a: np.linalg.norm(a, {"fro": None, "inf": np.inf}.get(n.ord, n.ord)),
    tx.Index: lambda n, a: a[n.index],
    tx.Linterp: lambda _, a, xp, fp: np.interp(a, xp, fp),
    tx.Stack: lambda _, *a: np.stack(a),
    tx.Concat: lambda _, *a: np.concatenate([np.atleast_1d(p) for p in a]),
    tx.Block: lambda n, *a: np.block([list(a[i : i + n.columns]) for i in range(0, len(a), n.columns)]),
    tx.Diag: lambda _, a: np.diag(a),
    tx.SSM: lambda _, a: np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]]),
    tx.Transpose: lambda _, a: a.T,
    tx.Inv: lambda _, a: np.linalg.inv(a),
    tx.Solve: lambda _, a, b: np.linalg.solve(a, b),
    tx.Vmap: lambda _, a, *rest: np.array([row @ row for row in a]),
    tx.QDCM: lambda _, q: _rotation(q / np.linalg.norm(q)),
}  # fmt: skip


def _rotation(q: np.ndarray) -> np.ndarray:
    """Rodrigues' formula: R = I + 2 w [r]x + 2 [r]x^2."""
    cross = np.cross(q[1:], np.eye(3)).T
    return np.eye(3) + 2.0 * q[0] * cross + 2.0 * cross @ cross


def by_numpy(expr: tx.Expr, values: dict[str, np.ndarray]) -> tuple[Any, float]:
    """The value, and the largest number met on the way: what rounding is to be compared with."""
    if isinstance(expr, tx.Constant):
        return expr.value, float(np.max(np.abs(expr.value)))
    if not expr.children():
        return values[expr.name], float(np.max(np.abs(values[expr.name])))
    parts = [by_numpy(child, values) for child in expr.children()]
    value = NUMPY[type(expr)](expr, *(part[0] for part in parts))
    return value, max(float(np.max(np.abs(value))), *(part[1] for part in parts))


def check(expr: tx.Expr, values: dict[str, np.ndarray]) -> bool:
    """Whether the numbers stay in a range where the comparison says something; raises where they differ."""
    with np.errstate(all="ignore"):
        expected, largest = by_numpy(expr, values)
    if not largest < 1e6:
        return False
    canonical = expr.canonicalize()
    found, simpler = function_of(expr, canonical)({name: jnp.asarray(value) for name, value in values.items()})
    assert found.shape == simpler.shape == np.shape(expected) == expr.check_shape() == canonical.check_shape()
    tolerance = 1e-11 * (1.0 + largest**2)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(simpler, expected, rtol=0.0, atol=tolerance)
    assert canonical.canonicalize().key() == canonical.key()
    return True


relaxed = settings(derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck))


@settings(relaxed, max_examples=35)
@given(st.randoms(use_true_random=False))
def test_random_trees(source: Random) -> None:
    forest = Forest(source)
    assume(check(forest.tree(source.choice(SHAPES), 4), forest.values()))


@pytest.mark.slow
@settings(relaxed, max_examples=1000)
@given(st.randoms(use_true_random=False))
def test_many_random_trees(source: Random) -> None:
    forest = Forest(source)
    assume(check(forest.tree(source.choice(SHAPES), 5), forest.values()))


def test_the_trees_are_varied() -> None:
    """A fixed crop holds nearly every node the interpreter knows."""
    forest = Forest(Random(0))
    kinds = {type(n) for _ in range(150) for n in tx.postorder(forest.tree(forest.source.choice(SHAPES), 4))}
    assert set(NUMPY) <= kinds


def test_the_check_sees_a_wrong_node() -> None:
    """The interpreter stands on its own: a node with a wrong sign does not pass."""

    class Wrong(tx.Sin):
        def evaluate(self, *values: Any) -> Any:
            return -super().evaluate(*values)

    values = {"a": np.array(0.5)}
    NUMPY[Wrong] = NUMPY[tx.Sin]
    try:
        with pytest.raises(AssertionError, match="Not equal"):
            check(Wrong(LEAVES[()][0]), values)
        check(tx.Sin(LEAVES[()][0]), values)
    finally:
        del NUMPY[Wrong]
