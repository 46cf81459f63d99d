"""Kinematic trees of links on a base: their coordinates, frames and poses."""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import instance, listed, name_list, short
from ..errors import ModelError
from ..expr import Constant, Control, Expr, State
from ..expr.fields import ExprLike
from ..expr.kinds.declare import known_as
from ..expr.kinds.kinds import Pose, Twist
from ..expr.kinds.unit import JOULE, SECOND, Unit
from ..expr.lie import AdjointAction, Compose, Inverse
from ..expr.operations.arithmetic import is_identity
from .arguments import finite, of_shape
from .bodies import SpatialInertia
from .loops import Loop, Metric, check_loops
from .screws import element_kind, unit_of
from .tree import Frame, Link, Segment, segments_of, shapes_of, sorted_links

if TYPE_CHECKING:
    from ..view import Shape

#: Inertias below this fraction of the total inertia of a body are round-off.
_ROUND_OFF = 1e-13
#: Positions: a vector, or a mapping with a vector "q" and an element for each joint on a group.
Positions = ExprLike | Mapping[str, ExprLike]


class KinematicTree:
    """A kinematic tree of links and joints: its coordinates, frames and poses.

    The arguments and attributes are those of `Mechanism`, which adds the dynamics.
    """

    def __init__(
        self,
        links: Iterable[Link],
        gravity: ExprLike = (0.0, 0.0, -9.81),
        *,
        base: str = "base",
        keep: Collection[str] = (),
        notes: Iterable[str] = (),
        driven: Collection[str] | None = None,
        loops: Iterable[Loop] = (),
        loop_metric: Metric = Metric(),  # noqa: B008
        shapes: Iterable[Shape] = (),
        collision: Iterable[Shape] | None = None,
        base_body: SpatialInertia | None = None,
    ) -> None:
        name = type(self).__name__
        try:
            self.links = sorted_links(links, base)
            self.segments, self.frames = segments_of(self.links, keep, base)
        except ModelError as error:
            raise ModelError(f"{name}: {error}") from None
        self.gravity = of_shape(name, "gravity", gravity, (3,), "a vector in the base's axes")
        if isinstance(self.gravity, Constant) and not np.isfinite(self.gravity.value).all():
            raise ModelError(f"{name} expects gravity to be finite, got {self.gravity!r}")
        self._notes = tuple(notes)
        self.base, self.shapes, self.base_body = base, shapes_of(name, shapes), base_body
        self.collision = None if collision is None else shapes_of(name, collision)
        instance(f"{name}: base_body", base_body, SpatialInertia | None, "a SpatialInertia", ModelError)
        self.dofs = 1 + max((max(s.freedoms, default=-1) for s in self.segments), default=-1)
        self.loops, self.loop_metric = tuple(loops), loop_metric
        driven = None if driven is None else tuple(driven)
        #: The arguments of the constructor besides the links, which `replace` passes on.
        self.arguments: dict[str, Any] = {"gravity": self.gravity, "base": base, "keep": keep, "notes": self._notes}
        self.arguments |= {"driven": driven, "loops": self.loops, "loop_metric": loop_metric, "shapes": self.shapes}
        self.arguments |= {"base_body": base_body, "collision": self.collision}
        if driven is None:
            driven = [s.link.joint.name for s in self.segments if s.moves_by_motor]
        self.driven = tuple(driven)
        self.freedoms(self.driven)
        check_loops(self.loops, self.loop_metric, lambda name: self.frame(name).segment)

    def check_masses(self, owner: str) -> None:
        """Raise ModelError for a joint that moves no mass, so that its acceleration is not determined."""
        heavy = [segment.body is not None or segment.link.drive.rotor is not None for segment in self.segments]
        for i in reversed(range(len(self.segments))):
            if not heavy[i] and self.segments[i].link.joint.dofs:
                raise ModelError(
                    f"{owner}: joint {self.segments[i].link.joint.name!r} carries no mass, so its acceleration is not "
                    "determined.\n  fix: give its link or a later one a body, or give the joint an armature"
                )
            if self.segments[i].before >= 0:
                heavy[self.segments[i].before] |= heavy[i]
        self._check_tips(owner)

    def _check_tips(self, owner: str) -> None:
        """Raise ModelError for a joint at a tip (a leaf of the tree) whose body has no inertia
        about the joint's axis.
        """
        carrying = {segment.before for segment in self.segments}
        for i, segment in enumerate(self.segments):
            H, drive = segment.link.joint.motion_subspace, segment.link.drive
            aided = drive.rotor is not None or segment.link.mimic is not None or i in carrying
            if aided or segment.body is None or not isinstance(H, Constant):
                continue
            if (M := segment.body.known_matrix) is None:
                continue
            least = np.linalg.eigvalsh(H.value.T @ M @ H.value).min(initial=np.inf)
            if least <= _ROUND_OFF * max(np.trace(M[3:, 3:]), np.finfo(float).tiny):
                raise ModelError(
                    f"{owner}: the body of {segment.link.name!r} has no inertia about the axis of joint "
                    f"{segment.link.joint.name!r}, so its acceleration is not determined.\n"
                    "  fix: give the body a thickness, or the joint an armature"
                )

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self.links)} links, {self.dofs} freedoms)"

    @functools.cached_property
    def bodies(self) -> dict[int, SpatialInertia]:
        """The body of every segment with mass, merged with all links fixed to it, by the index of the segment."""
        return {i: segment.body for i, segment in enumerate(self.segments) if segment.body is not None}

    # ---- coordinates -------------------------------------------------------------------------------------------------

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the moving joints, in the order of the velocities; a mimic joint shares the entries of the joint
        that it follows.
        """
        return tuple(segment.link.joint.name for segment in self.segments)

    @functools.cached_property
    def _width(self) -> int:
        """The length of the position vector."""
        return max((s.coordinates.stop for s in self.segments if s.coordinates is not None), default=0)

    @functools.cached_property
    def _grouped(self) -> dict[str, Segment]:
        return {s.link.joint.name: s for s in self.segments if s.link.joint.group is not None}

    @functools.cached_property
    def q(self) -> Any:
        """The position vector "q" as a State with the limits of the joints; a mapping if some joints are on groups."""
        elements: dict[str, Any] = {name: self._element(segment) for name, segment in self._grouped.items()}
        if not self._width:
            return elements
        low, high = self._bounds(lambda drive: (drive.lower, drive.upper), by_freedom=False)
        q = known_as(State("q", (self._width,), min=low, max=high), unit=self._unit(grouped=False))
        return {"q": q, **elements} if elements else q

    @functools.cached_property
    def qd(self) -> State:
        """The velocities "qd" (n,) as a State, with the limits of the joints."""
        low, high = self._bounds(lambda d: (None if d.speed is None else -d.speed, d.speed), by_freedom=True)
        unit = self._unit()
        return known_as(State("qd", (self.dofs,), min=low, max=high), unit=None if unit is None else unit / SECOND)

    def motors(self, joints: Collection[str]) -> Control:
        """The motor forces "tau" of some joints as a Control with limits, in the order of the joints."""
        at = self.freedoms(joints)
        low, high = self._bounds(lambda drive: drive.efforts, by_freedom=True)
        unit = self._unit()
        tau = Control("tau", (len(at),), min=None if low is None else low[at], max=None if high is None else high[at])
        return known_as(tau, unit=None if unit is None else JOULE / unit)

    def _unit(self, grouped: bool = True) -> Unit | None:
        """The unit of all coordinates, including those of joints on groups; None if the units differ."""
        segments = [s for s in self.segments if s.freedoms and s.link.mimic is None]
        joints = [s.link.joint for s in segments if grouped or s.link.joint.group is None]
        units = {unit_of(joint.motion_subspace) for joint in joints}
        return units.pop() if len(units) == 1 else None

    def _element(self, segment: Segment) -> Any:
        """The position of a joint on a group, with the names of the frames that it connects if these have names."""
        joint, before = segment.link.joint, self.base if segment.before < 0 else self.segments[segment.before].link.name
        to = before if is_identity(segment.link.mount) else ""
        place, kind = joint.position, element_kind(joint.group, to, segment.link.name)
        return place if kind is None or place is None else known_as(place, kind)

    def _bounds(self, limits: Any, *, by_freedom: bool) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The limits of all joints that do not mimic others, as vectors; None if no joint has limits."""
        size = self.dofs if by_freedom else self._width
        low, high = np.full(size, -np.inf), np.full(size, np.inf)
        for segment in self.segments:
            if segment.link.mimic is None:
                where: Any = list(segment.freedoms) if by_freedom else segment.coordinates
                least, most = limits(segment.link.drive)
                if where is not None:
                    low[where] = -np.inf if least is None else least
                    high[where] = np.inf if most is None else most
        return (low if np.isfinite(low).any() else None), (high if np.isfinite(high).any() else None)

    def freedoms(self, joints: Collection[str]) -> list[int]:
        """The indices of the velocities of these joints, each index once. Raises ModelError for an unknown joint."""
        entries: list[int] = []
        for name in name_list("joints", joints, ModelError):
            entries += [i for i in self.segment_of(name).freedoms if i not in entries]
        return entries

    def segment_of(self, joint: str) -> Segment:
        """The segment that a joint carries. Raises ModelError for an unknown name, or a merged joint."""
        for segment in self.segments:
            if segment.link.joint.name == joint:
                return segment
        is_fixed = isinstance(joint, str) and joint in self.frames
        raise ModelError(
            f"there is no moving joint {short(joint)}; known are {listed(self.joints, None if is_fixed else joint)}"
            + ".\n  fix: to keep a Fixed joint, which is merged with its parent link by default, name it in keep="
            * is_fixed
        )

    def coordinates(self, owner: str, name: str, value: ExprLike | None) -> Expr:
        """The argument `name` of `owner`, with one entry for each degree of freedom (n,); for None the state qd. Raises
        ShapeError for another shape.
        """
        hint = "one entry for each freedom; of a chain one entry for each link, from base to tip"
        return self.qd if value is None else finite(owner, name, of_shape(owner, name, value, (self.dofs,), hint))

    def positions(self, owner: str, q: Positions | None) -> list[Expr]:
        """The joint position of every segment.

        Raises:
            ShapeError: a vector of another length, an element of another shape.
            ModelError: missing or unknown elements of joints on groups.
        """
        places: Any = self.q if q is None else q
        if not isinstance(places, Mapping):
            if self._grouped:
                raise ModelError(
                    f"{owner} expects q as a mapping, got {short(places)}: positions of {listed(self._grouped)} are on "
                    f'groups.\n  fix: {{"q": vector, {next(iter(self._grouped))!r}: element}}'
                )
            places = {"q": places}
        wanted = {*self._grouped, *(["q"] if self._width else [])}
        if set(places) != wanted:
            raise ModelError(f"{owner} expects positions of {listed(sorted(wanted))}, got {listed(places)}")
        hint = "one entry for each coordinate; of a chain one entry for each link, from base to tip"
        vector = of_shape(owner, "q", places["q"], (self._width,), hint) if self._width else Constant(np.zeros(0))
        return [self._position(owner, segment, vector, places) for segment in self.segments]

    def _position(self, owner: str, segment: Segment, vector: Expr, places: Mapping[str, ExprLike]) -> Expr:
        joint, mimic = segment.link.joint, segment.link.mimic
        if joint.group is not None:
            return of_shape(owner, f"the position of {joint.name!r}", places[joint.name], joint.group.shape)
        coordinates = vector[segment.coordinates]
        return coordinates if mimic is None else mimic.ratio * coordinates + mimic.offset

    def along(self, segment: Segment, velocities: Expr) -> Expr:
        """H qd (6,): the twist across a segment's joint for velocities (n,), or the corresponding part of
        accelerations, in the segment's frame.
        """
        return segment.along(velocities)

    # ---- kinematics --------------------------------------------------------------------------------------------------

    def frame(self, name: str) -> Frame:
        """The frame with the name of its link, or of the joint that carries the link. Raises ModelError for an unknown
        name.
        """
        return self.frames[self.frame_name(name)]

    def frame_name(self, name: str) -> str:
        """The name of a frame, from the name of its link or of the joint that carries the link. Raises ModelError for
        an unknown name.
        """
        if name in self.frames:
            return name
        for link in self.links:
            if link.joint.name == name:
                return link.name
        raise ModelError(f"there is no frame {short(name)}; known are {listed(self.frames, name)}")

    def link(self, name: str) -> Link:
        """A link of the tree, by its name or the name of its joint. Raises ModelError for an unknown name."""
        for of in (lambda link: link.name, lambda link: link.joint.name):
            for link in self.links:
                if of(link) == name:
                    return link
        names = [link.name for link in self.links]
        raise ModelError(f"there is no link {short(name)}; known are {listed(names, name)}")

    def transforms(self, q: Positions | None = None) -> list[Expr]:
        """The pose T (4, 4) of each segment in its parent segment, or in the base. Raises ShapeError for positions of
        another shape.
        """
        places = self.positions(f"{type(self).__name__}.transforms", q)
        return [segment.link.transform(place) for segment, place in zip(self.segments, places, strict=True)]

    def poses(self, q: Positions | None = None) -> list[Expr]:
        """The pose T (4, 4) of each segment in the base. Raises ShapeError for positions of another shape."""
        return list(self._poses) if q is None else self._composed(q)

    @functools.cached_property
    def _poses(self) -> list[Expr]:
        return self._composed(None)

    def _composed(self, q: Positions | None) -> list[Expr]:
        poses: list[Expr] = []
        for segment, T in zip(self.segments, self.transforms(q), strict=True):
            poses.append(T if segment.before < 0 else Compose(poses[segment.before], T))
        return poses

    def twists(self, q: Positions | None = None, qd: ExprLike | None = None) -> list[Expr]:
        """The body twist V (6,) of each segment, in its frame: $V_i = Ad_T^-1 V_parent + H qd_i$. Raises ShapeError for
        another shape.
        """
        rates = self.coordinates(f"{type(self).__name__}.twists", "qd", qd)
        twists: list[Expr] = []
        for segment, T in zip(self.segments, self.transforms(q), strict=True):
            V, before = self.along(segment, rates), segment.before
            twists.append(V if before < 0 else AdjointAction(T, twists[before], inverse=True) + V)
        return twists

    def pose(self, frame: str, q: Positions | None = None, *, relative_to: str | None = None) -> Expr:
        """The pose T (4, 4) that maps coordinates of a frame to those of the base, or of another frame. Raises
        ModelError for an unknown frame.
        """
        at = self.frame(frame)
        T = at.T if at.segment < 0 else Compose(self.poses(q)[at.segment], at.T)
        T = T if relative_to is None else Compose(Inverse(self.pose(relative_to, q)), T)
        to = self.base if relative_to is None else self.frame_name(relative_to)
        return known_as(T, Pose(to, self.frame_name(frame)))

    def twist(self, frame: str, q: Positions | None = None, qd: ExprLike | None = None) -> Expr:
        """The body twist (6,) of a frame: its velocity relative to the base, in its own axes. Raises ModelError for an
        unknown frame.
        """
        at = self.frame(frame)
        if at.segment < 0:
            return Constant(np.zeros(6))
        V = AdjointAction(at.T, self.twists(q, qd)[at.segment], inverse=True)
        return known_as(V, Twist(self.frame_name(frame)))
