"""The accelerations of mechanisms as expressions, by the articulated-body algorithm (ABA).

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), section 7.3.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence

import numpy as np

from ...expr import Concat, Dot, Expr, Outer, SolvePositive
from ...expr.fields import ExprLike
from ...expr.lie import CoadjointAction, Pose
from ...expr.lie.elements import parts_of_pose
from ..kinematic_tree import KinematicTree, Positions
from ..tree import Segment
from .closed_loops import closed_dynamics
from .dynamics import Wrenches, bias_forces, checked, less, mass_matrix, outside
from .inertia_frames import in_frame, mirrored
from .limbs import Mapped, coordinates_of, equal_limbs, others
from .motion import ZERO, CarriedBody, Moving, acceleration_of_base, motion_of
from .rotors import turning_of_rotors


def forward_dynamics(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> Expr:
    """The joint accelerations (n,) under joint forces tau, by the articulated-body algorithm (ABA): m/s2 for
    translations, rad/s2 for rotations.

    It solves $M(q) qdd + b(q, qd) = tau$ in O(n). A pass from the tips to the base computes the articulated inertia I
    and bias b of each segment: the wrench on the segment is I B + b for its acceleration B. A pass from the base to the
    tips then computes the accelerations. If joints mimic others, or there are loop constraints, the equations of motion
    are solved with the mass matrix instead.

    Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 7.

    Args:
        mechanism: a tree or a chain.
        q, qd: positions and velocities (n,); the states of the mechanism by default.
        tau: joint forces (n,), N for translations, N m for rotations; zero by default.
        wrenches: external wrenches (6,) by name of frame, about its origin and in its axes.
    Raises:
        ShapeError: an argument of the wrong shape.
        ModelError: unknown positions or frames; a joint that moves no mass.
    Example: `tx.lower(forward_dynamics(arm, arm.q, arm.qd, tau))(0.0, {"q": q, "qd": qd})`.
    """
    owner = "forward_dynamics"
    checked(owner, mechanism).check_masses(owner)
    forces = mechanism.coordinates(owner, "tau", np.zeros(mechanism.dofs) if tau is None else tau)
    if mechanism.loops:
        return closed_dynamics(mechanism, q, qd, forces, wrenches=wrenches)[0]
    if any(segment.link.mimic for segment in mechanism.segments):
        return SolvePositive(mass_matrix(mechanism, q), forces - bias_forces(mechanism, q, qd, wrenches=wrenches))
    rates = mechanism.coordinates(owner, "qd", qd)
    turning = turning_of_rotors(mechanism, rates)
    forces = forces if turning is None else forces - turning
    pushes = outside(owner, mechanism, wrenches)
    return _by_recursion(mechanism, mechanism.positions(owner, q), rates, forces, pushes)


#: The usual abbreviation.
aba = forward_dynamics


def _by_recursion(
    mechanism: KinematicTree, positions: list[Expr], rates: Expr, forces: Expr, pushes: list[Expr | None]
) -> Expr:
    """The accelerations (n,). Limbs of equal structure are a map over the limbs."""
    groups = equal_limbs(mechanism, pushes)
    trunk = others(mechanism, groups)
    moving = motion_of(trunk, dict(enumerate(positions)), rates, ZERO)
    I = {i: state.inertia for i, state in moving.items()}
    b = {i: less(state.needed, pushes[i]) for i, state in moving.items()}
    w = {i: state.w for i, state in moving.items()}
    inward = list[Mapped]()
    for group in groups:
        batches = [group.on_parents(w), group.positions(positions), group.rows(rates), group.rows(forces)]
        inward.append(group.map(_limb_inward, batches))
        for k, parent in enumerate(group.parents):
            felt_I, felt_b = inward[-1].of(inward[-1].rows[k], 0, 2)
            I[parent], b[parent] = I[parent] + mirrored(felt_I), b[parent] + felt_b
    hinges = _inward(moving, I, b, forces)
    kept = {i: _Kept.of(moving[i], hinges[i].freedoms) for i in moving}
    qdd, B = _outward(trunk, kept, acceleration_of_base(mechanism.gravity))
    for group, passed in zip(groups, inward, strict=True):
        one = functools.partial(_limb_outward, passed)
        rows = group.map(one, [passed.rows, group.on_parents(B), group.positions(positions)]).rows
        for k in range(len(group.roots)):
            freedoms = [i for place in group.places(k) for i in mechanism.segments[place].freedoms]
            qdd.update((i, rows[k][j]) for j, i in enumerate(freedoms))
    return Concat(*(qdd[i] for i in range(mechanism.dofs)))


def _inward(moving: Mapping[int, Moving], I: dict[int, Expr], b: dict[int, Expr], forces: Expr) -> dict[int, _Hinge]:
    """The pass from the tips to the base, from the inertias and biases of single segments."""
    hinges: dict[int, _Hinge] = {}
    for i in reversed(list(moving)):
        hinges[i] = _Hinge(moving[i], I[i], b[i], forces)
        before = moving[i].segment.before
        if before >= 0:
            felt_I, felt_b = hinges[i].felt_before()
            I[before], b[before] = I[before] + felt_I, b[before] + felt_b
    return hinges


def _outward(
    segments: Mapping[int, Segment], kept: Mapping[int, _Kept], base: Expr
) -> tuple[dict[int, Expr], dict[int, Expr]]:
    """The pass from the base to the tips: the accelerations of joints by degree of freedom, and B of segments."""
    qdd, accelerations = dict[int, Expr](), dict[int, Expr]()
    for i, segment in segments.items():
        B = kept[i].carried(base if segment.before < 0 else accelerations[segment.before])
        for k, freedom in enumerate(segment.freedoms):
            qdd[freedom] = kept[i].alone[k] - Dot(kept[i].shares[k], B)
            B = B + segment.link.joint.motion_subspace[:, k] * qdd[freedom]
        accelerations[i] = B
    return qdd, accelerations


def _limb_inward(segments: dict[int, Segment], w: Expr, q: Expr, qd: Expr, tau: Expr) -> list[Expr]:
    """What the parent of a limb feels, and what the pass to the tips needs."""
    moving = motion_of(segments, {i: q[coordinates_of(segment)] for i, segment in segments.items()}, qd, w)
    I = {i: state.inertia for i, state in moving.items()}
    b = {i: state.needed for i, state in moving.items()}
    hinges = _inward(moving, I, b, tau)
    results = [*hinges[0].felt_before()]
    for i in moving:
        known = _Kept.of(moving[i], hinges[i].freedoms)
        results += [parts_of_pose(known.T)[0], known.centripetal, known.coriolis, *known.shares, *known.alone]
    return results


def _limb_outward(passed: Mapped, segments: dict[int, Segment], row: Expr, B: Expr, q: Expr) -> list[Expr]:
    """The accelerations of the joints of a limb, for B of its parent."""
    results = iter(passed.of(row, 2))
    kept = dict[int, _Kept]()
    for i, segment in segments.items():
        p = parts_of_pose(segment.link.transform(q[coordinates_of(segment)]))[1]
        T, centripetal, coriolis = Pose(next(results), p), next(results), next(results)
        shares, alone = ([next(results) for _ in segment.freedoms] for _ in range(2))
        kept[i] = _Kept(T, centripetal, coriolis, shares, alone)
    qdd, _ = _outward(segments, kept, B)
    return list(qdd.values())


@dataclasses.dataclass(frozen=True)
class _Kept(CarriedBody):
    """What the pass to the tips needs of a segment: the acceleration of each degree of freedom is alone - share' B."""

    shares: Sequence[Expr]
    alone: Sequence[Expr]

    @classmethod
    def of(cls, moving: Moving, freedoms: Sequence[_Freedom]) -> _Kept:
        shares, alone = [freedom.share for freedom in freedoms], [freedom.left / freedom.D for freedom in freedoms]
        return cls(moving.T, moving.centripetal, moving.coriolis, shares, alone)


class _Hinge:
    """A joint with its subtree, on which the wrench I B + b acts. Its degrees of freedom are eliminated one by one."""

    def __init__(self, moving: Moving, I: Expr, b: Expr, forces: Expr) -> None:
        self.moving, self.freedoms = moving, list[_Freedom]()
        for k in reversed(range(len(moving.segment.freedoms))):
            if self.freedoms:
                I, b = self.freedoms[0].eliminated()
            self.freedoms.insert(0, _Freedom(moving, k, I, b, forces[moving.segment.freedoms[k]]))
        self.rigid = None if self.freedoms else (I, b)

    def felt_before(self) -> tuple[Expr, Expr]:
        """Its contribution to I and b of the parent segment, in the parent's frame: Ad*_T I_a Ad_T^-1 and Ad*_T (b_a +
        I_a c).

        c is the part of B that depends on the velocities.
        """
        moving, link = self.moving, self.moving.segment.link
        if self.rigid is None:
            I, b = self.freedoms[0].eliminated()
        else:
            I, b = self.rigid
        felt = in_frame(link.mount, in_frame(moving.placement, I))
        return felt, CoadjointAction(moving.T, b + I @ moving.coriolis) + felt @ moving.centripetal


class _Freedom:
    """One degree of freedom of a joint, with motion column H, on bodies with the wrench I B + b.

    With U = I H and D = H' U + rotor inertia, its acceleration is (tau - H' b - U' B) / D, where B is the acceleration
    of the segment without this degree of freedom. Without a rotor U / D is h* + U_R / D, with h* the working wrench and
    U_R the part of U that the bearing carries. In this form the entries of I - U U' / D along the joint are exact
    zeros.
    """

    def __init__(self, moving: Moving, k: int, I: Expr, b: Expr, tau: Expr) -> None:
        joint = moving.segment.link.joint
        self.I, self.b, self.tau = I, b, tau
        self.H, self.working = joint.motion_subspace[:, k], joint.actuation_basis[:, k]
        self.U = I @ self.H
        self.rotor = moving.segment.link.drive.rotor
        felt = Dot(self.H, self.U)
        self.D = felt if self.rotor is None else felt + self.rotor
        self.left = tau - Dot(self.H, b)
        self.carried = self._reaction(self.U) / self.D
        self.share = self.working + self.carried if self.rotor is None else self.U / self.D

    def _reaction(self, F: Expr) -> Expr:
        return F - self.working * Dot(self.H, F)

    def eliminated(self) -> tuple[Expr, Expr]:
        """I_a = I - U U' / D and b_a = b + U (tau - H' b) / D; without a rotor the working part of b_a is tau."""
        I = mirrored(self.I - Outer(self.U, self.share))
        if self.rotor is not None:
            return I, self.b + self.share * self.left
        return I, self._reaction(self.b) + self.carried * self.left + self.working * self.tau
