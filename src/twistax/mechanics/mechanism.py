"""Mechanisms: a tree of links on a base, its coordinates, its frames and their kinematics."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import listed, short
from ..errors import ModelError
from ..expr import Constant, Control, Expr, State
from ..expr.fields import ExprLike
from ..expr.lie import AdjointAction, Compose, Inverse
from ..expr.operations.soft import Asked
from .arguments import of_shape
from .bodies import SpatialInertia
from .drives import Drive
from .loops import Loop, Metric, check_loops
from .tree import Frame, Link, Segment, segments_of, shapes_of, sorted_links

if TYPE_CHECKING:
    from ..system import System
    from ..view import Body, Shape

#: Positions: a vector, or a mapping with a vector "q" and an element for each joint on a group.
Positions = ExprLike | Mapping[str, ExprLike]


class Mechanism:
    """Bodies on joints, in the shape of a tree, on a base at rest under uniform gravity.

    A floating base is a link on a `Free` joint. Links on `Fixed` joints are merged with what they sit on; their frames
    stay.

    **Velocities** are one vector qd (n,), the freedoms of the joints in the order of `joints`: m/s along slides, rad/s
    about axes, w of a ball, the body twist [v; w] of a free joint. **Positions** are one vector q with the coordinates
    of all joints but balls and free ones; each of those has its own element of SO(3) or SE(3). A function takes them as
    the vector, or as a mapping {"q": vector, "name of the joint": element}. Joints that mimic others have neither.

    Args:
        links: one or more, in any order; see `Link`.
        gravity: (3,) in the base's axes, m/s2; numbers or an expression.
        base: name of the base's frame.
        keep: names of `Fixed` joints that are not merged, so that the wrench they carry can be asked for.
        notes: what else there is to say about the model, such as what a file has and nobody uses.
        loops: closures of frames beyond the tree, see `loops`; they act in `forward_dynamics` and in `system`.
        loop_metric: how rows of loops are compared: which say what others say, and which wrenches are the shortest.
        driven: names of the joints that motors drive. Unless given all but free ones, followers, and those whose drive
            has a spring and no effort: passive joints.
        shapes: what the base looks like in its frame, for `solution.show`; what else stands still, such as a table.
    Attributes:
        links, gravity, driven, loops, loop_metric, base, shapes: as given, the links each after its parent; gravity as
            an expression.
        segments: what is left after merging; see `Segment`.
        frames: the names of all frames, with the segment each is fixed to.
        dofs: n.
        q, qd: the states of `system`, and what functions take unless other positions and velocities are given.
    Raises:
        ModelError: links that are no tree; see `sorted_links` and `segments_of`.
        ShapeError: gravity is not of shape (3,).
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
        self.base, self.shapes = base, shapes_of(name, shapes)
        self.dofs = 1 + max((max(s.freedoms, default=-1) for s in self.segments), default=-1)
        self.loops, self.loop_metric = tuple(loops), loop_metric
        driven = None if driven is None else tuple(driven)
        #: What `replace` gives the constructor again, beside the links.
        self._given: dict[str, Any] = {
            "gravity": self.gravity,
            "base": base,
            "keep": keep,
            "notes": self._notes,
            "driven": driven,
        }
        self._given |= {"driven": driven, "loops": self.loops, "loop_metric": loop_metric, "shapes": self.shapes}
        if driven is None:
            driven = [s.link.joint.name for s in self.segments if s.moves_by_motor]
        self.driven = tuple(driven)
        self.freedoms(self.driven)
        check_loops(self.loops, self.loop_metric, lambda name: self.frame(name).segment)

    @functools.cached_property
    def redundant_closures(self) -> int:
        """The number of closure rows that follow from others at a random configuration."""
        from .closed_loops import redundant_rows

        return redundant_rows(self) if self.loops else 0

    @functools.cached_property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the model, for example what a file has that is not used."""
        if not self.redundant_closures:
            return self._notes
        rows = sum(loop.rows for loop in self.loops)
        return (
            *self._notes,
            f"the loops say {self.redundant_closures} of {rows} things twice: what they carry is the shortest solution",
        )

    def check_masses(self, owner: str) -> None:
        """Raise ModelError for a joint that moves no mass, so that its acceleration is not determined."""
        heavy = [segment.body is not None or segment.link.drive.rotor is not None for segment in self.segments]
        for i in reversed(range(len(self.segments))):
            if not heavy[i] and self.segments[i].link.joint.dofs:
                raise ModelError(
                    f"{owner}: joint {self.segments[i].link.joint.name!r} moves no mass, so its acceleration is not "
                    "determined.\n  fix: give a body to its link or to one beyond it, or the joint an armature"
                )
            if self.segments[i].before >= 0:
                heavy[self.segments[i].before] |= heavy[i]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self.links)} links, {self.dofs} freedoms)"

    def replace(self, *, drives: Mapping[str, Drive] | None = None, **changes: Any) -> Mechanism:
        """A copy with other drives, or with some of the constructor's arguments changed.

        `arm.replace(drives={"elbow": Drive(stiffness=5.0)})` puts a spring into a joint of an arm from a file.

        Args:
            drives: by joint, each in place of the whole drive that its link has.
            changes: arguments of `Mechanism`; what is not named stays.
        Raises: ModelError for a joint or an argument that is not known; as the constructor.
        """
        for name in changes.keys() - {"links", *self._given}:
            known = ["drives", "links", *self._given]
            raise ModelError(f"Mechanism.replace has no argument {name!r}; it takes: {listed(known, name)}")
        if drives and "links" in changes:  # they go into the new ones
            return self.replace(**changes).replace(drives=drives)
        joints = {link.joint.name: link for link in self.links}
        for name, drive in (drives or {}).items():
            if name not in joints:
                raise ModelError(f"Mechanism.replace: there is no joint {name!r}; there are: {listed(joints, name)}")
            joints[name] = dataclasses.replace(joints[name], drive=drive)
        return Mechanism(**{"links": joints.values(), **self._given, **changes})

    @functools.cached_property
    def bodies(self) -> dict[int, SpatialInertia]:
        """The body of every segment that has mass, with all that is fixed to it, by the index of the segment."""
        return {i: segment.body for i, segment in enumerate(self.segments) if segment.body is not None}

    # ---- coordinates -------------------------------------------------------------------------------------------------

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the joints that move, in the order of the velocities; followers have their leader's entries."""
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
        """The position vector "q" as a State with the limits of the joints; a mapping where joints are on groups."""
        elements: dict[str, Any] = {name: segment.link.joint.position for name, segment in self._grouped.items()}
        if not self._width:
            return elements
        low, high = self._bounds(lambda drive: (drive.lower, drive.upper), by_freedom=False)
        q = State("q", (self._width,), min=low, max=high)
        return {"q": q, **elements} if elements else q

    @functools.cached_property
    def qd(self) -> State:
        """The velocities "qd" (n,) as a State, with the limits of the joints."""
        low, high = self._bounds(lambda d: (None if d.speed is None else -d.speed, d.speed), by_freedom=True)
        return State("qd", (self.dofs,), min=low, max=high)

    def motors(self, joints: Collection[str]) -> Control:
        """The forces "tau" of the motors of some joints as a Control, with their limits; in the joints' order."""
        at = self.freedoms(joints)
        low, high = self._bounds(lambda drive: drive.efforts, by_freedom=True)
        return Control("tau", (len(at),), min=None if low is None else low[at], max=None if high is None else high[at])

    def _bounds(self, limits: Any, *, by_freedom: bool) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The limits of all leaders in one vector each; None where no joint has one."""
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
        """The entries of the velocities that belong to the joints named, each once. Raises ModelError."""
        entries: list[int] = []
        for name in [joints] if isinstance(joints, str) else joints:
            entries += [i for i in self.segment_of(name).freedoms if i not in entries]
        return entries

    def segment_of(self, joint: str) -> Segment:
        """The segment that a joint carries. Raises ModelError for an unknown name, or a merged joint."""
        for segment in self.segments:
            if segment.link.joint.name == joint:
                return segment
        raise ModelError(
            f"no joint {short(joint)} moves here; known are {listed(self.joints, joint)}.\n"
            "  a Fixed joint is merged with what it sits on, unless it is named in keep="
        )

    def coordinates(self, owner: str, name: str, value: ExprLike | None) -> Expr:
        """The argument `name` of `owner`, one entry a freedom (n,); qd itself where None. Raises ShapeError."""
        hint = "one entry for each freedom; of a chain one entry for each link, from base to tip"
        return self.qd if value is None else of_shape(owner, name, value, (self.dofs,), hint)

    def positions(self, owner: str, q: Positions | None) -> list[Expr]:
        """The position of the joint of every segment.

        Raises:
            ShapeError: a vector of another length, an element of another shape.
            ModelError: elements of joints on groups that are missing, or others that are not known.
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
        """H qd (6,): the twist of a segment's joint for velocities (n,), or its part of accelerations, in the segment's
        frame.
        """
        H = segment.link.joint.motion_subspace
        if not segment.freedoms:
            return Constant(np.zeros(6))
        if len(segment.freedoms) == 1:
            return H[:, 0] * segment.scaled(velocities[segment.freedoms[0]])
        return H @ velocities[segment.freedoms[0] : segment.freedoms[-1] + 1]

    # ---- kinematics --------------------------------------------------------------------------------------------------

    def frame(self, name: str) -> Frame:
        """A frame by the name of its link, or of the joint that carries the link. Raises ModelError."""
        if name in self.frames:
            return self.frames[name]
        for link in self.links:
            if link.joint.name == name:
                return self.frames[link.name]
        raise ModelError(f"there is no frame {short(name)}; known are {listed(self.frames, name)}")

    def transforms(self, q: Positions | None = None) -> list[Expr]:
        """T (4, 4) of each segment in the segment before, or in the base. Raises ShapeError."""
        places = self.positions(f"{type(self).__name__}.transforms", q)
        return [segment.link.transform(place) for segment, place in zip(self.segments, places, strict=True)]

    def poses(self, q: Positions | None = None) -> list[Expr]:
        """T (4, 4) of each segment in the base. Raises ShapeError."""
        poses: list[Expr] = []
        for segment, T in zip(self.segments, self.transforms(q), strict=True):
            poses.append(T if segment.before < 0 else Compose(poses[segment.before], T))
        return poses

    def twists(self, q: Positions | None = None, qd: ExprLike | None = None) -> list[Expr]:
        """V (6,) of each segment, in its frame: $V_i = Ad_T^-1 V_before + H qd_i$. Raises ShapeError."""
        rates = self.coordinates(f"{type(self).__name__}.twists", "qd", qd)
        twists: list[Expr] = []
        for segment, T in zip(self.segments, self.transforms(q), strict=True):
            V, before = self.along(segment, rates), segment.before
            twists.append(V if before < 0 else AdjointAction(T, twists[before], inverse=True) + V)
        return twists

    def pose(self, frame: str, q: Positions | None = None, *, relative_to: str | None = None) -> Expr:
        """T (4, 4): maps coordinates of a frame to those of the base, or of another frame. Raises ModelError."""
        at = self.frame(frame)
        T = at.T if at.segment < 0 else Compose(self.poses(q)[at.segment], at.T)
        return T if relative_to is None else Compose(Inverse(self.pose(relative_to, q)), T)

    def twist(self, frame: str, q: Positions | None = None, qd: ExprLike | None = None) -> Expr:
        """The body twist (6,) of a frame: its velocity seen from the base, in its own axes. Raises ModelError."""
        at = self.frame(frame)
        if at.segment < 0:
            return Constant(np.zeros(6))
        return AdjointAction(at.T, self.twists(q, qd)[at.segment], inverse=True)

    def energy(self, q: Positions | None = None, qd: ExprLike | None = None) -> Expr:
        """$T + U$ (), J: the sum of `energies`.

        It changes by motors, friction, outer forces and masses that move in bodies, and by nothing else.

        Raises: as `energies`.
        """
        return functools.reduce(operator.add, self.energies(q, qd).values())

    def energies(self, q: Positions | None = None, qd: ExprLike | None = None) -> dict[str, Expr]:
        """The parts of the energy, each (), J, by name: "kinetic", "gravity" and "springs".

        "gravity" is zero for masses at the base, "springs" where all springs of the drives are at rest.

        Raises: ShapeError; ModelError for bodies with masses that move by rates that are not known.
        """
        from .momentum import kinetic_energy, potential_energy, spring_energy

        parts = (kinetic_energy(self, q, qd), potential_energy(self, q), spring_energy(self, q))
        return dict(zip(("kinetic", "gravity", "springs"), parts, strict=True))

    def bodies_in_view(self, xs: Mapping[str, Any], params: Mapping[str, Any]) -> list[Body]:
        """All frames along a motion with the shapes of their links, for `solution.show(bodies=mechanism)`."""
        from .links_in_view import links_in_view

        return links_in_view(self, xs, params)

    def system(
        self,
        *,
        controls: Collection[str] | None = None,
        forces: ExprLike | None = None,
        wrenches: Mapping[str, ExprLike] | None = None,
        rates: Mapping[State | str, ExprLike] | None = None,
        outputs: Mapping[str, ExprLike] | Callable[[Expr, Expr], Mapping[str, ExprLike]] | None = None,
        constraints: Asked | Iterable[Asked] | Mapping[str, Asked] = (),
    ) -> System:
        """The mechanism as a `tx.System`, with the states `q` and `qd`.

        The rate of qd is the forward dynamics under motors, gears, damping, friction and springs of the links' drives.
        Limits are the bounds of states and controls. The corrections close the loops of the mechanism.

        Args:
            controls: the joints that motors drive; `driven` unless given. Their commands are the Control
                "tau", one entry a freedom, in the order of the joints named. None named, none made.
            forces: further forces of the joints (n,), N or N m, such as those of a feedback.
            wrenches: what acts on the mechanism from outside, by frame.
            rates: of further states, such as those that the inertia of a body depends on.
            outputs, constraints: as for `tx.System`; of `q` and `qd`, or anything else. Outputs may be a function
                f(qdd, tau) that gives them: of the accelerations (n,) of the motion, and of all that motors, springs,
                friction and `forces` exert on the joints (n,), N or N m.
        Raises:
            ModelError: a joint or frame that is not known; a mechanism in which nothing moves; rates of the
                mechanism's own states, or of states that a body depends on and that are not known.
            ShapeError: an argument of another shape.
        """
        from .mechanism_system import system_of

        return system_of(self, controls, forces, wrenches, rates, outputs, constraints)


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
