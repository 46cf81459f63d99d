"""Which functions of a phase are alike: what they are traced from as keys, and their numbers apart."""

from __future__ import annotations

from collections.abc import Hashable

from ..expr import Control, Leaf, Parameter, State, Time
from ..expr.fields import freeze
from .flat import Numbers
from .shooting import Shooting


class Layout:
    """Where the leaves of a phase stand, whatever they are called.

    Attributes:
        key: equal for phases whose points, controls, parameters and times are laid out alike.
        named: what stands for a leaf, by its name.
        boxes: whose limits there are.
    """

    def __init__(self, shooting: Shooting, numbers: Numbers) -> None:
        local, border = shooting.local, shooting.border
        boxes: dict[str, Hashable] = {box.name: ("free", k) for k, box in enumerate(border.boxes)}
        self.named: dict[str, Hashable] = {n: ("parameter", k) for k, n in enumerate(numbers.names)} | boxes
        self.named |= {name: ("state", k) for k, name in enumerate(local.group.factors)}
        self.named |= {name: ("control", k) for k, name in enumerate(local.controls.slices)}
        self.boxes = tuple((self.named[b.leaf], b.entry, b.sign) for b in shooting.path.bounds)
        controls = tuple(part.stop - part.start for part in local.controls.slices.values())
        free = tuple(box.shape for box in border.boxes)
        self.key = (group_key(shooting), controls, free, border.phases, shooting.phase, numbers.key, local.sign)

    def token(self, leaf: Leaf) -> Hashable:
        """What stands for a leaf; None where it counts with all that it has."""
        if isinstance(leaf, Time):
            return "time"
        known = isinstance(leaf, (State, Control, Parameter)) and leaf.name in self.named
        return (type(leaf), self.named[leaf.name], leaf.shape) if known else None


def group_key(shooting: Shooting) -> Hashable:
    """Equal for phases whose states are of the same groups."""
    return tuple((type(own), freeze(own), own.shape) for own in shooting.dynamics.group.factors.values())
