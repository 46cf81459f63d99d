"""Two orders of six-vectors in one system: an error that names both places, and no error where there is no mistake."""

from collections.abc import Callable

import numpy as np
import pytest

import twistax as tx
from twistax import lie

L, A = tx.LINEAR_FIRST, tx.ANGULAR_FIRST
g, h = tx.State("g", group=tx.SE3), tx.State("h", group=tx.SE3, order=A)
V, W = tx.State("V", (6,)), tx.State("W", (6,))
q = tx.State("q", (6,))
F, K = tx.Control("F", (6,)), tx.Control("K", (6,))
M, N, J = (tx.Parameter(name, value=np.eye(6)) for name in "MNJ")
c, v = tx.Parameter("c", value=1.0), tx.Parameter("v", value=np.ones(3))
EYE, ZERO = np.eye(4), np.zeros(6)


def ad(xi: tx.Expr, order: tx.Order) -> tx.Expr:
    return lie.Adjoint(xi, np.arange(6.0), order=order)


def outputs(**exprs: tx.Expr) -> Callable[[], tx.System]:
    return lambda: tx.System(rates={V: ZERO, W: ZERO, q: ZERO}, outputs=exprs)


def rates(*pairs: tuple[tx.State, object]) -> Callable[[], tx.System]:
    return lambda: tx.System(rates=dict(pairs))


#: what: (a system that mixes orders, words that name the first place, words that name the second)
MIXED = {
    "a vector in two nodes": (outputs(y=ad(V, L), z=ad(V, A)), "outputs['y']", "outputs['z']"),
    "one node inside another": (outputs(y=ad(ad(V, L), A)), "Adjoint.twist1 -> Adjoint", "outputs['y']"),
    "a pose and the twist it is moved by": (rates((h, V), (V, ad(V, L))), "rates['V']", "rate of the pose 'h'"),
    "poses of both orders": (rates((g, V), (h, V), (V, F)), "rate of the pose 'g'", "rate of the pose 'h'"),
    "a state and its rate": (rates((V, ad(F, L)), (W, lie.AdjointDual(V, K, order=A))), "rates['V']", "rates['W']"),
    "a control": (rates((V, ad(F, L)), (W, ad(F, A))), "rates['V']", "rates['W']"),
    "a sum": (outputs(y=ad(V, L) + ad(W, A)), "Add.terms[0] -> Adjoint", "Add.terms[1] -> Adjoint"),
    "a difference, a negative, a scaled vector": (outputs(y=-c * ad(V, L) / 2.0 - ad(W, A)), "Adjoint", "Adjoint"),
    "a choice": (outputs(y=tx.Where(c <= 1.0, ad(V, L), ad(W, A))), "Where.x", "Where.y"),
    "a constraint": (
        lambda: tx.System(rates={V: F, W: K}, constraints=[ad(V, L) <= ad(W, A)]),
        "Inequality.lhs",
        "Inequality.rhs",
    ),
    "power": (outputs(y=tx.linalg.Dot(ad(V, L), lie.AdjointDual(W, F, order=A))), "Dot.left", "Dot.right"),
    "power by a matrix product": (outputs(y=ad(V, L) @ ad(W, A)), "MatMul.left", "MatMul.right"),
    "a matrix and a vector": (outputs(y=lie.SE3Adjoint(EYE, order=A) @ ad(V, L)), "SE3Adjoint", "Adjoint"),
    "a transposed matrix": (outputs(y=lie.SE3Adjoint(EYE, order=A).T @ ad(V, L)), "SE3Adjoint", "Adjoint"),
    "an inverted matrix": (outputs(y=tx.linalg.Inv(lie.SE3Adjoint(EYE, order=A)) @ ad(V, L)), "SE3Adjoint", "Adjoint"),
    "two matrices": (outputs(y=lie.SE3Adjoint(EYE, order=A) @ lie.SE3Adjoint(EYE)), "left", "right"),
    "an action": (outputs(y=lie.AdjointAction(EYE, ad(V, L), order=A)), "AdjointAction.twist", "outputs['y']"),
    "a coaction": (outputs(y=lie.CoadjointAction(EYE, F, order=A), z=ad(F, L)), "outputs['y']", "outputs['z']"),
    "a solve": (
        lambda: tx.System(rates={h: V, V: tx.linalg.Solve(M, lie.wrench(force=v, torque=v))}),
        "rate of the pose 'h'",
        "JoinedParts",
    ),
    "an inertia between both": (outputs(y=lie.AdjointDual(V, M @ ad(W, L), order=A)), "AdjointDual", "Adjoint"),
    "a Jacobian whose rows are twists": (outputs(y=ad(J @ q, L), z=ad(J @ V, A)), "outputs['y']", "outputs['z']"),
    "a narrow Jacobian": (
        outputs(y=lie.Reorder(M)[:, :2] @ v[:2] + ad(V, L), z=ad(tx.Parameter("B", (6, 3)) @ v, A) + V),
        "outputs['y']",
        "outputs['z']",
    ),
    "an outer product": (outputs(y=tx.linalg.Outer(ad(V, L), v) + tx.linalg.Outer(ad(W, A), v)), "Outer", "Outer"),
    "a part": (outputs(y=lie.linear(V, order=A), z=lie.angular(V)), "outputs['y']", "outputs['z']"),
    "an exponential": (outputs(y=lie.SE3Exp(V, order=A), z=lie.LeftJacobian(V)), "outputs['y']", "outputs['z']"),
    "a logarithm": (outputs(y=lie.SE3Log(EYE, order=A) + ad(V, L)), "SE3Log", "Adjoint"),
    "a Reorder the wrong way": (outputs(y=lie.Reorder(ad(V, L), order=L)), "Reorder.value", "outputs['y']"),
    "the body of a Vmap": (
        outputs(y=tx.Vmap(lambda s: s * ad(V, L), np.arange(3.0)), z=ad(V, A)),
        "Vmap.body -> Mul.factors[1] -> Adjoint",
        "outputs['z']",
    ),
}


@pytest.mark.parametrize("what", MIXED)
def test_mixed_orders_are_refused_and_both_places_named(what: str) -> None:
    build, one, other = MIXED[what]
    with pytest.raises(tx.OrderError) as caught:
        build()
    first, *places, fix = str(caught.value).splitlines()
    assert first.startswith("two orders of six-vectors are combined")
    assert "LINEAR_FIRST" in first
    assert "ANGULAR_FIRST" in first
    assert len(places) == 2
    assert places[0].startswith("  at: ")
    assert places[1].startswith("  and: ")
    assert sorted(place.split()[-1] for place in places) == ["ANGULAR_FIRST", "LINEAR_FIRST"]
    assert any(one in place for place in places), places
    assert any(other in place for place in places), places
    assert "tx.lie.Reorder" in fix


SHARED = tx.Constant(ZERO)

SOUND = {
    "one order throughout": rates((h, V), (V, tx.linalg.Solve(M, F - lie.AdjointDual(V, M @ V, order=A)))),
    "a Reorder between": outputs(y=ad(V, L) + lie.Reorder(ad(W, A), order=L)),
    "a Reorder of an operator": outputs(y=lie.Reorder(lie.SE3Adjoint(EYE), order=A) @ ad(W, A)),
    "a Reorder in a rate": rates((h, lie.Reorder(V, order=A)), (g, V), (V, F)),
    "two bodies, each in its order": rates((g, V), (h, W), (V, ad(F, L)), (W, ad(K, A))),
    "constants anywhere": outputs(y=ad(ZERO, L) + 0 * V, z=ad(ZERO, A) + 0 * W, e=ad(V, L) + np.ones(6)),
    "one constant in both": rates((V, ad(V, L) + SHARED), (W, ad(W, A) + SHARED)),
    "made of a constant": outputs(y=ad(V, L) + 2.0 * tx.Constant(ZERO), z=ad(W, A) + 2.0 * tx.Constant(ZERO)),
    "a scalar times ones": outputs(y=ad(V, L) - c * np.ones(6), z=ad(W, A) - c * np.ones(6)),
    "six joints": outputs(y=ad(J @ q, L), z=ad(N @ q, A)),
    "torques of six joints": rates((q, tx.linalg.Solve(M, J.T @ ad(V, L) + N.T @ ad(W, A) - q)), (V, F), (W, K)),
    "twists and torques of six joints": rates(
        (q, J.T @ ad(J @ q, L) + N.T @ ad(N @ q, A) + tx.linalg.Solve(J, ad(V, L)) + tx.linalg.Inv(N) @ ad(W, A)),
        (V, F),
        (W, K),
    ),
    "six thrusters": rates((V, ad(V, L) + J @ F), (W, ad(W, A) + N @ F)),
    "an index ends the flow": outputs(y=ad(V[:], L), z=ad(V[[3, 4, 5, 0, 1, 2]], A)),
    "joining ends the flow": outputs(y=ad(V, L), z=ad(tx.Concat(V[3:], V[:3]), A)),
    "six points": outputs(y=lie.Act(EYE, tx.Parameter("p", (6, 3))), z=ad(V, L), w=ad(W, A)),
    "joint angles with no order": outputs(y=tx.Sin(q) + q, z=ad(V, L), w=ad(W, A)),
    "elements of two batches": outputs(
        y=tx.Vmap(lambda x: ad(2.0 * x, L), tx.Parameter("X", (3, 6))),
        z=tx.Vmap(lambda x: ad(2.0 * x, A), tx.Parameter("Y", (3, 6))),
    ),
    "rotations have no order": rates((tx.State("R", group=tx.SO3), v), (V, ad(V, L)), (W, ad(W, A))),
}


@pytest.mark.parametrize("what", SOUND)
def test_sound_systems_are_accepted(what: str) -> None:
    assert isinstance(SOUND[what](), tx.System)


def test_the_message_in_full() -> None:
    with pytest.raises(tx.OrderError) as caught:
        tx.System(rates={h: V, V: tx.linalg.Solve(M, F - lie.AdjointDual(V, M @ V))})
    assert str(caught.value).splitlines() == [
        "two orders of six-vectors are combined: LINEAR_FIRST and ANGULAR_FIRST.",
        "  at: rates['V']: Solve.b -> Sub.right -> AdjointDual, V is LINEAR_FIRST",
        "  and: the rate of the pose 'h': V is ANGULAR_FIRST",
        "  fix: give both places the same order=, or put a tx.lie.Reorder between them",
    ]


def test_an_order_error_is_a_model_error_and_a_value_error() -> None:
    assert issubclass(tx.OrderError, tx.ModelError)
    assert issubclass(tx.OrderError, ValueError)
