"""How expressions print."""

import numpy as np

from twistax import SE3, SO3, lie
from twistax import expr as tx

s, x, y = tx.State("s"), tx.State("x", shape=(3,)), tx.State("y_ref", shape=(3,))
A = tx.Parameter("A", shape=(3, 3))


def test_text() -> None:
    cases = {
        "((A @ x) - y_ref)": A @ x - y,
        "((s * x) * 2.)": s * x * 2.0,
        "((x + y_ref) ** 2.)": (x + y) ** 2,
        "(-x)": -x,
        "x[0]": x[0],
        "A[:2, -1]": A[:2, -1],
        "A[..., None]": A[..., None],
        "(A).T": A.T,
        "Norm(x, ord=1)": tx.Norm(x, 1),
        "x <= y_ref": x <= y,
        "(x <= y_ref)[0]": (x <= y)[0],
        "Block([[A], [x]])": tx.Block([[A], [x]]),
        "Vmap(e_0.0 -> (e_0.0 @ x), batch=A)": tx.Vmap(lambda a: a @ x, A),
        "Vmap(e_0.0, e_0.1 -> (e_0.0 @ e_0.1), batch=[A, A], axis=1)": tx.Vmap(lambda a, b: a @ b, [A, A], axis=1),
    }
    assert {repr(expr): expr for expr in cases.values()}.keys() == cases.keys()


def test_latex() -> None:
    cases = {
        r"A \, x - y_{\mathrm{ref}}": A @ x - y,
        r"x - \left(y_{\mathrm{ref}} + s\right)": x - (y + s),
        r"x - y_{\mathrm{ref}} + s": (x - y) + s,
        r"\left(x + s\right) \, y_{\mathrm{ref}}": (x + s) * y,
        r"\left(-3\right) \, x": -3.0 * x,
        r"2 \cdot 3 \, s": tx.Mul(2.0, 3.0, s),
        r"-x": -x,
        r"-\left(-x\right)": tx.Neg(-x),
        r"\frac{x + s}{s}": (x + s) / s,
        r"{\left(x + s\right)}^{2}": (x + s) ** 2,
        r"{A}^{\top} \, x": A.T @ x,
        r"{\left(A \, A\right)}^{\top}": (A @ A).T,
        r"{A}^{-1} \, \left(x - s\right)": tx.Solve(A, x - s),
        r"{\left({A}^{-1} \, x\right)}^{2}": tx.Solve(A, x) ** 2,
        r"{\left(A + s\right)}^{-1}": tx.Inv(A + s),
        r"\left\|x\right\|_{\infty}": tx.Norm(x, "inf"),
        r"\sin\left(s\right)": tx.Sin(s),
        r"x \times y_{\mathrm{ref}}": tx.Cross(x, y),
        r"x \le 1": x <= 1.0,
        r"\begin{bmatrix} s & 0 \\ 1 & -s \end{bmatrix}": tx.Block([[s, 0.0], [1.0, -s]]),
        r"\left[{e_{\mathrm{0.0}}}_{[0]}\right]_{e_{\mathrm{0.0}} \in A}": tx.Vmap(lambda a: a[0], A),
    }
    assert {expr.latex(): expr for expr in cases.values()}.keys() == cases.keys()


def test_latex_of_changes_of_frame() -> None:
    """Sums and products as operands stand in parentheses wherever they would be read wrongly."""
    g, h, R = tx.State("g", group=SE3), tx.State("h", group=SE3), tx.State("R", group=SO3)
    V = tx.State("V", (6,))
    back = lie.AdjointAction(lie.Compose(g, h), V, inverse=True)
    cases = {
        r"\mathrm{Ad}_{g} \, \left(V + V\right)": lie.AdjointAction(g, V + V),
        r"\mathrm{Ad}_{g} \, \mathrm{Ad}^*_{h} \, V": lie.AdjointAction(g, lie.CoadjointAction(h, V)),
        r"\mathrm{Ad}_{{\left(g \circ h\right)}^{-1}} \, V": back,
        r"{\left(g \circ h\right)}^{-1} \circ g": lie.Compose(lie.Inverse(lie.Compose(g, h)), g),
        r"R \cdot \left(x + y_{\mathrm{ref}}\right)": lie.Act(R, x + y),
        r"\left(R \cdot x\right) \times y_{\mathrm{ref}}": tx.Cross(lie.Act(R, x), y),
    }
    assert {expr.latex(): expr for expr in cases.values()}.keys() == cases.keys()


def test_tree() -> None:
    total = x + y
    expr = tx.Solve(A, total * tx.Norm(total))
    assert expr.tree().splitlines() == [
        "Solve (3,)",
        "├─ A: Parameter A (3, 3)",
        "└─ b: Mul (3,)",
        "   ├─ factors[0]: Add (3,)",
        "   │  ├─ terms[0]: State x (3,)",
        "   │  └─ terms[1]: State y_ref (3,)",
        "   └─ factors[1]: Norm ()",
        "      └─ operand: Add (line 4)",
    ]


def test_the_tree_of_something_wrong_shows_where() -> None:
    lines = tx.Sin(x + tx.Constant(np.ones(4))).tree().splitlines()
    assert lines[0] == "Sin (shape does not fit)"
    assert lines[2] == "   ├─ terms[0]: State x (3,)"


def test_the_tree_of_a_map_shows_its_body() -> None:
    lines = tx.Vmap(lambda a: tx.Sin(a @ x), A).tree().splitlines()
    assert lines[0] == "Vmap (3,)"
    assert lines[1] == "├─ body: Sin ()"
    assert lines[-1] == "└─ batches[0]: Parameter A (3, 3)"


def test_static_fields_show_in_the_tree() -> None:
    assert tx.Norm(x, 1).tree().splitlines()[0] == "Norm ord=1 ()"
    assert x[1:].tree().splitlines()[0] == "Index [1:] (2,)"
