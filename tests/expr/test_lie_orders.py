"""[v; w] and [w; v]: where they meet in a system it says so, names both places, and Reorder joins them."""

import re

import numpy as np
import pytest

import twistax as tx
from twistax import lie

LINEAR, ANGULAR = tx.LINEAR_FIRST, tx.ANGULAR_FIRST
ORDERS = pytest.mark.parametrize("order", [LINEAR, ANGULAR], ids=str)
V, U = tx.State("V", shape=(6,)), tx.State("U", shape=(6,))
F = tx.Control("F", shape=(6,))
M, P = tx.Parameter("M", shape=(6, 6)), tx.Parameter("P", shape=(4, 6))
T = tx.Parameter("T", shape=(4, 4))
s = tx.State("s")


def pose(order: tx.Order = LINEAR) -> tx.State:
    return tx.State("g", group=tx.SE3, order=order)


def newton_euler(order: tx.Order) -> tx.Expr:
    return tx.linalg.Solve(M, F - lie.AdjointDual(V, M @ V, order=order))


def body(order: tx.Order = LINEAR, outputs: dict[str, tx.Expr] | None = None, **others: tx.Expr) -> tx.System:
    """A body with pose g and twist V in one order, driven by F; rates of the states U and s by keyword."""
    rates = {pose(order): V, V: newton_euler(order), U: others.get("U", 0.0 * U), s: 0.0 * s}
    return tx.System(rates=rates, outputs=outputs)


# ---- what may stand together -------------------------------------------------------------------------------------


@ORDERS
def test_one_order_throughout(order: tx.Order) -> None:
    g = pose(order)
    outputs = {
        "spin": lie.angular(V, order=order),
        "world": lie.SE3AdjointDual(g, order=order) @ (M @ V),
        "error": lie.SE3Log(lie.Compose(lie.Inverse(T), g), order=order) - V,
        "thrust": lie.wrench(force=V[:3], torque=np.zeros(3), order=order) + F,
        "bodies": tx.Vmap(lambda p: lie.AdjointDual(V, p, order=order), batch=P),
    }
    body(order, outputs)


@ORDERS
def test_what_has_no_order(order: tx.Order) -> None:
    """Poses, constants, parts, and six numbers that never meet a Lie node of the other order."""
    g, fixed = pose(order), np.arange(6.0)
    other = ANGULAR if order is LINEAR else LINEAR
    outputs = {
        "the same pose": lie.SE3Adjoint(g, order=other) @ U,
        "a constant both ways": lie.linear(fixed, order=LINEAR) + lie.linear(fixed, order=ANGULAR),
        "a constant in sums": (V + fixed) @ (F - fixed) + (U - fixed) @ fixed,
        "parts": lie.linear(V, order=order) + lie.angular(U, order=other),
        "rebuilt from parts": lie.linear(tx.Concat(V[3:], V[:3]), order=other),
        "rotations": lie.LeftJacobian(V[:3], order=other) @ (lie.Hat(V[3:], order=other) @ V[:3]),
    }
    body(order, outputs)


def test_two_bodies_with_an_order_each() -> None:
    h = tx.State("h", group=tx.SE3, order=ANGULAR)
    tx.System(rates={pose(): V, V: newton_euler(LINEAR), h: U, U: lie.AdjointDual(U, 2.0 * U, order=ANGULAR)})


def test_joints_have_no_order() -> None:
    """Six joint rates drive a linear-first and an angular-first twist through two Jacobians."""
    q, J, K = tx.State("q", shape=(6,)), tx.Parameter("J", (6, 6)), tx.Parameter("K", (6, 6))
    outputs = {"hand": lie.linear(J @ q), "elbow": lie.linear(K @ q, order=ANGULAR)}
    tx.System(rates={q: tx.linalg.Solve(M, J.T @ F)}, outputs=outputs)
    with pytest.raises(tx.OrderError):
        tx.System(rates={q: tx.linalg.Solve(M, J.T @ F)}, outputs=outputs | {"again": lie.angular(K @ q)})


# ---- what may not ------------------------------------------------------------------------------------------------

G = pose()
#: The linear-first body of `body`, read as if it were angular first.
MISREAD = [
    lie.AdjointDual(V, U, order=ANGULAR),
    lie.AdjointDual(U, M @ V, order=ANGULAR),
    lie.Adjoint(U, 2.0 * V, order=ANGULAR),
    lie.Adjoint(V / 2.0, U, order=ANGULAR),
    lie.SE3Adjoint(G, order=ANGULAR) @ V,
    lie.SE3AdjointDual(G, order=ANGULAR) @ (F - M @ V),
    lie.SE3AdjointDual(G, order=ANGULAR).T @ F,
    lie.AdjointAction(G, V, order=ANGULAR),
    lie.CoadjointAction(G, F, order=ANGULAR),
    lie.SE3Exp(-V, order=ANGULAR),
    V - lie.SE3Log(G, order=ANGULAR),
    lie.Hat(V, order=ANGULAR),
    lie.Vee(T, order=ANGULAR) + V,
    lie.LeftJacobian(V, order=ANGULAR),
    lie.RightJacobian(U, order=ANGULAR) @ V,
    lie.LeftJacobianInverse(V * s, order=ANGULAR),
    lie.RightJacobianInverse(U, order=ANGULAR) @ V,
    lie.linear(V, order=ANGULAR),
    lie.angular(tx.linalg.Inv(M) @ F, order=ANGULAR),
    lie.wrench(force=V[:3], torque=V[3:], order=ANGULAR) - F,
    tx.linalg.Dot(lie.wrench(force=V[:3], torque=V[3:], order=ANGULAR), V),
    tx.Where(s <= 0.0, V, lie.twist(linear=V[:3], angular=V[3:], order=ANGULAR)),
    tx.Cond(s <= 0.0, V, lie.twist(linear=V[:3], angular=V[3:], order=ANGULAR)),
    tx.Vmap(lambda p: lie.AdjointDual(V, p, order=ANGULAR), batch=P),
    lie.Reorder(V, order=LINEAR),
    lie.linear(lie.Reorder(V, order=ANGULAR)),
    lie.Reorder(lie.SE3Adjoint(G, order=ANGULAR), order=LINEAR) @ lie.Reorder(V, order=ANGULAR),
]


@pytest.mark.parametrize("misread", MISREAD, ids=str)
def test_two_orders_meet(misread: tx.Expr) -> None:
    """The message names both orders, a place each, and the way out."""
    with pytest.raises(tx.OrderError) as caught:
        body(outputs={"misread": misread})
    first, *places, fix = str(caught.value).splitlines()
    assert re.match(
        r"two orders of six-vectors are combined.*: (LINEAR|ANGULAR)_FIRST and (LINEAR|ANGULAR)_FIRST\.$", first
    )
    assert len(places) == 2
    assert sorted(re.findall(r"is (\w+)_FIRST", "\n".join(places))) == ["ANGULAR", "LINEAR"]
    assert any("outputs['misread']" in place for place in places)
    assert "order=" in fix
    assert "tx.lie.Reorder" in fix


def test_the_places_are_paths() -> None:
    with pytest.raises(tx.OrderError) as caught:
        body(outputs={"misread": tx.linalg.Norm(lie.linear(V, order=ANGULAR))})
    text = str(caught.value)
    assert "rates['V']: Solve.b -> Sub.right -> AdjointDual, " in text
    assert "outputs['misread']: Norm.operand -> LinearPart, V is ANGULAR_FIRST" in text


def test_a_pose_and_its_rate() -> None:
    with pytest.raises(tx.OrderError, match=r"the rate of the pose 'g': V is ANGULAR_FIRST"):
        tx.System(rates={pose(ANGULAR): V, V: newton_euler(LINEAR)})


def test_a_state_and_its_rate() -> None:
    """U is read linear first in an output; its rate is an angular-first bracket."""
    a, b = tx.Parameter("a", (6,)), tx.Parameter("b", (6,))
    with pytest.raises(tx.OrderError) as caught:
        body(U=lie.Adjoint(a, b, order=ANGULAR), outputs={"v": lie.linear(U)})
    assert "rates['U']: ad(a, b, order=ANGULAR_FIRST) is ANGULAR_FIRST" in str(caught.value)
    assert "outputs['v']" in str(caught.value)


def test_a_matrix_state_and_its_rate() -> None:
    """A 6x6 state, such as a covariance, has an order as well."""
    C = tx.State("C", shape=(6, 6))
    rates = {C: lie.SE3Adjoint(T, order=ANGULAR)}
    tx.System(rates=rates, outputs={"w": lie.angular(C @ F, order=ANGULAR)})
    with pytest.raises(tx.OrderError, match=r"outputs\['w'\]"):
        tx.System(rates=rates, outputs={"w": lie.angular(C @ F)})


def test_constraints_and_equal_leaves_count() -> None:
    """Two objects of the same name and shape are one leaf."""
    same = tx.State("V", shape=(6,))
    with pytest.raises(tx.OrderError, match=r"constraints\["):
        tx.System(
            rates={pose(): V, V: newton_euler(LINEAR)},
            constraints=[tx.linalg.Norm(lie.linear(same, order=ANGULAR)) <= 1.0],
        )


def test_an_order_must_be_an_order() -> None:
    for wrong in ("linear", None, True):
        with pytest.raises(TypeError, match=r"order=tx\.LINEAR_FIRST or tx\.ANGULAR_FIRST"):
            lie.Adjoint(V, U, order=wrong)


# ---- Reorder -----------------------------------------------------------------------------------------------------


def test_reorder_joins_two_orders() -> None:
    """The same flight written twice: once linear first, once angular first with a Reorder at the seams."""
    g = pose()
    swapped = lie.Reorder(V, order=ANGULAR)
    inertia = lie.Reorder(M, order=ANGULAR)
    bias = lie.AdjointDual(swapped, inertia @ swapped, order=ANGULAR)
    rate = tx.linalg.Solve(inertia, lie.Reorder(F, order=ANGULAR) - bias)
    plain = tx.compile(tx.System(rates={g: V, V: newton_euler(LINEAR)}))
    mixed = tx.compile(tx.System(rates={g: V, V: lie.Reorder(rate)}))
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6))
    values = ({"g": np.eye(4), "V": rng.normal(size=6)}, {"F": rng.normal(size=6)}, {"M": root @ root.T + np.eye(6)})
    np.testing.assert_allclose(mixed(0.0, *values)["V"], plain(0.0, *values)["V"], rtol=1e-12)
    np.testing.assert_array_equal(mixed(0.0, *values)["g"], plain(0.0, *values)["g"])
