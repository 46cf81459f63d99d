"""Kind rules: how nodes propagate kinds, frames and units; one rule for each node class, `Expr.kinds`.

An axis has a frame, and an axis of length six also has a space: that of twists, or its dual. A rule states which axes
have the same frame and space (SAME), which have the same frame and are dual because they are summed over (DUAL), and
which have only the frame in common (FRAME). `Expr.shared_orders` states which axes correspond. A value has one unit for
all entries; the unit of a six-vector is that of its angular part.

This module accesses nodes only by their fields and methods, so that node classes can refer to their rules.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable, Hashable, Iterable, Sequence
from fractions import Fraction
from typing import Any, ClassVar, TypeAlias

from .bodies import Acts, Bodies, BodyMotion, summed
from .kinds import Space
from .unit import ONE, Unit

Units: TypeAlias = Sequence[Unit | None]
#: The space of an axis of a value, as far as it is known.
SpaceOf: TypeAlias = Callable[[Any, int], Space | None]


class Common(enum.Enum):
    """The properties that two axes have in common."""

    SAME = "frame and space"
    DUAL = "frame, with dual spaces"
    FRAME = "frame"
    HALF = "frame, if the second is known to be a twist or a wrench"


#: The sizes of axes that may have a frame: of vectors, rotations and poses, six-vectors.
_WITH_FRAME = (3, 4, 6)
#: Two axes and what they have in common.
Link: TypeAlias = tuple[Any, int, Any, int, Common]


class Clash(Exception):
    """Two operands whose units are incompatible, or one whose unit is not accepted; `values` contains one or two."""

    def __init__(self, sentence: str, *values: tuple[Any, Unit]) -> None:
        super().__init__(sentence)
        self.values = values


@dataclasses.dataclass(frozen=True)
class Rule:
    """A rule without constraints: frames and units of operands and result are undetermined, for any shapes.

    Subclass it for a custom node, as a frozen dataclass.

    Raises: a system raises KindError if operands violate a rule; the method `unit` raises `Clash`, which is converted
    to one.
    """

    #: Whether the unit is open where those of all operands are.
    by_operands: ClassVar[bool] = False
    #: Whether the result is of the bodies of the last operand.
    keeps_bodies: ClassVar[bool] = False
    #: Whether each link is one from an operand to the result.
    entrywise: ClassVar[bool] = False
    #: Whether it maps a body over batches: elements and results are as the values of the body.
    maps: ClassVar[bool] = False

    def variant(self, node: Any) -> Hashable:
        """What pairs of axes depend on besides the node's class and its operands' shapes; None: read for each node."""
        return None

    def links(self, node: Any) -> Iterable[Link]:
        """The pairs of corresponding axes."""
        return ()

    def spaces(self, node: Any) -> Iterable[tuple[Any, int, Space]]:
        """The axes whose space the node determines, that of twists or of wrenches."""
        return ()

    def unframed(self, node: Any) -> Iterable[tuple[Any, Any]]:
        """Pairs of a vector that cannot be in any frame, and the cause."""
        return ()

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        """The unit of the result from those of the operands, None if unknown. Raises Clash."""
        return None

    def made(self, node: Any, units: Units) -> Space | None:
        """The space of the result, if the units of the operands determine it."""
        return None

    def bodies(self, node: Any, known: Sequence[Bodies]) -> Bodies:
        """The body of the result, from those of the operands. Raises BodyClash."""
        return known[-1] if self.keeps_bodies else None


#: Stated by nodes that can be anything: tables, maps over batches, functions of users.
OPEN = Rule()
#: Stated by leaves: what they declare.
DECLARED = Rule()


@dataclasses.dataclass(frozen=True)
class _Mapped(Rule):
    """A map over batches: every element is of the kind of its batch, and the result is of the kind of the body."""

    maps = True


MAPPED = _Mapped()


@dataclasses.dataclass(frozen=True)
class FixedUnits(Rule):
    """The rule of a function with fixed units, such as the pressure in Pa at an altitude in m; operands have any shape.

    Attributes:
        takes: the unit of each operand, None for any.
        gives: the unit of the result, None if unknown.
        one_frame: whether operands and result are vectors in one frame.
    Raises: a system raises KindError if an operand is known to have another unit.
    Example: `kinds = tx.kinds.FixedUnits((tx.kinds.Unit.of("m"),), tx.kinds.Unit.of("Pa"))` in the class of a node.
    """

    takes: tuple[Unit | None, ...] = ()
    gives: Unit | None = None
    one_frame: bool = False

    def links(self, node: Any) -> Iterable[Link]:
        return [(value, -1, node, -1, Common.FRAME) for value in node.children()] if self.one_frame else []

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        for value, unit, wanted in zip(node.children(), units, self.takes, strict=True):
            if unit is not None and wanted is not None and unit != wanted:
                raise Clash(f"{type(node).__name__} takes {wanted}", (value, unit))
        return self.gives


def common_unit(values: Sequence[Any], units: Units, what: str) -> Unit | None:
    """The common unit of all known units. Raises Clash if they differ."""
    known = [(value, unit) for value, unit in zip(values, units, strict=True) if unit is not None]
    for value, unit in known[1:]:
        if unit != known[0][1]:
            raise Clash(what, known[0], (value, unit))
    return known[0][1] if known else None


def _number(node: Any, value: Any, unit: Unit | None) -> None:
    """Raise Clash for an operand that must have no unit."""
    if unit is not None and unit != ONE:
        raise Clash(f"{type(node).__name__} expects radians or a number without unit", (value, unit))


def _entries(node: Any, values: Sequence[Any], how: Common) -> Iterable[Link]:
    """Corresponding axes of what is combined entry by entry."""
    shape = node.shape
    axes = [(-axis, size) for axis, size in enumerate(reversed(shape), 1) if size in _WITH_FRAME]
    for value in values if axes else ():
        its = value.shape
        for axis, size in axes:
            if len(its) >= -axis and its[axis] == size:
                yield value, axis, node, axis, how


def _groups(node: Any, *how: Common) -> Iterable[Link]:
    """The groups of `shared_orders`; the first ones as said, the others SAME."""
    for k, axes in enumerate(node.shared_orders()):
        value, axis = axes[0]
        if value.shape[axis] in _WITH_FRAME:
            common = how[k] if k < len(how) else Common.SAME
            for other, its_axis in axes[1:]:
                yield value, axis, other, its_axis, common


def six(value: Any, space: SpaceOf) -> bool:
    """Whether a value is known to consist of six-vectors, whose entries have different units."""
    return any(size == 6 and space(value, k - value.ndim) is not None for k, size in enumerate(value.shape))


def _product(values: Sequence[Any], units: Units) -> Unit | None:
    """The product of units; a whole number counts, and has none."""
    total = ONE
    for value, unit in zip(values, units, strict=True):
        if unit is None and not (hasattr(type(value), "whole") and value.whole):
            return None
        total *= unit or ONE
    return total


class ByShapes(Rule):
    """Base of rules whose pairs of axes depend on the class of a node and the shapes of its operands alone."""

    def variant(self, node: Any) -> Hashable:
        return True


@dataclasses.dataclass(frozen=True)
class Terms(ByShapes):
    """Operands and result agree in everything; the first `conditions` operands are apart from that.

    A scalar that is added to each entry of a vector is not frame-invariant.

    Attributes:
        conditions: the number of leading operands that do not contribute to the result.
        compares: whether the result is boolean.
        signs: the signs of the terms of a sum; the last one is that of all others.
    """

    conditions: int = 0
    compares: bool = False
    signs: tuple[int, ...] = ()
    by_operands = entrywise = True

    def unframed(self, node: Any) -> Iterable[tuple[Any, Any]]:
        if not self.signs or node.shape not in ((3,), (6,)):
            return ()
        return ((node, value) for value in node.children() if value.shape == ())

    def links(self, node: Any) -> Iterable[Link]:
        return _entries(node, node.children()[self.conditions :], Common.SAME)

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        values = node.children()[self.conditions :]
        unit = common_unit(values, units[self.conditions :], f"{type(node).__name__} has one unit")
        return None if self.compares else unit

    def bodies(self, node: Any, known: Sequence[Bodies]) -> Bodies:
        values = node.children()
        return (
            summed(values, known, [*self.signs, *self.signs[-1:] * len(values)][: len(values)]) if self.signs else None
        )


@dataclasses.dataclass(frozen=True)
class UnitPower(ByShapes):
    """Entrywise power: the unit to that power; None reads the power from a constant exponent."""

    power: Fraction | None = None
    entrywise = True

    def links(self, node: Any) -> Iterable[Link]:
        return _entries(node, node.children()[:1], Common.FRAME)

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        if six(node.children()[0], space):
            return None
        if self.power is not None:
            return None if units[0] is None else units[0] ** self.power
        base, exponent = node.children()
        _number(node, exponent, units[1])
        value = getattr(exponent, "value", None)
        if not exponent.is_leaf or value is None or value.ndim:
            _number(node, base, units[0])
            return units[0]
        return None if units[0] is None else units[0] ** Fraction(float(value)).limit_denominator(64)


@dataclasses.dataclass(frozen=True)
class NumberRule(ByShapes):
    """Operands are angles in rad or numbers without unit, and the result is one; `of_one_unit`: operands have one
    common unit.
    """

    of_one_unit: bool = False
    gives: Unit | None = ONE

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        if self.of_one_unit:
            common_unit(node.children(), units, f"{type(node).__name__} expects operands of one unit")
        else:
            for value, unit in zip(node.children(), units, strict=True):
                _number(node, value, unit)
        return self.gives


class _Product(ByShapes):
    """Entry by entry: one frame; the units multiply."""

    by_operands = entrywise = True

    def links(self, node: Any) -> Iterable[Link]:
        values = node.children()
        vectors = [value for value in values if value.ndim]
        return _entries(node, vectors, Common.SAME if len(vectors) == 1 else Common.FRAME)

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        values = node.children()
        if node.shape == (4, 4) and any(value.is_group_element for value in values):
            for value, unit in zip(values, units, strict=True):
                if unit not in (None, ONE):
                    raise Clash("a pose has no single unit: multiply its rotation or its position", (value, unit))
        unit = self.combined(node, units)
        return None if unit is None or sum(six(value, space) for value in values) > 1 else unit

    def combined(self, node: Any, units: Units) -> Unit | None:
        return _product(node.children(), units)


class _Quotient(_Product):
    """Entry by entry: one frame; the unit of the left over that of the right."""

    def combined(self, node: Any, units: Units) -> Unit | None:
        left, right = (_product([value], [unit]) for value, unit in zip(node.children(), units, strict=True))
        return None if left is None or right is None else left / right


@dataclasses.dataclass(frozen=True)
class MatrixRule(ByShapes):
    """Products, inverses and similar nodes: the axes of `shared_orders`, some of them dual; powers of units."""

    how: tuple[Common, ...] = ()
    powers: tuple[int, ...] = (1,)
    by_operands = True

    def links(self, node: Any) -> Iterable[Link]:
        return _groups(node, *self.how)

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        total = ONE
        for unit, power in zip(units, self.powers, strict=True):
            if unit is None:
                return None
            total *= unit**power
        return total


class _Pairing(MatrixRule):
    """A product of matrices and vectors. A vector with itself is the square of its length, and no power."""

    def variant(self, node: Any) -> Hashable:
        """Whether it is the square of a vector's length."""
        left, right = node.children()
        return len(left.shape) == len(right.shape) == 1 and (left is right or left.key() == right.key())

    def links(self, node: Any) -> Iterable[Link]:
        return () if self.variant(node) else super().links(node)

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        if None in units or (self.variant(node) and six(node.children()[0], space)):
            return None
        return super().unit(node, units, space)

    def bodies(self, node: Any, known: Sequence[Bodies]) -> Bodies:
        """A change of frame keeps them."""
        left = node.children()[0]
        return known[-1] if left.is_group_element or (left.kinds or OPEN).keeps_bodies else None


@dataclasses.dataclass(frozen=True)
class Solved(MatrixRule):
    """A^-1 b: from a wrench on a body, it computes the acceleration of that body."""

    def bodies(self, node: Any, known: Sequence[Bodies]) -> Bodies:
        return BodyMotion({known[-1].on: 1}) if isinstance(known[-1], Acts) else None


SUM, DIFFERENCE, NEGATIVE = Terms(signs=(1,)), Terms(signs=(1, -1)), Terms(signs=(-1,))
ALIKE, CHOICE, COMPARISON = Terms(), Terms(conditions=1), Terms(compares=True)
PRODUCT, QUOTIENT = _Product(), _Quotient()
POWER, SIGN, SIZE = UnitPower(), UnitPower(Fraction(0)), UnitPower(Fraction(1))
SQUARE, ROOT = UnitPower(Fraction(2)), UnitPower(Fraction(1, 2))
NUMBERS, RATIO = NumberRule(), NumberRule(of_one_unit=True)
MATRIX_PRODUCT = _Pairing((Common.DUAL,), (1, 1))
TRANSPOSE, OUTER = MatrixRule(), MatrixRule((), (1, 1))
INVERSE = MatrixRule((Common.DUAL, Common.DUAL), (-1,))
SOLVE = Solved((Common.SAME, Common.DUAL), (-1, 1))
DIAGONAL = MatrixRule((Common.FRAME,), (1,))


@dataclasses.dataclass(frozen=True)
class OneFrame(ByShapes):
    """All axes have one frame, and the units multiply. `axes`: those of each operand, then of the result."""

    axes: tuple[tuple[int, ...], ...]
    by_operands = True

    def links(self, node: Any) -> Iterable[Link]:
        values = [*node.children(), node]
        slots = [(value, axis) for value, axes in zip(values, self.axes, strict=True) for axis in axes]
        for value, axis in slots[1:]:
            yield *slots[0], value, axis, Common.FRAME

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        return _product(node.children(), units)


class _Cross(OneFrame):
    """A vector product: one frame, units multiply."""

    def links(self, node: Any) -> Iterable[Link]:
        left, right = node.children()
        for value in (right, node):
            yield left, -1, value, -value.ndim, Common.FRAME


CROSS = _Cross(())
