"""What rotors of joints take beyond their inertia times the accelerations.

A rotor of the inertia a on every freedom of a joint has the kinetic energy a (|v|^2 + |w|^2) / 2 of the twist [v; w]
across the joint, in the axes of the child. Those turn, so that the rotor needs the forces

    H' a [v' + w x v; w'].

The middle term is left where a joint both slides and turns about another direction: in a plane, or freely.

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
    """H' a [w x v; 0] of all joints (n,), N; None where it vanishes for all velocities."""
    terms: list[Expr] = [Constant(0.0)] * mechanism.dofs
    turning = list(_turning(mechanism))
    for segment, rotor in turning:
        turned = rotor * _turned(mechanism, segment, qd)
        for k, i in enumerate(segment.freedoms):
            terms[i] = Dot(_slide(segment, k), turned)
    return Concat(*terms) if turning else None


def turning_of_rotor(mechanism: KinematicTree, segment: Segment, qd: Expr) -> Expr | None:
    """w x v (3,) of one joint, for a rotor of one; None where it vanishes for all velocities."""
    return _turned(mechanism, segment, qd) if _turns(segment) else None


def _turned(mechanism: KinematicTree, segment: Segment, qd: Expr) -> Expr:
    across = mechanism.along(segment, qd)
    return Cross(angular(across), linear(across))


def turning_by_velocities(mechanism: KinematicTree, qd: Expr) -> Expr | None:
    """The derivatives (n, n) of `turning_of_rotors` by the velocities."""
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
    """Whether a rotor has such a term: a joint of one or two freedoms turns about the axis it slides on."""
    H = segment.link.joint.motion_subspace
    still = isinstance(H, Constant) and not (np.any(H.value[:3]) and np.any(H.value[3:]))
    return len(segment.freedoms) > 2 and not still


def _slide(segment: Segment, k: int) -> Expr:
    return linear(segment.link.joint.motion_subspace[:, k])
