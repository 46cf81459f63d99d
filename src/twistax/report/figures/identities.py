"""Identities of Lie algebra and joints at random values, against references that share no formula with them.

The references are 4x4 matrices, forces that act at points, and SciPy's `expm` and `Rotation`. T = T_ab maps coordinates
of frame b to frame a. In a pairing, each side is transformed separately. An error is the largest entry of the
difference, relative to the largest entry of the reference if that is above 1.
"""

import functools
from collections.abc import Sequence
from types import SimpleNamespace
from typing import NamedTuple

import jax
import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from ... import lower
from ...expr import Constant, Expr, State, leaves_of, lie
from ...expr.matrices.linalg import Dot
from ...groups import ANGULAR_FIRST, LINEAR_FIRST, Order
from ...mechanics import joints, power
from ..harness.expected import at_most
from ..harness.measurement import Section, quick

_CASES, _POINTS, _SEED = 200, 5, 20240607

Array = np.ndarray
#: Arrays with a leading axis of cases, by name: the leaves, and what they are made of; twists are [v; w].
Values = SimpleNamespace


class Identity(NamedTuple):
    """An expression of the package, and the values of all cases computed without the package."""

    name: str
    expression: Expr
    reference: Array


def worst_errors(identities: Sequence[Identity], z: Values, order: Order = LINEAR_FIRST) -> dict[str, float]:
    """The largest error of each simplified expression over all cases, by name. Needs JAX's x64 switch."""
    names = {leaf.name for leaf in leaves_of(*(it.expression for it in identities))} & vars(z).keys()
    function = lower([it.expression.canonicalize() for it in identities])
    results = jax.jit(jax.vmap(functools.partial(function, 0.0)))({n: _ordered(getattr(z, n), order) for n in names})
    worst: dict[str, float] = {}
    for it, result in zip(identities, results, strict=True):
        exact = _ordered(it.reference, order).reshape(len(z.T), -1)
        size = np.maximum(1.0, np.max(np.abs(exact), axis=1, initial=0.0))
        errors = np.max(np.abs(np.asarray(result).reshape(exact.shape) - exact), axis=1, initial=0.0) / size
        worst[it.name] = float(np.max([worst.get(it.name, 0.0), *errors]))
    return worst


def _ordered(value: Array, order: Order) -> Array:
    """Reorder every axis of six entries [v; w], but for the leading axis of cases."""
    axes = [axis for axis in range(1, value.ndim) if value.shape[axis] == 6 and not order.linear_leads]
    return np.roll(value, [3] * len(axes), axes)


def _hat(xi: Array) -> Array:
    X = np.zeros((*xi.shape[:-1], 4, 4))
    X[..., :3, :3], X[..., :3, 3] = np.cross(np.eye(3), xi[..., None, 3:]), xi[..., :3]
    return X


def _vee(X: Array) -> Array:
    return np.stack([*(X[..., i, 3] for i in range(3)), X[..., 2, 1], X[..., 0, 2], X[..., 1, 0]], axis=-1)


def _bracket(xi: Array) -> Array:
    """The matrices (n, 6, 6) of eta -> (X Y - Y X)^v, X = xi^, Y = eta^."""
    X, Y = _hat(xi)[:, None], _hat(np.eye(6))
    return np.swapaxes(_vee(X @ Y - Y @ X), 1, 2)


def _mean_exponential(M: Array) -> Array:
    """The integral of expm(s M) over s from 0 to 1, as a block of one larger exponential."""
    return expm(np.pad(M, ((0, 0), (0, 6), (0, 6))) + np.eye(12, k=6))[:, :6, 6:]


def _total(points: Array, forces: Array) -> Array:
    """Force and torque about the origin of forces that act at points."""
    return np.concatenate([forces.sum(axis=1), np.cross(points, forces).sum(axis=1)], axis=1)


@functools.cache
def random_values(cases: int = _CASES) -> Values:
    """Random values; the rotation of every twist is below a half turn, so that Log has one answer."""
    rng, z = np.random.default_rng(_SEED), Values()
    turns = rng.normal(size=(2, cases, 3))
    turns *= rng.uniform(0.0, 3.1, size=(2, cases, 1)) / np.linalg.norm(turns, axis=2, keepdims=True)
    z.xi, z.log = np.concatenate([2.0 * rng.normal(size=(2, cases, 3)), turns], axis=2)
    z.points, z.forces = rng.normal(size=(2, cases, _POINTS, 3))
    z.eta, z.tau, z.rate = rng.normal(size=(3, cases, 6))
    # By SciPy's quaternions, orthonormal to the last digit or two, which expm is not.
    z.T = expm(_hat(z.log))
    z.T[:, :3, :3] = Rotation.from_rotvec(z.log[:, 3:]).as_matrix()
    R = np.swapaxes(z.T[:, :3, :3], 1, 2)
    z.moved, z.turned = z.points @ R + z.T[:, None, :3, 3], z.forces @ R
    z.F = _total(z.points, z.forces)
    return z


_xi, _eta, _F, _tau, _rate = (State(name, shape=(6,)) for name in ("xi", "eta", "F", "tau", "rate"))
_T = State("T", shape=(4, 4))


def lie_identities(z: Values, o: Order) -> list[Identity]:
    """Identities of brackets, adjoints, Exp, Log and Jacobians in an order of twists."""
    Ad, coAd = functools.partial(lie.SE3Adjoint, order=o), functools.partial(lie.SE3AdjointDual, order=o)
    ad, Exp = functools.partial(lie.Adjoint, order=o), functools.partial(lie.SE3Exp, order=o)
    pairing, power = Dot(lie.AdjointDual(_xi, _F, order=o), _eta) + Dot(_F, ad(_xi, _eta)), np.sum(z.F * z.eta, axis=1)
    B, moved = _bracket(z.xi), _vee(z.T @ _hat(z.eta) @ np.linalg.inv(z.T))
    left, right, dual = _mean_exponential(B), _mean_exponential(-B), expm(-np.swapaxes(B, 1, 2))
    return [
        Identity("ad_xi eta = (X Y - Y X)^v", ad(_xi, _eta), np.einsum("nij,nj->ni", B, z.eta)),
        Identity("<ad*_xi F, eta> + <F, ad_xi eta> = 0", pairing, np.zeros(len(z.xi))),
        Identity("Ad_T eta = (T Y T^-1)^v", Ad(_T) @ _eta, moved),
        Identity("Ad*_T F: forces at points, moved", coAd(_T) @ _F, _total(z.moved, z.turned)),
        Identity("<Ad*_T F, Ad_T eta> = <F, eta>", Dot(coAd(_T) @ _F, Ad(_T) @ _eta), power),
        Identity("Exp xi = expm(X)", Exp(_xi), expm(_hat(z.xi))),
        Identity("Log expm(X) = xi", lie.SE3Log(_T, order=o), z.log),
        Identity("Ad_Exp(xi) = expm(ad_xi)", Ad(Exp(_xi)), expm(B)),
        Identity("Ad*_Exp(xi) = expm(-ad_xi^T)", coAd(Exp(_xi)), dual),
        Identity("J_l = integral of expm(s ad)", lie.LeftJacobian(_xi, order=o), left),
        Identity("J_r = integral of expm(-s ad)", lie.RightJacobian(_xi, order=o), right),
        Identity("J_l^-1", lie.LeftJacobianInverse(_xi, order=o), np.linalg.inv(left)),
        Identity("J_r^-1", lie.RightJacobianInverse(_xi, order=o), np.linalg.inv(right)),
    ]


#: One joint of each kind; the oblique axes have length 3.
JOINTS: tuple[joints.Joint, ...] = (
    joints.Revolute("hinge", axis=(0.0, 0.0, 1.0)),
    joints.Revolute("oblique", axis=(1.0, -2.0, 2.0)),
    joints.Prismatic("slide", axis=(2.0, 2.0, 1.0)),
    joints.Spherical("ball"),
    joints.Free("free"),
    joints.Fixed("weld"),
)


def joint_identities(z: Values) -> list[Identity]:
    """Identities of every joint in a random frame. Motions of joints, and bodies, are checked in tests/mechanics."""
    identities = []
    for joint in JOINTS:
        k, moved = joint.dofs, joint.screws_in(_T)
        H, (tau, rate) = moved.motion_subspace, (x[:k] if k else Constant(np.zeros(0)) for x in (_tau, _rate))
        spent = np.sum(z.tau[:, :k] * z.rate[:, :k], axis=1)
        identities += [
            Identity("h*^T H = I", moved.actuation_basis.T @ H, np.tile(np.eye(k), (len(z.T), 1, 1))),
            Identity("reciprocity: H^T H-bar* = 0", H.T @ moved.constraint_basis, np.zeros((len(z.T), k, 6 - k))),
            Identity("power of an actuator = tau . q'", power(moved.wrench(tau), H @ rate), spent),
        ]
    return identities


_LIE = "ad, ad*, Ad, Ad*, Exp, Log and the Jacobians, 13 identities"
_MECHANICS = "joints in random frames, 3 statements: unit power, reciprocity, power of an actuator"


def _lie(order: Order) -> float:
    return max(worst_errors(lie_identities(random_values(), order), random_values(), order).values())


def _joints() -> float:
    return max(worst_errors(joint_identities(random_values()), random_values()).values())


IDENTITIES: Section = [
    quick(_LIE, "twists [v; w]", at_most(1e-12), _lie, LINEAR_FIRST),
    quick(_LIE, "twists [w; v]", at_most(1e-12), _lie, ANGULAR_FIRST),
    quick(_MECHANICS, "tx.mechanics", at_most(1e-13), _joints),
]
