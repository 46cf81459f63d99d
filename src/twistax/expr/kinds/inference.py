"""Inference of frames, spaces and units of all values of a system, with an error for contradictions.

Frames and spaces belong to axes. Axes that must agree form a class; two different frames or spaces in a class are an
error, whose message names the places that determined them. Units are inferred from the leaves to the roots. The
inference does not affect programs, and is skipped if no leaf declares a kind or unit.

A constant without a kind has no frame or unit, and neither has an expression of such constants; each occurrence is a
separate value.
"""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Hashable, Mapping, MutableMapping, Sequence
from typing import Any, NamedTuple

from ...errors import KindError
from ..graph import find_path, postorder
from ..leaves import Constant, Leaf, State
from ..node import Expr, Shape
from ..orders import bodies, short
from .axes import AxisClasses, AxisFact
from .body_inference import BodyInference, check_bodies
from .declare import kind_of, known_of
from .kinds import Kind, Space
from .node_pairs import NodePairs
from .remedies import remedy_of_frames, remedy_of_spaces, remedy_of_units
from .rules import OPEN, Clash, Rule
from .unit import ONE, SECOND, Unit

_SIX = 6
#: What rules say of axes, by the class of a node, then by what else it depends on, shapes, and which are constants; and
#: for how many of them it is kept.
_PAIRS: MutableMapping[type[Expr], dict[Hashable, NodePairs]] = weakref.WeakKeyDictionary()
_MOST_PAIRS = 1000


@dataclasses.dataclass(slots=True)
class _Value:
    """What is known of a value besides the frames and spaces of its axes.

    Attributes:
        end: the axes have the numbers before it; 0 for all constants that declare nothing.
        free: whether it is made of constants alone that declare nothing.
    """

    shape: Shape
    end: int
    free: bool = False
    unit: Unit | None = None


class NodePlace(NamedTuple):
    """A node below a named root."""

    name: str
    root: Expr
    node: Expr

    def __str__(self) -> str:
        return self.name if self.node is self.root else f"{self.name}: {find_path(self.root, self.node)}"


class Inference:
    """Traverses all expressions of a system, children first, and applies the rule of each node once.

    The axes of a value have numbers.
    """

    def __init__(self, leaves: Sequence[Leaf]) -> None:
        self.leaves = leaves
        self._roots: dict[str, Expr] = {}
        self._frames, self._spaces = AxisClasses(), AxisClasses()
        self._count = 0
        self._values: dict[int, _Value] = {}
        self._of_names: dict[str, _Value] = {}
        #: From elements of batches to the batch with which they were read first.
        self._batches: dict[int, _Value] = {}
        #: Whether a kind says of which body a value is.
        self.has_bodies = False
        #: Nodes, vectors that can be in no frame, and what makes them so.
        self._unframed: list[tuple[Expr, Expr, Expr]] = []
        #: Nodes that join halves to six-vectors, and the numbers of the axes of a half and of the whole.
        self._halves: list[tuple[Expr, int, int]] = []
        self._pairs_of: dict[type[Expr], dict[Hashable, NodePairs]] = {}
        for leaf in leaves:
            self._leaf(leaf)
            if not isinstance(leaf, Constant):
                self._of_names[leaf.key()] = self._values[id(leaf)]

    def read(self, roots: Mapping[str, Expr], nodes: Sequence[Expr]) -> None:
        """Apply the rules of all nodes below roots, with the names used in messages, and to bodies of maps and
        rates.
        """
        self._roots = dict(roots)
        self._read(nodes)

    def _read(self, nodes: Sequence[Expr]) -> None:
        for node in nodes:
            if id(node) in self._values:
                continue
            if isinstance(node, Leaf):
                self._leaf(node)
                continue
            rule = node.kinds or OPEN
            knows = rule.maps and self._elements(node)
            for body in bodies(node):
                self._read(postorder(body))
            if rule.maps:
                self._mapped(node, knows)
            else:
                self._node(node, rule)
            self._known_as(node)

    def _numbered(self, shape: Shape) -> int:
        """The end of the numbers for the axes of another value. A quaternion has two frames."""
        self._count += 2 if shape == (4,) else len(shape) or 1
        return self._count

    def _leaf(self, leaf: Leaf) -> None:
        """Leaves of one name are one value; elements of batches and constants are what they are."""
        if id(leaf) in self._values:
            return
        is_constant = isinstance(leaf, Constant)
        if is_constant and not leaf.declares:
            self._values[id(leaf)] = _Value(leaf.shape, 0, True)
            return
        value = None if is_constant else self._of_names.get(leaf.key())
        if value is None:
            value = _Value(leaf.shape, self._numbered(leaf.shape), is_constant and leaf.kind is None)
        self._values[id(leaf)] = value
        value.unit = value.unit if leaf.unit is None else leaf.unit
        if leaf.kind is not None:
            self._kind(leaf, value.end, leaf.kind, f", declared {leaf.kind}")
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
        (kind, unit), value = facts, self._values[id(node)]
        value.free = False
        if kind is not None:
            self._kind(node, value.end, kind, f", taken as {kind}")
        if unit is not None and value.unit is not None and unit != value.unit:
            raise self._of_units(node, Clash(f"{short(node)} is declared in {unit}", (node, value.unit)), unit)
        value.unit = value.unit if unit is None else unit

    def _node(self, node: Expr, rule: Rule) -> None:
        children, shape, known = node.children(), node.shape, self._values
        operands = [known[id(child)] for child in children]
        units = [operand.unit for operand in operands]
        value = known[id(node)] = _Value(shape, self._numbered(shape))
        if rule is OPEN:
            value.free = all(operand.free for operand in operands)
            return
        pairs, places = self._pairs(node, rule, children, operands), dict[int, int]()
        value.free, ends = pairs.free, [operand.end for operand in operands]
        ends.append(value.end)
        if pairs.places:  # what is made of constants alone is another value at each place
            places = {id(children[k]): self._numbered(operands[k].shape) for k in pairs.places}
            for k in pairs.places:
                ends[k] = places[id(children[k])]
        if pairs.links or pairs.spaces or pairs.unframed:
            self._link(node, children, ends, pairs)
        if rule.by_operands and not any(units):
            return
        try:
            value.unit = rule.unit(node, units, lambda v, axis: self._space(places.get(id(v), known[id(v)].end) + axis))
        except Clash as clash:
            raise self._of_units(node, clash) from None
        made = rule.made(node, units)
        if made is not None:
            self._fix(self._spaces, value.end - node.ndim, AxisFact(made, node, -node.ndim, node))

    def _pairs(self, node: Expr, rule: Rule, children: Sequence[Expr], operands: Sequence[_Value]) -> NodePairs:
        """What a rule says of the axes of a node, read once for nodes that do not differ in it."""
        variant, node_class = rule.variant(node), type(node)
        kind = (variant, node.shape, *[(operand.shape, operand.free) for operand in operands])
        of_class = self._pairs_of.get(node_class)
        if of_class is None:
            of_class = self._pairs_of[node_class] = _PAIRS.setdefault(node_class, {})
        pairs = None if variant is None else of_class.get(kind)
        if pairs is None:
            pairs = NodePairs.of(node, rule, children, [operand.free for operand in operands])
            if variant is not None and len(of_class) < _MOST_PAIRS and len(set(map(id, children))) == len(children):
                of_class[kind] = pairs  # one value twice says nothing of two
        return pairs

    def _elements(self, node: Any) -> bool:
        """What batches say of the elements in the body of a map; whether the body says something of these batches.

        Substitution makes maps of one body over several batches: the body has the frames and units of the first ones.
        """
        all_alike = True
        for batch, element in zip(node.batches, node.placeholders, strict=True):
            read, mapped = id(element) in self._values, node.axis - batch.ndim
            self._leaf(element)
            of_batch, of_element = self._values[id(batch)], self._values[id(element)]
            first = self._batches.setdefault(id(element), of_batch)
            axes = [(axis, axis if axis > mapped else axis - 1) for axis in range(-element.ndim, 0)]
            if read:
                all_alike = all_alike and (first.end == of_batch.end or self._alike(of_element, of_batch, axes))
            elif not of_batch.free:
                of_element.unit = of_batch.unit
                for axis, its_axis in axes:
                    self._same(node, of_element.end + axis, of_batch.end + its_axis)
        return all_alike

    def _alike(self, element: _Value, batch: _Value, axes: Sequence[tuple[int, int]]) -> bool:
        """Whether an element has the unit, the spaces and the frames, some of them known, of another batch."""
        if element.unit != batch.unit:
            return False
        frames, spaces = (
            [[known and known.fact for known in (c.known(element.end + a), c.known(batch.end + b))] for a, b in axes]
            for c in (self._frames, self._spaces)
        )
        return all(a == b for a, b in [*frames, *spaces]) and (not axes or any(a for a, _ in frames))

    def _mapped(self, node: Any, knows: bool) -> None:
        """The value of a map, from that of its body if that says something of these batches."""
        body = self._values[id(node.body)]
        free = body.free and all(self._values[id(batch)].free for batch in node.batches)
        value = _Value(node.shape, self._numbered(node.shape), free, body.unit if knows else None)
        self._values[id(node)] = value
        if knows and not body.free:
            for axis in range(-len(body.shape), 0):
                self._same(node, value.end + axis, body.end + axis)

    def _same(self, at: Expr | str, one: int, other: int) -> None:
        """Two axes of one frame and space."""
        self._refuse(at, self._frames.link(one, other, False))
        self._refuse(at, self._spaces.link(one, other, False))

    def _link(self, node: Expr, children: Sequence[Expr], ends: Sequence[int], pairs: NodePairs) -> None:
        """What a node says of the axes of its operands and its value."""
        values, link_frames = (*children, node), self._frames.link
        for k, axis, space in pairs.spaces:
            self._fix(self._spaces, ends[k] + axis, AxisFact(space, values[k], axis, node))
        for one, axis, other, its_axis, dual, half in pairs.links:
            a, b = ends[one] + axis, ends[other] + its_axis
            if half:
                self._halves.append((node, a, b))
                continue
            both = link_frames(a, b, False)
            if dual is not None:
                both = both or self._spaces.link(a, b, dual)
            if both:
                self._refuse(node, both)
        for vector, by in pairs.unframed:
            if not self._values[id(values[by])].free:
                self._unframed.append((node, values[vector], values[by]))

    def read_rate(self, state: State, rate: Expr) -> None:
        """A rate has the frame and space of its state, and its unit per second; the rate of a pose is a twist."""
        self._leaf(state)
        place, of_state, of_rate = f"the rate of {state.name!r}", self._values[id(state)], self._values[id(rate)]
        end = self._numbered(rate.shape) if of_rate.free else of_rate.end
        if state.group.flat and state.shape == rate.shape:
            if len(state.shape) != 1 or state.shape[0] != 4:  # a quaternion has two frames, its rate none
                for axis in range(-state.ndim, 0):
                    self._same(place, of_state.end + axis, end + axis)
        elif state.group.rigid:
            self._refuse(place, self._frames.link(of_state.end - 1, end - 1, False))
            if rate.shape == (_SIX,):
                self._fix(self._spaces, end - 1, AxisFact(Space.MOTION, rate, -1, place))
        of = ONE if state.group.rigid else of_state.unit
        unit = of_rate.unit
        if of is not None and unit is not None and unit != of / SECOND:
            what = f"{state.name!r}, a pose or rotation," if state.group.rigid else f"{state.name!r} in {of}"
            raise self._of_units(place, Clash(f"the rate of {what} is in {of / SECOND}", (rate, unit)), of / SECOND)

    def _space(self, slot: int) -> Space | None:
        known = self._spaces.known(slot)
        return known.fact if known and isinstance(known.fact, Space) else None

    def link_halves(self) -> None:
        """The frame of each twist and wrench is that of its halves, once all spaces are known."""
        for node, half, six_vector in self._halves:
            if self._space(six_vector) is not None:
                self._refuse(node, self._frames.link(half, six_vector, False))

    def check_unframed(self) -> None:
        """Raise KindError if a scalar is added to the entries of a vector in a frame."""
        for node, vector, scalar in self._unframed:
            value = self._values[id(vector)]
            known = None if value.free else self._frames.known(value.end - 1)
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
        known = self._values[id(value)]
        axes = range(-2 if value.shape == (4,) else -value.ndim, 0)
        facts = (classes.known(known.end + axis) for axis in axes for classes in (self._frames, self._spaces))
        return known.unit is not None or any(facts)

    def unit(self, value: Expr) -> Unit | None:
        """The unit of a value, for a six-vector that of its angular part; None if undetermined."""
        return self._values[id(value)].unit

    def spaces(self, value: Expr) -> list[Space | None]:
        """The space of each axis of a value; None if undetermined or not of length six."""
        return [self._space(self._values[id(value)].end + axis) for axis in range(-value.ndim, 0)]

    def description(self, value: Expr) -> str:
        """A text about a value: its kind, frames and unit, or "open"."""
        end, spaces = self._values[id(value)].end, self.spaces(value)
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
    inference.link_halves()
    inference.check_unframed()
    if inference.has_bodies:
        check_bodies(nodes, roots, rates, BodyInference(inference.leaves, inference.place, short))
    return inference


def _declared_in_words(value: Expr) -> str:
    """What a value declares."""
    kind = kind_of(value)
    return "" if kind is None else f", declared {kind}"
