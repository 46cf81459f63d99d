"""Every expression node of OpenSCvx, and small expressions of those that twistax has under the same name.

A case builds one expression with the nodes of either package. Where the values differ, it says why, and how the value
there is had here.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from expr_cases import value_of

import twistax as tx

#: All public subclasses of `openscvx.symbolic.expr.Expr`, and what its package exports besides.
BASES = {"Expr", "Leaf", "Variable", "Constraint"}
WITHOUT_COUNTERPART = {
    *{"NodalConstraint", "CrossNodeConstraint", "CTCS", "NodeReference"},
    *{"STLExpr", "STLJaxExpr", "And", "Or", "IfThen", "IntegerVariable", "Always", "Eventually", "Until"},
    *{"WithJacobian", "Tau"},
}
#: What 0.5.2 does not have yet.
NEW_IN_THE_NIGHTLY = {"Tanh", "WithJacobian", "Tau"}
#: Nodes of a name that mean something else: theirs negates a formula of signal temporal logic, ours a condition.
NAMESAKES = {"Not"}


class Nodes:
    """The nodes of a package as attributes, wherever it keeps them."""

    def __init__(self, *modules: Any) -> None:
        self._modules = modules

    def __getattr__(self, name: str) -> Any:
        for module in self._modules:
            if hasattr(module, name):
                return getattr(module, name)
        raise AttributeError(name)


OURS = Nodes(tx, tx.linalg, tx.spatial, tx.lie)

Draw = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]


def signed(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Sizes between 0.1 and 0.9, so that all functions are defined and no kink is near."""
    return rng.uniform(0.1, 0.9, shape) * rng.choice([-1.0, 1.0], shape)


def positive(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return rng.uniform(0.1, 0.9, shape)


def wide(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Inside and outside of the tables below."""
    return rng.uniform(-2.0, 6.0, shape)


def pose_matrix(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return value_of(tx.lie.SE3Exp(signed(rng, (6,))))


def rotation_matrix(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return value_of(tx.lie.SO3Exp(signed(rng, (3,))))


@dataclasses.dataclass(frozen=True)
class Input:
    """A leaf of both expressions and how its value is drawn."""

    name: str
    shape: tuple[int, ...] = ()
    draw: Draw = signed
    kind: str = "Parameter"


a, b, c = Input("a", (3,)), Input("b", (3,)), Input("c", (2, 3))
s, r = Input("s"), Input("r")
A, B, cube = Input("A", (3, 3)), Input("B", (3, 3)), Input("cube", (2, 3, 4))
xi, eta = Input("xi", (6,)), Input("eta", (6,))
p, q = Input("p", (3,), positive), Input("q", (4,))
T, R = Input("T", (4, 4), pose_matrix), Input("R", (3, 3), rotation_matrix)
h, k = Input("h", (), wide), Input("k", (), wide)
x, X = Input("x", (3,), kind="State"), Input("X", (2, 3), kind="State")
u, U = Input("u", (3,), kind="Control"), Input("U", (2, 3), kind="Control")


@dataclasses.dataclass(frozen=True)
class Case:
    """One small expression in both packages.

    Attributes:
        node: the node it is about, of one name in both.
        build: (nodes of the package, leaves) -> expression.
        inputs: the leaves.
        reason: why the values differ; empty where they do not.
        here: the expression of twistax that has their value; `build` if None.
        as_there: what is left to do to the number.
    """

    node: str
    build: Callable[..., Any]
    inputs: tuple[Input, ...]
    reason: str = ""
    here: Callable[..., Any] | None = None
    as_there: Callable[[np.ndarray], np.ndarray] = np.asarray


def same(node: str, build: Callable[..., Any], *inputs: Input) -> Case:
    return Case(node, build, inputs)


def entrywise(node: str, leaf: Input = a, **options: float) -> Case:
    return same(node, lambda m, z: getattr(m, node)(z, **options), leaf)


KNOTS, TABLE = np.array([0.0, 1.0, 2.5, 4.0]), np.array([1.0, -1.0, 2.0, 2.5])
GRID = np.array([[1.0, -1.0, 0.5], [0.5, 2.0, 1.0], [4.0, 3.0, -2.0], [0.0, 1.0, 1.5]])
POINTS = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 1.0]])

CASES = [
    # arithmetic
    same("Add", lambda m, a, c: m.Add(a, c, 2.0), a, c),
    same("Sub", lambda m, a, s: a - s, a, s),
    same("Mul", lambda m, a, c: m.Mul(a, c, 3.0), a, c),
    same("Div", lambda m, a, s: a / s, a, s),
    same("MatMul", lambda m, A, B: A @ B, A, B),
    same("MatMul", lambda m, c, a: c @ a, c, a),
    same("MatMul", lambda m, a, A: a @ A, a, A),
    same("MatMul", lambda m, a, b: a @ b, a, b),
    same("MatMul", lambda m, a: np.eye(3)[::-1] @ a, a),
    same("Neg", lambda m, a: -a, a),
    same("Power", lambda m, a: a**2, a),
    same("Power", lambda m, p, s: p**s, p, s),
    # arrays
    same("Index", lambda m, c: c[1:, 0], c),
    same("Index", lambda m, a: a[::-1], a),
    same("Index", lambda m, X: X[1, :2], X),
    same("Concat", lambda m, s, a: m.Concat(s, a, 4.0), s, a),
    same("Concat", lambda m, c, A: m.Concat(c, A), c, A),
    same("Stack", lambda m, a, b: m.Stack([a, b]), a, b),
    Case(
        "Stack",
        lambda m, s, r: m.Stack([s, r]),
        (s, r),
        reason="scalar rows become rows of one entry there, though its check_shape says (k,)",
        as_there=lambda value: value[:, None],
    ),
    same("Hstack", lambda m, a, b: m.Hstack([a, b]), a, b),
    same("Hstack", lambda m, A, B: m.Hstack([A, B]), A, B),
    same("Vstack", lambda m, a, b: m.Vstack([a, b]), a, b),
    same("Vstack", lambda m, c, A: m.Vstack([c, A]), c, A),
    same("Block", lambda m, s: m.Block([[s, 0.0], [1.0, -s]]), s),
    same("Block", lambda m, A, B: m.Block([[A, np.ones((3, 2))], [B, np.zeros((3, 2))]]), A, B),
    same("Block", lambda m, cube: m.Block([[cube, cube]]), cube),
    # linear algebra
    same("Transpose", lambda m, c: c.T, c),
    Case(
        "Transpose",
        lambda m, cube: cube.T,
        (cube,),
        reason="with more than two axes it reverses all of them, though its check_shape swaps the last two",
        as_there=lambda value: np.transpose(value, (1, 2, 0)),
    ),
    same("Diag", lambda m, a: m.Diag(a), a),
    same("Sum", lambda m, c: m.Sum(c), c),
    same("Inv", lambda m, A: m.Inv(A + 4.0 * np.eye(3)), A),
    *[same("Norm", lambda m, a, o=o: m.linalg.Norm(a, ord=o), a) for o in ("fro", 1, 2, 3, "inf", "-inf")],
    *[same("Norm", lambda m, c, o=o: m.linalg.Norm(c, ord=o), c) for o in ("fro", 1, 2, "inf")],
    same("Norm", lambda m, cube: m.linalg.Norm(cube), cube),
    # functions
    *[entrywise(name) for name in ("Sin", "Cos", "Tan", "Tanh", "Asin", "Acos", "Atan", "Exp", "Abs", "Square")],
    *[entrywise(name) for name in ("PositivePart", "Huber")],
    entrywise("Sqrt", p),
    entrywise("Log", p),
    entrywise("Huber", delta=0.5),
    entrywise("SmoothReLU", c=0.1),
    same("Atan2", lambda m, a, s: m.Atan2(a, s), a, s),
    same("Max", lambda m, a, s: m.Max(a, s, 0.1), a, s),
    same("Min", lambda m, a, s: m.Min(a, s, 0.1), a, s),
    same("LogSumExp", lambda m, a, s: m.LogSumExp(a, s), a, s),
    same("LogSumExp", lambda m, a: m.LogSumExp(1000.0 * a, TABLE[:3]), a),
    # tables
    same("Linterp", lambda m, h: m.Linterp(h, KNOTS, TABLE), h),
    *[same("Cinterp", lambda m, h, o=o: m.Cinterp(h, KNOTS, TABLE, method=o), h) for o in ("cubic", "pchip", "akima")],
    same("Bilerp", lambda m, h, k: m.Bilerp(h, k, KNOTS, KNOTS[:3], GRID), h, k),
    # logic
    *[
        Case(
            "Cond",
            lambda m, a, s, test=test: m.Cond(test(m, a, s), a / 3.0, s * a),
            (a, s),
            reason="its value is cast to float32 until a Problem is built, then to the Problem's float_dtype",
            as_there=np.float32,
        )
        for test in (lambda m, a, s: s <= 0.0, lambda m, a, s: [s <= 0.5, s >= -0.5], lambda m, a, s: m.Any(a >= 0.2))
    ],
    same("All", lambda m, a: m.All(a >= -0.5), a),
    same("All", lambda m, a, s: m.All([a[0] <= 0.3, s >= 0.0]), a, s),
    same("Any", lambda m, a, s: m.Any([a <= -0.5, s >= 0.0]), a, s),
    # constraints
    *[
        Case(
            node,
            lambda m, a, s, relate=relate: relate(a, s),
            (a, s),
            reason="its value is the residual lhs - rhs, here it is which entries hold",
            here=lambda m, a, s, relate=relate: relate(a, s).residual(),
        )
        for node, relate in (
            ("Inequality", lambda a, s: a <= s),
            ("Inequality", lambda a, s: a >= s),
            ("Equality", lambda a, s: a == s),
        )
    ],
    # attitude
    same("QDCM", lambda m, q: m.spatial.QDCM(q), q),
    same("SSM", lambda m, a: m.spatial.SSM(a), a),
    same("SSMP", lambda m, a: m.spatial.SSMP(a), a),
    # Lie groups
    same("Adjoint", lambda m, xi, eta: m.lie.Adjoint(xi, eta), xi, eta),
    Case(
        "AdjointDual",
        lambda m, xi, eta: m.lie.AdjointDual(xi, eta),
        (xi, eta),
        reason="it is ad* of a twist [v; w] on a momentum ordered [L; p], and gives a wrench [tau; f]",
        here=lambda m, xi, mu: m.lie.Reorder(m.lie.AdjointDual(xi, m.lie.Reorder(mu))),
    ),
    *[
        Case(
            node,
            lambda m, T, node=node: getattr(m.lie, node)(T),
            (T,),
            reason="it is the matrix for [w; v]",
            here=lambda m, T, node=node: getattr(m.lie, node)(T, order=tx.ANGULAR_FIRST),
        )
        for node in ("SE3Adjoint", "SE3AdjointDual")
    ],
    same("SO3Exp", lambda m, a: m.lie.SO3Exp(a), a),
    same("SO3Log", lambda m, R: m.lie.SO3Log(R), R),
    same("SE3Exp", lambda m, xi: m.lie.SE3Exp(xi), xi),
    same("SE3Log", lambda m, T: m.lie.SE3Log(T), T),
    # batches
    same("Vmap", lambda m, a: m.Vmap(lambda z: m.linalg.Norm(a - z), batch=POINTS), a),
    same("Vmap", lambda m, c, p: m.Vmap(lambda z, w: w * z, batch=[c, p], axis=0), Input("c", (3, 2)), p),
    same("Vmap", lambda m, X: m.Vmap(lambda z: z[0] - z[1], batch=X, axis=1), X),
    Case(
        "Vmap",
        lambda m, a: m.Vmap(lambda z: m.linalg.Norm(a - z) <= 1.0, batch=POINTS),
        (a,),
        reason="of a constraint it is an expression, the residuals; here it is a constraint",
        here=lambda m, a: m.Vmap(lambda z: m.linalg.Norm(a - z) <= 1.0, batch=POINTS).residual(),
    ),
    # leaves
    same("Constant", lambda m: m.Constant(np.arange(6.0).reshape(2, 3))),
    Case(
        "Constant",
        lambda m: m.Constant(np.ones((1, 3))),
        (),
        reason="axes of length 1 are dropped",
        as_there=np.squeeze,
    ),
    same("Parameter", lambda m, A: A, A),
    same("State", lambda m, x: x, x),
    same("Control", lambda m, u: u, u),
    *[
        Case(node, lambda m, z: z, (leaf,), reason="a matrix arrives as one flat vector", as_there=np.ravel)
        for node, leaf in (("State", X), ("Control", U))
    ],
    Case(
        "Time",
        lambda m, t: t,
        (Input("time", (1,), positive, kind="Time"),),
        reason="it is a state of shape (1,), here a scalar",
        as_there=lambda value: value[None],
    ),
]

COMMON = {case.node for case in CASES}
DIFFERENT = {case.node for case in CASES if case.reason}
