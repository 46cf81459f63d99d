"""Mechanisms: a kinematic tree with loops, its energies, its system of equations, and a picture of it."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..checks import listed
from ..errors import ModelError
from ..expr import Expr, State
from ..expr.fields import ExprLike
from ..expr.operations.soft import Asked
from ..expr.transformations.rate import rates_by_name
from ..system import System
from .algorithms.closed_loops import redundant_rows
from .algorithms.momentum import kinetic_energy, potential_energy, spring_energy
from .drives import Drive
from .kinematic_tree import KinematicTree, Positions
from .links_in_view import links_in_view
from .mechanism_system import inverse_system_of, system_of
from .tree import Link

if TYPE_CHECKING:
    from ..view import Body


class Mechanism(KinematicTree):
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

    @functools.cached_property
    def redundant_closures(self) -> int:
        """The number of closure rows that follow from others at a random configuration."""
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

    def replace(self, *, drives: Mapping[str, Drive] | None = None, **changes: Any) -> Mechanism:
        """A copy with other drives, or with some of the constructor's arguments changed.

        `arm.replace(drives={"elbow": Drive(stiffness=5.0)})` puts a spring into a joint of an arm from a file.

        Args:
            drives: by joint, each in place of the whole drive that its link has.
            changes: arguments of `Mechanism`; what is not named stays.
        Raises: ModelError for a joint or an argument that is not known; as the constructor.
        """
        for name in changes.keys() - {"links", *self._arguments}:
            known = ["drives", "links", *self._arguments]
            raise ModelError(f"Mechanism.replace has no argument {name!r}; it takes: {listed(known, name)}")
        if drives and "links" in changes:  # they go into the new ones
            return self.replace(**changes).replace(drives=drives)
        joints = {link.joint.name: link for link in self.links}
        for name, drive in (drives or {}).items():
            if name not in joints:
                raise ModelError(f"Mechanism.replace: there is no joint {name!r}; there are: {listed(joints, name)}")
            joints[name] = dataclasses.replace(joints[name], drive=drive)
        return Mechanism(**{"links": joints.values(), **self._arguments, **changes})

    def _knowing(self, rates: Mapping[str, Expr]) -> Mechanism:
        """A copy whose bodies have the rates of the states that they depend on."""
        links = [
            link if link.body is None else dataclasses.replace(link, body=link.body.with_rates(rates))
            for link in self.links
        ]
        return self.replace(links=links)

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
        """The mechanism as a `tx.System` with accelerations for controls, for optimal control by inverse dynamics.

        The states are `q` and `qd`, the Control "qdd" (n,) is the rate of qd. What motors have to do follows by RNEA,

            $gear tau = M(q) qdd + h(q, qd) - forces$ of springs, damping, friction, wrenches,

        and is the output "tau". Its limits are constraints, and freedoms without a motor, such as the six of a floating
        base, are equalities. Rates are linear, and an evaluation is cheaper than one of forward dynamics.

        Args:
            controls: the joints that motors drive; `driven` unless given.
            forces, wrenches: as for `system`. Contact forces may be controls: `tx.mechanics.given_forces`.
            outputs, constraints: as for `system`, beside those above.
        Raises:
            ModelError: a joint or frame that is not known; nothing moves; loops; a name that is taken.
            ShapeError: an argument of another shape.

        Source: Erez, Todorov, Trajectory optimization for domains with contacts using inverse dynamics, IROS (2012).
        """
        return inverse_system_of(self, controls, forces, wrenches, outputs, constraints)


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
