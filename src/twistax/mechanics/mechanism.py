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
from .mechanism_system import system_of
from .tree import Link

if TYPE_CHECKING:
    from ..view import Body


class Mechanism(KinematicTree):
    """Bodies on joints, as a kinematic tree, on a base at rest under uniform gravity.

    A floating base is a link on a `Free` joint. Links on `Fixed` joints are merged with their parents; their frames
    remain available.

    **Velocities** are one vector qd (n,), the freedoms of the joints in the order of `joints`: m/s along slides, rad/s
    about axes, w of a ball, the body twist [v; w] of a free joint. **Positions** are one vector q with the coordinates
    of all joints but balls and free ones; each of those has its own element of SO(3) or SE(3). A function takes them as
    the vector, or as a mapping {"q": vector, "name of the joint": element}. Joints that mimic others have neither.

    Args:
        links: one or more, in any order; see `Link`.
        gravity: (3,) in the base's axes, m/s2; numbers or an expression.
        base: name of the base's frame.
        keep: names of `Fixed` joints that are not merged, so that their joint wrenches are available.
        notes: remarks on the model, such as elements of a file that are not used.
        loops: closures of frames beyond the tree, see `loops`; they act in `forward_dynamics` and in `system`.
        loop_metric: the norm of closure rows, which determines redundant rows and the smallest constraint wrenches.
        driven: names of the joints with motors. By default all but free and mimic joints, and those whose drive
            has a spring and no effort: passive joints.
        shapes: shapes of the base in its frame, for `solution.show`, and of fixed objects, such as a table.
    Attributes:
        links, gravity, driven, loops, loop_metric, base, shapes: the arguments, with each link after its parent and
            gravity as an expression.
        segments: the links after merging; see `Segment`.
        frames: the names of all frames, with the segment of each.
        dofs: n.
        q, qd: the states of `system`, and the default positions and velocities of functions.
    Raises:
        ModelError: links that are not a tree; see `sorted_links` and `segments_of`.
        ShapeError: gravity is not of shape (3,).
    """

    @functools.cached_property
    def redundant_closures(self) -> int:
        """The number of closure rows that follow from others at a random configuration."""
        return redundant_rows(self) if self.loops else 0

    @functools.cached_property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the model, for example elements of a file that are not used."""
        if not self.redundant_closures:
            return self._notes
        rows = sum(loop.rows for loop in self.loops)
        return (
            *self._notes,
            f"the loops say {self.redundant_closures} of {rows} things twice: what they carry is the shortest solution",
        )

    def replace(self, *, drives: Mapping[str, Drive] | None = None, **changes: Any) -> Mechanism:
        """A copy with other drives, or with some of the constructor's arguments changed.

        `arm.replace(drives={"elbow": Drive(stiffness=5.0)})` adds a spring to a joint of an arm from a file.

        Args:
            drives: by joint; each replaces the whole drive of its link.
            changes: arguments of `Mechanism`; others are unchanged.
        Raises: ModelError for an unknown joint or argument, and the errors of the constructor.
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

        It changes only by motors, friction, external forces and masses that move in bodies.

        Raises: as `energies`.
        """
        return functools.reduce(operator.add, self.energies(q, qd).values())

    def energies(self, q: Positions | None = None, qd: ExprLike | None = None) -> dict[str, Expr]:
        """The parts of the energy, each (), J, by name: "kinetic", "gravity" and "springs".

        "gravity" is zero for masses at the base, "springs" where all springs of the drives are at rest.

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

        The rate of qd is the forward dynamics under motors, gears, damping, friction and springs of the links' drives.
        Limits are the bounds of states and controls. The corrections close the loops of the mechanism.

        Args:
            controls: the joints with motors; `driven` by default. Their commands are the Control
                "tau", one entry for each freedom, in the order of the joints. An empty list makes no control.
            forces: further forces of the joints (n,), N or N m, such as those of a feedback.
            wrenches: external wrenches, by frame.
            rates: of further states, such as those that the inertia of a body depends on.
            outputs, constraints: as for `tx.System`, of `q` and `qd`, or other expressions. Outputs may be a function
                f(qdd, tau) that returns them, of the accelerations (n,) of the motion, and of the joint forces (n,), N
                or N m, of motors, springs, friction and `forces`.
        Raises:
            ModelError: an unknown joint or frame; a mechanism without moving joints; rates of the
                mechanism's own states; unknown rates of states that a body depends on.
            ShapeError: an argument of another shape.
        """
        mechanism = self._knowing(rates_by_name(rates)) if rates else self
        return system_of(mechanism, controls, forces, wrenches, rates, outputs, constraints)


class Chain(Mechanism):
    """Links in series from a base at rest to the tip, under uniform gravity: a `Mechanism` with one branch.

    Args:
        links: one or more, from base to tip; the parent of each is the previous one, whatever its `parent` is.
        gravity: (3,) in the base's axes, m/s2; numbers or an expression.
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
            # What is no link is refused with the rest.
            joined.append(dataclasses.replace(link, parent=before) if isinstance(link, Link) else link)
            before = getattr(link, "name", None)
        super().__init__(joined, gravity)
