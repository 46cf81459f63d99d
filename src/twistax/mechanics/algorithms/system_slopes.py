"""Derivatives of the accelerations of a mechanism's system, by recursive algorithms."""

from __future__ import annotations

import numpy as np

from ...expr import Constant, Control, Expr, Stack, State, leaves_of
from ...expr.fields import ExprLike
from ..joints import Joint
from ..kinematic_tree import KinematicTree
from ..tree import Segment
from .derivatives import acceleration_derivatives
from .dynamics import Wrenches
from .jacobians import BODY, frame_jacobian


def moves_itself(mechanism: KinematicTree) -> bool:
    """Whether masses or lengths depend on states or controls."""
    return any(isinstance(leaf, (State, Control)) for leaf in leaves_of(*_numbers(mechanism)))


def slopes_of_accelerations(
    mechanism: KinematicTree, qdd: Expr, forces: Expr, wrenches: Wrenches | None
) -> list[tuple[ExprLike, ExprLike]]:
    """The derivatives of `forward_dynamics` with respect to positions, velocities, joint forces and wrenches.

    Args:
        qdd: its result (n,).
        forces: those on which it depends (n,).
    """
    derivatives = acceleration_derivatives("system", mechanism, None, None, qdd, wrenches)
    q, vector = mechanism.q, list[Expr]()
    slopes: list[tuple[ExprLike, ExprLike]] = []
    for segment, place in zip(mechanism.segments, mechanism.positions("system", None), strict=True):
        if segment.link.mimic is not None or not segment.freedoms:
            continue
        columns = derivatives.q[:, segment.freedoms[0] : segment.freedoms[-1] + 1]
        if segment.link.joint.group is not None:
            slopes.append((place, columns))
        else:
            columns = _by_coordinates(segment, place, columns)
            vector += [columns[:, k] for k in range(segment.link.joint.dofs)]
    if vector:
        slopes.append((q if isinstance(q, State) else q["q"], Stack(*vector).T))
    slopes += [(mechanism.qd, derivatives.qd), (forces, derivatives.tau)]
    for frame, wrench in (wrenches or {}).items():
        slopes.append((wrench, derivatives.tau @ frame_jacobian(mechanism, frame, axes=BODY).T))
    return slopes


def scalars_of_slopes(mechanism: KinematicTree) -> int:
    """The number of scalars in a program of these derivatives, nearly: of pairs and triples of degrees of freedom that
    act on one another, and a tenth for the rest.
    """
    places = [i for i, segment in enumerate(mechanism.segments) for _ in segment.freedoms]
    reached = np.eye(len(mechanism.segments), dtype=bool)
    for i, segment in enumerate(mechanism.segments):
        if segment.before >= 0:
            reached[i] |= reached[segment.before]
    before = reached[np.ix_(places, places)].astype(int)  # row i has the degrees of freedom from the base to i
    related, depth = (before + before.T > 0).astype(int), before.sum(1)
    # The derivatives of forces and the mass matrix; the factor V of its inverse, and V V'; V (V' H) of both.
    return int(
        1.1 * (78 * depth.sum() + 3 * (depth**2).sum() + (before @ before.T).sum() + 8 * (before @ related).sum())
    )


def _by_coordinates(segment: Segment, place: Expr, columns: Expr) -> Expr:
    """From columns for velocities to columns for coordinates, whose rates may differ from the velocities."""
    joint = segment.link.joint
    if type(joint).rate is Joint.rate:
        return columns
    return columns @ Stack(*(joint.velocity_of(place, Constant(unit)) for unit in np.eye(joint.dofs))).T


def _numbers(mechanism: KinematicTree) -> list[Expr]:
    """All constants of a mechanism, of its geometry and inertia."""
    numbers: list[Expr] = [mechanism.gravity]
    for segment in mechanism.segments:
        link, body = segment.link, segment.body
        numbers += [link.mount, link.joint.motion_subspace]
        numbers += [] if body is None else [body.mass, body.center_of_mass, body.inertia]
        inner = segment.inner_motion
        numbers += [] if inner is None else [inner.still, inner.turning]
        numbers += [] if link.drive.rotor is None else [link.drive.rotor]
    return numbers
