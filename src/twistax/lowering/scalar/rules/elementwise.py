"""Operations on arrays, entry by entry."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..graph import Graph, Nodes
from ..operations import Operation, by_primitive, convert
from .rule import Rule, each

__all__ = ["ELEMENTWISE", "power"]


def _plain(operation: Operation) -> Rule:
    def rule(g: Graph, eqn: Any, *arrays: Nodes) -> list[Nodes]:
        return [each(g, lambda *a: g.node(operation, *a), *arrays)]

    return rule


def _method(name: str) -> Rule:
    def rule(g: Graph, eqn: Any, *arrays: Nodes) -> list[Nodes]:
        return [each(g, getattr(g, name), *arrays)]

    return rule


def power(g: Graph, x: int, n: int) -> int:
    """x^n by repeated squaring."""
    if n < 0:
        return g.div(g.one, power(g, x, -n))
    result: int | None = None
    while n:
        if n & 1:
            result = x if result is None else g.mul(result, x)
        n >>= 1
        if n:
            x = g.mul(x, x)
    return g.one if result is None else result


def _integer_pow(g: Graph, eqn: Any, a: Nodes) -> list[Nodes] | None:
    if a.size and g.dtypes[a.reshape(-1)[0]] != g.dtype:
        return None
    return [each(g, lambda x: power(g, x, eqn.params["y"]), a)]


def _rsqrt(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    root = by_primitive["sqrt"]
    return [each(g, lambda x: g.div(g.one, g.node(root, x)), a)]


def _square(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    return [each(g, lambda x: g.mul(x, x), a)]


def _pow(g: Graph, eqn: Any, a: Nodes, b: Nodes) -> list[Nodes]:
    """The exponent may be an integer."""

    def raised(x: int, n: int) -> int:
        same = n if g.dtypes[n] == g.dtypes[x] else g.node(convert(g.dtypes[x]), n)
        return g.node(by_primitive["pow"], x, same)

    return [each(g, raised, a, b)]


def _select_n(g: Graph, eqn: Any, which: Nodes, *cases: Nodes) -> list[Nodes]:
    """Case by case; a truth value chooses the second case where it holds."""
    equal, truth = by_primitive["eq"], np.dtype(bool)

    def choose(c: int, *options: int) -> int:
        if g.dtypes[c] == truth:
            return g.select(c, options[1], options[0])
        chosen = options[-1]
        for k in range(len(options) - 2, -1, -1):
            chosen = g.select(g.node(equal, c, g.constant(k, g.dtypes[c])), options[k], chosen)
        return chosen

    return [each(g, choose, which, *cases)]


def _convert(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    target = np.dtype(eqn.params["new_dtype"])

    def to(x: int) -> int:
        return x if g.dtypes[x] == target else g.node(convert(target), x)

    return [each(g, to, a)]


def _same(g: Graph, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    return list(arrays)


def _reduce_precision(g: Graph, eqn: Any, a: Nodes) -> list[Nodes] | None:
    """Nothing, where it names the type's own precision."""
    own, p = jnp.finfo(eqn.invars[0].aval.dtype), eqn.params
    return [a] if (p["exponent_bits"], p["mantissa_bits"]) == (own.nexp, own.nmant) else None


def _stop_gradient(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    stop = by_primitive["stop_gradient"]
    return [each(g, lambda x: x if g.numbers[x] is not None else g.node(stop, x), a)]


def _ordered(name: str) -> Rule:
    """le_to, lt_to: the order of all numbers, not-a-number behind them and equal to itself."""
    less, other = by_primitive[name], by_primitive["ne"]

    def compare(g: Graph, a: int, b: int) -> int:
        behind = g.node(other, b, b)
        if name == "lt":
            behind = _pair("and")(g, behind, g.node(by_primitive["eq"], a, a))
        return _pair("or")(g, g.node(less, a, b), behind)

    return lambda g, eqn, *arrays: [each(g, lambda *a: compare(g, *a), *arrays)]


def _pair(name: str) -> Callable[[Graph, int, int], int]:
    """and, or of two truth values, with what is known left out."""
    absorbing = name == "or"

    def pair(g: Graph, a: int, b: int) -> int:
        for x, y in ((a, b), (b, a)):
            known = g.numbers[x]
            if known is not None:
                return x if bool(known) is absorbing else y
        return a if a == b else g.node(by_primitive[name], a, b)

    return pair


def _boolean(name: str) -> Rule:
    """and, or: of truth values, or bit by bit."""
    pair = _pair(name)

    def rule(g: Graph, eqn: Any, a: Nodes, b: Nodes) -> list[Nodes]:
        if a.size and g.dtypes[a.reshape(-1)[0]] != np.dtype(bool):
            return [each(g, lambda x, y: g.node(by_primitive[name], x, y), a, b)]
        return [each(g, lambda x, y: pair(g, x, y), a, b)]

    return rule


_SPECIAL: dict[str, Callable[..., Any]] = {
    **{name: _method(name) for name in ("add", "sub", "mul", "div", "neg")},
    "add_any": _method("add"),
    "le_to": _ordered("le"),
    "lt_to": _ordered("lt"),
    "and": _boolean("and"),
    "or": _boolean("or"),
    "square": _square,
    "rsqrt": _rsqrt,
    "integer_pow": _integer_pow,
    "pow": _pow,
    "reduce_precision": _reduce_precision,
    "select_n": _select_n,
    "convert_element_type": _convert,
    "stop_gradient": _stop_gradient,
    **dict.fromkeys(("copy", "copy_p", "optimization_barrier", "pvary"), _same),
}

ELEMENTWISE: dict[str, Rule] = {
    **{name: _plain(operation) for name, operation in by_primitive.items() if name not in ("select", "stop_gradient")},
    **_SPECIAL,
}
