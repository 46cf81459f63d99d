"""Kind rules of nodes that reduce, join or cut arrays, and of tables."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Iterable
from typing import Any

from .rules import ByShapes, Common, Link, Rule, SpaceOf, Units, common_unit, six
from .unit import METRE, ONE, Unit


@dataclasses.dataclass(frozen=True)
class Reduced(ByShapes):
    """A sum or a norm of all entries has their unit."""

    by_operands = True

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        return None if six(node.children()[0], space) else units[0]


@dataclasses.dataclass(frozen=True)
class JoinedPieces(ByShapes):
    """Joined pieces: one unit if all have it. Rows (3,) have one frame, and so have the halves of a twist or a wrench.
    Other vectors may be joined in any frames, such as the features of a network.
    """

    rows: bool = False
    by_operands = True

    def links(self, node: Any) -> Iterable[Link]:
        values = node.children()
        halves = node.shape == (6,) and all(value.shape == (3,) for value in values)
        if halves or (self.rows and node.shape[-1:] == (3,)):
            for value in values:
                if value.shape[-1:] == (3,):
                    yield value, -1, node, -1, Common.HALF if halves else Common.FRAME

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        distinct = set(units)
        return distinct.pop() if len(distinct) == 1 else None


class _PartOfArray(Rule):
    """A part of an array: whole axes keep their frame; the rotation and the position of a pose have its frames."""

    def variant(self, node: Any) -> Hashable:
        """The index, where it is made of numbers and slices."""
        parts = node.index if isinstance(node.index, tuple) else (node.index,)
        return repr(node.index) if all(isinstance(part, (int, slice)) for part in parts) else None

    def links(self, node: Any) -> Iterable[Link]:
        base, index = node.base, node.index
        if isinstance(index, int) and node.shape != (4,):
            for axis in range(-node.ndim, 0):
                yield base, axis, node, axis, Common.SAME
        elif base.shape == (4, 4) and isinstance(index, tuple) and len(index) == 2:
            if index[0] == slice(None, 3) or index[0] == slice(0, 3):
                yield base, -2, node, -node.ndim, Common.FRAME
                if node.shape == (3, 3):
                    yield base, -1, node, -1, Common.FRAME
        elif base.shape == (3, 3) and node.shape == (3,):
            parts = index if isinstance(index, tuple) else (index,)
            kept = -1 if isinstance(parts[0], int) else -2
            yield base, kept, node, -1, Common.FRAME
        elif node.shape in ((3,), (6,)) and base.shape == (6,) and isinstance(index, slice):
            yield base, -1, node, -1, Common.FRAME

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        base, index = node.base, node.index
        if base.shape == (4, 4) and base.is_group_element and isinstance(index, tuple) and len(index) == 2:
            if isinstance(index[1], int) and index[1] in (3, -1):
                return METRE
            return ONE if index[1] == slice(None, 3) else None
        return None if six(base, space) or (base.shape == (6,) and not base.is_leaf) else units[0]


class _Table(ByShapes):
    """Coordinates, the points of their axes, and values: the unit of each axis, and that of the result."""

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        count, values = len(units) // 2, node.children()
        for k in range(count):
            pair = [values[k], values[count + k]]
            common_unit(pair, [units[k], units[count + k]], f"{type(node).__name__} has one unit along an axis")
        return units[-1]


REDUCED, PIECES, ROWS = Reduced(), JoinedPieces(), JoinedPieces(rows=True)
PART, TABLE = _PartOfArray(), _Table()
