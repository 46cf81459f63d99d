"""Formulas of nodes that occur many times on operands of the same types: JAX traces each of them once.

A function of `jax.numpy` checks and promotes its arguments at each call, which takes several times as long as the
operations that it comes to. A robot of thirty links has ten thousand nodes, of some hundred kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any

import jax

from ..jax_inside import is_traced, jaxpr_as_fun

#: A formula is traced alone where it is met for this time.
_OFTEN = 3


class RepeatedFormulas:
    """The formulas that one evaluation of expressions met: how often, or what JAX traced of them."""

    def __init__(self) -> None:
        self._met: dict[Hashable, int] = {}
        self._traced: dict[Hashable, Callable[..., list[Any]]] = {}

    def value(self, node: Any, operands: Sequence[Any]) -> Any:
        """The value of a node without branches, from those of its operands."""
        if not is_traced(operands):
            return node.evaluate_on_demand(operands, [])
        kind = (type(node), node.static_key(), *map(jax.typeof, operands))
        if kind not in self._traced:
            times = self._met[kind] = self._met.get(kind, 0) + 1
            if times < _OFTEN:
                return node.evaluate_on_demand(operands, [])
            formula = jax.make_jaxpr(lambda *values: node.evaluate_on_demand(list(values), []))
            self._traced[kind] = jaxpr_as_fun(formula(*operands))
        return self._traced[kind](*operands)[0]
