"""Right models are accepted; mutations of frame, transpose, dual, unit and order that change a number are refused.

Each mutant replaces one node of one rate. Counted are those that build where nothing is declared and whose numbers
differ. What kinds cannot see, signs and factors without unit, is counted apart.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import function_of
from kinds_models import MODELS

import twistax as tx

lie, linalg = tx.lie, tx.linalg


def _square(node: tx.Expr) -> bool:
    return node.shape in ((3, 3), (6, 6))


def _frame(node: tx.Expr) -> Iterator[tx.Expr]:
    """A change of frame forgotten, or the other way round."""
    if isinstance(node, tx.MatMul):
        R, vector = node.left, node.right
        if R.is_group_element and vector.ndim == 1:
            yield vector
            yield lie.Inverse(R) @ vector
        elif isinstance(R, (lie.SE3Adjoint, lie.SE3AdjointDual)):
            yield vector
            yield type(R)(lie.Inverse(R.transform)) @ vector
    if isinstance(node, lie.Inverse):
        yield node.element


def _transpose(node: tx.Expr) -> Iterator[tx.Expr]:
    """A transpose forgotten or too many, factors in the wrong order."""
    if isinstance(node, linalg.Transpose):
        yield node.operand
    if isinstance(node, tx.MatMul):
        if _square(node.left):
            yield node.left.T @ node.right
        if node.right.ndim == 1 and _square(node.left):
            yield node.right @ node.left


def _dual(node: tx.Expr) -> Iterator[tx.Expr]:
    """A twist for a momentum, a wrench for a twist, and the operators of one for those of the other."""
    if isinstance(node, lie.SE3Adjoint):
        yield lie.SE3AdjointDual(node.transform)
    if isinstance(node, lie.SE3AdjointDual):
        yield lie.SE3Adjoint(node.transform)
    if isinstance(node, lie.AdjointDual):
        yield lie.Adjoint(node.twist, node.momentum)
        yield lie.AdjointDual(node.momentum, node.twist)
    if isinstance(node, linalg.Solve):
        yield node.b
        yield node.A @ node.b
    if isinstance(node, tx.MatMul) and isinstance(node.left, tx.Parameter) and _square(node.left):
        yield node.right
        yield linalg.Solve(node.left, node.right)


def _unit(node: tx.Expr) -> Iterator[tx.Expr]:
    """A factor forgotten, a quotient for a product, another power."""
    if isinstance(node, tx.Mul) and len(node.factors) == 2:
        a, b = node.factors
        for kept, lost in ((a, b), (b, a)):
            if kept.shape == node.shape and not _pure(lost):
                yield kept
        if not _pure(b) and b.shape in ((), a.shape):
            yield a / b
    if isinstance(node, tx.Div) and not _pure(node.right):
        if node.left.shape == node.shape:
            yield node.left
        yield node.left * node.right
    if isinstance(node, tx.Power) and not _pure(node.base):
        yield node.base
        yield node.base**3
    if isinstance(node, linalg.Norm):
        yield node * node


def _order(node: tx.Expr) -> Iterator[tx.Expr]:
    """[v; w] for [w; v]: of one node, or of both parts."""
    if isinstance(node, (lie.Adjoint, lie.AdjointDual)):
        yield node.replace(order=tx.ANGULAR_FIRST)
    if isinstance(node, (lie.SE3Adjoint, lie.SE3AdjointDual)):
        yield node.replace(order=tx.ANGULAR_FIRST)
    if type(node).__name__ == "JoinedParts":
        parts = node.children()
        yield lie.wrench(force=parts[0], torque=parts[1], order=tx.ANGULAR_FIRST)
        yield lie.wrench(force=parts[1], torque=parts[0])


def _other_leaf(leaves: list[tx.Expr]) -> Callable[[tx.Expr], Iterator[tx.Expr]]:
    def mutate(node: tx.Expr) -> Iterator[tx.Expr]:
        """Another leaf of the same shape, which differs in kind, frame or unit."""
        for other in leaves:
            fits = node.is_leaf and not isinstance(node, tx.Constant) and other.shape == node.shape
            if fits and (other.kind, other.unit) != (node.kind, node.unit):
                yield other

    return mutate


def _blind(node: tx.Expr) -> Iterator[tx.Expr]:
    """Signs and factors without unit."""
    if isinstance(node, tx.Sub):
        yield node.left + node.right
    if isinstance(node, tx.Neg):
        yield node.operand
    if isinstance(node, linalg.Cross):
        yield linalg.Cross(node.right, node.left)
    if isinstance(node, tx.Sin):
        yield tx.Cos(node.operand)
    if isinstance(node, tx.Mul) and any(map(_pure, node.factors)):
        yield from (factor for factor in node.factors if factor.shape == node.shape)


def _pure(value: tx.Expr) -> bool:
    """A number without unit, as far as the mutations know: sines, angles, whole numbers, what is declared so."""
    if isinstance(value, (tx.Sin, tx.Cos, tx.Tan)):
        return True
    if isinstance(value, tx.Power):
        return _pure(value.base)
    if value.is_leaf:
        return str(value.unit) == "1" or isinstance(value, tx.Constant)
    return False


def replaced(root: tx.Expr, old: tx.Expr, new: tx.Expr) -> tx.Expr:
    """The tree with one node replaced, wherever this object stands."""
    if root is old:
        return new
    children = root.children()
    changed = [replaced(child, old, new) for child in children]
    return root.with_children(changed) if any(a is not b for a, b in zip(children, changed)) else root


def nodes_of(root: tx.Expr) -> list[tx.Expr]:
    return list({id(node): node for node in tx.expr.postorder(root)}.values())


def values_of(leaves: list[tx.Expr]) -> dict[str, Any]:
    rng = np.random.default_rng(3)
    values: dict[str, Any] = {}
    for leaf in leaves:
        if leaf.is_group_element:
            R = np.asarray(lie.so3.exp(jnp.asarray(rng.normal(size=3))))
            values[leaf.name] = (
                R if leaf.shape == (3, 3) else np.asarray(tx.pose(rotation=R, position=rng.normal(size=3)))
            )
        elif getattr(leaf, "value", None) is not None:
            values[leaf.name] = leaf.value
        else:
            values[leaf.name] = rng.uniform(0.3, 1.7, size=leaf.shape)
    return {name: jnp.asarray(value) for name, value in values.items()}


def study(model: Callable[[], dict[tx.State, Any]], most: int = 10**6) -> Iterator[tuple[str, bool, str]]:
    """Kind of mutation, whether it is refused, and the mutant's text, of the mutants of a model that count."""
    rates = {state: tx.to_expr(rate) for state, rate in model().items()}
    tx.System(rates=rates)
    leaves = list(
        {
            leaf.name: leaf
            for root in [*rates, *rates.values()]
            for leaf in tx.expr.leaves_of(root)
            if not isinstance(leaf, tx.Constant)
        }.values()
    )
    values = values_of(leaves)
    kinds = {"frame": _frame, "transpose": _transpose, "dual": _dual, "unit": _unit, "order": _order}
    kinds |= {"leaf": _other_leaf(leaves), "signs and factors": _blind}
    count = 0
    for state, rate in rates.items():
        before = np.asarray(function_of(rate)(values)[0])
        for node in nodes_of(rate):
            for what, mutate in kinds.items():
                for new in mutate(node):
                    if count >= most:
                        return
                    try:
                        mutant = replaced(rate, node, new)
                        if mutant.check_shape() != rate.shape:
                            continue
                        after = np.asarray(function_of(mutant)(values)[0])
                    except (tx.ShapeError, tx.OperationError):
                        continue
                    if np.allclose(before, after, rtol=1e-9, atol=1e-12):
                        continue
                    try:
                        tx.System(rates=rates | {state: mutant})
                        refused = False
                    except (tx.KindError, tx.OrderError):
                        refused = True
                    count += 1
                    yield what, refused, f"{model.__name__}: {state.name}' = {mutant!r} ({node!r} -> {new!r})"


def shares(models: Any, most: int = 10**6) -> tuple[Counter[str], Counter[str], list[str]]:
    """How many mutants count and how many are refused, by kind of mutation; and the others, written out."""
    total, refused, passed = Counter[str](), Counter[str](), list[str]()
    for model in models:
        for what, seen, text in study(model, most):
            total[what] += 1
            refused[what] += seen
            if not seen and what != "signs and factors":
                passed.append(f"{what}: {text}")
    return total, refused, passed


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_a_right_model_is_accepted(model: Any) -> None:
    assert isinstance(tx.System(rates=model()), tx.System)


def test_mutants_of_one_model_are_refused() -> None:
    total, refused, passed = shares([MODELS[1]])
    seen = total.total() - total["signs and factors"]
    assert seen > 20
    assert refused.total() - refused["signs and factors"] >= 0.95 * seen, passed


def test_mutants_of_all_models_are_refused() -> None:
    total, refused, passed = shares(MODELS)
    seen = total.total() - total["signs and factors"]
    print(f"\n{seen} mutants", dict(total), dict(refused), *passed, sep="\n")
    assert refused.total() - refused["signs and factors"] >= 0.95 * seen, passed
