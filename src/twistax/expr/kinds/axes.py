"""Classes of axes that have one frame or one space, and the facts that determined it."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from .kinds import Space

_Fact: TypeAlias = "str | Space"


class AxisFact(NamedTuple):
    """The frame or the space of an axis of a value, with the node or the text of the place that determined it.

    `note` is the declaration of the value, as text.
    """

    fact: _Fact
    value: Any
    axis: int
    at: Any
    note: str = ""

    @property
    def dual(self) -> AxisFact:
        """The same fact for an axis that is dual to this one; a frame is unchanged."""
        return self if isinstance(self.fact, str) else self._replace(fact=self.fact.dual)

    def clause(self, value: str) -> str:
        """A clause for messages about the value with this text: "F is in 'world'"."""
        takes, matrix = self.value.ndim == 2 and self.axis == -1, self.value.ndim == 2
        if isinstance(self.fact, str):
            verb = "takes what is in" if takes else "gives what is in" if matrix else "is in"
            return f"{value} {verb} {self.fact!r}"
        verb = "takes" if takes else "gives" if matrix else "is"
        return f"{value} {verb} {(self.fact.dual if takes else self.fact).value}"


class AxisClasses:
    """Union-find over numbered axes. An axis may be dual to the first one of its class."""

    def __init__(self) -> None:
        #: Of axes that are not first in their class: another one, and whether it is dual to that.
        self._parents: dict[int, tuple[int, bool]] = {}
        self._facts: dict[int, AxisFact] = {}

    def _find(self, slot: int) -> tuple[int, bool]:
        parents = self._parents
        parent = parents.get(slot)
        if parent is None:
            return slot, False
        if parent[0] not in parents:
            return parent
        path, flipped = [], False
        while slot in parents:
            path.append((slot, flipped))
            slot, flip = parents[slot]
            flipped ^= flip
        for passed, before in path:
            parents[passed] = slot, flipped ^ before
        return slot, flipped

    def known(self, slot: int) -> AxisFact | None:
        """The known fact about an axis."""
        first, flipped = self._find(slot)
        fact = self._facts.get(first)
        return fact.dual if fact and flipped else fact

    def fix(self, slot: int, fixed: AxisFact) -> tuple[AxisFact, AxisFact] | None:
        """Set a fact; returns both facts if they contradict each other."""
        first, flipped = self._find(slot)
        if first not in self._facts:
            self._facts[first] = fixed.dual if flipped else fixed
            return None
        there = self._facts[first].dual if flipped else self._facts[first]
        return None if there.fact == fixed.fact else (there, fixed)

    def link(self, one: int, other: int, dual: bool) -> tuple[AxisFact, AxisFact] | None:
        """Join two classes; returns both facts if they contradict each other, each with its origin."""
        parents = self._parents
        kept, a = self._find(one) if one in parents else (one, False)
        gone, b = self._find(other) if other in parents else (other, False)
        if kept == gone:
            return None
        flip = a ^ b ^ dual
        theirs = self._facts.get(gone)
        if theirs is not None:
            mine, as_here = self._facts.get(kept), theirs.dual if flip else theirs
            if mine is None:
                self._facts[kept] = as_here
            elif mine.fact != as_here.fact:
                return (mine.dual if a else mine), (theirs.dual if b else theirs)
        parents[gone] = kept, flip
        return None
