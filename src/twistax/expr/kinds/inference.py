"""Frames, spaces and units of all values of a system, and an error where two of them do not fit.

Frames and spaces belong to axes. What must agree forms a class, a class with two frames or spaces is a mistake, and the
places that fixed them are named. Units go from the leaves up. Nothing of it is part of a program, and where no leaf
declares anything nothing is done.

A constant without a kind may stand anywhere, and so may what is made of such constants alone: it is another value at
each place.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

from ...errors import KindError
from ..graph import find_path, postorder
from ..leaves import Constant, Leaf, State
from ..node import Expr
from .kinds import Space
from .remedies import remedy_of_frames, remedy_of_spaces, remedy_of_units
from .rules import OPEN, Clash, Common, Rule
from .unit import ONE, SECOND, Unit

_SIX = 6
_Token: TypeAlias = Hashable
#: An axis of a value: what stands for the value, and the axis counted from the last, -1.
_Slot: TypeAlias = tuple[_Token, int]
_Fact: TypeAlias = "str | Space"


class Place(NamedTuple):
    """A node below a named root."""

    name: str
    root: Expr
    node: Expr

    def __str__(self) -> str:
        return self.name if self.node is self.root else f"{self.name}: {find_path(self.root, self.node)}"


@dataclasses.dataclass(frozen=True)
class Fixed:
    """The frame or the space of an axis, of which value, and where it was fixed."""

    fact: _Fact
    value: Expr
    axis: int
    place: Place

    def __str__(self) -> str:
        name, takes = short(self.value), self.value.ndim == 2 and self.axis == -1
        if isinstance(self.fact, str):
            verb = "takes what is in" if takes else "gives what is in" if self.value.ndim == 2 else "is in"
            return f"{self.place}, {name} {verb} {self.fact!r}{_said(self.value)}"
        verb = "takes" if takes else "gives" if self.value.ndim == 2 else "is"
        return f"{self.place}, {name} {verb} {(self.fact.dual if takes else self.fact).value}{_said(self.value)}"


class _Classes:
    """Union-find over axes. An axis may be dual to the first one of its class; the class remembers what fixed it."""

    def __init__(self) -> None:
        self._parent: dict[_Slot, tuple[_Slot, bool]] = {}
        self._fixed: dict[_Slot, Fixed] = {}

    def _find(self, slot: _Slot) -> tuple[_Slot, bool]:
        path, flipped = [], False
        parent, flip = self._parent.setdefault(slot, (slot, False))
        while parent != slot:
            path.append((slot, flipped))
            slot, flipped = parent, flipped ^ flip
            parent, flip = self._parent[slot]
        for passed, before in path:
            self._parent[passed] = slot, flipped ^ before
        return slot, flipped

    def known(self, slot: _Slot) -> Fixed | None:
        first, flipped = self._find(slot)
        return _turned(self._fixed.get(first), flipped)

    def fix(self, slot: _Slot, fixed: Fixed) -> tuple[Fixed, Fixed] | None:
        """Both where they differ."""
        first, flipped = self._find(slot)
        there = _turned(self._fixed.get(first), flipped)
        if there is None:
            self._fixed[first] = _turned(fixed, flipped)  # type: ignore[assignment]
        return None if there is None or there.fact == fixed.fact else (there, fixed)

    def link(self, one: _Slot, other: _Slot, dual: bool) -> tuple[Fixed, Fixed] | None:
        """Both where they differ, each as it was fixed."""
        (kept, a), (gone, b) = self._find(one), self._find(other)
        if kept == gone:
            return None
        flip = a ^ b ^ dual
        mine, theirs = self._fixed.get(kept), self._fixed.get(gone)
        if mine and theirs and mine.fact != _turned(theirs, flip).fact:  # type: ignore[union-attr]
            return _turned(mine, a), _turned(theirs, b)  # type: ignore[return-value]
        self._parent[gone] = kept, flip
        if theirs and not mine:
            self._fixed[kept] = _turned(theirs, flip)  # type: ignore[assignment]
        return None


def _turned(fixed: Fixed | None, flip: bool) -> Fixed | None:
    if fixed is None or not flip or isinstance(fixed.fact, str):
        return fixed
    return dataclasses.replace(fixed, fact=fixed.fact.dual)


class Inference:
    """Walks all expressions of a system, children first, and applies the rule of each node once."""

    def __init__(self, leaves: Sequence[Leaf]) -> None:
        self._leaves = leaves
        self._frames, self._spaces = _Classes(), _Classes()
        self._units: dict[object, Unit | None] = {}
        self._free: dict[object, bool] = {}

    def read(self, name: str, root: Expr) -> None:
        """Apply the rules of all nodes below a root, and of bodies of maps and rates."""
        self._read(name, root, root)

    def _read(self, name: str, root: Expr, below: Expr) -> None:
        for node in postorder(below):
            if id(node) in self._free:
                continue
            for body in bodies(node):
                self._read(name, root, body)
            place = Place(name, root, node)
            if isinstance(node, Leaf):
                self._leaf(place, node)
            else:
                self._node(place, node, node.kinds or OPEN)

    def _leaf(self, place: Place, leaf: Leaf) -> None:
        kind = leaf.kind
        self._free[id(leaf)] = isinstance(leaf, Constant) and kind is None
        self._units[_token(leaf)] = leaf.unit
        if kind is not None:
            for axis, frame in kind.frames().items():
                self._fix(self._frames, leaf, leaf, axis, Fixed(frame, leaf, axis, place))
                if kind.space is not None:
                    self._fix(self._spaces, leaf, leaf, axis, Fixed(kind.space, leaf, axis, place))

    def _node(self, place: Place, node: Expr, rule: Rule) -> None:
        children, links, spaces = node.children(), list(rule.links(node)), list(rule.spaces(node))
        free = self._free
        sources = [v for one, _, other, _, _ in links for v in (one, other) if v is not node] or children
        free[id(node)] = all(free.get(id(v), False) for v in sources) and all(v is not node for v, _, _ in spaces)
        for value, axis, space in spaces:
            self._fix(self._spaces, node, value, axis, Fixed(space, value, axis, place))
        for one, axis, other, its_axis, common in links:
            a, b = self._slot(node, one, axis), self._slot(node, other, its_axis)
            self._refuse(place, self._frames.link(a, b, False))
            if common is not Common.FRAME and one.shape[axis] == _SIX:
                self._refuse(place, self._spaces.link(a, b, common is Common.DUAL))
        units = [self._units[_token(child)] for child in children]
        try:
            unit = rule.unit(node, units, lambda value, axis: self._space(node, value, axis))
        except Clash as clash:
            raise self._of_units(place, clash) from None
        self._units[_token(node)] = unit
        made = rule.made(node, units)
        if made is not None:
            self._fix(self._spaces, node, node, -node.ndim, Fixed(made, node, -node.ndim, place))

    def read_rate(self, state: State, rate: Expr) -> None:
        """A rate has the frame and space of its state, and its unit per second; that of a pose is a twist."""
        name = f"the rate of {state.name!r}"
        place = Place(name, rate, rate)
        if id(state) not in self._free:
            self._leaf(Place(f"the state {state.name!r}", state, state), state)
        if state.group.flat and state.shape == rate.shape:
            if len(state.shape) != 1 or state.shape[0] != 4:  # a quaternion has two frames, its rate none
                for axis in range(-state.ndim, 0):
                    a, b = self._slot(state, state, axis), self._slot(state, rate, axis)
                    self._refuse(place, self._frames.link(a, b, False))
                    self._refuse(place, self._spaces.link(a, b, False))
        elif state.group.rigid:
            a, b = self._slot(state, state, -1), self._slot(state, rate, -1)
            self._refuse(place, self._frames.link(a, b, False))
            if rate.shape == (6,):
                self._fix(self._spaces, state, rate, -1, Fixed(Space.MOTION, rate, -1, place))
        of = ONE if state.group.rigid else state.unit
        unit = self._units.get(_token(rate))
        if of is not None and unit is not None and unit != of / SECOND:
            what = f"{state.name!r}, a pose or rotation," if state.group.rigid else f"{state.name!r} in {of}"
            raise self._of_units(place, Clash(f"the rate of {what} is in {of / SECOND}", (rate, unit)), of / SECOND)

    def _slot(self, parent: Expr, value: Expr, axis: int) -> _Slot:
        """The axis of a value as its parent sees it."""
        if value is not parent and self._free.get(id(value), False):
            return (id(value), id(parent)), axis
        return _token(value), axis

    def _space(self, node: Expr, value: Expr, axis: int) -> Space | None:
        known = self._spaces.known(self._slot(node, value, axis))
        return known.fact if known and isinstance(known.fact, Space) else None

    def _fix(self, classes: _Classes, parent: Expr, value: Expr, axis: int, fixed: Fixed) -> None:
        if isinstance(fixed.fact, Space) and value.shape[axis] != _SIX:
            return
        self._refuse(fixed.place, classes.fix(self._slot(parent, value, axis), fixed))

    def _refuse(self, place: Place, both: tuple[Fixed, Fixed] | None) -> None:
        if both is None:
            return
        one, other = both
        if isinstance(one.fact, str) and isinstance(other.fact, str):
            what = f"two frames meet: {one.fact!r} and {other.fact!r}"
            fix = remedy_of_frames(self._leaves, one.fact, other.fact, one.value, other.value)
        else:
            what = "a twist meets a wrench or momentum, or is paired with another twist"
            fix = remedy_of_spaces()
        raise KindError(f"{what}.\n  where: {place}\n  at: {one}\n  and: {other}\n  fix: {fix}")

    def _of_units(self, place: Place, clash: Clash, wanted: Unit = ONE) -> KindError:
        units = " and ".join(dict.fromkeys(str(unit) for _, unit in clash.values))
        lines = [f"{clash}, got {units}.", f"  where: {place}"]
        lines += [
            f"  {word}: {short(value)} is in {unit}{_said(value)}"
            for word, (value, unit) in zip(("at", "and"), clash.values, strict=False)
        ]
        return KindError("\n".join([*lines, f"  fix: {remedy_of_units([unit for _, unit in clash.values], wanted)}"]))

    def unit(self, value: Expr) -> Unit | None:
        """The unit of a value, of a six-vector that of its angular part; None where it is open."""
        return self._units.get(_token(value))

    def spaces(self, value: Expr) -> list[Space | None]:
        """The space of each axis of a value, None where it is open or not of length six."""
        return [self._space(value, value, axis) for axis in range(-value.ndim, 0)]

    def description(self, value: Expr) -> str:
        """What is known of a value: its kind, frames and unit, or open."""
        spaces = self.spaces(value)
        axes = (-2, -1) if value.ndim == 2 or value.shape == (4,) else (-1,) if value.ndim == 1 else ()
        frames = [self._frames.known(self._slot(value, value, axis)) for axis in axes]
        names = ["open" if frame is None else repr(frame.fact) for frame in frames]
        parts = []
        if len(value.shape) == 1 and spaces[0] is not None:
            parts.append(spaces[0].value)
        if value.is_group_element or (value.shape == (4,) and any(frames)):
            parts.append(f"from {names[-1]} to {names[0]}")
        elif any(frames):
            parts.append("in " + " by ".join(dict.fromkeys(names)))
        unit = self.unit(value)
        parts.append("unit open" if unit is None else f"unit {unit}")
        return ", ".join(parts)


def check_kinds(roots: Mapping[str, Expr], rates: Mapping[State, Expr], leaves: Iterable[Leaf]) -> Inference | None:
    """What is known of all values of a system; None where no leaf declares anything.

    Args:
        roots: every expression of a system, by the name used in messages.
        rates: the rate of every state.
        leaves: all leaves.
    Raises: KindError where two frames, spaces or units do not fit.
    """
    known = list(leaves)
    if not any(leaf.declares for leaf in (*known, *rates)):
        return None
    return infer_kinds(roots, rates, known)


def infer_kinds(roots: Mapping[str, Expr], rates: Mapping[State, Expr], leaves: Sequence[Leaf]) -> Inference:
    """What is known of all values of a system, whether leaves declare anything or not. Raises KindError."""
    inference = Inference([*leaves, *rates])
    for name, root in roots.items():
        inference.read(name, root)
    for state, rate in rates.items():
        inference.read_rate(state, rate)
    return inference


def bodies(node: Expr) -> list[Expr]:
    """The expressions that a node holds besides its children."""
    if type(node).outline is Expr.outline:
        return []
    children = {id(child) for child in node.children()}
    return [part for _, part in node.outline() if id(part) not in children]


def short(value: Expr, longest: int = 60) -> str:
    """The text of a value, cut off where it is long."""
    text = repr(value)
    return text if len(text) <= longest else f"{text[:longest]}..."


def _said(value: Expr) -> str:
    """What a leaf declares."""
    return f", declared {value.kind}" if isinstance(value, Leaf) and value.kind is not None else ""


def _token(value: Expr) -> _Token:
    """What stands for a value: leaves of one name are one, and equal constants of two units are two."""
    return value.key() if value.is_leaf and not isinstance(value, Constant) else id(value)
