"""Serial chains: bodies one after the other, each on a joint to the one before. Trees with one branch."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from ..errors import ModelError
from ..expr.fields import ExprLike
from .mechanism import Mechanism
from .tree import Link


class Chain(Mechanism):
    """Links one after the other from a base at rest to the tip, under uniform gravity: a `Mechanism` with one branch.

    Args:
        links: one or more, from base to tip; each sits on the one before, whatever its `parent` says.
        gravity: (3,) in the base's axes, m/s2; numbers or an expression.
    Raises:
        ModelError: no links, or something else among them.
        ShapeError: gravity is not of shape (3,).
    """

    def __init__(self, links: Iterable[Link], gravity: ExprLike = (0.0, 0.0, -9.81)) -> None:
        if not isinstance(links, Iterable):
            raise ModelError(f"Chain expects links made by Link, got {links!r}")
        before: str | None = None
        joined: list[Link] = []
        for link in links:
            # What is no link is refused with the rest.
            joined.append(dataclasses.replace(link, parent=before) if isinstance(link, Link) else link)
            before = getattr(link, "name", None)
        super().__init__(joined, gravity)
