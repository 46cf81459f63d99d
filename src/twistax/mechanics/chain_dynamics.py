"""Dynamics of serial chains as expressions: forces of accelerations (RNEA), the reverse (ABA), mass matrix (CRBA).

In place of the rate A of a link's twist, in its own frame, the recursions carry

    B = A + [w x v; 0],

the acceleration of the frame's origin and the angular acceleration. With W = [0; w] Newton and Euler then say
F = M B + ad*_W(M W), and linear velocities appear nowhere. From link to link, with T the pose of a link in the one
before, p its origin there, H = [s; r] the motion of its joint, and w_0 the angular velocity of the link before in the
axes of this one:

    w = w_0 + r q'
    B = Ad_T^-1 (B_before + [w x (w x p); 0]) + [(w_0 + w) x s q'; w_0 x r q'] + H q''

where the first bracket has the w of the link before. Gravity is an acceleration of the base upwards.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008): section 2.11 for B, 5.3 for RNEA, 6.2 for CRBA, 7.3 for
ABA.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from ..expr import Block, Concat, Constant, Cos, Cross, Dot, Expr, Outer, Sin, Where
from ..expr.fields import ExprLike
from ..expr.lie import (
    Act,
    AdjointAction,
    AdjointDual,
    AxisRotation,
    CoadjointAction,
    Inverse,
    angular,
    linear,
    translation,
    twist,
)
from ..expr.lie.elements import parts_of_pose
from .chain import Chain, Link
from .joints import complement

_ZERO = Constant(np.zeros(3))


def _coordinates(owner: str, chain: Chain, name: str, value: ExprLike) -> Expr:
    if not isinstance(chain, Chain):
        raise ModelError(f"{owner} expects a chain, tx.mechanics.Chain(links), got {type(chain).__name__}")
    return chain.coordinates(owner, name, value)


def inverse_dynamics(chain: Chain, q: ExprLike, qd: ExprLike, qdd: ExprLike) -> Expr:
    """The forces of the motors (n,) that give a chain the accelerations qdd: N for a slide, N m for a turn.

    The recursive Newton-Euler algorithm (RNEA). From base to tip the motion, from tip to base

        F = M B + ad*_W(M W) + Ad*_T F of the next link,    tau = H' F.

    Args:
        chain: the links and gravity.
        q, qd, qdd: positions, velocities and accelerations (n,).
    Raises: ShapeError if an argument is not of shape (n,).
    """
    qdd = _coordinates("inverse_dynamics", chain, "qdd", qdd)
    moving = _motion("inverse_dynamics", chain, q, qd)
    B, needed = _acceleration_of_base(chain), []
    for i, link in enumerate(moving):
        B = link.carried(B) + link.H * qdd[i]
        needed.append(link.inertia @ B + link.gyroscopic)
    tau = []
    F = needed[-1]
    for i in reversed(range(chain.dofs)):
        tau.append(Dot(moving[i].H, F))
        if i:
            F = needed[i - 1] + CoadjointAction(moving[i].T, F)
    return Concat(*reversed(tau))


def forward_dynamics(chain: Chain, q: ExprLike, qd: ExprLike, tau: ExprLike) -> Expr:
    """The accelerations (n,) of a chain whose motors give the forces tau: m/s2 for a slide, rad/s2 for a turn.

    The articulated-body algorithm (ABA). From tip to base it finds what a link and all that hangs on it need for the
    acceleration B of the link, the wrench I B + b; from base to tip the accelerations.

    Args:
        chain: the links and gravity.
        q, qd: positions and velocities (n,).
        tau: forces of the motors (n,), N for a slide, N m for a turn.
    Raises: ShapeError if an argument is not of shape (n,).
    """
    tau = _coordinates("forward_dynamics", chain, "tau", tau)
    moving = _motion("forward_dynamics", chain, q, qd)
    hinges = []
    I, b = moving[-1].inertia, moving[-1].gyroscopic
    for i in reversed(range(chain.dofs)):
        hinges.append(_Hinge(moving[i], I, b, tau[i]))
        if i:
            felt_I, felt_b = hinges[-1].felt_before()
            I, b = moving[i - 1].inertia + felt_I, moving[i - 1].gyroscopic + felt_b
    B, qdd = _acceleration_of_base(chain), []
    for hinge in reversed(hinges):
        B = hinge.link.carried(B)
        qdd.append(hinge.acceleration(B))
        B = B + hinge.link.H * qdd[-1]
    return Concat(*qdd)


#: The field's short names.
rnea, aba = inverse_dynamics, forward_dynamics


def mass_matrix(chain: Chain, q: ExprLike) -> Expr:
    """The inertia M (n, n) of a chain in its coordinates: kinetic energy q'.M q' / 2, motors' forces M q'' + h(q, q').

    The composite-rigid-body algorithm (CRBA). From tip to base I_c, the inertia of a link with all that hangs on it as
    if it were rigid; M_ij = H_j' Ad* I_c H_i for every link j between the base and link i.

    Args:
        chain: the links; gravity has no part in it.
        q: positions (n,).
    Raises: ShapeError if q is not of shape (n,).
    """
    q = _coordinates("mass_matrix", chain, "q", q)
    T = chain.transforms(q)
    H = [link.joint.motion_subspace[:, 0] for link in chain.links]
    M = [[_ZERO[0]] * chain.dofs for _ in chain.links]
    I: Expr = Constant(np.zeros((6, 6)))
    for i in reversed(range(chain.dofs)):
        link = chain.links[i]
        I = link.body.matrix + I
        F = I @ H[i]
        for j in reversed(range(i + 1)):
            M[i][j] = M[j][i] = Dot(H[j], F)
            F = CoadjointAction(T[j], F)
        I = in_frame(link.mount, in_frame(link.joint.placement(q[i : i + 1]), I))
    return Block(M)


@dataclasses.dataclass(frozen=True)
class _Moving:
    """A link in motion. Six-vectors are in its frame, but for `centripetal`, which is in that of the link before."""

    link: Link
    placement: Expr  # pose of the joint's child frame in its parent frame
    T: Expr  # pose of the link in the link before
    H: Expr  # motion of the joint (6,)
    gyroscopic: Expr  # ad*_W(M W)
    centripetal: Expr  # [w x (w x p); 0] of the link before
    coriolis: Expr  # [(w_0 + w) x s q'; w_0 x r q']

    @property
    def inertia(self) -> Expr:
        """M (6, 6)."""
        return self.link.body.matrix

    def carried(self, B_before: Expr) -> Expr:
        """The acceleration (6,) of the link while its joint has none."""
        return AdjointAction(self.T, B_before + self.centripetal, inverse=True) + self.coriolis


def _acceleration_of_base(chain: Chain) -> Expr:
    return twist(linear=-chain.gravity, angular=_ZERO)


def _motion(owner: str, chain: Chain, q: ExprLike, qd: ExprLike) -> list[_Moving]:
    """From base to tip: the angular velocities and what follows from them."""
    q, qd = _coordinates(owner, chain, "q", q), _coordinates(owner, chain, "qd", qd)
    w: Expr = _ZERO
    moving = []
    for i, link in enumerate(chain.links):
        T, H = link.transform(q[i : i + 1]), link.joint.motion_subspace[:, 0]
        R, p = parts_of_pose(T)
        slide, turn = linear(H) * qd[i], angular(H) * qd[i]
        centripetal = twist(linear=Cross(w, Cross(w, p)), angular=_ZERO)
        before = Act(Inverse(R), w)
        w = before + turn
        W = twist(linear=_ZERO, angular=w)
        moving.append(
            _Moving(
                link=link,
                placement=link.joint.placement(q[i : i + 1]),
                T=T,
                H=H,
                gyroscopic=AdjointDual(W, link.body.momentum(W)),
                centripetal=centripetal,
                coriolis=twist(linear=Cross(before + w, slide), angular=Cross(before, turn)),
            )
        )
    return moving


class _Hinge:
    """A joint with all that hangs on it, which needs the wrench I B + b.

    With U = I H and D = H' U the joint accelerates by q'' = (tau - H' b - U' B) / D, B that of the link but for its own
    joint's. U / D is h* + U_R / D, with h* the joint's working wrench and U_R what the bearing carries of U: written
    so, the entries of I - U U' / D along the joint are exact zeros.
    """

    def __init__(self, link: _Moving, I: Expr, b: Expr, tau: Expr) -> None:
        self.link, self.I, self.b, self.tau = link, I, b, tau
        joint = link.link.joint
        self.working = joint.actuation_basis[:, 0]
        self.U = I @ link.H
        self.D = Dot(link.H, self.U)
        self.left = tau - Dot(link.H, b)
        self.carried = joint.reaction(self.U) / self.D

    def acceleration(self, B: Expr) -> Expr:
        """q'' () where the link has the acceleration B (6,) but for its own joint's."""
        return self.left / self.D - Dot(self.working + self.carried, B)

    def felt_before(self) -> tuple[Expr, Expr]:
        """What it adds to I and b of the link before, in its frame.

        Ad*_T I_a Ad_T^-1 with I_a = I - U U' / D, and Ad*_T (b + I_a c + U (tau - H' b) / D) with c what B gets from
        the velocities. Of the wrench the working part is tau.
        """
        link, joint = self.link, self.link.link.joint
        I = mirrored(self.I - Outer(self.U, self.working + self.carried))
        bearing = joint.reaction(self.b) + I @ link.coriolis + self.carried * self.left
        felt = in_frame(link.link.mount, in_frame(link.placement, I))
        wrench = CoadjointAction(link.T, bearing + self.working * self.tau)
        return felt, wrench + felt @ link.centripetal


# ---- symmetric 6x6 inertias [M H; H' J] in other frames, with what is equal by symmetry computed once ----------------

#: The entries on and above the diagonal of a 6x6 matrix.
_UPPER = np.triu(np.ones((6, 6), dtype=bool))
#: Factors of the entries of 3x3 matrices.
_REFLECTED = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
_ACROSS = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
_ALONG = np.diag([1.0, -1.0, 0.0])
_LAST_COLUMN = np.outer([1.0, 1.0, 0.0], [0.0, 0.0, 1.0])
_LAST_ROW = _LAST_COLUMN.T


def mirrored(I: Expr) -> Expr:
    """A symmetric matrix (6, 6) of the entries on and above the diagonal of I."""
    return Where(Constant(_UPPER), I, I.T)


def in_frame(T: Expr, I: Expr) -> Expr:
    """Ad*_T I Ad_T^-1 (6, 6) of a symmetric I."""
    R, p = parts_of_pose(T)
    if isinstance(R, AxisRotation):
        I, T = _turned_about_axis(R, I), translation(p)
    return mirrored(CoadjointAction(T, CoadjointAction(T, I).T))


def _turned_about_axis(R: AxisRotation, I: Expr) -> Expr:
    """The blocks R M R', R H R', R J R' of a turn about a fixed axis, together."""
    C = Constant(_axes(R.axis))

    def turned(X: Expr) -> Expr:
        return C @ _turned_about_z(C.T @ X @ C, R.angle) @ C.T

    H = turned(I[:3, 3:])
    return Block([[turned(I[:3, :3]), H], [H.T, turned(I[3:, 3:])]])


def _turned_about_z(X: Expr, angle: Expr) -> Expr:
    """R X R' (3, 3), R the turn about z: entries with z turn like vectors, the others by the double angle.

    With y = s (x00 - x11) + c (x01 + x10) the latter are [x00 - s y, c y - x10; c y - x01, x11 + s y]: eleven
    operations in place of 24.
    """
    R, s, c = AxisRotation(angle, (0.0, 0.0, 1.0)), Sin(angle), Cos(angle)
    y = s * (X[0, 0] - X[1, 1]) + c * (X[0, 1] + X[1, 0])
    plane = _REFLECTED * X.T + (c * y) * _ACROSS - (s * y) * _ALONG
    return plane + R @ (_LAST_COLUMN * X) + (_LAST_ROW * X) @ R.T


def _axes(axis: tuple[float, ...]) -> NDArray[np.float64]:
    """A rotation C (3, 3) with C z = axis: a permutation, signs apart, where the axis is one of the coordinates."""
    C = np.column_stack([complement(np.array(axis)[:, None]), axis])
    return C if np.linalg.det(C) > 0.0 else C[:, [1, 0, 2]]
