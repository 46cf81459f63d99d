"""Identities of Lie algebra, joints and bodies on random values, against references that share no formula with them.

The references are 4x4 matrices, forces that act at points, clouds of point masses summed one by one, and SciPy's `expm`
and `Rotation`. Where a pairing is checked, each side is transformed by itself. An error is the largest entry of the
difference, relative to the largest entry of the reference where that is above 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import jax
import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import twistax as tx

from ...expr import Constant, Expr, State, leaves_of, lie
from ...expr.linalg import Dot
from ...groups import ANGULAR_FIRST, LINEAR_FIRST, Order
from ...mechanics import SpatialInertia, joints, power
from ..checks import Check, Section, at_most

_CASES, _POINTS, _SEED = 200, 5, 20240607

Array = np.ndarray
#: Arrays with a leading axis of cases, by name: the leaves, and what they are made of; twists are [v; w].
Values = SimpleNamespace


@dataclass(frozen=True)
class Identity:
    """What the package computes, and the same of all cases computed without it."""

    name: str
    expression: Expr
    reference: Array


def worst_errors(identities: Sequence[Identity], z: Values, order: Order = LINEAR_FIRST) -> dict[str, float]:
    """The worst case of each, by name, of the simplified expressions. Needs JAX's x64 switch."""
    names = {leaf.name for leaf in leaves_of(*(each.expression for each in identities))} & vars(z).keys()
    function = tx.lower([each.expression.canonicalize() for each in identities])
    results = jax.jit(jax.vmap(partial(function, 0.0)))({name: _ordered(getattr(z, name), order) for name in names})
    worst: dict[str, float] = {}
    for each, found in zip(identities, results, strict=True):
        exact = _ordered(each.reference, order).reshape(len(z.T), -1)
        size = np.maximum(1.0, np.max(np.abs(exact), axis=1, initial=0.0))
        errors = np.max(np.abs(np.asarray(found).reshape(exact.shape) - exact), axis=1, initial=0.0) / size
        worst[each.name] = float(np.max([worst.get(each.name, 0.0), *errors]))
    return worst


def _ordered(value: Array, order: Order) -> Array:
    """Every axis of six entries of [v; w], but for that of the cases, in an order."""
    axes = [axis for axis in range(1, value.ndim) if value.shape[axis] == 6 and not order.linear_leads]
    return np.roll(value, [3] * len(axes), axes)


# ---- references: T = T_ab maps coordinates of frame b to frame a ----------------------------------------------------


def _hat(xi: Array) -> Array:
    """xi^ = [[w]x v; 0 0] (..., 4, 4)."""
    X = np.zeros((*xi.shape[:-1], 4, 4))
    X[..., :3, :3], X[..., :3, 3] = np.cross(np.eye(3), xi[..., None, 3:]), xi[..., :3]
    return X


def _vee(X: Array) -> Array:
    return np.stack([*(X[..., i, 3] for i in range(3)), X[..., 2, 1], X[..., 0, 2], X[..., 1, 0]], axis=-1)


def _bracket(xi: Array) -> Array:
    """The matrices (n, 6, 6) of eta -> (X Y - Y X)^v, X = xi^, Y = eta^."""
    X, Y = _hat(xi)[:, None], _hat(np.eye(6))
    return np.swapaxes(_vee(X @ Y - Y @ X), 1, 2)


def _conjugate(T: Array, xi: Array) -> Array:
    """(T xi^ T^-1)^v."""
    return _vee(T @ _hat(xi) @ np.linalg.inv(T))


def _mean_exponential(M: Array) -> Array:
    """The integral of expm(s M) over s from 0 to 1, as a block of one larger exponential."""
    return expm(np.pad(M, ((0, 0), (0, 6), (0, 6))) + np.eye(12, k=6))[:, :6, 6:]


def _total(points: Array, forces: Array) -> Array:
    """Force and torque about the origin of forces that act at points."""
    return np.concatenate([forces.sum(axis=1), np.cross(points, forces).sum(axis=1)], axis=1)


def _velocities(xi: Array, points: Array) -> Array:
    """What twists (..., 6) do to points: X [r; 1]."""
    X = _hat(xi)
    return np.einsum("...ij,...pj->...pi", X[..., :3, :3], points) + X[..., None, :3, 3]


def _mass_matrix(points: Array, masses: Array) -> Array:
    """Entry (i, j): the sum over the points of mass times the velocities that unit twists i and j give it."""
    unit = _velocities(np.eye(6), points[:, None])
    return np.einsum("np,nipx,njpx->nij", masses, unit, unit)


def random_values(cases: int = _CASES) -> Values:
    """Random values; the rotation of every twist is below a half turn, so that Log has one answer."""
    rng, z = np.random.default_rng(_SEED), Values()
    turns = rng.normal(size=(2, cases, 3))
    turns *= rng.uniform(0.0, 3.1, size=(2, cases, 1)) / np.linalg.norm(turns, axis=2, keepdims=True)
    z.xi, z.log = np.concatenate([2.0 * rng.normal(size=(2, cases, 3)), turns], axis=2)
    z.points, z.forces = rng.normal(size=(2, cases, _POINTS, 3))
    z.eta, z.V, z.tau, z.rate = rng.normal(size=(4, cases, 6))
    z.gravity, z.masses = rng.normal(size=(cases, 3)), rng.uniform(0.5, 2.0, size=(cases, _POINTS))
    # By SciPy's quaternions, orthonormal to the last digit or two, which expm is not.
    z.T = expm(_hat(z.log))
    z.T[:, :3, :3] = Rotation.from_rotvec(z.log[:, 3:]).as_matrix()
    R = np.swapaxes(z.T[:, :3, :3], 1, 2)
    z.moved, z.turned, z.down = z.points @ R + z.T[:, None, :3, 3], z.forces @ R, z.gravity[:, None] @ z.T[:, :3, :3]
    z.F, z.m = _total(z.points, z.forces), z.masses.sum(axis=1)
    z.c = np.einsum("np,npx->nx", z.masses, z.points) / z.m[:, None]
    arms = z.points - z.c[:, None]
    squares = np.einsum("npx,npx->np", arms, arms)[..., None, None] * np.eye(3) - arms[..., None] * arms[..., None, :]
    z.I = np.einsum("np,npxy->nxy", z.masses, squares)
    z.momenta = z.masses[..., None] * _velocities(z.V, z.points)
    return z


# ---- Lie algebra ----------------------------------------------------------------------------------------------------

_xi, _eta, _F, _V, _tau, _rate = (State(name, shape=(6,)) for name in ("xi", "eta", "F", "V", "tau", "rate"))
_T, _gravity = State("T", shape=(4, 4)), State("gravity", shape=(3,))


def lie_identities(z: Values, o: Order) -> list[Identity]:
    """Of the brackets, the adjoints, Exp, Log and the Jacobians in an order."""
    Ad, coAd = partial(lie.SE3Adjoint, order=o), partial(lie.SE3AdjointDual, order=o)
    ad, Exp, B = partial(lie.Adjoint, order=o), partial(lie.SE3Exp, order=o), _bracket(z.xi)
    pairing, power = Dot(lie.AdjointDual(_xi, _F, order=o), _eta) + Dot(_F, ad(_xi, _eta)), np.sum(z.F * z.eta, axis=1)
    left, right, dual = _mean_exponential(B), _mean_exponential(-B), expm(-np.swapaxes(B, 1, 2))
    return [
        Identity("ad_xi eta = (X Y - Y X)^v", ad(_xi, _eta), np.einsum("nij,nj->ni", B, z.eta)),
        Identity("<ad*_xi F, eta> + <F, ad_xi eta> = 0", pairing, np.zeros(len(z.xi))),
        Identity("Ad_T eta = (T Y T^-1)^v", Ad(_T) @ _eta, _conjugate(z.T, z.eta)),
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


# ---- joints and bodies ----------------------------------------------------------------------------------------------

#: One joint of each kind, and its motion subspace by hand; the oblique axes have length 3.
JOINTS: tuple[tuple[joints.Joint, Array], ...] = (
    (joints.Revolute("hinge", axis=(0.0, 0.0, 1.0)), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]).T),
    (joints.Revolute("oblique", axis=(1.0, -2.0, 2.0)), np.array([[0.0, 0.0, 0.0, 1.0, -2.0, 2.0]]).T / 3.0),
    (joints.Prismatic("slide", axis=(2.0, 2.0, 1.0)), np.array([[2.0, 2.0, 1.0, 0.0, 0.0, 0.0]]).T / 3.0),
    (joints.Spherical("ball"), np.vstack([np.zeros((3, 3)), np.eye(3)])),
    (joints.Free("free"), np.eye(6)),
    (joints.Fixed("weld"), np.zeros((6, 0))),
)


def joint_identities(z: Values) -> list[Identity]:
    """Of every joint in a random frame."""
    return [identity for joint, H in JOINTS for identity in _of_joint(z, joint, H)]


def _of_joint(z: Values, joint: joints.Joint, H: Array) -> list[Identity]:
    n, k, moved = len(z.T), H.shape[1], joint.screws_in(_T)
    tau, rate = (leaf[:k] if k else Constant(np.zeros(0)) for leaf in (_tau, _rate))
    motions, actuation = moved.motion_subspace, moved.actuation(lie.SE3AdjointDual(_T) @ _F)
    turned = np.swapaxes(_conjugate(z.T[:, None], H.T), 1, 2)
    # Of the forces at the points for a unit of each motion.
    work = np.einsum("npx,nkpx->nk", z.forces, _velocities(H.T, z.points[:, None]))
    spent = np.sum(z.tau[:, :k] * z.rate[:, :k], axis=1)
    none = np.zeros((n, k, 6 - k))
    return [
        Identity("Ad_T H = (T h^ T^-1)^v", motions, turned),
        Identity("h*^T H = I", moved.actuation_basis.T @ motions, np.tile(np.eye(k), (n, 1, 1))),
        Identity("reciprocity: H^T H-bar* = 0", motions.T @ moved.constraint_basis, none),
        Identity("H^T F = virtual work at points", actuation, work),
        Identity("power of an actuator = tau . q'", power(moved.wrench(tau), motions @ rate), spent),
    ]


def body_identities(z: Values) -> list[Identity]:
    """Of a body, in its own frame and in a random one."""
    body = SpatialInertia(mass=State("m"), center_of_mass=State("c", shape=(3,)), inertia=State("I", shape=(3, 3)))
    M, momentum = _mass_matrix(z.points, z.masses), _total(z.points, z.momenta)
    net = z.F + np.einsum("nji,nj->ni", _bracket(z.V), momentum)
    return [
        Identity("M", body.matrix, M),
        Identity("M in another frame", body.in_frame(_T).matrix, _mass_matrix(z.moved, z.masses)),
        Identity("momentum", body.momentum(_V), momentum),
        Identity("weight", body.weight(_T, _gravity), _total(z.points, z.masses[..., None] * z.down)),
        Identity("acceleration", body.acceleration(_V, _F), np.linalg.solve(M, net[..., None])[..., 0]),
    ]


def _lie(name: str, order: Order) -> Check:
    what, z = "ad, ad*, Ad, Ad*, Exp, Log and the Jacobians, 13 identities", random_values
    return Check(what, name, lambda: max(worst_errors(lie_identities(z(), order), z(), order).values()), at_most(1e-12))


def _mechanics() -> float:
    z = random_values()
    return max(worst_errors([*joint_identities(z), *body_identities(z)], z).values())


_STATEMENTS = "joints and bodies in random frames, 10 statements: reciprocity, power, transforms, point clouds"

IDENTITIES = Section(
    "identities",
    [
        _lie("twists [v; w]", LINEAR_FIRST),
        _lie("twists [w; v]", ANGULAR_FIRST),
        Check(_STATEMENTS, "tx.mechanics", _mechanics, at_most(1e-13)),
    ],
)
