"""Identities of Lie algebra, joints and bodies on random values, against references that share no formula with them.

The references are 4x4 matrices, forces that act at points, clouds of point masses summed one by one, and SciPy's `expm`
and `Rotation`. Where a pairing is checked, each side is transformed by itself. An error is the largest entry of the
difference, relative to the largest entry of the reference where that is above 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

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

__all__ = ["JOINTS", "SECTION", "Identity", "body_identities", "joint_identities", "lie_identities", "worst_errors"]

_CASES, _POINTS = 200, 5
_SEED = 20240607

Array = np.ndarray
#: The leaves of one case, and what they are made of, by name.
Values = Mapping[str, Array]


@dataclass(frozen=True)
class Identity:
    """What the package computes, and the same computed without it from the values of one case."""

    name: str
    expression: Expr
    reference: Callable[[Values], Array]


def worst_errors(identities: Sequence[Identity], order: Order = LINEAR_FIRST, cases: int = _CASES) -> dict[str, float]:
    """The worst case of each, by name, of the simplified expressions. Needs JAX's x64 switch."""
    values = _values(order, cases)
    function = tx.lower([each.expression.canonicalize() for each in identities])
    names = {leaf.name for leaf in leaves_of(*(each.expression for each in identities))}
    x = {name: np.stack([z[name] for z in values]) for name in names & values[0].keys()}
    worst: dict[str, float] = {}
    for each, results in zip(identities, jax.jit(jax.vmap(partial(function, 0.0)))(x), strict=True):
        for z, got in zip(values, np.asarray(results), strict=True):
            exact = each.reference(z)
            size = max(1.0, float(np.max(np.abs(exact), initial=0.0)))
            error = float(np.max(np.abs(got - exact), initial=0.0)) / size
            worst[each.name] = max(worst.get(each.name, 0.0), error)
    return worst


# ---- references: twists in the order given; T = T_ab maps coordinates of frame b to frame a -------------------------


def _join(v: Array, w: Array, order: Order) -> Array:
    return np.concatenate([v, w] if order.linear_leads else [w, v])


def _hat(xi: Array, order: Order = LINEAR_FIRST) -> Array:
    """xi^ = [[w]x v; 0 0] (4, 4)."""
    v, w = (xi[:3], xi[3:]) if order.linear_leads else (xi[3:], xi[:3])
    return np.block([[np.cross(np.eye(3), w), v[:, None]], [np.zeros((1, 4))]])


def _vee(X: Array, order: Order) -> Array:
    return _join(X[:3, 3], np.array([X[2, 1], X[0, 2], X[1, 0]]), order)


def _commutator(order: Order, xi: Array, eta: Array) -> Array:
    """(X Y - Y X)^v of X = xi^, Y = eta^."""
    X, Y = _hat(xi, order), _hat(eta, order)
    return _vee(X @ Y - Y @ X, order)


def _bracket(order: Order, xi: Array) -> Array:
    """The matrix (6, 6) of eta -> [xi, eta]."""
    return np.stack([_commutator(order, xi, unit) for unit in np.eye(6)], axis=1)


def _conjugate(order: Order, T: Array, xi: Array) -> Array:
    """(T xi^ T^-1)^v."""
    return _vee(T @ _hat(xi, order) @ np.linalg.inv(T), order)


def _total(points: Array, forces: Array, order: Order = LINEAR_FIRST) -> Array:
    """Force and torque about the origin of forces that act at points."""
    return _join(forces.sum(axis=0), np.cross(points, forces).sum(axis=0), order)


def _total_in_a(order: Order, z: Values, forces: Array) -> Array:
    """The same of points and forces given in frame b, about the origin of a, in its axes."""
    return _total(_moved_points(z), forces @ z["T"][:3, :3].T, order)


def _moved_points(z: Values) -> Array:
    return z["points"] @ z["T"][:3, :3].T + z["T"][:3, 3]


def _mean_exponential(M: Array) -> Array:
    """The integral of expm(s M) over s from 0 to 1, as a block of one larger exponential."""
    n = len(M)
    return expm(np.block([[M, np.eye(n)], [np.zeros((n, 2 * n))]]))[:n, n:]


def _velocities(xi: Array, points: Array) -> Array:
    """What a twist does to points: X [r; 1]."""
    return points @ _hat(xi)[:3, :3].T + xi[:3]


def _mass_matrix(points: Array, masses: Array) -> Array:
    """Entry (i, j): the sum over the points of mass times the velocities that unit twists i and j give it."""
    unit = np.stack([_velocities(xi, points) for xi in np.eye(6)])
    return np.einsum("p,ipx,jpx->ij", masses, unit, unit)


def _momenta(z: Values) -> Array:
    """Of each point."""
    return z["masses"][:, None] * _velocities(z["V"], z["points"])


def _kinetic_energy(z: Values) -> Array:
    return np.asarray(0.5 * np.sum(_momenta(z) * _velocities(z["V"], z["points"])))


def _pose(position: Array, turn: Array) -> Array:
    """By SciPy's quaternions, orthonormal to the last digit or two."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), position
    return T


def _sums(points: Array, masses: Array, suffix: str) -> dict[str, Array]:
    """Mass, centre of mass, and inertia about it of a cloud."""
    m = masses.sum()
    c = masses @ points / m
    tensor = sum(mass * ((r @ r) * np.eye(3) - np.outer(r, r)) for mass, r in zip(masses, points - c, strict=True))
    return {f"m{suffix}": np.asarray(m), f"c{suffix}": c, f"I{suffix}": np.asarray(tensor)}


def _values(order: Order, cases: int) -> list[dict[str, Array]]:
    """Random values; the rotation of every twist is below a half turn, so that Log has one answer."""
    rng = np.random.default_rng(_SEED)
    found = []
    for _ in range(cases):
        axes = rng.normal(size=(2, 3))
        turns = axes / np.linalg.norm(axes, axis=1)[:, None] * rng.uniform(0.0, 3.1, size=(2, 1))
        xi, log = (_join(v, w, order) for v, w in zip(2.0 * rng.normal(size=(2, 3)), turns, strict=True))
        T = expm(_hat(log, order))
        # To the last digit or two, which expm is not.
        T[:3, :3] = Rotation.from_rotvec(turns[1]).as_matrix()
        points, points2, forces = rng.normal(size=(3, _POINTS, 3))
        masses, masses2 = rng.uniform(0.5, 2.0, size=(2, _POINTS))
        z = {"points": points, "points2": points2, "forces": forces, "masses": masses, "masses2": masses2}
        z |= {"xi": xi, "log": log, "T": T, "pose": _pose(*rng.normal(size=(2, 3)))}
        z |= {name: rng.normal(size=6) for name in ("eta", "V", "tau", "rate")}
        z |= {"F": _total(points, forces, order), "q": np.asarray(rng.uniform(-6.0, 6.0))}
        z |= {"gravity": rng.normal(size=3)} | _sums(points, masses, "") | _sums(points2, masses2, "2")
        found.append(z)
    return found


# ---- Lie algebra ----------------------------------------------------------------------------------------------------

_xi, _eta, _F = (State(name, shape=(6,)) for name in ("xi", "eta", "F"))
_V, _tau, _rate = (State(name, shape=(6,)) for name in ("V", "tau", "rate"))
_T, _R = State("T", shape=(4, 4)), State("pose", shape=(4, 4))
_q, _gravity = State("q"), State("gravity", shape=(3,))


def lie_identities(o: Order) -> list[Identity]:
    """Of the brackets, the adjoints, Exp, Log and the Jacobians in an order."""
    Ad, coAd = partial(lie.SE3Adjoint, order=o), partial(lie.SE3AdjointDual, order=o)
    ad, Exp = partial(lie.Adjoint, order=o), partial(lie.SE3Exp, order=o)
    pairing = Dot(lie.AdjointDual(_xi, _F, order=o), _eta) + Dot(_F, ad(_xi, _eta))

    def mean(sign: float) -> Callable[[Values], Array]:
        return lambda z: _mean_exponential(sign * _bracket(o, z["xi"]))

    def inverse(sign: float) -> Callable[[Values], Array]:
        return lambda z: np.linalg.inv(mean(sign)(z))

    return [
        Identity("ad_xi eta = (X Y - Y X)^v", ad(_xi, _eta), lambda z: _commutator(o, z["xi"], z["eta"])),
        Identity("<ad*_xi F, eta> + <F, ad_xi eta> = 0", pairing, lambda z: np.zeros(())),
        Identity("Ad_T eta = (T Y T^-1)^v", Ad(_T) @ _eta, lambda z: _conjugate(o, z["T"], z["eta"])),
        Identity("Ad*_T F: forces at points, moved", coAd(_T) @ _F, lambda z: _total_in_a(o, z, z["forces"])),
        Identity(
            "<Ad*_T F, Ad_T eta> = <F, eta>", Dot(coAd(_T) @ _F, Ad(_T) @ _eta), lambda z: np.asarray(z["F"] @ z["eta"])
        ),
        Identity("Exp xi = expm(X)", Exp(_xi), lambda z: expm(_hat(z["xi"], o))),
        Identity("Log expm(X) = xi", lie.SE3Log(_T, order=o), lambda z: z["log"]),
        Identity("Ad_Exp(xi) = expm(ad_xi)", Ad(Exp(_xi)), lambda z: expm(_bracket(o, z["xi"]))),
        Identity("Ad*_Exp(xi) = expm(-ad_xi^T)", coAd(Exp(_xi)), lambda z: expm(-_bracket(o, z["xi"]).T)),
        Identity("J_l = integral of expm(s ad)", lie.LeftJacobian(_xi, order=o), mean(1.0)),
        Identity("J_r = integral of expm(-s ad)", lie.RightJacobian(_xi, order=o), mean(-1.0)),
        Identity("J_l^-1", lie.LeftJacobianInverse(_xi, order=o), inverse(1.0)),
        Identity("J_r^-1", lie.RightJacobianInverse(_xi, order=o), inverse(-1.0)),
    ]


# ---- joints ---------------------------------------------------------------------------------------------------------

#: One joint of each kind, and its motion subspace by hand; the oblique axes have length 3.
JOINTS: tuple[tuple[joints.Joint, Array], ...] = (
    (joints.Revolute("hinge", axis=(0.0, 0.0, 1.0)), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]).T),
    (joints.Revolute("oblique", axis=(1.0, -2.0, 2.0)), np.array([[0.0, 0.0, 0.0, 1.0, -2.0, 2.0]]).T / 3.0),
    (joints.Prismatic("slide", axis=(2.0, 2.0, 1.0)), np.array([[2.0, 2.0, 1.0, 0.0, 0.0, 0.0]]).T / 3.0),
    (joints.Spherical("ball"), np.vstack([np.zeros((3, 3)), np.eye(3)])),
    (joints.Free("free"), np.eye(6)),
    (joints.Fixed("weld"), np.zeros((6, 0))),
)


def _first(vector: Expr, count: int) -> Expr:
    return vector[:count] if count else Constant(np.zeros(0))


def _moved_motions(H: Array, z: Values) -> Array:
    columns = [_conjugate(LINEAR_FIRST, z["T"], column) for column in H.T]
    return np.stack(columns, axis=1) if columns else H


def _virtual_work(H: Array, z: Values) -> Array:
    """The work of the forces at the points for a unit of each motion."""
    return np.array([np.sum(z["forces"] * _velocities(column, z["points"])) for column in H.T])


def joint_identities() -> list[Identity]:
    """Of every joint in a random frame."""
    return [identity for joint, H in JOINTS for identity in _of_joint(joint, H)]


def _of_joint(joint: joints.Joint, H: Array) -> list[Identity]:
    k, moved = H.shape[1], joint.screws_in(_T)
    motions, F_a = moved.motion_subspace, lie.SE3AdjointDual(_T) @ _F
    dual, reaction = moved.actuation_basis.T @ motions, moved.actuation(moved.reaction(F_a))
    work = power(moved.wrench(_first(_tau, k)), motions @ _first(_rate, k))
    found = [
        Identity("Ad_T H = (T h^ T^-1)^v", motions, lambda z: _moved_motions(H, z)),
        Identity("h*^T H = I", dual, lambda z: np.eye(k)),
        Identity("reciprocity: H^T H-bar* = 0", motions.T @ moved.constraint_basis, lambda z: np.zeros((k, 6 - k))),
        Identity("reaction: H^T (F - h* H^T F) = 0", reaction, lambda z: np.zeros(k)),
        Identity("H^T F = virtual work at points", moved.actuation(F_a), lambda z: _virtual_work(H, z)),
        Identity("power of an actuator = tau . q'", work, lambda z: np.asarray(z["tau"][:k] @ z["rate"][:k])),
    ]
    if k == 1:
        # One of the parts of the motion is zero, so that the other is the way or the turn itself.
        placed, v, w = joint.placement(_q * np.ones(1)), H[:3, 0], H[3:, 0]
        found.append(Identity("T_pc of a hinge, of a slide", placed, lambda z: _pose(z["q"] * v, z["q"] * w)))
    return found


# ---- bodies ---------------------------------------------------------------------------------------------------------


def _body(suffix: str) -> SpatialInertia:
    m, c, tensor = State(f"m{suffix}"), State(f"c{suffix}", shape=(3,)), State(f"I{suffix}", shape=(3, 3))
    return SpatialInertia(mass=m, center_of_mass=c, inertia=tensor)


def _both(z: Values) -> Array:
    points = np.concatenate([_moved_points(z), z["points2"]])
    return _mass_matrix(points, np.concatenate([z["masses"], z["masses2"]]))


def _acceleration(z: Values) -> Array:
    carried = _bracket(LINEAR_FIRST, z["V"]).T @ _total(z["points"], _momenta(z))
    return np.linalg.solve(_mass_matrix(z["points"], z["masses"]), z["F"] + carried)


def _weight(z: Values) -> Array:
    return _total(z["points"], z["masses"][:, None] * (z["pose"][:3, :3].T @ z["gravity"]))


def _power(z: Values) -> Array:
    return np.asarray(np.sum(z["forces"] * _velocities(z["V"], z["points"])))


def body_identities() -> list[Identity]:
    """Of bodies, in their own frame and in a random one."""
    body, other, V_a = _body(""), _body("2"), lie.SE3Adjoint(_T) @ _V
    moved = body.in_frame(_T)
    return [
        Identity("M", body.matrix, lambda z: _mass_matrix(z["points"], z["masses"])),
        Identity("M in another frame", moved.matrix, lambda z: _mass_matrix(_moved_points(z), z["masses"])),
        Identity("M of two bodies in one frame", (moved + other).matrix, _both),
        Identity("momentum", body.momentum(_V), lambda z: _total(z["points"], _momenta(z))),
        Identity("momentum in another frame", moved.momentum(V_a), lambda z: _total_in_a(LINEAR_FIRST, z, _momenta(z))),
        Identity("kinetic energy", body.kinetic_energy(_V), _kinetic_energy),
        Identity("kinetic energy in another frame", moved.kinetic_energy(V_a), _kinetic_energy),
        Identity("weight", body.weight(_R, _gravity), _weight),
        Identity("acceleration", body.acceleration(_V, _F), _acceleration),
        Identity("power of forces at points", power(lie.SE3AdjointDual(_T) @ _F, V_a), _power),
    ]


# ---- checks ---------------------------------------------------------------------------------------------------------


def _of_joints_and_bodies() -> float:
    return max(worst_errors([*joint_identities(), *body_identities()]).values())


SECTION = Section(
    "identities",
    "Identities",
    f"{_CASES} random cases each, against matrices, forces at points, clouds of point masses and SciPy: the worst "
    "error, relative to the reference where that is above 1.",
    {
        "": [
            *(
                Check(
                    "ad, ad*, Ad, Ad*, Exp, Log and the Jacobians, 13 identities",
                    f"twists {name}",
                    lambda order=order: max(worst_errors(lie_identities(order), order).values()),  # type: ignore[misc]
                    at_most(1e-12),
                )
                for name, order in (("[v; w]", LINEAR_FIRST), ("[w; v]", ANGULAR_FIRST))
            ),
            Check(
                "joints and bodies in random frames, 17 statements: reciprocity, power, transforms, point clouds",
                "tx.mechanics",
                _of_joints_and_bodies,
                at_most(1e-13),
            ),
        ]
    },
)
