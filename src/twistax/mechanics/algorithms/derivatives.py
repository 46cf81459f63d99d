"""Derivatives of the dynamics with respect to positions, velocities and accelerations or forces, in the tangent space.

Positions are varied by right perturbations: a perturbation d of joint j moves everything beyond it by the twist S_j d,
where S = Ad_T H is the motion column of the joint. Let V and A be the twists and accelerations of the segments, let
`before` be the segment before j, and

    S'_j = V_j x S_j        P_j = V_before x S_j        P'_j = A_before x S_j + V_before x P_j,

then in the perturbed segments V_i changes by P_j, and A_i by P'_j - V_i x P_j, as seen in axes that move with them.
Summed from the tips to the base, with I and B of `spread.py` and F the wrench of the joint,

    d tau_i / d q_j   = S_i . (I_i P'_j + B_i P_j)                for i = j and beyond,
                      = S_i . (I_j P'_j + B_j P_j + S_j x* F_j)   for i before j,
    d tau_i / d qd_j  = S_i . (I_k (P_j + S'_j) + B_k S_j)        with k the later one of i and j,
    d tau_i / d qdd_j = S_i . I_k S_j.

All quantities are expressed in a frame that coincides with the first segment of a tree and moves at its constant linear
velocity, which is permitted because inertial frames are equivalent. The motion of the first joint enters through the
acceleration and the angular velocity of its segment. The derivatives of accelerations are -M^-1 times those of the
forces; if the first joint is free, the part due to its acceleration needs no M.

Sources: J. Carpentier, N. Mansard, Analytical derivatives of rigid body dynamics algorithms, RSS (2018); S. Singh,
R. Russell, P. Wensing, Efficient analytical derivatives of rigid-body dynamics using spatial vector algebra, IEEE RA-L
(2022), there [w; v].
"""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from ...errors import ModelError
from ...expr import Concat, Constant, Cross, Expr, Hstack, InverseFactor, InversePositive, Stack, Where
from ...expr.fields import ExprLike
from ...expr.lie import Adjoint, AdjointAction, AdjointDual, CoadjointAction, Compose, angular, linear, twist
from ..kinematic_tree import KinematicTree, Positions
from ..tree import Segment
from .dynamics import Wrenches, checked, outside
from .forward_dynamics import forward_dynamics
from .motion import ZERO, acceleration_of_base
from .rotors import turning_by_velocities
from .spread import Spread

_NOTHING = Constant(np.zeros(6))


class ForceDerivatives(NamedTuple):
    """Derivatives of joint forces (n,) with respect to positions (right perturbations),
    velocities and accelerations.
    """

    q: Expr
    qd: Expr
    qdd: Expr


class AccelerationDerivatives(NamedTuple):
    """Derivatives of accelerations (n,) with respect to positions (right perturbations),
    velocities and joint forces.
    """

    q: Expr
    qd: Expr
    tau: Expr


def inverse_dynamics_derivatives(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    qdd: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> ForceDerivatives:
    """The derivatives (n, n) of `inverse_dynamics` with respect to positions, velocities and accelerations.

    The derivative with respect to accelerations is the mass matrix. Columns follow the order of the velocities; a
    position on a group is varied by a right perturbation, in the order of its body velocity.

    Args: as for `inverse_dynamics`. Wrenches are assumed constant in the axes of their frames.
    Raises: the errors of `inverse_dynamics`.
    """
    owner = "inverse_dynamics_derivatives"
    rates = checked(owner, mechanism).coordinates(owner, "qdd", np.zeros(mechanism.dofs) if qdd is None else qdd)
    perturbed = _Perturbed(owner, mechanism, q, qd, rates, wrenches)
    by_q, by_qd = perturbed.by_motion()
    through = perturbed.by_acceleration
    return ForceDerivatives(by_q + through(perturbed.moved), by_qd + through(perturbed.hastened), perturbed.mass_matrix)


def forward_dynamics_derivatives(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> AccelerationDerivatives:
    """The derivatives (n, n) of `forward_dynamics` with respect to positions, velocities and joint forces.

    The derivative with respect to forces is the inverse of the mass matrix. Columns are as for
    `inverse_dynamics_derivatives`.

    Args, Raises: as for `forward_dynamics`. Wrenches are assumed constant in the axes of their frames.
    """
    owner = "forward_dynamics_derivatives"
    if checked(owner, mechanism).loops:
        raise ModelError(
            f"{owner} expects a tree, got one with closed loops.\n  fix: use tx.compile(mechanism.system()).jacobian"
        )
    qdd = forward_dynamics(checked(owner, mechanism), q, qd, tau, wrenches=wrenches)
    return acceleration_derivatives(owner, mechanism, q, qd, qdd, wrenches)


def acceleration_derivatives(
    owner: str,
    mechanism: KinematicTree,
    q: Positions | None,
    qd: ExprLike | None,
    qdd: Expr,
    wrenches: Wrenches | None,
) -> AccelerationDerivatives:
    """The result of `forward_dynamics_derivatives` for known accelerations qdd (n,)."""
    perturbed = _Perturbed(owner, mechanism, q, qd, qdd, wrenches)
    by_q, by_qd = perturbed.by_motion()
    M, n = perturbed.mass_matrix, mechanism.dofs
    moved, hastened = perturbed.free_root(perturbed.moved), perturbed.free_root(perturbed.hastened)
    if moved is None or hastened is None:
        by_q = by_q + perturbed.by_acceleration(perturbed.moved)
        by_qd = by_qd + perturbed.by_acceleration(perturbed.hastened)
    V = InverseFactor(M)
    both = -(V @ (V.T @ Hstack(by_q, by_qd)))
    qdd_by_q, qdd_by_qd = both[:, :n], both[:, n:]
    if moved is not None and hastened is not None:
        qdd_by_q, qdd_by_qd = qdd_by_q - moved, qdd_by_qd - hastened
    return AccelerationDerivatives(qdd_by_q, qdd_by_qd, InversePositive(M))


@dataclasses.dataclass(frozen=True)
class _Freedom:
    """The effect of a unit of one degree of freedom. Six-vectors are in the frame of the first segment of its tree."""

    place: int  # index of its segment
    entry: int  # index among the velocities
    ratio: float  # of a mimic joint
    S: Expr
    moved: tuple[
        Expr, Expr
    ]  # with respect to position: the argument of I (6,), and the angular part of the argument of B (3,)
    hastened: tuple[Expr, Expr]  # the same with respect to velocity


class _Segment(NamedTuple):
    T: Expr
    V: Expr
    A: Expr


class _Perturbed:
    """A motion, and the changes of the joint forces under small perturbations of it."""

    def __init__(
        self,
        owner: str,
        mechanism: KinematicTree,
        q: Positions | None,
        qd: ExprLike | None,
        qdd: Expr,
        wrenches: Wrenches | None,
    ) -> None:
        self.mechanism = mechanism
        places = mechanism.positions(owner, q)
        self._qd, self._qdd = mechanism.coordinates(owner, "qd", qd), qdd
        segments, self._freedoms = mechanism.segments, list[_Freedom]()
        #: The change of the acceleration of the first segment per unit of a degree of freedom of its joint: by
        #: position, by velocity.
        self.moved, self.hastened = dict[int, Expr](), dict[int, Expr]()
        moving: list[_Segment] = []
        for i, (segment, place) in enumerate(zip(segments, places, strict=True)):
            T = segment.link.transform(place)
            known = self._first(i, segment, T) if segment.before < 0 else self._next(i, segment, T, moving)
            moving.append(known)
        self._spreads = [Spread.of(s, motion.T, motion.V) for s, motion in zip(segments, moving, strict=True)]
        self._F: list[Expr] = []
        pushes = outside(owner, mechanism, wrenches)
        for segment, motion, spread, pushed in zip(segments, moving, self._spreads, pushes, strict=True):
            F, inner = spread.inertia(motion.A) + AdjointDual(motion.V, spread.inertia(motion.V)), segment.inner_motion
            if inner is not None:
                w = motion.T[:3, :3].T @ angular(motion.V)
                F = F + CoadjointAction(motion.T, inner.wrench(w))
            self._F.append(F if pushed is None else F - CoadjointAction(motion.T, pushed))
        for i in reversed(range(len(segments))):
            before = segments[i].before
            if before >= 0:
                self._F[before] = self._F[before] + self._F[i]
                self._spreads[before] = self._spreads[before].plus(self._spreads[i])

    # ---- pass from the base to the tips ----------------------------------------------------------------------------

    def _first(self, i: int, segment: Segment, T: Expr) -> _Segment:
        """A segment on the base, in its own frame, with the velocity of its origin subtracted."""
        V, ratio = self.mechanism.along(segment, self._qd), _ratio(segment)
        w, v = angular(V), linear(V)
        up = AdjointAction(T, acceleration_of_base(self.mechanism.gravity), inverse=True)
        A = up + twist(linear=Cross(w, v), angular=ZERO) + self.mechanism.along(segment, self._qdd)
        for k, a in enumerate(segment.freedoms):
            H = segment.link.joint.motion_subspace[:, k]
            s, r, x = linear(H), angular(H), len(self._freedoms)
            self.moved[x] = twist(linear=Cross(linear(up), r), angular=ZERO)
            self.hastened[x] = twist(linear=Cross(r, v) + Cross(w, s), angular=Cross(w, r))
            self._freedoms.append(_Freedom(i, a, ratio, H, (_NOTHING, ZERO), (_NOTHING, r)))
        return _Segment(Constant(np.eye(4)), twist(linear=ZERO, angular=w), A)

    def _next(self, i: int, segment: Segment, T: Expr, moving: list[_Segment]) -> _Segment:
        before, ratio = moving[segment.before], _ratio(segment)
        frame = Compose(before.T, T)
        V, A = before.V, before.A
        motions = [AdjointAction(frame, segment.link.joint.motion_subspace[:, k]) for k in range(len(segment.freedoms))]
        rates = [_times(ratio, self._qd[a]) for a in segment.freedoms]
        for S, rate in zip(motions, rates, strict=True):
            V = V + S * rate
        for S, rate, a in zip(motions, rates, segment.freedoms, strict=True):
            P = Adjoint(before.V, S)
            Q = P if len(motions) == 1 else Adjoint(V, S)  # a single motion column is constant under its own rotation
            moved = Adjoint(before.A, S) + Adjoint(before.V, P), angular(P)
            self._freedoms.append(_Freedom(i, a, ratio, S, moved, (P + Q, angular(S))))
            A = A + S * _times(ratio, self._qdd[a]) + Q * rate
        return _Segment(frame, V, A)

    # ---- all pairs of degrees of freedom ---------------------------------------------------------------------------

    @functools.cached_property
    def _tree(self) -> list[tuple[int, int, Constant]]:
        """For each degree of freedom j: the first degree of freedom of its joint, the end of its subtree, and a mask of
        its ancestors among those before it.

        Branches are stored consecutively, so a subtree is a contiguous range.
        """
        segments, places = self.mechanism.segments, [freedom.place for freedom in self._freedoms]
        reached = np.eye(len(segments), dtype=bool)
        for i, segment in enumerate(segments):
            if segment.before >= 0:
                reached[i] |= reached[segment.before]
        subtrees = []
        for place in places:
            first = places.index(place)
            end = first + sum(bool(reached[i, place]) for i in places)
            subtrees.append((first, end, Constant(np.array([reached[place, i] for i in places[:first]], bool))))
        return subtrees

    @functools.cached_property
    def _motions(self) -> Expr:
        """The motion columns S of all degrees of freedom, as rows (N, 6)."""
        return Stack(*(freedom.S for freedom in self._freedoms))

    @functools.cached_property
    def _felt(self) -> Expr:
        """I S of all degrees of freedom, as rows (N, 6): the wrench of a unit acceleration."""
        return Stack(*(self._spreads[freedom.place].inertia(freedom.S) for freedom in self._freedoms))

    @functools.cached_property
    def _turned(self) -> Expr:
        """The angular parts of B' S of all degrees of freedom, as rows (N, 3)."""
        return Stack(*(self._spreads[freedom.place].coupled_back(freedom.S) for freedom in self._freedoms))

    def by_motion(self) -> tuple[Expr, Expr]:
        """The derivatives of the forces with respect to positions and velocities, without the parts of `moved` and
        `hastened`.
        """
        by_q, by_qd = list[Expr](), list[Expr]()
        for freedom, place in zip(self._freedoms, self._tree, strict=True):
            spread, (first, end, _) = self._spreads[freedom.place], place
            for columns, (x, b) in ((by_q, freedom.moved), (by_qd, freedom.hastened)):
                carried = spread.inertia(x) + spread.coupled(b)
                if columns is by_q:
                    carried = carried + AdjointDual(freedom.S, self._F[freedom.place])
                columns.append(self._column(place, self._felt[first:end] @ x + self._turned[first:end] @ b, carried))
        rate_columns, turning = self._gathered(by_qd), turning_by_velocities(self.mechanism, self._qd)
        return self._gathered(by_q), rate_columns if turning is None else rate_columns + turning

    @functools.cached_property
    def mass_matrix(self) -> Expr:
        """The mass matrix M (n, n), including rotors."""
        columns: list[Expr] = []
        for k, (freedom, place) in enumerate(zip(self._freedoms, self._tree, strict=True)):
            column = self._column(place, self._felt[place[0] : place[1]] @ freedom.S, self._felt[k])
            rotor = self.mechanism.segments[freedom.place].link.drive.rotor
            columns.append(column if rotor is None else column + rotor * np.eye(len(self._freedoms))[k])
        return self._gathered(columns)

    def _column(self, place: tuple[int, int, Constant], beyond: Expr, carried: Expr) -> Expr:
        """One column of joint forces (N,): `beyond` for the subtree of a degree of freedom, and for its ancestors the
        force of the wrench `carried`.
        """
        first, end, on_path = place
        parts = [beyond, Constant(np.zeros(len(self._freedoms) - end))]
        if first:
            parts.insert(0, Where(on_path, self._motions[:first] @ carried, Constant(np.zeros(first))))
        return Concat(*parts)

    def _gathered(self, columns: list[Expr]) -> Expr:
        """Rows and columns of joints, summed to those of the velocities (n, n): mimic joints add to the joints that
        they follow.
        """
        pairs = Stack(*columns).T
        G = np.zeros((len(self._freedoms), self.mechanism.dofs))
        for row, freedom in enumerate(self._freedoms):
            G[row, freedom.entry] = freedom.ratio
        return pairs if np.array_equal(G, np.eye(len(G))) else Constant(G.T) @ pairs @ Constant(G)

    # ---- effect of the acceleration of the first segments -----------------------------------------------------------

    def by_acceleration(self, changes: dict[int, Expr]) -> Expr:
        """The change of the forces under a change of the accelerations of the first segments."""
        N, columns = len(self._freedoms), list[Expr]()
        for number, (first, end, _) in enumerate(self._tree):
            felt = self._felt[first:end] @ changes.get(number, _NOTHING)
            columns.append(Concat(np.zeros(first), felt, np.zeros(N - end)))
        return self._gathered(columns)

    def free_root(self, changes: dict[int, Expr]) -> Expr | None:
        """The same change as accelerations of a free first joint (n, n); None if the first joint is another one."""
        segments, n = self.mechanism.segments, self.mechanism.dofs
        roots = [root for root in segments if root.before < 0]
        if any(len(root.freedoms) < 6 or root.link.drive.rotor is not None for root in roots):
            return None
        columns: list[Expr] = [Constant(np.zeros(n))] * n
        for number, change in changes.items():
            root = segments[self._freedoms[number].place]
            # H of six degrees of freedom is square: the accelerations are H^-1 of the change.
            basis = root.link.joint.actuation_basis.T
            spread = np.zeros((n, 6))
            spread[list(root.freedoms), range(6)] = 1.0
            columns[self._freedoms[number].entry] = Constant(spread) @ (basis @ change)
        return Stack(*columns).T


def _ratio(segment: Segment) -> float:
    return 1.0 if segment.link.mimic is None else segment.link.mimic.ratio


def _times(ratio: float, value: Expr) -> Expr:
    return value if ratio == 1.0 else ratio * value
