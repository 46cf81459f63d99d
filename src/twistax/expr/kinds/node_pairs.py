"""What the rule of a node says of axes, by the numbers of its operands: one record for all nodes that are alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from .kinds import Space
from .rules import Common, Rule

_SIX = 6


class AxisLink(NamedTuple):
    """An axis of a value and one of another that have one frame, and one space or dual ones unless `dual` is None.

    If `half`, only where the second is known to be a twist or a wrench.
    """

    one: int
    axis: int
    other: int
    its_axis: int
    dual: bool | None
    half: bool


class NodePairs(NamedTuple):
    """What a rule says of the axes of a node. Values are numbers of operands; the node has the number after them.

    Attributes:
        links: axes that correspond.
        spaces: values, axes and the spaces that they are in.
        unframed: vectors that can be in no frame, and what makes them so.
        places: operands that are made of constants alone, and another value at each place.
        free: whether the node is made of constants alone.
    """

    links: Sequence[AxisLink]
    spaces: Sequence[tuple[int, int, Space]]
    unframed: Sequence[tuple[int, int]]
    places: Sequence[int]
    free: bool

    @staticmethod
    def of(node: Any, rule: Rule, children: Sequence[Any], frees: Sequence[bool]) -> NodePairs:
        """What the rule says of a node. `frees`: whether an operand is made of constants alone."""
        values = [*children, node]
        if not any(value.shape for value in values):
            return NodePairs((), (), (), (), all(frees))
        numbers = {id(value): k for k, value in enumerate(values)}
        links = [_link(numbers, *link) for link in rule.links(node)]
        spaces = [(numbers[id(value)], axis, space) for value, axis, space in rule.spaces(node)]
        unframed = [(numbers[id(vector)], numbers[id(by)]) for vector, by in rule.unframed(node)]
        free, last, places = all(frees), len(children), list[int]()
        if any(is_free and child.shape for is_free, child in zip(frees, children, strict=True)):
            if rule.entrywise:  # what is made of constants alone says nothing here
                free = all(frees[link.one] for link in links) if links else free
                links = [link for link in links if not frees[link.one]]
            else:
                sources = {k for link in links for k in (link.one, link.other)} - {last} or range(last)
                free = all(frees[k] for k in sources) and all(k != last for k, _, _ in spaces)
                places = [k for k in range(last) if frees[k]]
        if free:  # its operands are other values at other places
            return NodePairs((), (), unframed, (), True)
        spaces = [(k, axis, space) for k, axis, space in spaces if values[k].shape[axis] == _SIX]
        return NodePairs(links, spaces, unframed, places, False)


def _link(numbers: dict[int, int], one: Any, axis: int, other: Any, its_axis: int, common: Common) -> AxisLink:
    dual = common is Common.DUAL if common in (Common.SAME, Common.DUAL) and one.shape[axis] == _SIX else None
    return AxisLink(numbers[id(one)], axis, numbers[id(other)], its_axis, dual, common is Common.HALF)
