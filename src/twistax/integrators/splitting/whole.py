"""The free motion of a whole system: that of its parts, side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax

from ...lowering.dynamics import Arrays
from ..charts.whole import Blocks
from .motion import Flows

__all__ = ["AllFlows"]


class AllFlows(Flows):
    """The flows of all parts: they share no state, so their flows commute."""

    def __init__(self, parts: Sequence[Flows]) -> None:
        self.parts = tuple(parts)

    def enter(self, x: Arrays) -> Blocks:
        return self._joined(lambda part: part.enter(x))

    def value(self, y: Blocks) -> Arrays:
        return {name: value for part in self.parts for name, value in part.value(y).items()}

    def at_rest(self, y: Blocks) -> Arrays:
        return {name: value for part in self.parts for name, value in part.at_rest(y).items()}

    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        return self._joined(lambda part: part.outer(y, dt))

    def inner(self, y: Blocks, dt: jax.Array) -> Blocks:
        return self._joined(lambda part: part.inner(y, dt))

    def inner_backwards(self, y: Blocks, dt: jax.Array) -> Blocks:
        return self._joined(lambda part: part.inner_backwards(y, dt))

    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        return self._joined(lambda part: part.kick(y, rates, dt))

    def settle(self, y: Blocks) -> Blocks:
        return self._joined(lambda part: part.settle(y))

    def _joined(self, blocks: Callable[[Flows], Blocks]) -> Blocks:
        return {name: block for part in self.parts for name, block in blocks(part).items()}
