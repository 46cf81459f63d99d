"""Dynamics of mechanisms as expressions: inverse dynamics (RNEA) and mass matrix (CRBA); `forward_dynamics.py` has ABA.

`motion.py` describes the quantities that the recursions propagate from body to body.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008): section 5.3 for RNEA, 6.2 for CRBA, 7.3 for ABA.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...errors import ModelError
from ...expr import Block, Concat, Constant, Dot, Expr
from ...expr.fields import ExprLike
from ...expr.kinds.declare import known_as
from ...expr.kinds.kinds import Wrench
from ...expr.lie import CoadjointAction
from ..arguments import finite, of_shape
from ..kinematic_tree import KinematicTree, Positions
from .inertia_frames import in_frame
from .motion import ZERO, acceleration_of_base, accelerations, inertia_of, motion
from .rotors import turning_of_rotors

#: Wrenches (6,) by the name of a frame, about its origin and in its axes.
Wrenches = Mapping[str, ExprLike]

_NOTHING = Constant(0.0)


def inverse_dynamics(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    qdd: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> Expr:
    """The joint forces (n,) for accelerations qdd, by the recursive Newton-Euler algorithm (RNEA): N for translations,
    N m for rotations.

    A pass from the base to the tips computes angular velocities (as W = [0; w]) and accelerations B; a pass from the
    tips to the base computes

        $F = M B + ad*_W(M W) + X - F_given + sum Ad*_T F_after, tau = H^T F$

    with X the wrench of masses that move inside their bodies, see `inner_motion`.

    Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 5.

    Args:
        mechanism: a tree or a chain.
        q, qd: positions and velocities (n,); the states of the mechanism by default.
        qdd: accelerations (n,), the rates of qd; zero by default.
        wrenches: external wrenches (6,) by name of frame, about its origin and in its axes.
    Raises:
        ShapeError: an argument of the wrong shape.
        ModelError: unknown positions or frames.
    Example: `tx.lower(inverse_dynamics(arm, qdd=tx.State("qdd", (n,))))(0.0, {"q": q, "qd": qd, "qdd": qdd})`.
    """
    checked("inverse_dynamics", mechanism)
    rates = mechanism.coordinates("inverse_dynamics", "qdd", np.zeros(mechanism.dofs) if qdd is None else qdd)
    needed = carried_wrenches("inverse_dynamics", mechanism, q, qd, rates, wrenches)
    return _gathered(mechanism, needed, mechanism.coordinates("inverse_dynamics", "qd", qd), rates)


def carried_wrenches(
    owner: str,
    mechanism: KinematicTree,
    q: Positions | None,
    qd: ExprLike | None,
    qdd: Expr,
    wrenches: Wrenches | None,
    *,
    of_velocities: bool = False,
) -> list[Expr]:
    """F (6,) of every segment, in its frame: the wrench through its joint; optionally only the part that vanishes with
    qd.
    """
    moving = motion(mechanism, mechanism.positions(owner, q), mechanism.coordinates(owner, "qd", qd))
    base = acceleration_of_base(ZERO if of_velocities else mechanism.gravity)
    B = accelerations(mechanism, moving, qdd, base)
    needed: list[Expr] = []
    for state, acceleration, pushed in zip(moving, B, outside(owner, mechanism, wrenches), strict=True):
        bias = state.gyroscopic if of_velocities else state.needed
        needed.append(less(state.inertia @ acceleration + bias, pushed))
    for i in reversed(range(len(moving))):
        if moving[i].segment.before >= 0:
            needed[moving[i].segment.before] += CoadjointAction(moving[i].T, needed[i])
    return needed


def _gathered(mechanism: KinematicTree, needed: list[Expr], qd: Expr, qdd: Expr) -> Expr:
    """The joint forces H' F (n,) plus those of the rotors; forces of mimic joints add to those of the joints that they
    follow.
    """
    tau: list[list[Expr]] = [[] for _ in range(mechanism.dofs)]
    for segment, F in zip(mechanism.segments, needed, strict=True):
        for k, i in enumerate(segment.freedoms):
            tau[i].append(segment.scaled(Dot(segment.link.joint.motion_subspace[:, k], F)))
            if segment.link.drive.rotor is not None:
                tau[i].append(segment.link.drive.rotor * segment.ratio**2 * qdd[i])
    forces, turning = Concat(*(sum(terms[1:], terms[0]) for terms in tau)), turning_of_rotors(mechanism, qd)
    return forces if turning is None else forces + turning


def bias_forces(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> Expr:
    """The bias b (n,) in $M qdd + b = tau$: gravity, Coriolis and centrifugal forces minus external wrenches, N or N m.

    Raises the errors of `inverse_dynamics`.
    Example: `tx.lower(bias_forces(arm))(0.0, {"q": q, "qd": qd})`.
    """
    return inverse_dynamics(mechanism, q, qd, wrenches=wrenches)


def gravity_forces(mechanism: KinematicTree, q: Positions | None = None) -> Expr:
    """The joint forces $g(q) = b(q, 0)$ (n,), N or N m, that hold the mechanism at rest.

    They include the forces of masses that move inside their bodies.

    Raises the errors of `inverse_dynamics`.
    Example: `tx.lower(gravity_forces(arm))(0.0, {"q": q})`.
    """
    checked("gravity_forces", mechanism)
    return inverse_dynamics(mechanism, q, np.zeros(mechanism.dofs))


def coriolis_forces(mechanism: KinematicTree, q: Positions | None = None, qd: ExprLike | None = None) -> Expr:
    """Coriolis and centrifugal forces $c(q, qd) = C(q, qd) qd$ (n,), N or N m: the part of the bias that vanishes at
    rest.

    Raises the errors of `inverse_dynamics`.
    Example: `tx.lower(coriolis_forces(arm))(0.0, {"q": q, "qd": qd})`.
    """
    owner, still = "coriolis_forces", Constant(np.zeros(checked("coriolis_forces", mechanism).dofs))
    needed = carried_wrenches(owner, mechanism, q, qd, still, None, of_velocities=True)
    return _gathered(mechanism, needed, mechanism.coordinates(owner, "qd", qd), still)


#: The usual abbreviation.
rnea = inverse_dynamics


def mass_matrix(mechanism: KinematicTree, q: Positions | None = None) -> Expr:
    """The mass matrix M (n, n) of a mechanism: kinetic energy $qd^T M qd / 2$, joint forces $M qdd + b(q, qd)$.

    Its entries are in kg, kg m and kg m2.

    The composite-rigid-body algorithm (CRBA): with I_c the inertia of a segment and all segments it carries, as one
    rigid body, $M_ij = H_j^T Ad* I_c H_i$ for every j between the base and i. Rotors add to the diagonal.

    Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 6.

    Args:
        mechanism: a tree or a chain; its gravity is ignored.
        q: positions; the states of the mechanism by default.
    Raises: ShapeError, ModelError: positions of the wrong shape, or with unknown names.
    Example: `tx.lower(mass_matrix(arm))(0.0, {"q": q})`.
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


def composite_inertias(mechanism: KinematicTree, positions: list[Expr]) -> list[Expr]:
    """I_c (6, 6) of each segment with its whole subtree as one rigid body, in its frame."""
    I = [inertia_of(segment) for segment in mechanism.segments]
    for i in reversed(range(len(I))):
        link, before = mechanism.segments[i].link, mechanism.segments[i].before
        if before >= 0:
            I[before] = I[before] + in_frame(link.mount, in_frame(link.joint.placement(positions[i]), I[i]))
    return I


def checked(owner: str, mechanism: KinematicTree) -> KinematicTree:
    """The mechanism itself. Raises ModelError for other objects, and if no joint moves."""
    if not isinstance(mechanism, KinematicTree):
        raise ModelError(
            f"{owner} expects a mechanism, such as tx.mechanics.Chain(links), got {type(mechanism).__name__}"
        )
    if not mechanism.dofs:
        raise ModelError(f"{owner} expects a mechanism with a joint that moves, got none")
    return mechanism


def outside(owner: str, mechanism: KinematicTree, wrenches: Wrenches | None) -> list[Expr | None]:
    """The sum of the external wrenches on each segment, in its frame; None if there are none."""
    outer_wrenches: list[Expr | None] = [None] * len(mechanism.segments)
    if wrenches is not None and not isinstance(wrenches, Mapping):
        raise ModelError(f"{owner} expects wrenches as a mapping from names of frames, got {type(wrenches).__name__}")
    for name, value in (wrenches or {}).items():
        at = mechanism.frame(name)
        what = f"the wrench at {name!r}"
        F = finite(owner, what, of_shape(owner, what, value, (6,), "[f; tau] in the frame's axes"))
        if at.segment >= 0:
            F = CoadjointAction(at.T, known_as(F, Wrench(mechanism.frame_name(name))))
            F, before = known_as(F, Wrench(mechanism.segments[at.segment].link.name)), outer_wrenches[at.segment]
            outer_wrenches[at.segment] = F if before is None else before + F
    return outer_wrenches


def less(needed: Expr, applied: Expr | None) -> Expr:
    """The difference `needed - applied`; `applied` may be None."""
    return needed if applied is None else needed - applied
