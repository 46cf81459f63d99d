"""Dynamics of mechanisms as expressions: forces of accelerations (RNEA), the reverse (ABA), mass matrix (CRBA).

`motion.py` says what the recursions carry from body to body.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008): section 5.3 for RNEA, 6.2 for CRBA, 7.3 for ABA.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import ModelError
from ..expr import Block, Concat, Constant, Dot, Expr, Outer, SolvePositive
from ..expr.fields import ExprLike
from ..expr.lie import CoadjointAction
from .arguments import of_shape
from .inertia_frames import in_frame, mirrored
from .mechanism import Mechanism, Positions
from .motion import ZERO, Moving, acceleration_of_base, inertia_of, motion
from .rotors import turning_of_rotors

#: Wrenches (6,) by the names of the frames they act in, at their origins and in their axes.
Wrenches = Mapping[str, ExprLike]

_NOTHING = Constant(0.0)


def inverse_dynamics(
    mechanism: Mechanism,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    qdd: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> Expr:
    """The joint forces (n,) that cause accelerations qdd, by the recursive Newton-Euler algorithm (RNEA): N for a
    slide, N m for a turn.

    A pass from the base to the tips computes twists W and accelerations B; a pass from the tips to the base computes

        $F = M B + ad*_W(M W) + X - F_given + sum Ad*_T F_after, tau = H^T F$

    with X the wrench of masses that move inside their bodies, see `inner_motion`.

    Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 5.

    Args:
        mechanism: a tree or a chain.
        q, qd: positions and velocities (n,); the states of the mechanism by default.
        qdd: accelerations (n,), the rates of qd; zero by default.
        wrenches: external wrenches (6,) by name of frame, in the axes of the frame.
    Raises:
        ShapeError: an argument of another shape.
        ModelError: positions or frames that are not known.
    """
    checked("inverse_dynamics", mechanism)
    rates = mechanism.coordinates("inverse_dynamics", "qdd", np.zeros(mechanism.dofs) if qdd is None else qdd)
    needed = carried_wrenches("inverse_dynamics", mechanism, q, qd, rates, wrenches)
    return _gathered(mechanism, needed, mechanism.coordinates("inverse_dynamics", "qd", qd), rates)


def carried_wrenches(
    owner: str,
    mechanism: Mechanism,
    q: Positions | None,
    qd: ExprLike | None,
    qdd: Expr,
    wrenches: Wrenches | None,
    *,
    of_velocities: bool = False,
) -> list[Expr]:
    """F (6,) of every segment, in its frame: the wrench through its joint; or only the part that vanishes with qd."""
    moving = motion(mechanism, mechanism.positions(owner, q), mechanism.coordinates(owner, "qd", qd))
    accelerations: list[Expr] = []
    needed: list[Expr] = []
    for state, pushed in zip(moving, outside(owner, mechanism, wrenches), strict=True):
        before = state.segment.before
        base = acceleration_of_base(ZERO if of_velocities else mechanism.gravity)
        B = state.carried(base if before < 0 else accelerations[before])
        accelerations.append(B + mechanism.along(state.segment, qdd))
        bias = state.gyroscopic if of_velocities else state.needed
        needed.append(_less(state.inertia @ accelerations[-1] + bias, pushed))
    for i in reversed(range(len(moving))):
        if moving[i].segment.before >= 0:
            needed[moving[i].segment.before] += CoadjointAction(moving[i].T, needed[i])
    return needed


def _gathered(mechanism: Mechanism, needed: list[Expr], qd: Expr, qdd: Expr) -> Expr:
    """The joint forces H' F (n,) plus those of the rotors; forces of followers add to those of their leaders."""
    tau: list[list[Expr]] = [[] for _ in range(mechanism.dofs)]
    for segment, F in zip(mechanism.segments, needed, strict=True):
        for k, i in enumerate(segment.freedoms):
            tau[i].append(segment.scaled(Dot(segment.link.joint.motion_subspace[:, k], F)))
            if segment.link.drive.rotor is not None:
                tau[i].append(segment.link.drive.rotor * segment.ratio**2 * qdd[i])
    forces, turning = Concat(*(sum(terms[1:], terms[0]) for terms in tau)), turning_of_rotors(mechanism, qd)
    return forces if turning is None else forces + turning


def bias_forces(
    mechanism: Mechanism, q: Positions | None = None, qd: ExprLike | None = None, *, wrenches: Wrenches | None = None
) -> Expr:
    """The bias b (n,) in $M qdd + b = tau$: gravity, Coriolis and centrifugal forces minus external wrenches, N or N m.

    Raises as `inverse_dynamics` does.
    """
    return inverse_dynamics(mechanism, q, qd, wrenches=wrenches)


def gravity_forces(mechanism: Mechanism, q: Positions | None = None) -> Expr:
    """The joint forces $g(q) = b(q, 0)$ (n,), N or N m, that hold the mechanism at rest.

    They include the forces of masses that move inside their bodies.

    Raises as `inverse_dynamics` does.
    """
    checked("gravity_forces", mechanism)
    return inverse_dynamics(mechanism, q, np.zeros(mechanism.dofs))


def coriolis_forces(mechanism: Mechanism, q: Positions | None = None, qd: ExprLike | None = None) -> Expr:
    """Coriolis and centrifugal forces $c(q, qd) = C(q, qd) qd$ (n,), N or N m: the part of the bias that vanishes at
    rest.

    Raises as `inverse_dynamics` does.
    """
    owner, still = "coriolis_forces", Constant(np.zeros(checked("coriolis_forces", mechanism).dofs))
    needed = carried_wrenches(owner, mechanism, q, qd, still, None, of_velocities=True)
    return _gathered(mechanism, needed, mechanism.coordinates(owner, "qd", qd), still)


def forward_dynamics(
    mechanism: Mechanism,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> Expr:
    """The joint accelerations (n,) under joint forces tau, by the articulated-body algorithm (ABA): m/s2 for a slide,
    rad/s2 for a turn.

    It solves $M(q) qdd + b(q, qd) = tau$ in O(n). A pass from the tips to the base computes for each segment the
    articulated inertia I and bias b, so that the wrench on the segment is I B + b at an acceleration B of the segment;
    a pass from the base to the tips computes the accelerations. If joints mimic others, or loops are closed, the
    equations of the mass matrix are solved instead.

    Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 7.

    Args:
        mechanism: a tree or a chain.
        q, qd: positions and velocities (n,); the states of the mechanism by default.
        tau: joint forces (n,), N for a slide, N m for a turn; zero by default.
        wrenches: external wrenches (6,) by name of frame, in the axes of the frame.
    Raises:
        ShapeError: an argument of another shape.
        ModelError: positions or frames that are not known; a joint that moves no mass.
    """
    owner = "forward_dynamics"
    checked(owner, mechanism).check_masses(owner)
    forces = mechanism.coordinates(owner, "tau", np.zeros(mechanism.dofs) if tau is None else tau)
    if mechanism.loops:
        from .closed_loops import closed_dynamics

        return closed_dynamics(mechanism, q, qd, forces, wrenches=wrenches)[0]
    if any(segment.link.mimic for segment in mechanism.segments):
        return SolvePositive(mass_matrix(mechanism, q), forces - bias_forces(mechanism, q, qd, wrenches=wrenches))
    rates = mechanism.coordinates(owner, "qd", qd)
    turning = turning_of_rotors(mechanism, rates)
    forces = forces if turning is None else forces - turning
    moving = motion(mechanism, mechanism.positions(owner, q), rates)
    I = [state.inertia for state in moving]
    b = [_less(state.needed, out) for state, out in zip(moving, outside(owner, mechanism, wrenches), strict=True)]
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


#: The field's short names.
rnea, aba = inverse_dynamics, forward_dynamics


def mass_matrix(mechanism: Mechanism, q: Positions | None = None) -> Expr:
    """The mass matrix M (n, n) of a mechanism: kinetic energy $qd.M qd / 2$, joint forces $M qdd + b(q, qd)$.

    Its entries are in kg, kg m and kg m2.

    The composite-rigid-body algorithm (CRBA): with I_c the inertia of a segment and all segments it carries, as one
    rigid body, $M_ij = H_j^T Ad* I_c H_i$ for every j between the base and i. Rotors add to the diagonal.

    Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 6.

    Args:
        mechanism: a tree or a chain; gravity does not matter.
        q: positions; the states of the mechanism by default.
    Raises: ShapeError, ModelError: positions of another shape or name.
    """
    checked("mass_matrix", mechanism)
    places = mechanism.positions("mass_matrix", q)
    T = [segment.link.transform(place) for segment, place in zip(mechanism.segments, places, strict=True)]
    I = composite_inertias(mechanism, places)
    n = mechanism.dofs
    M: list[list[list[Expr]]] = [[[] for _ in range(n)] for _ in range(n)]

    def add(a: int, b: int, value: Expr, ratio: float) -> None:
        M[a][b].append(value if ratio == 1.0 else ratio * value)

    for i, segment in enumerate(mechanism.segments):
        rotor, gear = segment.link.drive.rotor, segment.ratio
        for k, a in enumerate(segment.freedoms):
            F = I[i] @ segment.link.joint.motion_subspace[:, k]
            for other, c in enumerate(segment.freedoms[: k + 1]):
                value: Expr = Dot(segment.link.joint.motion_subspace[:, other], F)
                if c == a and rotor is not None:
                    value = value + rotor
                add(a, c, value, gear**2)
                if c != a:
                    add(c, a, value, 1.0)
            j = i
            while mechanism.segments[j].before >= 0:
                F, j = CoadjointAction(T[j], F), mechanism.segments[j].before
                ancestor = mechanism.segments[j]
                for other, c in enumerate(ancestor.freedoms):
                    value = Dot(ancestor.link.joint.motion_subspace[:, other], F)
                    add(a, c, value, gear * ancestor.ratio)
                    add(c, a, value, gear * ancestor.ratio)
    return Block([[sum(terms[1:], terms[0]) if terms else _NOTHING for terms in row] for row in M])


def composite_inertias(mechanism: Mechanism, positions: list[Expr]) -> list[Expr]:
    """I_c (6, 6) of each segment with its whole subtree as one rigid body, in its frame."""
    I = [inertia_of(segment) for segment in mechanism.segments]
    for i in reversed(range(len(I))):
        link, before = mechanism.segments[i].link, mechanism.segments[i].before
        if before >= 0:
            I[before] = I[before] + in_frame(link.mount, in_frame(link.joint.placement(positions[i]), I[i]))
    return I


def checked(owner: str, mechanism: Mechanism) -> Mechanism:
    """The mechanism itself. Raises ModelError for anything else, and where no joint moves."""
    if not isinstance(mechanism, Mechanism):
        raise ModelError(
            f"{owner} expects a mechanism, such as tx.mechanics.Chain(links), got {type(mechanism).__name__}"
        )
    if not mechanism.dofs:
        raise ModelError(f"{owner} expects a mechanism with a joint that moves, got none")
    return mechanism


def outside(owner: str, mechanism: Mechanism, wrenches: Wrenches | None) -> list[Expr | None]:
    """The sum of the external wrenches on each segment, in its frame; None without any."""
    outer_wrenches: list[Expr | None] = [None] * len(mechanism.segments)
    if wrenches is not None and not isinstance(wrenches, Mapping):
        raise ModelError(f"{owner} expects wrenches as a mapping from names of frames, got {type(wrenches).__name__}")
    for name, value in (wrenches or {}).items():
        at = mechanism.frame(name)
        F = of_shape(owner, f"the wrench at {name!r}", value, (6,), "[f; tau] in the frame's axes")
        if at.segment >= 0:
            F, before = CoadjointAction(at.T, F), outer_wrenches[at.segment]
            outer_wrenches[at.segment] = F if before is None else before + F
    return outer_wrenches


def _less(needed: Expr, applied: Expr | None) -> Expr:
    return needed if applied is None else needed - applied


class _Hinge:
    """A joint with its subtree, on which the wrench I B + b acts. Its freedoms are eliminated one by one."""

    def __init__(self, moving: Moving, I: Expr, b: Expr, forces: Expr) -> None:
        self.moving, self.freedoms = moving, list[_Freedom]()
        for k in reversed(range(len(moving.segment.freedoms))):
            if self.freedoms:
                I, b = self.freedoms[0].eliminated()
            self.freedoms.insert(0, _Freedom(moving, k, I, b, forces[moving.segment.freedoms[k]]))
        self.rigid = None if self.freedoms else (I, b)

    def felt_before(self) -> tuple[Expr, Expr]:
        """Its contribution to I and b of the segment before, in that frame: Ad*_T I_a Ad_T^-1 and Ad*_T (b_a + I_a c).

        c is what B gets from the velocities.
        """
        moving, link = self.moving, self.moving.segment.link
        if self.rigid is None:
            I, b = self.freedoms[0].eliminated()
        else:
            I, b = self.rigid
        felt = in_frame(link.mount, in_frame(moving.placement, I))
        return felt, CoadjointAction(moving.T, b + I @ moving.coriolis) + felt @ moving.centripetal


class _Freedom:
    """One freedom of a joint, with motion column H, on bodies with the wrench I B + b.

    With U = I H and D = H' U + the rotor's inertia it accelerates by (tau - H' b - U' B) / D, B that of the segment but
    for this freedom's. Without a rotor U / D is h* + U_R / D, with h* the working wrench and U_R what the bearing
    carries of U: written so, the entries of I - U U' / D along the joint are exact zeros.
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
