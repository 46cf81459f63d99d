"""Inference of frames, spaces and units of all values of a system, with an error for contradictions.

Frames and spaces belong to axes. Axes that must agree form a class; two different frames or spaces in a class are an
error, whose message names the places that determined them. Units are inferred from the leaves to the roots. The
inference does not affect programs, and is skipped if no leaf declares a kind or unit.

A constant without a kind has no frame or unit, and neither has an expression of such constants; each occurrence is a
separate value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from ...errors import KindError
from ..graph import find_path, postorder
from ..leaves import Constant, Leaf, State
from ..node import Expr
from ..orders import bodies, short
from .axes import AxisClasses, AxisFact
from .body_inference import BodyInference, check_bodies
from .declare import kind_of, known_of
from .kinds import Kind, Space
from .remedies import remedy_of_frames, remedy_of_spaces, remedy_of_units
from .rules import OPEN, Clash, Common, Link, Rule
from .unit import ONE, SECOND, Unit

_SIX = 6
#: The number of all constants that declare nothing.
_UNKNOWN = 0


class NodePlace(NamedTuple):
    """A node below a named root."""

    name: str
    root: Expr
    node: Expr

    def __str__(self) -> str:
        return self.name if self.node is self.root else f"{self.name}: {find_path(self.root, self.node)}"


class Inference:
    """Traverses all expressions of a system, children first, and applies the rule of each node once.

    The axes of a value have consecutive numbers, starting with the last axis (-1); the next number represents the value
    itself.
    """

    def __init__(self, leaves: Sequence[Leaf]) -> None:
        self.leaves = leaves
        self._roots: dict[str, Expr] = {}
        self._frames, self._spaces = AxisClasses(), AxisClasses()
        self._count = 0
        self._ends: dict[int, int] = {}
        self._of_names: dict[str, int] = {}
        self._units: dict[int, Unit | None] = {_UNKNOWN: None}
        self._free: dict[int, bool] = {}
        #: From elements of batches to the number of the batch with which they were read first.
        self._batches: dict[int, int] = {}
        #: Whether a kind says of which body a value is.
        self.has_bodies = False
        #: Nodes, vectors that can be in no frame, and what makes them so.
        self._unframed: list[tuple[Expr, Expr, Expr]] = []
        for leaf in leaves:
            self._leaf(leaf)
            if not isinstance(leaf, Constant):
                self._of_names[leaf.key()] = self._ends[id(leaf)]

    def read(self, roots: Mapping[str, Expr], nodes: Sequence[Expr]) -> None:
        """Apply the rules of all nodes below roots, with the names used in messages, and to bodies of maps and
        rates.
        """
        self._roots = dict(roots)
        self._read(nodes)

    def _read(self, nodes: Sequence[Expr]) -> None:
        for node in nodes:
            if id(node) in self._free:
                continue
            rule = node.kinds or OPEN
            knows = rule.maps and self._elements(node)
            for body in bodies(node):
                self._read(postorder(body))
            if isinstance(node, Leaf):
                self._leaf(node)
            elif rule.maps:
                self._mapped(node, knows)
                self._known_as(node)
            else:
                self._node(node, rule)
                self._known_as(node)

    def _numbered(self, value: Expr) -> int:
        """The end of the numbers for the axes of another value. A quaternion has two frames."""
        shape = value.shape
        self._count += 2 if shape == (4,) else len(shape) or 1
        return self._count

    def _leaf(self, leaf: Leaf) -> None:
        """Leaves of one name are one value; elements of batches and constants are what they are."""
        if id(leaf) in self._free:
            return
        is_constant = isinstance(leaf, Constant)
        self._free[id(leaf)] = is_constant and leaf.kind is None
        if is_constant and not leaf.declares:
            self._ends[id(leaf)] = _UNKNOWN
            return
        end = None if is_constant else self._of_names.get(leaf.key())
        self._ends[id(leaf)] = end = self._numbered(leaf) if end is None else end
        self._units[end] = self._units.get(end) if leaf.unit is None else leaf.unit
        if leaf.kind is not None:
            self._kind(leaf, end, leaf.kind, f", declared {leaf.kind}")
        self._known_as(leaf)

    def _kind(self, value: Expr, end: int, kind: Kind, note: str) -> None:
        """The frames and spaces of a declared kind."""
        self.has_bodies = self.has_bodies or bool(kind.bodies())
        for axis, frame in kind.axes().items():
            if frame:
                self._fix(self._frames, end + axis, AxisFact(frame, value, axis, value, note))
            if kind.space is not None:
                self._fix(self._spaces, end + axis, AxisFact(kind.space, value, axis, value, note))

    def _known_as(self, node: Expr) -> None:
        """What an expression says of itself."""
        facts = known_of(node)
        if facts is None:
            return
        (kind, unit), end = facts, self._ends[id(node)]
        self._free[id(node)] = False
        if kind is not None:
            self._kind(node, end, kind, f", taken as {kind}")
        known = self._units[end]
        if unit is not None and known is not None and unit != known:
            raise self._of_units(node, Clash(f"{short(node)} is declared in {unit}", (node, known)), unit)
        self._units[end] = known if unit is None else unit

    def _node(self, node: Expr, rule: Rule) -> None:
        free, ends, children = self._free, self._ends, node.children()
        end = ends[id(node)] = self._numbered(node)
        units, is_free, has_axes, needs_places = [], True, node.shape != (), False
        for child in children:
            units.append(self._units[ends[id(child)]])
            child_is_free = free[id(child)]
            is_free = is_free and child_is_free
            if child.shape:
                has_axes, needs_places = True, needs_places or child_is_free
        if rule is OPEN:
            free[id(node)], self._units[end] = is_free, None
            return
        here = ends
        if has_axes:
            links: Iterable[Link] = rule.links(node)
            if needs_places and rule.entrywise:  # what is made of constants alone says nothing here
                all_links = list(links)
                links = [link for link in all_links if not free[id(link[0])]]
                is_free = not links if all_links else is_free
            elif needs_places:
                links = list(links)
                sources = [v for one, _, other, _, _ in links for v in (one, other) if v is not node] or children
                is_free = all(free[id(v)] for v in sources) and all(v is not node for v, _, _ in rule.spaces(node))
                # What is made of constants alone is another value at each place.
                here = {id(v): self._numbered(v) if free[id(v)] else ends[id(v)] for v in children}
                here[id(node)] = end
            self._link(node, rule, links, here)
        free[id(node)] = is_free
        if rule.by_operands and not any(units):
            self._units[end] = None
            return
        try:
            self._units[end] = rule.unit(node, units, lambda value, axis: self._space(here[id(value)] + axis))
        except Clash as clash:
            raise self._of_units(node, clash) from None
        made = rule.made(node, units)
        if made is not None:
            self._fix(self._spaces, end - node.ndim, AxisFact(made, node, -node.ndim, node))

    def _elements(self, node: Any) -> bool:
        """What batches say of the elements in the body of a map; whether the body says something of these batches.

        Substitution makes maps of one body over several batches: the body has the frames and units of the first ones.
        """
        all_alike = True
        for batch, element in zip(node.batches, node.placeholders, strict=True):
            read, mapped = id(element) in self._free, node.axis - batch.ndim
            self._leaf(element)
            first, end = self._batches.setdefault(id(element), self._ends[id(batch)]), self._ends[id(batch)]
            axes = [(axis, axis if axis > mapped else axis - 1) for axis in range(-element.ndim, 0)]
            if read:
                all_alike = all_alike and (first == end or self._alike(element, batch, axes))
            elif not self._free[id(batch)]:
                self._units[self._ends[id(element)]] = self._units[end]
                for axis, its_axis in axes:
                    self._same(node, (element, axis), (batch, its_axis))
        return all_alike

    def _alike(self, element: Expr, batch: Expr, axes: Sequence[tuple[int, int]]) -> bool:
        """Whether an element has the unit, the spaces and the frames, some of them known, of another batch."""
        one, other = self._ends[id(element)], self._ends[id(batch)]
        if self._units[one] != self._units[other]:
            return False
        frames, spaces = (
            [[known and known.fact for known in (c.known(one + a), c.known(other + b))] for a, b in axes]
            for c in (self._frames, self._spaces)
        )
        return all(a == b for a, b in [*frames, *spaces]) and (not axes or any(a for a, _ in frames))

    def _mapped(self, node: Any, knows: bool) -> None:
        """The value of a map, from that of its body if that says something of these batches."""
        end, body = self._numbered(node), node.body
        self._ends[id(node)] = end
        self._free[id(node)] = self._free[id(body)] and all(self._free[id(batch)] for batch in node.batches)
        self._units[end] = self._units[self._ends[id(body)]] if knows else None
        if knows and not self._free[id(body)]:
            for axis in range(-body.ndim, 0):
                self._same(node, (node, axis), (body, axis))

    def _same(self, at: Expr, one: tuple[Expr, int], other: tuple[Expr, int]) -> None:
        """Two axes of one frame and space."""
        a, b = (self._ends[id(value)] + axis for value, axis in (one, other))
        self._refuse(at, self._frames.link(a, b, False) or self._spaces.link(a, b, False))

    def _link(self, node: Expr, rule: Rule, links: Iterable[Link], ends: Mapping[int, int]) -> None:
        """What a node says of the axes of its operands and its value."""
        for value, axis, space in rule.spaces(node):
            if value.shape[axis] == _SIX:
                self._fix(self._spaces, ends[id(value)] + axis, AxisFact(space, value, axis, node))
        for one, axis, other, its_axis, common in links:
            a, b = ends[id(one)] + axis, ends[id(other)] + its_axis
            both = self._frames.link(a, b, False)
            if common is not Common.FRAME and one.shape[axis] == _SIX:
                both = both or self._spaces.link(a, b, common is Common.DUAL)
            if both:
                self._refuse(node, both)
        for vector, by in rule.unframed(node):
            if not self._free[id(by)]:
                self._unframed.append((node, vector, by))

    def read_rate(self, state: State, rate: Expr) -> None:
        """A rate has the frame and space of its state, and its unit per second; the rate of a pose is a twist."""
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

    def check_unframed(self) -> None:
        """Raise KindError if a scalar is added to the entries of a vector in a frame."""
        for node, vector, scalar in self._unframed:
            known = None if self._free[id(vector)] else self._frames.known(self._ends[id(vector)] - 1)
            if known:
                raise KindError(
                    f"a scalar is added to each entry of a vector in {known.fact!r}.\n  where: {self.place(node)}\n"
                    f"  at: {self.place(known.at)}, {known.clause(short(known.value))}{known.note}\n"
                    f"  and: {short(scalar)} is a scalar\n"
                    "  fix: multiply the scalar by a vector, such as a direction"
                )

    def _fix(self, classes: AxisClasses, slot: int, fixed: AxisFact) -> None:
        if isinstance(fixed.fact, Space) and fixed.value.shape[fixed.axis] != _SIX:
            return
        self._refuse(fixed.at, classes.fix(slot, fixed))

    def place(self, at: Expr | str) -> str:
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
            what = f"two frames are combined: {one.fact!r} and {other.fact!r}"
            fix = remedy_of_frames(self.leaves, one.fact, other.fact, one.value, other.value)
        else:
            what = "a twist is combined with a wrench or momentum, or is paired with another twist"
            fix = remedy_of_spaces()
        texts = (f"{self.place(fact.at)}, {fact.clause(short(fact.value))}{fact.note}" for fact in both)
        at_one, at_other = texts
        raise KindError(f"{what}.\n  where: {self.place(at)}\n  at: {at_one}\n  and: {at_other}\n  fix: {fix}")

    def _of_units(self, at: Expr | str, clash: Clash, wanted: Unit = ONE) -> KindError:
        units = " and ".join(dict.fromkeys(str(unit) for _, unit in clash.values))
        lines = [f"{clash}, got {units}.", f"  where: {self.place(at)}"]
        lines += [
            f"  {word}: {short(value)} is in {unit}{_declared_in_words(value)}"
            for word, (value, unit) in zip(("at", "and"), clash.values, strict=False)
        ]
        return KindError("\n".join([*lines, f"  fix: {remedy_of_units([unit for _, unit in clash.values], wanted)}"]))

    def knows(self, value: Expr) -> bool:
        """Whether the kind or unit of a value is known."""
        end = self._ends[id(value)]
        axes = range(-2 if value.shape == (4,) else -value.ndim, 0)
        facts = (classes.known(end + axis) for axis in axes for classes in (self._frames, self._spaces))
        return self._units.get(end) is not None or any(facts)

    def unit(self, value: Expr) -> Unit | None:
        """The unit of a value, for a six-vector that of its angular part; None if undetermined."""
        return self._units.get(self._ends[id(value)])

    def spaces(self, value: Expr) -> list[Space | None]:
        """The space of each axis of a value; None if undetermined or not of length six."""
        return [self._space(self._ends[id(value)] + axis) for axis in range(-value.ndim, 0)]

    def description(self, value: Expr) -> str:
        """A text about a value: its kind, frames and unit, or "open"."""
        end, spaces = self._ends[id(value)], self.spaces(value)
        axes = (-2, -1) if value.ndim == 2 or value.shape == (4,) else (-1,) if value.ndim == 1 else ()
        frames = [self._frames.known(end + axis) for axis in axes]
        names = ["open" if frame is None else repr(frame.fact) for frame in frames]
        parts = []
        if len(value.shape) == 1 and spaces[0] is not None:
            parts.append(spaces[0].value)
        if value.is_group_element or (value.shape in ((4, 4), (4,)) and any(frames)):
            parts.append(f"from {names[-1]} to {names[0]}")
        elif any(frames):
            parts.append("in " + " by ".join(dict.fromkeys(names)))
        unit = self.unit(value)
        if unit is not None or value.shape != (4, 4):
            parts.append("unit open" if unit is None else f"unit {unit}")
        return ", ".join(parts)


def infer_kinds(
    roots: Mapping[str, Expr], rates: Mapping[State, Expr], leaves: Sequence[Leaf], nodes: Sequence[Expr] | None = None
) -> Inference:
    """The inferred kinds of all values of a system, also if no leaf declares one. Raises KindError for
    contradictions.
    """
    inference = Inference([*leaves, *rates])
    nodes = postorder(*roots.values()) if nodes is None else nodes
    inference.read(roots, nodes)
    for state, rate in rates.items():
        inference.read_rate(state, rate)
    inference.check_unframed()
    if inference.has_bodies:
        check_bodies(nodes, roots, rates, BodyInference(inference.leaves, inference.place, short))
    return inference


def _declared_in_words(value: Expr) -> str:
    """What a value declares."""
    kind = kind_of(value)
    return "" if kind is None else f", declared {kind}"
