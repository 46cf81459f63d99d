"""Branches of a tree: the effect of each of their degrees of freedom on the forces of the others.

`derivatives.py` has the equations and the sources.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...expr import Concat, Constant, Cross, Expr, Stack, Where
from ...expr.lie import Adjoint, AdjointAction, AdjointDual, CoadjointAction, Compose, angular, linear, twist
from ..tree import Segment
from .motion import ZERO, acceleration_of_base
from .spread import Spread

NOTHING = Constant(np.zeros(6))


@dataclasses.dataclass(frozen=True)
class Freedom:
    """The effect of a unit of one degree of freedom. Six-vectors are in the frame of the first segment of its tree."""

    place: int  # index of its segment
    entry: int  # index among the velocities
    ratio: float  # of a mimic joint
    S: Expr
    moved: tuple[
        Expr, Expr
    ]  # with respect to position: the argument of I (6,), and the angular part of the argument of B (3,)
    hastened: tuple[Expr, Expr]  # the same with respect to velocity


class MovingFrame(NamedTuple):
    """The pose of a segment in the common frame, its twist and its acceleration."""

    T: Expr
    V: Expr
    A: Expr


class ForceColumns(NamedTuple):
    """Derivatives of the forces of a branch with respect to its degrees of freedom, and the corresponding wrenches on
    what it stands on, a row for each.
    """

    forces: Expr  # (N, N)
    wrenches: Expr  # (N, 6)


class Branch:
    """Segments of a tree that move, and the wrenches on them.

    Args:
        segments: by index, those before others first.
        transforms: the pose of each in the segment before it.
        qd, qdd: velocities and accelerations, of which the entries are the segments' freedoms.
        base: what segments without a segment before them stand on; for the base of a tree its gravity (3,).
        pushes: the external wrench on each segment, or None.

    Attributes:
        moved, hastened: the change of the acceleration of the first segment of a tree per unit of a degree of freedom
            of its joint: by position, by velocity.
    """

    def __init__(
        self,
        segments: Mapping[int, Segment],
        transforms: Mapping[int, Expr],
        qd: Expr,
        qdd: Expr,
        base: MovingFrame | Expr,
        pushes: Mapping[int, Expr | None],
    ) -> None:
        self._segments, self._qd, self._qdd = segments, qd, qdd
        self.freedoms = list[Freedom]()
        self.moved, self.hastened = dict[int, Expr](), dict[int, Expr]()
        self.moving = dict[int, MovingFrame]()
        for i, segment in segments.items():
            before = self.moving[segment.before] if segment.before >= 0 else base
            make = self._next if isinstance(before, MovingFrame) else self._first
            self.moving[i] = make(i, segment, transforms[i], before)  # type: ignore[arg-type]
        self._spreads = {i: Spread.of(segments[i], frame.T, frame.V) for i, frame in self.moving.items()}
        self._F = dict[int, Expr]()
        for i, frame in self.moving.items():
            spread, inner = self._spreads[i], segments[i].inner_motion
            F = spread.inertia(frame.A) + AdjointDual(frame.V, spread.inertia(frame.V))
            if inner is not None:
                w = frame.T[:3, :3].T @ angular(frame.V)
                F = F + CoadjointAction(frame.T, inner.wrench(w))
            pushed = pushes[i]
            self._F[i] = F if pushed is None else F - CoadjointAction(frame.T, pushed)

    # ---- passes ------------------------------------------------------------------------------------------------------

    def _first(self, i: int, segment: Segment, T: Expr, gravity: Expr) -> MovingFrame:
        """A segment on the base, in its own frame, with the velocity of its origin subtracted."""
        V = segment.along(self._qd)
        w, v = angular(V), linear(V)
        up = AdjointAction(T, acceleration_of_base(gravity), inverse=True)
        A = up + twist(linear=Cross(w, v), angular=ZERO) + segment.along(self._qdd)
        for k, a in enumerate(segment.freedoms):
            H = segment.link.joint.motion_subspace[:, k]
            s, r, x = linear(H), angular(H), len(self.freedoms)
            self.moved[x] = twist(linear=Cross(linear(up), r), angular=ZERO)
            self.hastened[x] = twist(linear=Cross(r, v) + Cross(w, s), angular=Cross(w, r))
            self.freedoms.append(Freedom(i, a, segment.ratio, H, (NOTHING, ZERO), (NOTHING, r)))
        return MovingFrame(Constant(np.eye(4)), twist(linear=ZERO, angular=w), A)

    def _next(self, i: int, segment: Segment, T: Expr, before: MovingFrame) -> MovingFrame:
        frame = Compose(before.T, T)
        V, A = before.V, before.A
        motions = [AdjointAction(frame, segment.link.joint.motion_subspace[:, k]) for k in range(len(segment.freedoms))]
        rates = [segment.scaled(self._qd[a]) for a in segment.freedoms]
        for S, rate in zip(motions, rates, strict=True):
            V = V + S * rate
        for S, rate, a in zip(motions, rates, segment.freedoms, strict=True):
            P = Adjoint(before.V, S)
            Q = P if len(motions) == 1 else Adjoint(V, S)  # a single motion column is constant under its own rotation
            moved = Adjoint(before.A, S) + Adjoint(before.V, P), angular(P)
            self.freedoms.append(Freedom(i, a, segment.ratio, S, moved, (P + Q, angular(S))))
            A = A + S * segment.scaled(self._qdd[a]) + Q * rate
        return MovingFrame(frame, V, A)

    def add(self, place: int, spread: Spread, F: Expr) -> None:
        """Add what stands on a segment."""
        self._spreads[place], self._F[place] = self._spreads[place].plus(spread), self._F[place] + F

    def gather(self) -> tuple[Spread, Expr]:
        """Sum the masses and wrenches from the tips to the base; gives those of the first segment."""
        for i in reversed(list(self._segments)):
            if (before := self._segments[i].before) >= 0:
                self.add(before, self._spreads[i], self._F[i])
        first = next(iter(self._segments))
        return self._spreads[first], self._F[first]

    # ---- all pairs of degrees of freedom -----------------------------------------------------------------------------

    def carry(self, place: int) -> NDArray[np.bool_]:
        """Which degrees of freedom move a segment (N,)."""
        return np.array([self._reached[place][freedom.place] for freedom in self.freedoms], bool)

    @functools.cached_property
    def _reached(self) -> dict[int, dict[int, bool]]:
        """Whether a segment is moved by the joint of another one, or is that one."""
        reached = dict[int, dict[int, bool]]()
        for i, segment in self._segments.items():
            before = reached.get(segment.before, {})
            reached[i] = {j: i == j or before.get(j, False) for j in self._segments}
        return reached

    @functools.cached_property
    def _tree(self) -> list[tuple[int, int, Constant]]:
        """For each degree of freedom j: the first degree of freedom of its joint, the end of its subtree, and a mask of
        its ancestors among those before it.

        Branches are stored consecutively, so a subtree is a contiguous range.
        """
        places, subtrees = [freedom.place for freedom in self.freedoms], []
        for place in places:
            first = places.index(place)
            end = first + sum(self._reached[i][place] for i in places)
            subtrees.append((first, end, Constant(self.carry(place)[:first])))
        return subtrees

    @functools.cached_property
    def motions(self) -> Expr:
        """The motion columns S of all degrees of freedom, as rows (N, 6)."""
        return Stack(*(freedom.S for freedom in self.freedoms))

    @functools.cached_property
    def felt(self) -> Expr:
        """I S of all degrees of freedom, as rows (N, 6): the wrench of a unit acceleration."""
        return Stack(*(self._spreads[freedom.place].inertia(freedom.S) for freedom in self.freedoms))

    @functools.cached_property
    def turned(self) -> Expr:
        """The angular parts of B' S of all degrees of freedom, as rows (N, 3)."""
        return Stack(*(self._spreads[freedom.place].coupled_back(freedom.S) for freedom in self.freedoms))

    def by_position(self) -> ForceColumns:
        """The derivatives with respect to positions, without the part of `moved`."""
        return self._columns([freedom.moved for freedom in self.freedoms], self._F)

    def by_velocity(self) -> ForceColumns:
        """The derivatives with respect to velocities, without the part of `hastened`."""
        return self._columns([freedom.hastened for freedom in self.freedoms], None)

    def _columns(self, changes: list[tuple[Expr, Expr]], F: Mapping[int, Expr] | None) -> ForceColumns:
        columns, wrenches = list[Expr](), list[Expr]()
        for freedom, place, (x, b) in zip(self.freedoms, self._tree, changes, strict=True):
            spread, (first, end, _) = self._spreads[freedom.place], place
            carried = spread.inertia(x) + spread.coupled(b)
            if F is not None:
                carried = carried + AdjointDual(freedom.S, F[freedom.place])
            columns.append(self._column(place, self.felt[first:end] @ x + self.turned[first:end] @ b, carried))
            wrenches.append(carried)
        return ForceColumns(Stack(*columns).T, Stack(*wrenches))

    def mass_matrix(self) -> ForceColumns:
        """The derivatives with respect to accelerations, including rotors."""
        columns: list[Expr] = []
        for k, (freedom, place) in enumerate(zip(self.freedoms, self._tree, strict=True)):
            column = self._column(place, self.felt[place[0] : place[1]] @ freedom.S, self.felt[k])
            rotor = self._segments[freedom.place].link.drive.rotor
            columns.append(column if rotor is None else column + rotor * np.eye(len(self.freedoms))[k])
        return ForceColumns(Stack(*columns).T, self.felt)

    def _column(self, place: tuple[int, int, Constant], beyond: Expr, carried: Expr) -> Expr:
        """One column of joint forces (N,): `beyond` for the subtree of a degree of freedom, and for its ancestors the
        force of the wrench `carried`.
        """
        first, end, on_path = place
        parts = [beyond, Constant(np.zeros(len(self.freedoms) - end))]
        if first:
            parts.insert(0, Where(on_path, self.motions[:first] @ carried, Constant(np.zeros(first))))
        return Concat(*parts)
