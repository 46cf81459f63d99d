"""Mechanisms: a kinematic tree with loop constraints, its energies, its system of equations, and its animation."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..checks import listed, short
from ..errors import ModelError
from ..expr import Expr, State
from ..expr.fields import ExprLike
from ..expr.operations.soft import Asked
from ..expr.transformations.rate import rates_by_name
from ..system import System
from .algorithms.closed_loops import redundant_rows
from .algorithms.momentum import kinetic_energy, potential_energy, spring_energy
from .bodies import SpatialInertia
from .drives import Drive
from .editing import edits
from .editing.reroot import rerooted
from .kinematic_tree import KinematicTree, Positions
from .links_in_view import links_in_view
from .mechanism_system import inverse_system_of, system_of
from .tree import Link

if TYPE_CHECKING:
    from ..view import Body


class Mechanism(KinematicTree):
    """Bodies on joints, as a kinematic tree, on a base at rest under uniform gravity.

    A floating base is a link on a `Free` joint. Links on `Fixed` joints are merged with their parents; their frames
    remain available.

    **Velocities** are one vector qd (n,), the degrees of freedom of the joints in the order of `joints`: m/s for
    translations, rad/s for rotations, the body rate w of a ball joint, the body twist [v; w] of a free joint.
    **Positions** are one vector q with the coordinates of all joints except ball and free joints; each of those has a
    separate element of SO(3) or SE(3). Functions accept positions as the vector, or as a mapping {"q": vector, "name of
    the joint": element}. Joints that mimic others have neither positions nor velocities.

    Args:
        links: one or more, in any order; see `Link`.
        gravity: acceleration (3,) in the base's axes, m/s2; numbers or an expression.
        keep: names of `Fixed` joints that are not merged, so that their joint wrenches are available.
        notes: remarks on the model, such as elements of a file that are ignored.
        loops: loop constraints between frames, in addition to the tree; see `loops`. `forward_dynamics` and `system`
            include them.
        loop_metric: the norm of rows of loop constraints, which determines redundant rows and the minimum-norm
            constraint wrenches.
        driven: names of the joints with motors. By default all, except free and mimic joints, and passive joints, whose
            drive has a spring and no effort.
        shapes: shapes of the base in its frame, for `solution.show`, including fixed objects such as a table.
        collision: the solids of the base for `clearances`; None: its shapes.
        base_body: the body of the base. It has an effect only once the base moves, after `attach` or `rerooted`.
    Attributes:
        links, gravity, driven, loops, loop_metric, base, shapes, collision, base_body: the arguments, with each link
            after its parent and gravity as an expression.
        segments: the links after merging; see `Segment`.
        frames: all frames by name, with the segment of each.
        dofs: n.
        q, qd: the states of `system`, and the default positions and velocities of functions.
    Raises:
        ModelError: links that are not a tree; see `sorted_links` and `segments_of`.
        ShapeError: gravity is not of shape (3,).
    Example: `Mechanism([Link(joints.Free("trunk"), body, tx.pose())]).system()`.
    """

    @functools.cached_property
    def redundant_closures(self) -> int:
        """The number of redundant rows of loop constraints at a random configuration."""
        return redundant_rows(self) if self.loops else 0

    @functools.cached_property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the model, for example elements of a file that are ignored."""
        notes = [*self._notes]
        if self.base_body is not None:
            notes.append(f"the mass of {self.base!r}, which has no effect while it does not move")
        if self.redundant_closures:
            rows = sum(loop.rows for loop in self.loops)
            notes.append(
                f"{self.redundant_closures} of {rows} loop constraints are redundant: "
                "constraint wrenches are the minimum-norm solution"
            )
        return tuple(notes)

    def replace(self, *, drives: Mapping[str, Drive] | None = None, **changes: Any) -> Mechanism:
        """A copy with other drives, or with some of the constructor's arguments changed.

        `arm.replace(drives={"elbow": Drive(stiffness=5.0)})` adds a spring to a joint of an arm from a file.

        Args:
            drives: drives by joint; each replaces the whole drive of its link.
            changes: arguments of `Mechanism`; others are unchanged.
        Raises: ModelError for an unknown joint or argument, and the errors of the constructor.
        """
        for name in changes.keys() - {"links", *self.arguments}:
            known = ["drives", "links", *self.arguments]
            raise ModelError(f"Mechanism.replace has no argument {name!r}; it takes: {listed(known, name)}")
        if drives and "links" in changes:  # they are passed to the new links
            return self.replace(**changes).replace(drives=drives)
        if not isinstance(drives, Mapping | None):
            raise ModelError(f"Mechanism.replace expects drives by the names of joints, got {short(drives)}")
        joints = {link.joint.name: link for link in self.links}
        for name, drive in (drives or {}).items():
            if name not in joints:
                raise ModelError(f"Mechanism.replace: there is no joint {name!r}; known are {listed(joints, name)}")
            joints[name] = dataclasses.replace(joints[name], drive=drive)
        return Mechanism(**{"links": joints.values(), **self.arguments, **changes})

    def lock(self, positions: Mapping[str, ExprLike]) -> Mechanism:
        """A copy in which some joints, and the joints that mimic them, are fixed at positions.

        Each becomes a `Fixed` joint of the same name, and the bodies on both sides are merged. Its frame is kept. Its
        motor, friction, spring and rotor are removed.

        Args:
            positions: by joint: a number in rad or m, (k,) for several coordinates, a rotation (3, 3) or a pose (4, 4)
                for joints on groups. A position outside of the limits adds a note. Positions may be expressions of
                Parameters.
        Raises:
            ModelError: a joint that is unknown, does not move, or mimics another; a position that is not finite or not
                on the group, or that changes during the motion; a loop constraint between frames that become one body.
            ShapeError: a position of the wrong shape.

        Example:
            `arm.lock({"finger": 0.02})`
        """
        return self.replace(**edits.locked(self, positions))

    def attach(self, other: Mechanism, frame: str | None = None, pose: ExprLike | None = None) -> Mechanism:
        """A copy with another mechanism attached: the base of the other mechanism is fixed at a pose in a frame of this
        one.

        The base of the other mechanism becomes a link of the same name with the body `base_body`, that of the root link
        of a file. Loop constraints, motors, mimic joints and shapes of both are kept. Gravity is that of this
        mechanism. If the frame is the base, the result contains two separate robots.

        Args:
            other: the mechanism that is attached, such as a gripper.
            frame: a frame of this mechanism; its base by default.
            pose: the pose T (4, 4) of the other's base in the frame; the identity by default. It must be constant
                during the motion.
        Raises:
            ModelError: an unknown frame; names that both mechanisms have (see `renamed`); different loop metrics;
                numbers that are not a pose.
            ShapeError: pose is not of shape (4, 4).

        Example:
            `arm.attach(gripper.renamed("left_"), "flange", tx.pose(position=[0.0, 0.0, 0.1]))`
        """
        return self.replace(**edits.attached(self, other, frame, pose))

    def without(self, *names: str) -> Mechanism:
        """A copy without some links and their subtrees. Loop constraints within the removed part are removed as well.

        Args:
            names: names of links, or of the joints that carry them.
        Raises: ModelError for an unknown link; a joint that mimics a removed one; a loop constraint between a removed
            link and a remaining one; and if no link remains.
        """
        return self.replace(**edits.without(self, names))

    def renamed(self, prefix: str) -> Mechanism:
        """A copy in which the names of base, links, joints and loop constraints begin with a prefix. Parameters keep
        their names.

        The states of its system are named after the new joints.

        Raises: ModelError for a prefix that is not a string.
        """
        return self.replace(**edits.renamed(self, prefix))

    def with_inertia(self, bodies: Mapping[str, SpatialInertia | None]) -> Mechanism:
        """A copy with other bodies of some links. `arm.link("hand").body` is the present one, to which a payload may be
        added by +.

        Args:
            bodies: bodies by link, in the frame of the link; None for a link without mass. That of the base has no
                effect while the base does not move.
        Raises: ModelError for an unknown link, or a value that is not a `SpatialInertia`.
        """
        return self.replace(**edits.with_inertia(self, bodies))

    def rerooted(self, frame: str) -> Mechanism:
        """The same mechanism with another link as root: the joints between the new and the old root are reversed.

        - If the old root is on a `Free` joint, that joint carries the new root: the motions are the same, with other
          coordinates. The same holds for the only link on the base, if it is on a `Fixed` joint.
        - Else the base becomes a link with the body `base_body`, and the new root is fixed to a new base, "world".
          Gravity keeps its numbers, which are then in the axes of the new root.

        Reversed joints keep their names, positions, limits and drives; a position on a group becomes its inverse. All
        frames are kept. A reversed joint whose mount is not the identity has a frame "<link> at <joint>".

        Args:
            frame: the new root: a link, or the joint that carries it.
        Raises: ModelError for an unknown frame; a joint on the path that cannot be reversed, such as a `Planar` joint;
            a ball or free joint whose drive acts in axes of its child.
        """
        return self.replace(**rerooted(self, frame))

    def to_urdf(self, name: str = "robot", *, leave_out: Collection[str] = ()) -> str:
        """The mechanism as the text of a URDF file. `load` reads the same mechanism back.

        Numbers are written with full precision, those of Parameters with their default values. Features that URDF
        cannot express raise an error: loop constraints, springs, armatures, gears, gravity other than (0, 0, -9.81),
        joints without a motor, meshes without a file, and joints that are `Helical` or `Cylindrical`.

        Args:
            name: the name of the robot, not of a file.
            leave_out: kinds of features to omit, such as ["armature", "gravity"]; the error message names them.
        Raises: ModelError for a feature that cannot be written, with its joints or links; numbers that are not known.

        Example:
            `pathlib.Path("arm.urdf").write_text(arm.to_urdf("arm"))`
        """
        from .writers.urdf_text import urdf_text

        return urdf_text(self, name, leave_out)

    def to_mjcf(self, name: str = "robot", *, leave_out: Collection[str] = ()) -> str:
        """The mechanism as the text of an MJCF file, for MuJoCo. `load` reads the same mechanism back.

        As `to_urdf`, with the additional features of MJCF: springs, armatures, gears, gravity, motors of some joints,
        and loop constraints of points and poses. MJCF cannot express speed limits, `AxisLoop`, `Planar`, `Helical` or
        `Cylindrical` joints, bodies without mass, or names of `Fixed` joints. The base is the world, with a site of the
        base's name, or with a body of this name that has the mass of the base. Geoms of the collision geometry
        (`Link.collision`) collide; other shapes do not. Meshes need a file in the format STL or OBJ.

        Args:
            name, leave_out: as for `to_urdf`.
        Raises: ModelError as `to_urdf`; a moving link without mass, or with an inertia that MuJoCo refuses; a free
            joint that is not on the base.
        """
        from .writers.mjcf_text import MjcfText

        return MjcfText(self, name, leave_out).text

    def _knowing(self, rates: Mapping[str, Expr]) -> Mechanism:
        """A copy whose bodies know the rates of the states that they depend on."""
        links = [
            link if link.body is None else dataclasses.replace(link, body=link.body.with_rates(rates))
            for link in self.links
        ]
        return self.replace(links=links)

    def energy(self, q: Positions | None = None, qd: ExprLike | None = None) -> Expr:
        """The total energy $T + U$ (), J: the sum of `energies`.

        Only motors, friction, external forces and masses that move in bodies change it.

        Raises: the errors of `energies`.
        """
        return functools.reduce(operator.add, self.energies(q, qd).values())

    def energies(self, q: Positions | None = None, qd: ExprLike | None = None) -> dict[str, Expr]:
        """The parts of the energy, each (), J, by name: "kinetic", "gravity" and "springs".

        "gravity" is zero if all masses are at the base's origin, "springs" if all springs of the drives are at their
        rest positions.

        Raises: ShapeError; ModelError for bodies with moving masses whose rates are unknown.
        """
        parts = (kinetic_energy(self, q, qd), potential_energy(self, q), spring_energy(self, q))
        return dict(zip(("kinetic", "gravity", "springs"), parts, strict=True))

    def bodies_in_view(self, xs: Mapping[str, Any], params: Mapping[str, Any]) -> list[Body]:
        """All frames along a motion with the shapes of their links, for `solution.show(bodies=mechanism)`."""
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

        The rate of qd is the forward dynamics under the motors, gears, damping, friction and springs of the links'
        drives. Limits are the bounds of states and controls. Corrections of the system keep the loops closed.

        Args:
            controls: the joints with motors; `driven` by default. Their commands are the Control "tau", one entry for
                each degree of freedom, in the order of the joints. With an empty list there is no control.
            forces: additional forces of the joints (n,), N or N m, such as those of a feedback controller.
            wrenches: external wrenches (6,) by name of frame, in the axes of the frame.
            rates: rates of additional states, such as those that the inertia of a body depends on.
            outputs, constraints: as for `tx.System`, as functions of `q`, `qd` and other leaves. Outputs may also be a
                function f(qdd, tau) that returns them: qdd (n,) are the accelerations of the motion, and tau (n,), N or
                N m, the joint forces of motors, springs, friction and `forces`.
        Raises:
            ModelError: an unknown joint or frame; a mechanism without moving joints; rates of the
                mechanism's own states; unknown rates of states that a body depends on.
            ShapeError: an argument of another shape.
        """
        mechanism = self._knowing(rates_by_name(rates)) if rates else self
        return system_of(mechanism, controls, forces, wrenches, rates, outputs, constraints)

    def inverse_system(
        self,
        *,
        controls: Collection[str] | None = None,
        forces: ExprLike | None = None,
        wrenches: Mapping[str, ExprLike] | None = None,
        outputs: Mapping[str, ExprLike] | Callable[[Expr, Expr], Mapping[str, ExprLike]] | None = None,
        constraints: Asked | Iterable[Asked] | Mapping[str, Asked] = (),
    ) -> System:
        """The mechanism as a `tx.System` with accelerations as controls, for optimal control by inverse dynamics.

        The states are `q` and `qd`; the Control "qdd" (n,) is the rate of qd. The motor forces tau follow from RNEA,

            $gear tau = M(q) qdd + h(q, qd) - forces$ (of springs, damping, friction, wrenches),

        and are the output "tau". Their limits are constraints. Degrees of freedom without a motor, such as the six of a
        floating base, give equality constraints. Rates are linear, and an evaluation is cheaper than one of forward
        dynamics.

        Args:
            controls: the joints that motors drive; `driven` by default.
            forces, wrenches: as for `system`. Contact forces may be controls: see `tx.mechanics.given_forces`.
            outputs, constraints: as for `system`, in addition to those above.
        Raises:
            ModelError: an unknown joint or frame; a mechanism without moving joints, or with loops; a name that the
                system adds itself.
            ShapeError: an argument of another shape.

        Source: Erez, Todorov, Trajectory optimization for domains with contacts using inverse dynamics, IROS (2012).
        """
        return inverse_system_of(self, controls, forces, wrenches, outputs, constraints)


class Chain(Mechanism):
    """Links in series from a base at rest to the tip, under uniform gravity: a `Mechanism` with one branch.

    Args:
        links: one or more, from base to tip; the parent of each is the previous one, and its `parent` is ignored.
        gravity: acceleration (3,) in the base's axes, m/s2; numbers or an expression.
    Raises:
        ModelError: no links, or elements that are not links.
        ShapeError: gravity is not of shape (3,).
    """

    def __init__(self, links: Iterable[Link], gravity: ExprLike = (0.0, 0.0, -9.81)) -> None:
        if not isinstance(links, Iterable):
            raise ModelError(f"Chain expects links made by Link, got {links!r}")
        before: str | None = None
        joined: list[Link] = []
        for link in links:
            # Other objects are refused by the constructor of the mechanism.
            joined.append(dataclasses.replace(link, parent=before) if isinstance(link, Link) else link)
            before = getattr(link, "name", None)
        super().__init__(joined, gravity)
