"""Inverse dynamics as a linear function of masses, first moments and inertias.

Let B = [b; a] be the acceleration of a segment minus gravity, and w its angular velocity, see `algorithms/motion.py`.
The wrench of the segment is linear in its mass m, first moment h = m c and inertia I about the origin:

    f = m b + a x h + w x (w x h)        tau = h x b + I a + w x I w

Source: C. Atkeson, C. An, J. Hollerbach, Estimation of Inertial Parameters of Manipulator Loads and Links, Int. J. of
Robotics Research 5 (1986), equation 8.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

import numpy as np

from ...checks import listed, name_list
from ...errors import ModelError
from ...expr import Block, Concat, Constant, Dot, Expr, Stack, Tanh, to_expr
from ...expr.fields import ExprLike
from ...expr.lie import CoadjointAction, Hat, angular, linear
from ..algorithms.dynamics import checked
from ..algorithms.motion import Moving, acceleration_of_base, accelerations, motion
from ..algorithms.rotors import turning_of_rotor
from ..bodies import SpatialInertia
from ..kinematic_tree import KinematicTree, Positions
from ..tree import Segment

#: The parameters of a body: mass, first moment and inertia about the origin of its frame.
BODY = ("mass", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
#: The parameters of a drive.
DRIVE = ("armature", "damping", "friction")


@dataclasses.dataclass(frozen=True)
class Regressor:
    """Joint forces as a linear function of parameters, $tau = Y theta$. Made by `inverse_dynamics_regressor`.

    Attributes:
        matrix: Y (n, p), a function of positions, velocities and accelerations.
        parameters: theta (p,), the values of the mechanism: kg, kg m, kg m2, and the units of `Drive`.
        names: names of the parameters, such as "forearm.mass", "forearm.mx", "forearm.Ixy" and "elbow.damping".
    """

    matrix: Expr
    parameters: Expr
    names: tuple[str, ...]


def inverse_dynamics_regressor(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    qdd: ExprLike | None = None,
    *,
    drives: Collection[str] | None = None,
) -> Regressor:
    """The regressor Y (n, p) of the inverse dynamics: $Y(q, qd, qdd) theta = tau$, N or N m, linear in all parameters.

    Each segment, with all that is fixed to it, has ten parameters in its frame: the mass m, the first moment $m c$ and
    the inertia about the origin, in the order mass, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz. Let a and w be the
    angular acceleration and velocity, b the acceleration of the origin minus gravity, and $L(x)$ (3, 6) such that
    $L(x)$ times the six entries of the inertia I is $I x$. The wrench of the segment is

        $f = m b + ([a]x + [w]x [w]x) m c, tau = -[b]x m c + (L(a) + [w]x L(w)) I$

    and it is propagated to the base as in `inverse_dynamics`.

    Source: C. Atkeson, C. An, J. Hollerbach, Estimation of Inertial Parameters of Manipulator Loads and Links (1986),
    equation 8.

    Args:
        mechanism: a tree or a chain.
        q, qd, qdd: as in `inverse_dynamics`.
        drives: additional parameters of every moving joint: "armature" of rotors, "damping", and "friction" with the
            `friction_speed` of each drive. By default the armatures of the joints that have one: then $Y theta$ equals
            `inverse_dynamics`.
    Raises:
        ShapeError: an argument of the wrong shape.
        ModelError: unknown positions; an unknown name in `drives`; a body with masses that move in it.
    """
    owner = "inverse_dynamics_regressor"
    checked(owner, mechanism)
    rates = mechanism.coordinates(owner, "qd", qd)
    turning = mechanism.coordinates(owner, "qdd", np.zeros(mechanism.dofs) if qdd is None else qdd)
    moving = motion(mechanism, mechanism.positions(owner, q), rates)
    B = accelerations(mechanism, moving, turning, acceleration_of_base(mechanism.gravity))
    blocks = [_block(mechanism, moving, i, _wrenches(state.w, B[i])) for i, state in enumerate(moving)]
    theta = [_parameters_of(owner, segment) for segment in mechanism.segments]
    names = [f"{segment.link.name}.{name}" for segment in mechanism.segments for name in BODY]
    for segment, kind in _of_drives(owner, mechanism, drives):
        blocks.append(_drive_column(mechanism, segment, kind, rates, turning))
        theta.append(Concat(to_expr(getattr(segment.link.drive, kind))))
        names.append(f"{segment.link.joint.name}.{kind}")
    return Regressor(Block([blocks]), Concat(*theta), tuple(names))


def forces_of_parameters(mechanism: KinematicTree, theta: Expr, drives: Collection[str] | None, qdd: Expr) -> Expr:
    """The joint forces Y theta (n,) for parameters theta (p,), by one recursion that does not compute Y.

    Args:
        theta: in the order of `inverse_dynamics_regressor` with the same `drives`.
        qdd: accelerations (n,); positions and velocities are the states of the mechanism.
    """
    owner = "inverse_dynamics_regressor"
    moving = motion(mechanism, mechanism.positions(owner, None), mechanism.qd)
    B = accelerations(mechanism, moving, qdd, acceleration_of_base(mechanism.gravity))
    count = len(BODY)
    F = [_wrenches(m.w, B[i]) @ theta[count * i : count * (i + 1)] for i, m in enumerate(moving)]
    forces: list[Expr] = [Constant(0.0)] * mechanism.dofs
    for i in reversed(range(len(F))):
        segment = mechanism.segments[i]
        for k, row in enumerate(segment.freedoms):
            forces[row] = forces[row] + segment.scaled(Dot(segment.link.joint.motion_subspace[:, k], F[i]))
        if segment.before >= 0:
            F[segment.before] = F[segment.before] + CoadjointAction(moving[i].T, F[i])
    tau: Expr = Concat(*forces)
    for k, (segment, kind) in enumerate(_of_drives(owner, mechanism, drives), count * len(F)):
        tau = tau + _drive_column(mechanism, segment, kind, mechanism.qd, qdd)[:, 0] * theta[k]
    return tau


def _wrenches(w: Expr, B: Expr) -> Expr:
    """The wrench (6, 10) of a segment as a linear function of its parameters, in its frame."""
    b, a = linear(B), angular(B)
    W, zero = Hat(w), Constant(np.zeros((3, 6)))
    force = [b[:, None], Hat(a) + W @ W, zero]
    torque = [Constant(np.zeros((3, 1))), -Hat(b), _inertia_times(a) + W @ _inertia_times(w)]
    return Block([force, torque])


def _inertia_times(x: Expr) -> Expr:
    """The matrix L(x) (3, 6) with L(x) [Ixx, Ixy, Iyy, Ixz, Iyz, Izz] = I x."""
    o = Constant(0.0)
    x, y, z = x[0], x[1], x[2]
    return Stack(Concat(x, y, o, z, o, o), Concat(o, x, y, o, z, o), Concat(o, o, o, x, y, z))


def _block(mechanism: KinematicTree, moving: list[Moving], i: int, F: Expr) -> Expr:
    """The forces (n, 10) of all joints as a linear function of the parameters of segment i: nonzero only for joints
    between it and the base.
    """
    rows: list[list[Expr]] = [[] for _ in range(mechanism.dofs)]
    while i >= 0:
        segment = mechanism.segments[i]
        for k, row in enumerate(segment.freedoms):
            rows[row].append(segment.scaled(segment.link.joint.motion_subspace[:, k] @ F))
        F, i = CoadjointAction(moving[i].T, F), segment.before
    zero = Constant(np.zeros(10))
    return Stack(*(sum(terms[1:], terms[0]) if terms else zero for terms in rows))


def _parameters_of(owner: str, segment: Segment) -> Expr:
    if segment.body is None:
        return Constant(np.zeros(10))
    if segment.inner_motion is not None:
        raise ModelError(
            f"{owner}: masses move in the body of {segment.link.name!r}, and the forces of their motion are not linear "
            "in mass, first moment and inertia"
        )
    return parameters_of(segment.body)


def parameters_of(body: SpatialInertia) -> Expr:
    """The ten parameters of a body: mass, first moment and inertia about the origin."""
    M = body.matrix
    return Concat(
        body.mass, body.mass * body.center_of_mass, *(M[3 + i, 3 + j] for j in range(3) for i in range(j + 1))
    )


def _of_drives(owner: str, mechanism: KinematicTree, drives: Collection[str] | None) -> list[tuple[Segment, str]]:
    """The joints and kinds of drive parameters that have a column."""
    moving = [segment for segment in mechanism.segments if segment.freedoms]
    if drives is None:
        return [(segment, "armature") for segment in moving if segment.link.drive.rotor is not None]
    kinds = name_list("inverse_dynamics_regressor: drives", drives, ModelError)
    for kind in kinds:
        if kind not in DRIVE:
            raise ModelError(f"{owner} expects drives among {listed(DRIVE, kind)}, got {kind!r}")
    return [(segment, kind) for segment in moving for kind in kinds]


def _drive_column(mechanism: KinematicTree, segment: Segment, kind: str, qd: Expr, qdd: Expr) -> Expr:
    """The forces (n, 1) of all joints as a linear function of one drive parameter."""
    rows: list[Expr] = [Constant(0.0)] * mechanism.dofs
    turned = turning_of_rotor(mechanism, segment, qd) if kind == "armature" else None
    for k, i in enumerate(segment.freedoms):
        rate = segment.scaled(qd[i])
        if kind == "armature":
            rows[i] = segment.scaled(segment.scaled(qdd[i]))
            rows[i] = (
                rows[i] if turned is None else rows[i] + Dot(linear(segment.link.joint.motion_subspace[:, k]), turned)
            )
        else:
            rows[i] = segment.scaled(rate if kind == "damping" else Tanh(rate / segment.link.drive.friction_speed))
    return Concat(*rows)[:, None]
