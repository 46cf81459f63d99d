"""One-place mutations of models: what people get wrong in frames, transposes, duals, units and orders.

A mutation takes a node and gives what may stand in its place by mistake, made of the node and of leaves of its model.
It knows nothing of the rules of kinds.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from kinds_symmetry import Model, evaluated, replaced

import twistax as tx

lie, linalg = tx.lie, tx.linalg
Made = Iterator[tx.Expr]


def _leaves(model: Model, shape: tuple[int, ...]) -> list[tx.Expr]:
    return [leaf for leaf in model.leaves.values() if leaf.shape == shape]


def _frames_of(leaf: tx.Expr) -> dict[int, str]:
    return {} if leaf.kind is None else leaf.kind.frames()


def _is_rotation(node: tx.Expr) -> bool:
    return node.shape == (3, 3) and (node.is_group_element or isinstance(node, tx.spatial.QDCM))


def frame(node: tx.Expr, model: Model) -> Made:
    """A change of frame forgotten, done twice, the wrong way round, or of the wrong pose."""
    if isinstance(node, tx.MatMul) and node.right.ndim == 1:
        if _is_rotation(node.left):
            yield node.right
            yield node.left.T @ node.right
            yield node.left @ (node.left @ node.right)
        if isinstance(node.left, (lie.SE3Adjoint, lie.SE3AdjointDual)):
            yield node.right
            yield type(node.left)(lie.Inverse(node.left.transform), order=node.left.order) @ node.right
    if isinstance(node, lie.Act):
        yield lie.Act(lie.Inverse(node.children()[0]), node.children()[1])
        yield node.children()[1]
    if isinstance(node, lie.Compose):
        a, b = node.children()
        yield lie.Compose(b, a)
        yield lie.Compose(lie.Inverse(a), b)
        yield lie.Compose(a, lie.Inverse(b))
        yield a
        yield b
    if node.is_group_element and not isinstance(node, lie.Inverse):
        yield lie.Inverse(node)
        yield from (leaf for leaf in _leaves(model, node.shape) if leaf is not node and leaf.is_group_element)
    if node.is_leaf and not isinstance(node, tx.Constant) and node.shape in ((3,), (6,)):
        for other in _leaves(model, node.shape):
            if _frames_of(other) != _frames_of(node) and other.unit == node.unit:
                yield other
        for R in (*_leaves(model, (3, 3)), *_leaves(model, (4, 4))):
            if R.is_group_element and node.shape == (3,):
                turn = R if R.shape == (3, 3) else R[:3, :3]
                yield turn @ node
                yield turn.T @ node
            if R.shape == (4, 4) and node.shape == (6,):
                carry = lie.SE3Adjoint if node.kind.space.name == "MOTION" else lie.SE3AdjointDual
                yield carry(R, order=R.order) @ node
                yield carry(lie.Inverse(R), order=R.order) @ node


def transpose(node: tx.Expr, model: Model) -> Made:
    """A transpose or an inverse forgotten or too many, a row for a column, factors in the wrong order."""
    if isinstance(node, linalg.Transpose):
        yield node.operand
    if isinstance(node, lie.Inverse):
        yield node.children()[0]
    if isinstance(node, tx.MatMul) and node.left.ndim == 2 and node.left.shape[0] == node.left.shape[1]:
        yield node.left.T @ node.right
        if node.right.ndim == 1 or node.right.shape == node.left.shape:
            yield node.right @ node.left
    if isinstance(node, linalg.Solve):
        yield linalg.Solve(node.A.T, node.b)
    if isinstance(node, tx.Index) and node.base.shape == (3, 3) and isinstance(node.index, tuple):
        yield node.base[tuple(reversed(node.index))]


def dual(node: tx.Expr, model: Model) -> Made:
    """A twist for a momentum, a wrench for a twist, and the operators of one for those of the other."""
    swapped = {lie.SE3Adjoint: lie.SE3AdjointDual, lie.Adjoint: lie.AdjointDual}
    swapped |= {other: one for one, other in swapped.items()}
    if type(node) in swapped:
        yield swapped[type(node)](*node.children(), order=node.order)
    if isinstance(node, (lie.Adjoint, lie.AdjointDual)):
        a, b = node.children()
        yield type(node)(b, a, order=node.order)
        yield type(node)(a, a, order=node.order)
        yield type(node)(b, b, order=node.order)
        yield b
    if isinstance(node, tx.MatMul) and node.left.shape in ((3, 3), (6, 6)) and not _is_rotation(node.left):
        yield node.right
        yield linalg.Solve(node.left, node.right)
    if isinstance(node, linalg.Solve):
        yield node.b
        yield node.A @ node.b
    if node.is_leaf and node.shape == (6,):
        yield from (leaf for leaf in _leaves(model, (6,)) if type(leaf.kind) is not type(node.kind))
        for M in _leaves(model, (6, 6)):
            yield M @ node
            yield linalg.Solve(M, node)
    if node.is_leaf and node.shape == (3,) and not isinstance(node, tx.Constant):
        for J in _leaves(model, (3, 3)):
            if not J.is_group_element:
                yield J @ node
                yield linalg.Solve(J, node)
    parts = {"LinearPart": lie.angular, "AngularPart": lie.linear}
    if type(node).__name__ in parts:
        yield parts[type(node).__name__](*node.children(), order=node.order)
    if type(node).__name__ == "JoinedParts":
        yield node.with_children(node.children()[::-1])


def unit(node: tx.Expr, model: Model) -> Made:
    """A factor forgotten or too many, a product for a quotient, another power, a rate for its integral."""
    scalars = [leaf for leaf in _leaves(model, ()) if str(leaf.unit) != "1"]
    if isinstance(node, tx.Mul):
        for k, lost in enumerate(node.factors):
            rest = [factor for i, factor in enumerate(node.factors) if i != k]
            product = rest[0] if len(rest) == 1 else tx.Mul(*rest)
            yield product
            if lost.shape == ():
                yield product / lost
                yield product * lost * lost
    if isinstance(node, tx.Div):
        yield node.left
        yield node.left * node.right
        if node.right.shape == ():
            yield node.left / node.right / node.right
    if isinstance(node, tx.Power):
        yield node.base
        yield node.base**3
    if isinstance(node, (tx.Sqrt, tx.Square)):
        yield node.children()[0]
    if isinstance(node, linalg.Norm):
        yield linalg.Dot(node.children()[0], node.children()[0])
    if isinstance(node, linalg.Dot):
        yield linalg.Norm(node.children()[0])
    if isinstance(node, linalg.Cross):
        yield from node.children()
    if isinstance(node, (tx.Sin, tx.Cos, tx.Tan, tx.Exp)):
        yield node.children()[0]
    if node.is_leaf and not isinstance(node, tx.Constant):
        for other in _leaves(model, node.shape):
            if other.unit != node.unit:
                yield other
        for factor in scalars[:2]:
            yield factor * node
            yield node / factor


def order(node: tx.Expr, model: Model) -> Made:
    """[v; w] for [w; v], at one node, or by exchanged halves."""
    if getattr(node, "order", None) is not None and not node.is_leaf and not isinstance(node, lie.Reorder):
        other = {True: tx.ANGULAR_FIRST, False: tx.LINEAR_FIRST}[node.order.linear_leads]
        yield node.replace(order=other)
    if node.is_leaf and node.shape == (6,):
        yield tx.Concat(node[3:], node[:3])


def sign(node: tx.Expr, model: Model) -> Made:
    """Signs, functions and whole factors, which neither units nor axes show."""
    if isinstance(node, tx.Sub):
        yield node.left + node.right
        yield node.left
    if isinstance(node, tx.Neg):
        yield node.operand
    if isinstance(node, linalg.Cross):
        yield linalg.Cross(*reversed(node.children()))
    if isinstance(node, tx.Sin):
        yield tx.Cos(*node.children())
    if isinstance(node, tx.Add) and len(node.terms) > 1:
        yield from (term for term in node.terms if term.shape == node.shape)
    if node.is_leaf and not isinstance(node, tx.Constant):
        for other in _leaves(model, node.shape):
            if other is not node and (other.unit, other.kind) == (node.unit, node.kind):
                yield other


MUTATIONS: dict[str, Callable[[tx.Expr, Model], Made]] = {
    "frame": frame, "transpose": transpose, "dual": dual, "unit": unit, "order": order, "sign": sign,
}  # fmt: skip


class Mutant(NamedTuple):
    """A rate with one mistake."""

    what: str
    model: Model
    state: tx.State
    rate: tx.Expr
    text: str

    @property
    def refused(self) -> bool:
        try:
            tx.System(rates=self.model.rates | {self.state: self.rate})
        except (tx.KindError, tx.OrderError):
            return True
        return False

    @property
    def visible(self) -> bool:
        """Whether units or axes show the mistake; an order is one where leaves are known by their places."""
        return self.what == "order" or self.model.sees(self.state, self.rate)


def mutants(model: Model, keep: Callable[[], bool] = lambda: True) -> Iterator[Mutant]:
    """The mutants that build where nothing is declared, and whose numbers differ; `keep` draws a sample of them."""
    for state, rate in model.rates.items():
        before = evaluated(rate, model.values)
        seen = {rate.key()}
        for node in tx.expr.postorder(rate):
            for what, mutate in MUTATIONS.items():
                for new in _made(mutate, node, model):
                    if not keep():
                        continue
                    try:
                        wrong = replaced(rate, node, new)
                        if wrong.check_shape() != rate.shape or wrong.key() in seen:
                            continue
                        after = evaluated(wrong, model.values)
                    except (tx.ShapeError, tx.OperationError, tx.ModelError):
                        continue
                    seen.add(wrong.key())
                    if not np.allclose(before, after, rtol=1e-9, atol=1e-12):
                        yield Mutant(what, model, state, wrong, f"{model.name}: {state.name}': {node!r} -> {new!r}")


def _made(mutate: Callable[[tx.Expr, Model], Made], node: tx.Expr, model: Model) -> Made:
    """What a mutation makes, without what does not build by itself."""
    made = mutate(node, model)
    while True:
        try:
            yield next(made)
        except StopIteration:
            return
        except (tx.ShapeError, tx.OperationError, tx.ModelError):
            return
