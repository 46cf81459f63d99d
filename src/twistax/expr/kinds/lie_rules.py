"""Kind rules of Lie nodes: how rotations and poses change frames, and which operators apply to twists or wrenches."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Iterable
from typing import Any

from .kinds import Space
from .rules import ByShapes, Clash, Common, Link, OneFrame, Rule, SpaceOf, Units
from .unit import METRE, ONE, Unit


@dataclasses.dataclass(frozen=True)
class _FixedUnit(ByShapes):
    """Base of rules with a fixed unit."""

    gives: Unit | None = None

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        return self.gives


@dataclasses.dataclass(frozen=True)
class Frames(_FixedUnit):
    """Pairs of axes with one frame, by the index of the operand; the last index is the result."""

    pairs: tuple[tuple[int, int, int, int], ...] = ()

    def links(self, node: Any) -> Iterable[Link]:
        values = [*node.children(), node]
        for one, axis, other, its_axis in self.pairs:
            yield values[one], axis, values[other], its_axis, Common.FRAME


class _Act(Frames):
    """p_a = T_ab p_b: a pose moves points, which are in m; a rotation turns any vector."""

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        element, point = node.children()
        if element.shape == (4, 4) and units[1] not in (None, METRE):
            raise Clash("a pose transforms points, in m; transform other vectors by its rotation", (point, units[1]))
        return METRE if element.shape == (4, 4) else units[1]


class _Bracket(OneFrame):
    """ad and ad*: all in one frame. `spaces` of the operands and the result."""

    def __init__(self, *spaces: Space) -> None:
        super().__init__(((-1,),) * 3)
        object.__setattr__(self, "fixed", spaces)

    def spaces(self, node: Any) -> Iterable[tuple[Any, int, Space]]:
        return [(value, -1, space) for value, space in zip([*node.children(), node], self.fixed, strict=True)]  # type: ignore[attr-defined]


@dataclasses.dataclass(frozen=True)
class ChangeOfFrame(_FixedUnit):
    """Ad_T or Ad*_T, as a matrix: from the source frame of T to its target frame."""

    keeps_bodies = True  # of what it is multiplied by
    gives: Unit | None = ONE
    space: Space = Space.MOTION

    def links(self, node: Any) -> Iterable[Link]:
        (transform,) = node.children()
        yield transform, -2, node, -2, Common.FRAME
        yield transform, -1, node, -1, Common.FRAME

    def spaces(self, node: Any) -> Iterable[tuple[Any, int, Space]]:
        yield node, -2, self.space
        yield node, -1, self.space.dual


@dataclasses.dataclass(frozen=True)
class Carried(Rule):
    """Ad_T xi or Ad*_T F, computed without the matrix."""

    space: Space = Space.MOTION
    by_operands = keeps_bodies = True

    def variant(self, node: Any) -> Hashable:
        """Whether it changes the frame by the inverse."""
        return bool(node.inverse)

    def links(self, node: Any) -> Iterable[Link]:
        transform, vector = node.children()
        to, source = (-1, -2) if node.inverse else (-2, -1)
        yield transform, to, node, -node.ndim, Common.FRAME
        yield transform, source, vector, -vector.ndim, Common.FRAME

    def spaces(self, node: Any) -> Iterable[tuple[Any, int, Space]]:
        for value in (node.children()[1], node):
            yield value, -value.ndim, self.space

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        return units[1]


class _HalfOfSix(ByShapes):
    """The linear or the angular part of a six-vector."""

    by_operands = keeps_bodies = True

    def links(self, node: Any) -> Iterable[Link]:
        (vector,) = node.children()
        yield vector, -vector.ndim, node, -node.ndim, Common.FRAME

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        known, (vector,) = units[0], node.children()
        if known is None or node.place == 1:
            return known
        of = space(vector, -vector.ndim)
        return None if of is None else known * METRE if of is Space.MOTION else known / METRE


class _JoinedHalves(ByShapes):
    """A six-vector of both parts: their units say whether it is a twist or a wrench."""

    by_operands = True

    def links(self, node: Any) -> Iterable[Link]:
        for value in node.children():
            yield value, -value.ndim, node, -node.ndim, Common.FRAME

    def made(self, node: Any, units: Units) -> Space | None:
        """The space of the six-vector: of parts of which one is known, a wrench has kilograms and a twist has none."""
        linear, angular = units
        if linear is not None and angular is not None:
            return self.made_of(linear, angular)
        known = linear or angular
        return None if known is None else Space.FORCE if known.exponents[0] else Space.MOTION

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        linear, angular = units
        if linear is not None and angular is not None and self.made_of(linear, angular) is None:
            one, other = node.children()
            sentence = "a six-vector is [v; w] with v in the unit of w times m, or [f; tau] with f in that of tau per m"
            raise Clash(sentence, (one, linear), (other, angular))
        if angular is None and linear is not None:
            return linear / METRE if self.made(node, units) is Space.MOTION else linear * METRE
        return angular

    @staticmethod
    def made_of(linear: Unit, angular: Unit) -> Space | None:
        """The space of a six-vector with parts in these units."""
        return {METRE: Space.MOTION, ONE / METRE: Space.FORCE}.get(linear / angular)


@dataclasses.dataclass(frozen=True)
class OfTwist(_FixedUnit):
    """Exp and Log, hat and vee: the operand or the result of shape (6,) is a twist; the frame of (3,) is kept or
    undetermined.
    """

    takes: Unit | None = None

    def spaces(self, node: Any) -> Iterable[tuple[Any, int, Space]]:
        return [(value, -1, Space.MOTION) for value in [*node.children(), node] if value.shape == (6,)]

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        if self.takes is not None and units[0] not in (None, self.takes):
            raise Clash(
                f"{type(node).__name__} expects an angle in rad, or a displacement", (node.children()[0], units[0])
            )
        return self.gives


class _Reordered(ByShapes):
    """The same value in the other order."""

    by_operands = keeps_bodies = True

    def links(self, node: Any) -> Iterable[Link]:
        (value,) = node.children()
        for axis in range(-value.ndim, 0):
            yield value, axis, node, axis, Common.SAME

    def unit(self, node: Any, units: Units, space: SpaceOf) -> Unit | None:
        return units[0]


_KEPT, _EXCHANGED = ((0, -2, 1, -2), (0, -1, 1, -1)), ((0, -2, 1, -1), (0, -1, 1, -2))
_CHAINED = ((0, -1, 1, -2), (0, -2, 2, -2), (1, -1, 2, -1))
COMPOSE, INVERSE_ELEMENT, SAME_ROTATION = Frames(None, _CHAINED), Frames(None, _EXCHANGED), Frames(ONE, _KEPT)
ACT = _Act(None, ((0, -1, 1, -1), (0, -2, 2, -1)))
POSE = Frames(None, ((0, -2, 2, -2), (0, -1, 2, -1), (1, -1, 2, -2)))
SKEW, OF_QUATERNIONS = OneFrame(((-1,), (-1, -2))), OneFrame(((), ()))
BRACKET = _Bracket(Space.MOTION, Space.MOTION, Space.MOTION)
DUAL_BRACKET = _Bracket(Space.MOTION, Space.FORCE, Space.FORCE)
TWISTS_CHANGE_FRAME, WRENCHES_CHANGE_FRAME = ChangeOfFrame(), ChangeOfFrame(space=Space.FORCE)
TWISTS_CARRIED, WRENCHES_CARRIED = Carried(), Carried(Space.FORCE)
HALF, HALVES, REORDERED = _HalfOfSix(), _JoinedHalves(), _Reordered()
EXPONENTIAL, LOGARITHM, ALGEBRA = OfTwist(takes=ONE), OfTwist(ONE), OfTwist()
