"""Frames, spaces and units of all values of a system, and an error where two of them do not fit.

Frames and spaces belong to axes. What must agree forms a class, a class with two frames or spaces is a mistake, and the
places that fixed them are named. Units go from the leaves up. Nothing of it is part of a program, and where no leaf
declares anything nothing is done.

A constant without a kind may stand anywhere, and so may what is made of such constants alone: it is another value at
each place.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from ...errors import KindError
from ..graph import find_path, postorder
from ..leaves import Constant, Leaf, State
from ..node import Expr
from .axes import AxisClasses, AxisFact
from .kinds import Space
from .remedies import remedy_of_frames, remedy_of_spaces, remedy_of_units
from .rules import OPEN, Clash, Common, Rule
from .unit import ONE, SECOND, Unit

_SIX = 6


class NodePlace(NamedTuple):
    """A node below a named root."""

    name: str
    root: Expr
    node: Expr

    def __str__(self) -> str:
        return self.name if self.node is self.root else f"{self.name}: {find_path(self.root, self.node)}"


class Inference:
    """Walks all expressions of a system, children first, and applies the rule of each node once.

    The axes of a value have numbers, -1 the last. The number after it stands for the value.
    """

    def __init__(self, leaves: Sequence[Leaf]) -> None:
        self._leaves = leaves
        self._roots: dict[str, Expr] = {}
        self._frames, self._spaces = AxisClasses(), AxisClasses()
        self._count = 0
        self._ends: dict[int, int] = {}
        self._of_names: dict[str, int] = {}
        self._units: dict[int, Unit | None] = {}
        self._free: dict[int, bool] = {}
        for leaf in leaves:
            self._leaf(leaf)

    def read(self, roots: Mapping[str, Expr]) -> None:
        """Apply the rules of all nodes below roots, by the names used in messages, and of bodies of maps and rates."""
        self._roots = dict(roots)
        self._read(*roots.values())

    def _read(self, *roots: Expr) -> None:
        for node in postorder(*roots):
            if id(node) in self._free:
                continue
            for body in bodies(node):
                self._read(body)
            if isinstance(node, Leaf):
                self._leaf(node)
            else:
                self._node(node, node.kinds or OPEN)

    def _numbered(self, value: Expr) -> int:
        """The end of the numbers for the axes of another value. A quaternion has two frames."""
        count = 2 if value.shape == (4,) else value.ndim or 1
        self._count += count
        self._frames.grow(count)
        self._spaces.grow(count)
        return self._count

    def _leaf(self, leaf: Leaf) -> None:
        """Leaves of one name are one value."""
        if id(leaf) in self._free:
            return
        self._free[id(leaf)] = isinstance(leaf, Constant) and leaf.kind is None
        if isinstance(leaf, Constant):
            end = self._numbered(leaf)
        else:
            key = leaf.key()
            end = self._of_names[key] if key in self._of_names else self._numbered(leaf)
            self._of_names[key] = end
        self._ends[id(leaf)] = end
        self._units[end] = self._units.get(end) if leaf.unit is None else leaf.unit
        kind = leaf.kind
        if kind is not None:
            for axis, frame in kind.frames().items():
                self._fix(self._frames, end + axis, AxisFact(frame, leaf, axis, leaf))
                if kind.space is not None:
                    self._fix(self._spaces, end + axis, AxisFact(kind.space, leaf, axis, leaf))

    def _node(self, node: Expr, rule: Rule) -> None:
        free, ends, children = self._free, self._ends, node.children()
        end = ends[id(node)] = self._numbered(node)
        units = [self._units[ends[id(child)]] for child in children]
        if rule is OPEN or not (node.shape or any(child.shape for child in children)):  # scalars have no axes
            free[id(node)] = all(free[id(child)] for child in children)
            self._units[end] = None if rule is OPEN else self._unit(node, rule, units, {})
            return
        links, spaces = list(rule.links(node)), list(rule.spaces(node))
        sources = [v for one, _, other, _, _ in links for v in (one, other) if v is not node] or children
        free[id(node)] = all(free[id(v)] for v in sources) and all(v is not node for v, _, _ in spaces)
        # What is made of constants alone is another value at each place.
        here = {id(child): self._numbered(child) for child in children if free[id(child)]}
        here[id(node)] = end
        for value, axis, space in spaces:
            if value.shape[axis] == _SIX:
                at = here.get(id(value), ends[id(value)]) + axis
                self._fix(self._spaces, at, AxisFact(space, value, axis, node))
        for one, axis, other, its_axis, common in links:
            a = here.get(id(one), ends[id(one)]) + axis
            b = here.get(id(other), ends[id(other)]) + its_axis
            self._refuse(node, self._frames.link(a, b, False))
            if common is not Common.FRAME and one.shape[axis] == _SIX:
                self._refuse(node, self._spaces.link(a, b, common is Common.DUAL))
        self._units[end] = self._unit(node, rule, units, here)
        made = rule.made(node, units)
        if made is not None:
            self._fix(self._spaces, end - node.ndim, AxisFact(made, node, -node.ndim, node))

    def _unit(self, node: Expr, rule: Rule, units: Sequence[Unit | None], here: Mapping[int, int]) -> Unit | None:
        def space(value: Expr, axis: int) -> Space | None:
            return self._space(here.get(id(value), self._ends[id(value)]) + axis)

        try:
            return rule.unit(node, units, space)
        except Clash as clash:
            raise self._of_units(node, clash) from None

    def read_rate(self, state: State, rate: Expr) -> None:
        """A rate has the frame and space of its state, and its unit per second; that of a pose is a twist."""
        self._leaf(state)
        place = f"the rate of {state.name!r}"
        free = self._free[id(rate)]
        of_state, of_rate = self._ends[id(state)], self._numbered(rate) if free else self._ends[id(rate)]
        if state.group.flat and state.shape == rate.shape:
            if len(state.shape) != 1 or state.shape[0] != 4:  # a quaternion has two frames, its rate none
                for axis in range(-state.ndim, 0):
                    self._refuse(place, self._frames.link(of_state + axis, of_rate + axis, False))
                    self._refuse(place, self._spaces.link(of_state + axis, of_rate + axis, False))
        elif state.group.rigid:
            self._refuse(place, self._frames.link(of_state - 1, of_rate - 1, False))
            if rate.shape == (_SIX,):
                self._fix(self._spaces, of_rate - 1, AxisFact(Space.MOTION, rate, -1, place))
        of = ONE if state.group.rigid else self._units[of_state]
        unit = self._units[self._ends[id(rate)]]
        if of is not None and unit is not None and unit != of / SECOND:
            what = f"{state.name!r}, a pose or rotation," if state.group.rigid else f"{state.name!r} in {of}"
            raise self._of_units(place, Clash(f"the rate of {what} is in {of / SECOND}", (rate, unit)), of / SECOND)

    def _space(self, slot: int) -> Space | None:
        known = self._spaces.known(slot)
        return known.fact if known and isinstance(known.fact, Space) else None

    def _fix(self, classes: AxisClasses, slot: int, fixed: AxisFact) -> None:
        if isinstance(fixed.fact, Space) and fixed.value.shape[fixed.axis] != _SIX:
            return
        self._refuse(fixed.at, classes.fix(slot, fixed))

    def _place(self, at: Expr | str) -> str:
        """Where a node is."""
        if isinstance(at, str):
            return at
        for name, root in self._roots.items():
            for node in postorder(root):
                if node is at or any(at is inner for body in bodies(node) for inner in postorder(body)):
                    return str(NodePlace(name, root, at))
        return f"the state {at.name!r}" if isinstance(at, State) else short(at)

    def _refuse(self, at: Expr | str, both: tuple[AxisFact, AxisFact] | None) -> None:
        if both is None:
            return
        one, other = both
        if isinstance(one.fact, str) and isinstance(other.fact, str):
            what = f"two frames meet: {one.fact!r} and {other.fact!r}"
            fix = remedy_of_frames(self._leaves, one.fact, other.fact, one.value, other.value)
        else:
            what = "a twist meets a wrench or momentum, or is paired with another twist"
            fix = remedy_of_spaces()
        texts = (f"{self._place(each.at)}, {each.clause(short(each.value))}{_said(each.value)}" for each in both)
        at_one, at_other = texts
        raise KindError(f"{what}.\n  where: {self._place(at)}\n  at: {at_one}\n  and: {at_other}\n  fix: {fix}")

    def _of_units(self, at: Expr | str, clash: Clash, wanted: Unit = ONE) -> KindError:
        units = " and ".join(dict.fromkeys(str(unit) for _, unit in clash.values))
        lines = [f"{clash}, got {units}.", f"  where: {self._place(at)}"]
        lines += [
            f"  {word}: {short(value)} is in {unit}{_said(value)}"
            for word, (value, unit) in zip(("at", "and"), clash.values, strict=False)
        ]
        return KindError("\n".join([*lines, f"  fix: {remedy_of_units([unit for _, unit in clash.values], wanted)}"]))

    def description(self, value: Expr) -> str:
        """What is known of a value: its kind, frames and unit, or open."""
        end = self._ends[id(value)]
        spaces = [self._space(end + axis) for axis in range(-value.ndim, 0)]
        axes = (-2, -1) if value.ndim == 2 or value.shape == (4,) else (-1,) if value.ndim == 1 else ()
        frames = [self._frames.known(end + axis) for axis in axes]
        names = ["open" if frame is None else repr(frame.fact) for frame in frames]
        parts = []
        if len(value.shape) == 1 and spaces[0] is not None:
            parts.append(spaces[0].value)
        if value.is_group_element or (value.shape == (4,) and any(frames)):
            parts.append(f"from {names[-1]} to {names[0]}")
        elif any(frames):
            parts.append("in " + " by ".join(dict.fromkeys(names)))
        unit = self._units.get(end)
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
    inference.read(roots)
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

