"""Reverse-mode derivatives (cotangents) on the graph, whose products are computed only where necessary."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from .interface import Graph

#: So many products at most stay apart: what is read further back takes as many operations for each.
_APART = 3


class Cotangent(NamedTuple):
    """A cotangent weight * rate; the rate is propagated further back.

    The cotangent of the divisor in p / r^3 is -(p / r^3) / r^3, which is zero in floating point at large r where its
    product with 3 r^2 is not. Its weight is -p / r^3 c, its rate 1 / r^3: of the size of the relative change of r^3, as
    is the rate of r, 3 r^2 / r^3.

    Attributes:
        weight: a node; it is zero where a branch that was not taken makes the cotangent zero.
        rate: a node.
    """

    weight: int
    rate: int

    def through(self, g: Graph, slope: int | tuple[int, int]) -> Cotangent:
        """The cotangent of an argument of an operation with this derivative."""
        if isinstance(slope, tuple):
            return Cotangent(g.scaled(g.over(slope[0], self.rate), self.weight), slope[1])
        if self.rate == g.one:
            return Cotangent(g.scaled(slope, self.weight), g.one)
        return Cotangent(self.weight, g.over(slope, self.rate))

    def total(self, g: Graph) -> int:
        """The product."""
        return self.weight if self.rate == g.one else g.scaled(self.rate, self.weight)


class Cotangents(Mapping[int, int]):
    """The cotangents of nodes, each the sum of the contributions of the nodes that read it."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        #: For each node the weights by their rates.
        self._terms: dict[int, dict[int, int]] = {}

    def add(self, node: int, term: Cotangent) -> None:
        g = self._graph
        if g.zero in term:
            return
        weights = self._terms.setdefault(node, {})
        known = weights.get(term.rate)
        weights[term.rate] = term.weight if known is None else g.joined(known, term.weight)

    def of(self, node: int) -> list[Cotangent]:
        """The terms of the cotangent of a node, once all its readers have contributed.

        A few products stay apart, as those of r^2 that is read by 1 / r^2 and by its root: each has its size.
        """
        g, weights = self._graph, self._terms[node]
        rates: dict[int, int] = {}
        for rate, weight in weights.items():
            rates[weight] = g.add(rates[weight], rate) if weight in rates else rate
        terms = [Cotangent(weight, rate) for weight, rate in rates.items()]
        wide = g.dtype.itemsize > 4 and any(term.rate == g.one for term in terms)
        if len(terms) == 1 or (len(terms) <= _APART and not wide):
            return terms
        if wide:
            return [Cotangent(_sum(g, terms), g.one)]
        relative = [term for term in terms if g.reciprocal_of(term.rate) is not None and not g.may_be_cut(term.weight)]
        rest = [term for term in terms if term not in relative]
        joined = [_joined(g, node, relative)] if relative else []
        return [*joined, Cotangent(_sum(g, rest), g.one)] if rest else joined

    def __getitem__(self, node: int) -> int:
        return _sum(self._graph, self.of(node))

    def __contains__(self, node: object) -> bool:
        return node in self._terms

    def __iter__(self) -> Iterator[int]:
        return iter(self._terms)

    def __len__(self) -> int:
        return len(self._terms)


def _joined(g: Graph, node: int, terms: Sequence[Cotangent]) -> Cotangent:
    """Terms whose rates are reciprocals as one of which the rate is: each weight becomes w (d rate) for a rate 1 / d.

    Their sum as a number may have a derivative out of range, as that of r^-5 by r^2 at r = 7e6, where its product with
    the derivative of r^2 is not. The weights, changes of the result with relative ones of d, have the result's size.
    """
    inverse = g.div(g.one, node)
    rate = inverse if any(term.rate == inverse for term in terms) else terms[0].rate
    divisor = g.reciprocal_of(rate)
    assert divisor is not None
    weights = (
        term.weight if term.rate == rate else g.scaled(g.over(divisor, term.rate), term.weight) for term in terms
    )
    return Cotangent(functools.reduce(g.joined, weights), rate)


def _sum(g: Graph, terms: Iterable[Cotangent]) -> int:
    return functools.reduce(g.joined, (term.total(g) for term in terms))
