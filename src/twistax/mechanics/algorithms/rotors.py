"""The forces of joint rotors in addition to their inertia times the accelerations.

Rotors with inertia a on all degrees of freedom of a joint have the kinetic energy a (|v|^2 + |w|^2) / 2, with [v; w]
the twist across the joint in the child's axes. These axes rotate, so the rotors require the forces

    H' a [v' + w x v; w'].

The term w x v remains if a joint translates and rotates about different directions, as planar and free joints do.

Source: J. Marsden, T. Ratiu, Introduction to Mechanics and Symmetry (1999), section 13.5: the Euler-Poincare equations.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...expr import Block, Concat, Constant, Cross, Dot, Expr
from ...expr.lie import angular, linear
from ..kinematic_tree import KinematicTree
from ..tree import Segment


def turning_of_rotors(mechanism: KinematicTree, qd: Expr) -> Expr | None:
    """The forces H' a [w x v; 0] of all joints (n,), N; None if they vanish for all velocities."""
    terms: list[Expr] = [Constant(0.0)] * mechanism.dofs
    turning = list(_turning(mechanism))
    for segment, rotor in turning:
        turned = rotor * _turned(mechanism, segment, qd)
        for k, i in enumerate(segment.freedoms):
            terms[i] = Dot(_slide(segment, k), turned)
    return Concat(*terms) if turning else None


def turning_of_rotor(mechanism: KinematicTree, segment: Segment, qd: Expr) -> Expr | None:
    """The vector w x v (3,) of one joint, for a rotor with unit inertia; None if it vanishes for all velocities."""
    return _turned(mechanism, segment, qd) if _turns(segment) else None


def _turned(mechanism: KinematicTree, segment: Segment, qd: Expr) -> Expr:
    across = mechanism.along(segment, qd)
    return Cross(angular(across), linear(across))


def turning_by_velocities(mechanism: KinematicTree, qd: Expr) -> Expr | None:
    """The derivatives (n, n) of `turning_of_rotors` with respect to the velocities."""
    slopes: list[list[Expr]] = [[Constant(0.0)] * mechanism.dofs for _ in range(mechanism.dofs)]
    turning = list(_turning(mechanism))
    for segment, rotor in turning:
        across, H = mechanism.along(segment, qd), segment.link.joint.motion_subspace
        for m, j in enumerate(segment.freedoms):
            turned = Cross(angular(H[:, m]), linear(across)) + Cross(angular(across), _slide(segment, m))
            for k, i in enumerate(segment.freedoms):
                slopes[i][j] = rotor * Dot(_slide(segment, k), turned)
    return Block(slopes) if turning else None


def _turning(mechanism: KinematicTree) -> Iterator[tuple[Segment, Expr]]:
    """The segments whose rotors have such a term."""
    for segment in mechanism.segments:
        rotor = segment.link.drive.rotor
        if rotor is not None and _turns(segment):
            yield segment, rotor


def _turns(segment: Segment) -> bool:
    """Whether a rotor has such a term. It does not if the joint has one or two degrees of freedom, a rotation about the
    axis of its translation.
    """
    H = segment.link.joint.motion_subspace
    still = isinstance(H, Constant) and not (np.any(H.value[:3]) and np.any(H.value[3:]))
    return len(segment.freedoms) > 2 and not still


def _slide(segment: Segment, k: int) -> Expr:
    return linear(segment.link.joint.motion_subspace[:, k])
