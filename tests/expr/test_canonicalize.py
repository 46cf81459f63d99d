"""The rewrites of `canonicalize`, one by one; docs/rewrites.md lists them."""

import numpy as np
import pytest
from expr_cases import value_of

from twistax import expr as tx

s, r = tx.State("s"), tx.State("r")
x, y, z = (tx.State(name, shape=(3,)) for name in "xyz")
A, B = tx.State("A", shape=(3, 3)), tx.State("B", shape=(3, 3))
k = tx.Constant
ONES, ZEROS, EYE = np.ones(3), np.zeros(3), np.eye(3)
NOT_SINGULAR = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 1.0], [0.0, 1.0, 2.0]])
VALUES = {
    "s": 0.7,
    "r": -1.3,
    "x": np.array([1.0, -2.0, 0.5]),
    "y": np.array([0.25, 3.0, -1.0]),
    "z": np.array([-0.5, 0.125, 2.0]),
    "A": NOT_SINGULAR,
    "B": NOT_SINGULAR[::-1] + 0.5,
}

REWRITES: list[tuple[str, tx.Expr, tx.Expr]] = [
    # constants
    ("folds sums", k(1.0) + 2.0, k(3.0)),
    ("folds through every node", tx.Norm(tx.Cross(k([1.0, 0, 0]), k([0, 2.0, 0]))) * tx.Sin(k(0.0)), k(0.0)),
    ("gathers constants of a sum", 1.0 + x + 2.0, x + 3.0),
    ("gathers constants of a product", 2.0 * x * 3.0, 6.0 * x),
    # zeros and ones
    ("x + 0", x + 0.0, x),
    ("0 + x", 0.0 + x, x),
    ("x - 0", x - 0.0, x),
    ("0 - x", 0.0 - x, -x),
    ("x * 1", x * 1.0, x),
    ("x * 0", x * 0.0, k(ZEROS)),
    ("x / 1", x / 1.0, x),
    ("0 / x", 0.0 / x, k(ZEROS)),
    ("x ** 1", x**1, x),
    ("x ** 0", x**0, k(ONES)),
    ("0 @ x", k(np.zeros((3, 3))) @ x, k(ZEROS)),
    # the shape stays
    ("s * ones keeps its shape", s * ONES, k(ONES) * s),
    ("s + zeros keeps its shape", s + ZEROS, s + k(ZEROS)),
    ("s - s of a vector", (s + ZEROS) - s, (s + k(ZEROS)) - s),
    ("what cancels leaves its shape", tx.Add(x, s, -x), s + k(ZEROS)),
    ("s ** ones", s**ONES, s ** k(ONES)),
    # cancellation
    ("x - x", x - x, k(ZEROS)),
    ("x + (-x)", x + (-x), k(ZEROS)),
    ("equal structures cancel", (A @ x) - (A @ x), k(ZEROS)),
    ("x - (-y)", x - (-y), x + y),
    ("-(-x)", tx.Neg(-x), x),
    # nesting
    ("nested sums", (x + y) + z, tx.Add(x, y, z)),
    ("nested products", x * (y * z), tx.Mul(x, y, z)),
    ("nested maxima", tx.Max(tx.Max(x, y), z, 1.0, 2.0), tx.Max(x, y, z, 2.0)),
    ("nested minima", tx.Min(x, tx.Min(y, 1.0), 2.0), tx.Min(x, y, 1.0)),
    ("equal operands of a maximum", tx.Max(x, y, x), tx.Max(x, y)),
    ("nested LogSumExp", tx.LogSumExp(tx.LogSumExp(x, y), x), tx.LogSumExp(x, y, x)),
    ("nested Concat", tx.Concat(tx.Concat(x, s), y), tx.Concat(x, s, y)),
    ("nested All", tx.All(tx.All(x <= 0.0), s <= 0.0), tx.All(x <= 0.0, s <= 0.0)),
    # matrices
    ("double transpose", A.T.T, A),
    ("transpose of a vector", x.T, x),
    ("transpose of a diagonal matrix", tx.Diag(x).T, tx.Diag(x)),
    ("I @ x", EYE @ x, x),
    ("A @ I", A @ EYE, A),
    ("Inv(Inv(A))", tx.Inv(tx.Inv(A)), A),
    ("Inv of a diagonal matrix", tx.Inv(tx.Diag(x)), tx.Diag(1.0 / x)),
    ("Solve(I, x)", tx.Solve(EYE, x), x),
    ("Solve of a diagonal matrix", tx.Solve(tx.Diag(x), y), y / x),
    ("Solve of a diagonal matrix, columns", tx.Solve(tx.Diag(x), A), A / x[:, None]),
    ("Solve with an inverse", tx.Solve(tx.Inv(A), x), A @ x),
    ("Solve with a constant", tx.Solve(2.0 * EYE, x), 0.5 * EYE @ x),
    ("trace of a transpose", tx.Trace(A.T), tx.Trace(A)),
    ("trace of a diagonal matrix", tx.Trace(tx.Diag(x)), tx.Sum(x)),
    ("x cross x", tx.Cross(x, x), k(ZEROS)),
    ("sum of a scalar", tx.Sum(s), s),
    # functions
    ("norm of -x", tx.Norm(-x, 1), tx.Norm(x, 1)),
    ("norm of a scalar", tx.Norm(s), tx.Abs(s)),
    ("|-x|", tx.Abs(-x), tx.Abs(x)),
    ("||x||", tx.Abs(tx.Abs(x)), tx.Abs(x)),
    ("|x^2|", tx.Abs(tx.Square(x)), tx.Square(x)),
    ("(-x)^2", tx.Square(-x), tx.Square(x)),
    ("cos(-x)", tx.Cos(-x), tx.Cos(x)),
    ("exp(log x)", tx.Exp(tx.Log(tx.Square(x))), tx.Square(x)),
    ("log(exp x)", tx.Log(tx.Exp(x)), x),
    # parts
    ("all of x", x[:], x),
    ("all of A", A[..., 0:3], A),
    ("a row of a stack", tx.Stack(x, y)[1], y),
    ("an entry of a stack", tx.Stack(x, y)[1, 2], y[2]),
    ("an entry of a Concat", tx.Concat(s, x, r)[2], x[1]),
    ("a scalar of a Concat", tx.Concat(s, x, r)[-1], r),
    ("a piece of a Concat", tx.Concat(s, x, r)[1:4], x),
    ("a part of a piece", tx.Concat(s, x, r)[2:4], x[1:3]),
    ("several pieces of a Concat", tx.Concat(s, x, y)[1:], tx.Concat(x, y)),
    ("a part of a part", tx.Concat(x, y) [1:][::-2][1], y[0]),
    ("a negative index", A[-1, 1:], A[2, 1:3]),
    ("an entry of a part", (1.0 * x)[1:][0], x[1]),
    ("one piece", tx.Concat(x), x),
    ("one block", tx.Block([[A]]), A),
    ("Hstack of vectors", tx.Hstack([x, s]), tx.Concat(x, s)),
    ("Vstack of vectors", tx.Vstack([x, y]), tx.Stack(x, y)),
    ("Vstack of matrices", tx.Vstack([A, B]), tx.Concat(A, B)),
    # choices
    ("a decided Where", tx.Where(k(1.0) <= 2.0, x, y), x),
    ("a denied Where", tx.Where(k([3.0, 4.0, 5.0]) <= 2.0, x, y), y),
    ("Where with equal sides", tx.Where(s <= 1.0, x, x), x),
    ("Where keeps its shape", tx.Where(k([3.0, 4.0, 5.0]) <= 2.0, x, s), tx.Where(k([False] * 3), x, s)),
    ("a decided Cond", tx.Cond(k(1.0) <= 2.0, x, y), x),
    ("a decided Cond keeps its shape", tx.Cond(k(1.0) <= 2.0, s, y), s + k(ZEROS)),
    ("Cond with equal branches", tx.Cond(s <= 1.0, x, x), x),
    ("All that holds", tx.All(k(1.0) <= 2.0), k(True)),
    ("All with a denied part", tx.All(k(3.0) <= 2.0, s <= 1.0), k(False)),
    ("Any with a part that holds", tx.Any(k(1.0) <= 2.0, s <= 1.0), k(True)),
    # constraints
    ("a constraint", x + 0.0 <= y, x <= y),
    ("a canonical constraint", x <= 0.0, x <= 0.0),
    ("an equation", x + 0.0 == 1.0, x == 1.0),
]  # fmt: skip


@pytest.mark.parametrize(("expr", "expected"), [c[1:] for c in REWRITES], ids=[c[0] for c in REWRITES])
def test_rewrite(expr: tx.Expr, expected: tx.Expr) -> None:
    found = expr.canonicalize()
    assert found.key() == expected.key(), f"{expr!r} became {found!r}, not {expected!r}"
    assert found.check_shape() == expr.check_shape()
    assert found.canonicalize() is found
    before, after = value_of(expr, **VALUES), value_of(found, **VALUES)
    assert before.shape == after.shape
    np.testing.assert_allclose(after, before, rtol=1e-13, atol=1e-15)


def test_what_is_not_rewritten() -> None:
    """Identities that fail somewhere finite, change a shape, or lose digits."""
    ill = np.diag([1.0, 1.0, 1e-12])
    for expr in (
        tx.Asin(tx.Sin(x)),
        tx.Sqrt(tx.Square(x)),
        s * ONES,
        tx.Norm(s + ZEROS),
        tx.Stack(x, y)[:, 0],
        tx.Solve(k(ill), x),
        x / y,
        A @ B,
    ):
        assert type(expr.canonicalize()) is type(expr)


def test_keys_tell_factors_apart() -> None:
    p, q, u, v = (tx.Parameter(name, shape=()) for name in "pquv")
    assert (p * u - q * v).key() != (q * u - p * v).key()
    assert (p * u - q * v).canonicalize().key() != (q * u - p * v).canonicalize().key()
    assert (p * u).key() != (p + u).key()
    assert (p - u).key() != (u - p).key()
    assert tx.State("p").key() != p.key()
    assert tx.Control("p").key() != p.key()
    assert tx.State("p", shape=(1,)).key() != tx.State("p").key()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (tx.Norm(x), tx.Norm(x, 1)),
        (tx.Huber(x), tx.Huber(x, delta=0.3)),
        (tx.SmoothReLU(x), tx.SmoothReLU(x, c=1e-7)),
        (x[0], x[1]),
        (x[:1], x[0]),
        (x[np.array([0, 1])], x[np.array([0, 2])]),
        (x[None], x[..., None]),
        (tx.Cinterp(s, [0.0, 1.0, 2.0], [1.0, 2.0, 0.0]), tx.Cinterp(s, [0.0, 1.0, 2.0], [1.0, 2.0, 0.5])),
        (tx.Cinterp(s, [0, 1, 2, 3], [1, 2, 0, 1]), tx.Cinterp(s, [0, 1, 2, 3], [1, 2, 0, 1], method="pchip")),
        (tx.Block([[s, r]]), tx.Block([[s], [r]])),
        (k(0.0), k([0.0])),
        (k(1.0), k(True)),
        (x <= y, x == y),
        (tx.Max(x, y), tx.Min(x, y)),
        (tx.All(x <= y), tx.Any(x <= y)),
    ],
    ids=str,
)
def test_static_fields_are_part_of_the_key(one: tx.Expr, other: tx.Expr) -> None:
    assert one.key() != other.key()


def test_nothing_that_is_not_finite_is_folded() -> None:
    """The run shall show where it happens."""
    expr = s + 1.0 / k(0.0)
    assert "/" in repr(expr.canonicalize())
    assert type(tx.Log(k(-1.0)).canonicalize()) is tx.Log


def test_a_shared_sum_stays_shared() -> None:
    total = x + y
    expr = tx.Sin(total) + (total + z) * (total + 1.0)
    sums = [node for node in tx.postorder(expr.canonicalize()) if repr(node) == "(x + y)"]
    assert len(sums) == 1


def test_folding_works_in_double_precision_whatever_the_switch() -> None:
    import jax

    with jax.enable_x64(False):
        folded = (tx.Sin(k(0.1)) * s).canonicalize()
    assert "0.09983341664682815" in str(folded.factors[0].value)
