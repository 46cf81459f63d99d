"""The accelerations of mechanisms as expressions, by the articulated-body algorithm (ABA).

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), section 7.3.
"""

from __future__ import annotations

import numpy as np

from ...expr import Concat, Constant, Dot, Expr, Outer, SolvePositive
from ...expr.fields import ExprLike
from ...expr.lie import CoadjointAction
from ..kinematic_tree import KinematicTree, Positions
from .closed_loops import closed_dynamics
from .dynamics import Wrenches, bias_forces, checked, less, mass_matrix, outside
from .inertia_frames import in_frame, mirrored
from .motion import Moving, acceleration_of_base, motion
from .rotors import turning_of_rotors

_NOTHING = Constant(0.0)


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
    moving = motion(mechanism, mechanism.positions(owner, q), rates)
    I = [state.inertia for state in moving]
    b = [less(state.needed, out) for state, out in zip(moving, outside(owner, mechanism, wrenches), strict=True)]
    hinges: list[_Hinge] = []
    for i in reversed(range(len(moving))):
        hinges.append(_Hinge(moving[i], I[i], b[i], forces))
        before = moving[i].segment.before
        if before >= 0:
            felt_I, felt_b = hinges[-1].felt_before()
            I[before], b[before] = I[before] + felt_I, b[before] + felt_b
    accelerations: list[Expr] = []
    qdd: list[Expr] = [_NOTHING] * mechanism.dofs
    for hinge in reversed(hinges):
        before = hinge.moving.segment.before
        base = acceleration_of_base(mechanism.gravity) if before < 0 else accelerations[before]
        B = hinge.moving.carried(base)
        for i, freedom in zip(hinge.moving.segment.freedoms, hinge.freedoms, strict=True):
            qdd[i] = freedom.acceleration(B)
            B = B + freedom.H * qdd[i]
        accelerations.append(B)
    return Concat(*qdd)


#: The usual abbreviation.
aba = forward_dynamics


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

    def acceleration(self, B: Expr) -> Expr:
        """Its acceleration () if the segment has the acceleration B (6,) apart from it."""
        return self.left / self.D - Dot(self.share, B)

    def eliminated(self) -> tuple[Expr, Expr]:
        """I_a = I - U U' / D and b_a = b + U (tau - H' b) / D; without a rotor the working part of b_a is tau."""
        I = mirrored(self.I - Outer(self.U, self.share))
        if self.rotor is not None:
            return I, self.b + self.share * self.left
        return I, self._reaction(self.b) + self.carried * self.left + self.working * self.tau
