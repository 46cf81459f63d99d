"""Energies and momenta of mechanisms as expressions.

The centroidal momentum is that of all bodies about their common centre of mass, in axes parallel to the base's.

Source: D. Orin, A. Goswami, S. Lee, Centroidal dynamics of a humanoid robot, Autonomous Robots (2013).
"""

from __future__ import annotations

import functools
import operator

import numpy as np

from ...errors import ModelError
from ...expr import Constant, Dot, Expr, Stack
from ...expr.fields import ExprLike
from ...expr.lie import Act, CoadjointAction, translation
from ..kinematic_tree import KinematicTree, Positions
from .dynamics import checked, composite_inertias

_NOTHING = Constant(0.0)


def _sum(terms: list[Expr], empty: Expr = _NOTHING) -> Expr:
    return functools.reduce(operator.add, terms) if terms else empty


def kinetic_energy(mechanism: KinematicTree, q: Positions | None = None, qd: ExprLike | None = None) -> Expr:
    """The kinetic energy (), J: the sum of $V^T M V / 2$ over all bodies, plus that of rotors and of masses that move
    inside bodies.

    Raises ShapeError for arguments of the wrong shape, and ModelError if the rates of moving masses are not known.
    Example: `arm.system(outputs={"kinetic": kinetic_energy(arm)})`.
    """
    twists = checked("kinetic_energy", mechanism).twists(q, qd)
    terms = [body.kinetic_energy(twists[i]) for i, body in mechanism.bodies.items()]
    rates = mechanism.coordinates("kinetic_energy", "qd", qd)
    for segment in mechanism.segments:
        rotor = segment.link.drive.rotor
        for i in segment.freedoms if rotor is not None else ():
            rotor_rate = segment.scaled(rates[i])
            terms.append(0.5 * (rotor * rotor_rate * rotor_rate))
    return _sum(terms)


def potential_energy(mechanism: KinematicTree, q: Positions | None = None) -> Expr:
    """The potential energy of gravity $U = -sum m_i g . c_i$ over all bodies (), J: zero for masses at the base's
    origin. Raises ShapeError for positions of the wrong shape.
    """
    poses = checked("potential_energy", mechanism).poses(q)
    lifted = [
        body.mass * Dot(mechanism.gravity, Act(poses[i], body.center_of_mass)) for i, body in mechanism.bodies.items()
    ]
    return -_sum(lifted)


def spring_energy(mechanism: KinematicTree, q: Positions | None = None) -> Expr:
    """The energy $sum k |q - q_0|^2 / 2$ of the springs of all drives (), J; for a ball joint the deflection is Log R.
    Raises ShapeError for positions of the wrong shape.
    """
    places = checked("spring_energy", mechanism).positions("spring_energy", q)
    terms: list[Expr] = []
    for segment, place in zip(mechanism.segments, places, strict=True):
        deflection = segment.link.joint.deflection(place)
        if deflection is not None and segment.link.drive.sprung:
            terms += [segment.link.drive.stored(deflection[k]) for k in range(len(segment.freedoms))]
    return _sum(terms)


def total_mass(mechanism: KinematicTree) -> Expr:
    """The mass of all bodies on moving joints (), kg. Raises ModelError if no body moves.

    Example: `tx.lower(total_mass(arm))(0.0)`.
    """
    masses = [body.mass for body in checked("total_mass", mechanism).bodies.values()]
    if not masses:
        raise ModelError("total_mass expects a mechanism with bodies, got rotors only")
    return _sum(masses)


def center_of_mass(mechanism: KinematicTree, q: Positions | None = None) -> Expr:
    """The centre of mass $c = sum m_i c_i / sum m_i$ of all bodies on moving joints (3,), m, in the base.

    Raises ShapeError for positions of the wrong shape, and ModelError if there is no mass.
    Example: `tx.lower(center_of_mass(arm))(0.0, {"q": q})`.
    """
    poses = checked("center_of_mass", mechanism).poses(q)
    moments = [body.mass * Act(poses[i], body.center_of_mass) for i, body in mechanism.bodies.items()]
    return _sum(moments) / total_mass(mechanism)


def spatial_momentum(mechanism: KinematicTree, q: Positions | None = None, qd: ExprLike | None = None) -> Expr:
    """The momentum [p; L] (6,) of all bodies about the BASE's origin, in the base's axes: the sum of Ad*_T M V. Raises
    ShapeError for arguments of the wrong shape.

    If gravity is the only external force, the rate of p is its force, and the rate of L its moment.
    """
    poses, twists = checked("spatial_momentum", mechanism).poses(q), mechanism.twists(q, qd)
    terms: list[Expr] = [CoadjointAction(poses[i], body.momentum(twists[i])) for i, body in mechanism.bodies.items()]
    return _sum(terms, Constant(np.zeros(6)))


def centroidal_momentum(mechanism: KinematicTree, q: Positions | None = None, qd: ExprLike | None = None) -> Expr:
    """The momentum [p; L] (6,) of all bodies about their common centre of mass, in the base's axes: N s and N m s.
    Raises ShapeError for arguments of the wrong shape.
    Example: `arm.system(outputs={"momentum": centroidal_momentum(arm)})`.
    """
    about_base = spatial_momentum(mechanism, q, qd)
    return CoadjointAction(translation(center_of_mass(mechanism, q)), about_base, inverse=True)


def centroidal_matrix(mechanism: KinematicTree, q: Positions | None = None) -> Expr:
    """The centroidal momentum matrix A (6, n), kg and kg m: $A qd$ is the centroidal momentum. Its columns are $Ad*_T
    I_c H$.

    Masses that move inside bodies have an additional momentum relative to their bodies, which $A qd$ does not contain.

    Raises ShapeError.
    """
    places = checked("centroidal_matrix", mechanism).positions("centroidal_matrix", q)
    poses, I = mechanism.poses(q), composite_inertias(mechanism, places)
    columns: list[list[Expr]] = [[] for _ in range(mechanism.dofs)]
    for i, segment in enumerate(mechanism.segments):
        for k, a in enumerate(segment.freedoms):
            H = segment.link.joint.motion_subspace[:, k]
            columns[a].append(segment.scaled(CoadjointAction(poses[i], I[i] @ H)))
    about_base = Stack(*(_sum(column) for column in columns)).T
    return CoadjointAction(translation(center_of_mass(mechanism, q)), about_base, inverse=True)
