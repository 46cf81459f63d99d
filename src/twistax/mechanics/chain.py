"""Serial chains: bodies one after the other, each on a joint to the one before.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 4, for trees; [v; w] here.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..errors import ModelError
from ..expr import Constant, Dot, Expr
from ..expr.fields import ExprLike
from ..expr.lie import Act, AdjointAction, Compose, Pose
from ..expr.lie.elements import parts_of_pose
from .arguments import of_shape, pose
from .bodies import SpatialInertia
from .joints import Joint


@dataclasses.dataclass(frozen=True)
class Link:
    """A body, the joint that carries it, and where that joint sits. The link's frame is the joint's child frame.

    Attributes:
        joint: of one freedom, such as Revolute or Prismatic.
        body: mass, centre of mass and inertia in the link's frame.
        mount: T (4, 4) of the joint's parent frame in the frame of the link before, or of the base; numbers, or an
            expression that does not change with the motion.
    Raises:
        ModelError: a joint with more or fewer freedoms; no joint or no body; a mount made of numbers and no pose.
        ShapeError: mount is not of shape (4, 4).
    """

    joint: Joint
    body: SpatialInertia
    mount: Any

    def __post_init__(self) -> None:
        if not isinstance(self.joint, Joint) or self.joint.dofs != 1:
            raise ModelError(
                f"Link expects a joint of one freedom, got {self.joint!r}.\n"
                "  fix: several freedoms are several joints, with bodies of no size between them; a body on a Fixed "
                "joint is merged with the one before: before + body.in_frame(mount)"
            )
        if not isinstance(self.body, SpatialInertia):
            raise ModelError(f"Link expects a SpatialInertia as body, got {self.body!r}")
        object.__setattr__(self, "mount", pose("Link", "mount", self.mount))

    def transform(self, position: Expr) -> Expr:
        """T (4, 4) of the link's frame in that of the link before, of the joint's position (1,)."""
        R, _ = parts_of_pose(self.mount)
        turn, shift = parts_of_pose(self.joint.placement(position))
        return Pose(Compose(R, turn), Act(self.mount, shift))


@dataclasses.dataclass(frozen=True, init=False)
class Chain:
    """Links one after the other from a base at rest to the tip, under uniform gravity.

    Positions q and velocities q' are vectors (n,), an entry a joint from base to tip: m and m/s for a slide, rad and
    rad/s for a turn. The states of the joints themselves are not used.

    Args:
        links: one or more, from base to tip.
        gravity: (3,) in the base's axes, m/s2; numbers or an expression.
    Attributes:
        links, gravity: as given; gravity as an expression.
    Raises:
        ModelError: no links, or something else among them.
        ShapeError: gravity is not of shape (3,).
    """

    links: tuple[Link, ...]
    gravity: Expr

    def __init__(self, links: Iterable[Link], gravity: ExprLike = (0.0, 0.0, -9.81)) -> None:
        if not isinstance(links, Iterable):
            raise ModelError(f"Chain expects links made by Link, got {links!r}")
        links = tuple(links)
        for link in links:
            if not isinstance(link, Link):
                raise ModelError(f"Chain expects links made by Link, got {link!r}")
        if not links:
            raise ModelError("Chain expects at least one link, got none")
        object.__setattr__(self, "links", links)
        g = of_shape("Chain", "gravity", gravity, (3,), "a vector in the base's axes")
        if isinstance(g, Constant) and not np.isfinite(g.value).all():
            raise ModelError(f"Chain expects gravity to be finite, got {g!r}")
        object.__setattr__(self, "gravity", g)

    @property
    def dofs(self) -> int:
        """n, the number of links."""
        return len(self.links)

    def coordinates(self, owner: str, name: str, value: ExprLike) -> Expr:
        """The argument `name` of `owner` as an expression (n,). Raises ShapeError."""
        return of_shape(owner, name, value, (self.dofs,), "one entry for each link, from base to tip")

    def transforms(self, q: ExprLike) -> list[Expr]:
        """T (4, 4) of each link in the link before, the first in the base. Raises ShapeError."""
        q = self.coordinates("Chain.transforms", "q", q)
        return [link.transform(q[i : i + 1]) for i, link in enumerate(self.links)]

    def poses(self, q: ExprLike) -> list[Expr]:
        """T (4, 4) of each link in the base. Raises ShapeError."""
        return list(itertools.accumulate(self.transforms(q), Compose))

    def twists(self, q: ExprLike, qd: ExprLike) -> list[Expr]:
        """V (6,) of each link, in its frame: V_i = Ad_T^-1 V_(i-1) + H q_i'. Raises ShapeError."""
        qd = self.coordinates("Chain.twists", "qd", qd)
        V: Expr = Constant(np.zeros(6))
        found = []
        for i, (link, T) in enumerate(zip(self.links, self.transforms(q), strict=True)):
            V = AdjointAction(T, V, inverse=True) + link.joint.motion_subspace[:, 0] * qd[i]
            found.append(V)
        return found

    def energy(self, q: ExprLike, qd: ExprLike) -> Expr:
        """Kinetic and potential energy (), J; the latter is zero for masses at the base. Raises ShapeError."""
        terms = []
        for link, T, V in zip(self.links, self.poses(q), self.twists(q, qd), strict=True):
            body = link.body
            terms.append(body.kinetic_energy(V) - body.mass * Dot(self.gravity, Act(T, body.center_of_mass)))
        return sum(terms[1:], terms[0])
