"""Bodies of twists and wrenches: the moving body and the reference body of a twist, and the body on which a wrench
acts.

The twist of A relative to B is treated as the difference A - B, so that twists of A relative to B and of B relative to
C add up to the twist of A relative to C. Wrenches on one body can be added; a subtracted wrench is a reaction, which
may act on any body.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias


@dataclasses.dataclass(frozen=True)
class BodyMotion:
    """A sum of body motions. If the coefficients do not add up to zero, the rest is relative to an unknown body."""

    bodies: Mapping[str, int]

    def times(self, factor: int) -> BodyMotion:
        return BodyMotion({name: factor * n for name, n in self.bodies.items()})

    def plus(self, other: BodyMotion) -> BodyMotion:
        names = dict.fromkeys([*self.bodies, *other.bodies])
        total = {name: self.bodies.get(name, 0) + other.bodies.get(name, 0) for name in names}
        return BodyMotion({name: n for name, n in total.items() if n})

    @property
    def complete(self) -> bool:
        return sum(self.bodies.values()) == 0

    @property
    def of_one_body(self) -> bool:
        """Whether it is, or may be, a multiple of the twist of one body relative to another one."""
        return not self.complete or len(self.bodies) in (0, 2)

    def fits(self, other: BodyMotion) -> bool:
        """Whether both may be the same twist."""
        difference = self.plus(other.times(-1))
        return not difference.bodies or (len(difference.bodies) == 1 and not (self.complete and other.complete))

    def __str__(self) -> str:
        plus, minus = ([name for name, n in self.bodies.items() if n * sign > 0] for sign in (1, -1))
        of, against = (" and ".join(map(repr, names)) for names in (plus, minus))
        return f"of {of or 'a body'}" + (f" relative to {against}" if against else "")


@dataclasses.dataclass(frozen=True)
class Acts:
    """A wrench on a body."""

    on: str

    def __str__(self) -> str:
        return f"on {self.on!r}"


#: What is known of the bodies of a value; None: nothing.
Bodies: TypeAlias = "BodyMotion | Acts | None"


class BodyClash(Exception):
    """Values of different bodies are added; `values` are the operands."""

    def __init__(self, sentence: str, *values: tuple[Any, Bodies]) -> None:
        super().__init__(sentence)
        self.values = values


def summed(values: Sequence[Any], known: Sequence[Bodies], signs: Sequence[int]) -> Bodies:
    """The bodies of a sum. Raises BodyClash for wrenches on different bodies."""
    acting = [(v, k) for v, k, sign in zip(values, known, signs, strict=True) if isinstance(k, Acts) and sign > 0]
    for pair in acting[1:]:
        if pair[1] != acting[0][1]:
            raise BodyClash("wrenches on two bodies are added", acting[0], pair)
    if acting:
        return acting[0][1]
    total = BodyMotion({})
    for bodies, sign in zip(known, signs, strict=True):
        if not isinstance(bodies, BodyMotion):
            return None
        total = total.plus(bodies.times(sign))
    return total
