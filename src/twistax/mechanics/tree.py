"""Kinematic trees of bodies and joints: the links that users define, and the segments of the recursions.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 4, for trees; [v; w] here.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from ..checks import listed, reals
from ..errors import ModelError
from ..expr import Constant, Expr, canonicalize_all
from ..expr.lie import Act, Compose, Pose
from ..expr.lie.elements import parts_of_pose
from ..view import Shape
from .arguments import constant, dataclass_repr, pose
from .bodies import SpatialInertia
from .drives import Drive
from .inner_motion import InnerMotion
from .joints import Joint


@dataclasses.dataclass(frozen=True)
class Mimic:
    """A joint that follows another joint: its position is ratio times the position of that joint, plus offset.

    Attributes:
        joint: the name of the leading joint.
        ratio, offset: finite numbers; the offset in rad or m.
    Raises: ModelError if ratio or offset is not a finite number.
    Example: `Mimic("left_finger", ratio=-1.0)`.
    """

    joint: str
    ratio: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        for name in ("ratio", "offset"):
            value = reals(f"Mimic of {self.joint!r}: {name}", getattr(self, name), ModelError)
            if value.shape or not np.isfinite(value):
                raise ModelError(f"Mimic of {self.joint!r} expects {name} to be a finite number, got {value.tolist()}")


@dataclasses.dataclass(frozen=True, repr=False)
class Link:
    """A body, the joint that carries it, and the pose of that joint on the parent link. The link's frame is the joint's
    child frame.

    A link on a `Fixed` joint is merged with its parent; its frame keeps its name. So a link on a Fixed
    joint without a body is a frame.

    Attributes:
        joint: a joint of any kind.
        body: mass, centre of mass and inertia in the link's frame; None for a link without mass.
        mount: pose T (4, 4) of the joint's parent frame in the frame of the parent link, or of the base: numbers, or an
            expression that is constant during the motion.
        parent: the name of the parent link; None for the base. In a `Chain` it is the previous link of the list.
        name: the name of the link; by default that of the joint.
        drive: rotor, damping, friction, spring, gear and limits of the joint.
        mimic: the joint that this one follows, or None.
        shapes: what `solution.show` draws for the link; by default the ellipsoid of its inertia.
        collision: the solids of the link for `clearances`; None: its shapes.
    Raises:
        ModelError: a joint, body, drive or mimic of another type; a numeric mount that is not a pose, or one
            that depends on time, states or controls; a mimic joint with a position on a group.
        ShapeError: mount is not of shape (4, 4).
    Example: `Link(joints.Revolute("elbow", (0.0, 1.0, 0.0)), body, tx.pose(), parent="shoulder")`.
    """

    joint: Joint
    body: SpatialInertia | None
    mount: Any
    parent: str | None = None
    name: str = ""
    drive: Drive = dataclasses.field(default_factory=Drive)
    mimic: Mimic | None = None
    shapes: Iterable[Shape] = ()
    collision: Iterable[Shape] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.joint, Joint):
            raise ModelError(f"Link expects a joint, such as joints.Revolute, got {self.joint!r}")
        if self.body is not None and not isinstance(self.body, SpatialInertia):
            raise ModelError(f"Link expects a SpatialInertia as body, got {self.body!r}")
        if not isinstance(self.drive, Drive):
            raise ModelError(f"Link expects a Drive as drive, got {self.drive!r}")
        if self.mimic is not None and (not isinstance(self.mimic, Mimic) or self.joint.dofs != 1):
            raise ModelError(
                "Link expects a Mimic as mimic, and a joint with one degree of freedom, got "
                f"{self.mimic!r} of {self.joint!r}"
            )
        object.__setattr__(self, "shapes", shapes_of("Link", self.shapes))
        if self.collision is not None:
            object.__setattr__(self, "collision", shapes_of("Link", self.collision))
        owner = f"Link {self.name or self.joint.name!r}"
        object.__setattr__(self, "mount", constant(owner, "mount", pose("Link", "mount", self.mount)))
        object.__setattr__(self, "name", self.name or self.joint.name)

    def transform(self, position: Expr) -> Expr:
        """The pose T (4, 4) of the link's frame in that of its parent link, as a function of the joint's position."""
        R, _ = parts_of_pose(self.mount)
        turn, shift = parts_of_pose(self.joint.placement(position))
        return Pose(Compose(R, turn), Act(self.mount, shift))

    def __repr__(self) -> str:
        return dataclass_repr(self)


def shapes_of(owner: str, shapes: Any) -> tuple[Shape, ...]:
    """Shapes, or one shape, as a tuple. Raises ModelError for other objects."""
    sequence = (shapes,) if isinstance(shapes, Shape) else tuple(shapes) if isinstance(shapes, Iterable) else (shapes,)
    wrong = [shape for shape in sequence if not isinstance(shape, Shape)]
    if wrong:
        raise ModelError(f"{owner} expects shapes, such as tx.view.Sphere(0.1), got {wrong[0]!r}")
    return sequence


def solids_of(part: Any) -> tuple[Shape, ...]:
    """The solids for distances of a link, or of the base of a mechanism: its collision geometry, or else its shapes."""
    return tuple(part.shapes if part.collision is None else part.collision)


@dataclasses.dataclass(frozen=True)
class Segment:
    """A link merged with all links that are fixed to it, a node of the recursions.

    Attributes:
        link: the link; its mount is in the parent segment.
        body: the body, merged with all that is fixed to it; None without mass.
        before: the index of the parent segment; -1 for the base.
        freedoms: the entries of the velocity that move it; for a mimic joint those of the joint that it follows.
        coordinates: the entries of the position vector; None for a position on a group.
    """

    link: Link
    body: SpatialInertia | None
    before: int
    freedoms: tuple[int, ...]
    coordinates: slice | None

    @property
    def ratio(self) -> float:
        """The ratio of a mimic joint, else 1."""
        return 1.0 if self.link.mimic is None else self.link.mimic.ratio

    @functools.cached_property
    def inner_motion(self) -> InnerMotion | None:
        """The effect of masses that move inside the body; None if none move. Raises ModelError for unknown rates."""
        return None if self.body is None else self.body.inner_motion

    @property
    def moves_by_motor(self) -> bool:
        """Whether its joint has a motor by default. A joint is passive if its drive has a spring and no effort."""
        drive, joint = self.link.drive, self.link.joint
        passive = drive.sprung and drive.effort is None
        return joint.dofs < 6 and self.link.mimic is None and not passive

    def scaled(self, value: Expr) -> Expr:
        """The value times the ratio of a mimic joint; the value itself for other joints."""
        return value if self.link.mimic is None else self.ratio * value

    def along(self, velocities: Expr) -> Expr:
        """H qd (6,): the twist across the joint for velocities (n,), in the segment's frame."""
        H = self.link.joint.motion_subspace
        if not self.freedoms:
            return Constant(np.zeros(6))
        if len(self.freedoms) == 1:
            return H[:, 0] * self.scaled(velocities[self.freedoms[0]])
        return H @ velocities[self.freedoms[0] : self.freedoms[-1] + 1]


@dataclasses.dataclass(frozen=True)
class Frame:
    """A frame that is fixed to a segment, or to the base if `segment` is -1, with its pose T (4, 4) in the segment's
    frame.
    """

    segment: int
    T: Expr


def sorted_links(links: Iterable[Any], base: str) -> tuple[Link, ...]:
    """The links sorted so that each follows its parent, branch by branch.

    Raises: ModelError for no links; objects that are not links; repeated names; an unknown parent; a cycle.
    """
    if not isinstance(links, Iterable):
        raise ModelError(f"expected links made by Link, got {links!r}")
    links = tuple(links)
    for link in links:
        if not isinstance(link, Link):
            raise ModelError(f"expected links made by Link, got {link!r}")
    if not links:
        raise ModelError("expected at least one link, got none")
    for kind, names in (("links", [link.name for link in links]), ("joints", [link.joint.name for link in links])):
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ModelError(f"two {kind} are named {twice[0]!r}.\n  fix: use unique names within a mechanism")
    known = [link.name for link in links]
    children: dict[str | None, list[Link]] = {}
    for link in links:
        parent = None if link.parent == base and base not in known else link.parent
        if parent is not None and parent not in known:
            raise ModelError(
                f"link {link.name!r} has the parent {parent!r}, but there is no link of that name; known are "
                f"{listed(sorted(known), parent)}.\n  fix: use the name of a link, or parent=None for the base"
            )
        children.setdefault(parent, []).append(link)
    order: list[Link] = []
    waiting = list(reversed(children.get(None, [])))
    while waiting:
        order.append(waiting.pop())
        waiting += reversed(children.get(order[-1].name, []))
    if len(order) < len(links):
        left = sorted(set(known) - {link.name for link in order})
        raise ModelError(
            f"the links {listed(left)} are not connected to the base.\n"
            "  fix: check parent= of these links: one of them must be None"
        )
    return tuple(order)


def segments_of(
    links: tuple[Link, ...], keep: Collection[str], base: str
) -> tuple[tuple[Segment, ...], dict[str, Frame]]:
    """The segments of moving links, with fixed links merged, and the frame of every link.

    Raises: ModelError for a mimic joint whose leading joint does not exist, is itself a mimic joint, or does not have
    one degree of freedom.
    """
    ground = Frame(-1, Constant(np.eye(4)))
    frames = {base: ground}  # a link may have the name of the base
    moving: list[tuple[Link, int]] = []
    bodies: list[list[SpatialInertia]] = []
    for link in links:
        at = ground if link.parent is None else frames[link.parent]
        mount = _folded(Compose(at.T, link.mount))
        if link.joint.dofs or link.joint.name in keep:
            frames[link.name] = Frame(len(moving), Constant(np.eye(4)))
            moving.append((dataclasses.replace(link, mount=mount), at.segment))
            bodies.append([] if link.body is None else [link.body])
        else:
            frames[link.name] = Frame(at.segment, mount)
            if link.body is not None and at.segment >= 0:
                bodies[at.segment].append(link.body.in_frame(mount))
    freedoms, coordinates = _numbered([link for link, _ in moving])
    segments = tuple(
        Segment(link, merged(parts), before, freedoms[link.joint.name], coordinates[link.joint.name])
        for (link, before), parts in zip(moving, bodies, strict=True)
    )
    return segments, frames


def merged(bodies: list[SpatialInertia]) -> SpatialInertia | None:
    """The sum of inertias as one inertia; None for no inertia."""
    return functools.reduce(SpatialInertia.merge, bodies) if bodies else None


def _folded(T: Expr) -> Expr:
    return canonicalize_all([T])[0]


def _numbered(links: list[Link]) -> tuple[Mapping[str, tuple[int, ...]], Mapping[str, slice | None]]:
    """The entries of the velocity vector and of the position vector that belong to each joint."""
    freedoms: dict[str, tuple[int, ...]] = {}
    coordinates: dict[str, slice | None] = {}
    free, coordinate = 0, 0
    for link in links:
        name, k = link.joint.name, link.joint.dofs
        if link.mimic is not None:
            continue
        freedoms[name] = tuple(range(free, free + k))
        free += k
        grouped = link.joint.group is not None
        coordinates[name] = None if grouped else slice(coordinate, coordinate + k)
        coordinate += 0 if grouped else k
    leaders = sorted(name for name, at in freedoms.items() if len(at) == 1)
    for link in links:
        if link.mimic is None:
            continue
        leader = link.mimic.joint
        if leader not in leaders:
            raise ModelError(
                f"joint {link.joint.name!r} mimics {leader!r}, which is not a joint with one degree of "
                f"freedom that mimics no other; such joints are {listed(leaders, leader)}.\n"
                "  fix: mimic one of these joints"
            )
        freedoms[link.joint.name], coordinates[link.joint.name] = freedoms[leader], coordinates[leader]
    return freedoms, coordinates
