"""Where published formulas are wrong: for each row of docs/conventions.md a law that ours keeps and theirs breaks.

Each law is stated without either formula: point forces and point masses, 4x4 matrices, commutators, SciPy's `expm`.
Putting a published formula in place of ours makes its row fail: the same law must also refuse the published one.
"""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import twistax as tx
from oracles import hat, skew
from twistax.mechanics import SpatialInertia
from twistax.tableaus import RK4

Array = np.ndarray
rng = np.random.default_rng(11)
O, I = np.zeros((3, 3)), np.eye(3)


def vee(X: Array) -> Array:
    return np.array([*X[:3, 3], X[2, 1], X[0, 2], X[1, 0]])


def commutator(a: Array, b: Array) -> Array:
    return vee(hat(a) @ hat(b) - hat(b) @ hat(a))


# One random case of everything; T = T_ab has a rotation and a position that do not commute.
xi, eta, mu, F = rng.normal(size=(4, 6))
T = expm(hat(rng.normal(size=6)))
R, r = T[:3, :3], T[:3, 3]
points, forces = rng.normal(size=(2, 5, 3))
masses = rng.uniform(0.5, 2.0, size=5)


def wrench_of(points: Array, forces: Array) -> Array:
    """Force and torque about the origin of forces that act at points."""
    return np.concatenate([forces.sum(axis=0), np.cross(points, forces).sum(axis=0)])


def value(expr: tx.Expr, **leaves: Array) -> Array:
    return np.asarray(tx.lower(expr)(0.0, leaves))


def six(name: str) -> tx.State:
    return tx.State(name, shape=(6,))


pose = tx.State("T", group=tx.SE3)


# ---- ours, as a user writes them -----------------------------------------------------------------------------------


def coad(xi: Array, mu: Array) -> Array:
    return value(tx.lie.AdjointDual(six("xi"), six("mu")), xi=xi, mu=mu)


def ad(xi: Array, eta: Array) -> Array:
    return value(tx.lie.Adjoint(six("xi"), six("eta")), xi=xi, eta=eta)


def Ad(T: Array, xi: Array) -> Array:
    return value(tx.lie.SE3Adjoint(pose) @ six("xi"), T=T, xi=xi)


def Ad_inverse(T: Array, xi: Array) -> Array:
    return value(tx.lie.SE3Adjoint(tx.lie.Inverse(pose)) @ six("xi"), T=T, xi=xi)


def Ad_dual(T: Array, F: Array) -> Array:
    return value(tx.lie.SE3AdjointDual(pose) @ six("F"), T=T, F=F)


def Ad_dual_inverse(T: Array, F: Array) -> Array:
    return value(tx.lie.SE3AdjointDual(tx.lie.Inverse(pose)) @ six("F"), T=T, F=F)


def Ad_transposed(T: Array, F: Array) -> Array:
    return value(tx.lie.SE3Adjoint(pose).T @ six("F"), T=T, F=F)


# ---- laws: the size of what is left over ---------------------------------------------------------------------------


def pairing(coadjoint: Callable[[Array, Array], Array]) -> float:
    """<ad*_xi mu, eta> + <mu, [xi, eta]> = 0, the bracket being the commutator of 4x4 matrices."""
    return abs(coadjoint(xi, mu) @ eta + mu @ commutator(xi, eta))


def bracket(adjoint: Callable[[Array, Array], Array]) -> float:
    """ad_xi eta is the commutator."""
    return float(np.abs(adjoint(xi, eta) - commutator(xi, eta)).max())


def conjugation(adjoint: Callable[[Array, Array], Array]) -> float:
    """(Ad_T xi)^ = T xi^ T^-1."""
    return float(np.abs(adjoint(T, xi) - vee(T @ hat(xi) @ np.linalg.inv(T))).max())


def conjugation_back(adjoint: Callable[[Array, Array], Array]) -> float:
    """(Ad_T^-1 xi)^ = T^-1 xi^ T."""
    return float(np.abs(adjoint(T, xi) - vee(np.linalg.inv(T) @ hat(xi) @ T)).max())


def transport(coadjoint: Callable[[Array, Array], Array]) -> float:
    """Forces at points, their total wrench taken in frame b and mapped to a, or taken in a."""
    in_a = wrench_of(points @ R.T + r, forces @ R.T)
    return float(np.abs(coadjoint(T, wrench_of(points, forces)) - in_a).max())


def transport_back(coadjoint: Callable[[Array, Array], Array]) -> float:
    """The same from a to b."""
    in_b = wrench_of((points - r) @ R, forces @ R)
    return float(np.abs(coadjoint(T, wrench_of(points, forces)) - in_b).max())


def translation(coadjoint: Callable[[Array, Array], Array]) -> float:
    """Forces at points, seen from a frame with the same axes and another origin."""
    return float(np.abs(coadjoint(r, wrench_of(points, forces)) - wrench_of(points - r, forces)).max())


def landing_place(position_in_world: Callable[[Array], Array]) -> float:
    """A body at r with axes R: its point q is at r + R q in the world."""
    return float(np.abs(position_in_world(points[0]) - (r + R @ points[0])).max())


def vanishing(product: Callable[[Array, Array, Array], Array]) -> float:
    """What is claimed to be zero of H, h* and H-bar* of a hinge about z, all of them seen from another frame."""
    units = np.eye(6)
    constraint = np.stack([Ad_dual(T, unit) for unit in units[:5]], axis=1)
    return float(np.abs(product(Ad(T, units[5]), Ad_dual(T, units[5]), constraint)).max())


def kinetic_energy(transformed: Callable[[Array, Array], Array]) -> float:
    """The inertia of a cloud of masses in frame b, mapped to a, gives the energy of the same masses in a."""
    in_b = sum(
        m * np.block([[I, -skew(c)], [skew(c), -skew(c) @ skew(c)]]) for m, c in zip(masses, points, strict=True)
    )
    velocities = xi[:3] + np.cross(xi[3:], points @ R.T + r)
    return abs(xi @ transformed(T, in_b) @ xi - masses @ (velocities**2).sum(axis=1))


def left_perturbation(jacobian: Callable[[Array], Array]) -> float:
    """Exp(w + d) = Exp(J_l(w) d) Exp(w) to first order, by central differences of SciPy's expm."""
    w, step = xi[3:], 1e-5
    slopes = [(expm(skew(w + step * d)) - expm(skew(w - step * d))) @ expm(-skew(w)) / (2 * step) for d in I]
    columns = [[X[2, 1], X[0, 2], X[1, 0]] for X in slopes]
    return float(np.abs(jacobian(w) - np.stack(columns, axis=1)).max())


def missing_order(pull_back: Callable[[jax.Array], jax.Array]) -> float:
    """How far from 4 the observed order of Munthe-Kaas steps with RK4 is, for a force-free asymmetric body."""
    J = np.array([1.0, 2.0, 3.0])
    v0, w0 = np.array([0.4, -0.2, 0.3]), np.array([0.9, 1.4, -0.7])

    def slope(eta: jax.Array, V: jax.Array) -> tuple[jax.Array, jax.Array]:
        v, w = V[:3], V[3:]
        return pull_back(eta) @ V, jnp.concatenate([jnp.cross(v, w), jnp.cross(J * w, w) / J])

    def step(g: jax.Array, V: jax.Array, h: jax.Array) -> tuple[jax.Array, jax.Array]:
        stages: list[tuple[jax.Array, jax.Array]] = []
        for row in (*RK4.a, RK4.b):
            eta, gain = (h * sum((a * k[i] for a, k in zip(row, stages) if a), jnp.zeros(6)) for i in range(2))
            stages.append(slope(eta, V + gain))
        return g @ tx.lie.se3.exp(eta), V + gain

    @jax.jit
    def end(count: jax.Array) -> jax.Array:
        start = (jnp.eye(4), jnp.asarray(np.concatenate([v0, w0])))
        return jax.lax.fori_loop(0, count, lambda _, state: step(*state, 1.0 / count), start)[0]

    def matrices(t: float, y: Array) -> Array:
        g, v, w = y[:16].reshape(4, 4), y[16:19], y[19:]
        return np.concatenate([(g @ hat(y[16:])).ravel(), np.cross(v, w), np.cross(J * w, w) / J])

    start = np.concatenate([np.eye(4).ravel(), v0, w0])
    exact = solve_ivp(matrices, (0.0, 1.0), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:16, -1].reshape(4, 4)
    errors = [np.abs(end(count) - exact).max() for count in (20, 40, 80)]
    return abs(np.polyfit(np.log([20, 40, 80]), -np.log(errors), 1)[0] - 4.0)


# ---- the rows ------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Erratum:
    """A published formula, ours in its place, and the law that tells them apart."""

    row: str
    law: Callable[..., float]
    ours: Callable[..., Array]
    published: Callable[..., Array]
    tolerance: float = 1e-12


def moved_inertia(T: Array, M: Array) -> Array:
    mass, first = M[0, 0], M[3:, :3]
    centre = np.array([first[2, 1], first[0, 2], first[1, 0]]) / mass
    about_centre = M[3:, 3:] + mass * skew(centre) @ skew(centre)
    body = SpatialInertia(mass=mass, center_of_mass=centre, inertia=about_centre)
    return value(body.in_frame(pose).matrix, T=T)


def parts(six: Array) -> tuple[Array, Array]:
    return six[:3], six[3:]


def openscvx_coad(xi: Array, mu: Array) -> Array:
    (v, w), (f, tau) = parts(xi), parts(mu)
    return np.concatenate([np.cross(w, f) + np.cross(v, tau), np.cross(w, tau)])


def openscvx_ad_matrix(xi: Array, eta: Array) -> Array:
    v, w = parts(xi)
    return np.block([[skew(w), O], [skew(v), skew(w)]]) @ eta


ROWS = [
    Erratum("O1", pairing, coad, openscvx_coad),
    Erratum("O2", conjugation, Ad, lambda T, xi: np.block([[R, O], [skew(r) @ R, R]]) @ xi),
    Erratum("O3", transport, Ad_dual, lambda T, F: np.block([[R, skew(r) @ R], [O, R]]) @ F),
    Erratum("O4", bracket, ad, openscvx_ad_matrix),
    Erratum(
        "O5",
        landing_place,
        lambda q: value(tx.lie.Act(pose, tx.State("q", shape=(3,))), T=T, q=q),
        lambda q: (np.linalg.inv(T) @ np.append(q, 1.0))[:3],
    ),
    Erratum("O6", transport_back, Ad_transposed, Ad_dual),
    Erratum("K1", conjugation_back, Ad_inverse, lambda T, xi: np.block([[R.T, skew(r) @ R.T], [O, R.T]]) @ xi),
    Erratum("K2", transport_back, Ad_dual_inverse, lambda T, F: np.block([[R.T, O], [-skew(r) @ R.T, R.T]]) @ F),
    Erratum("K3", vanishing, lambda H, working, constraint: H @ constraint, lambda H, working, bar: working @ bar),
    Erratum(
        "K4",
        translation,
        lambda r, F: Ad_dual_inverse(expm(hat(np.append(r, np.zeros(3)))), F),
        lambda r, F: -np.block([[I, O], [skew(r), I]]) @ F,
    ),
    Erratum("U1", missing_order, tx.lie.se3.right_jacobian_inv, tx.lie.se3.left_jacobian_inv, tolerance=0.15),
    Erratum(
        "U2",
        kinetic_energy,
        moved_inertia,
        lambda T, M: tx.lie.se3.Ad_dual(T) @ M @ tx.lie.se3.Ad(T),
    ),
    Erratum(
        "U3",
        left_perturbation,
        tx.lie.so3.left_jacobian,
        lambda w: (
            I
            - (1 - np.cos(np.linalg.norm(w))) / (w @ w) * skew(w)
            + (np.linalg.norm(w) - np.sin(np.linalg.norm(w))) / (w @ w) ** 1.5 * skew(w) @ skew(w)
        ),
        tolerance=1e-9,
    ),
]


@pytest.mark.parametrize("erratum", ROWS, ids=lambda erratum: erratum.row)
def test_the_law_keeps_ours_and_breaks_the_published_formula(erratum: Erratum) -> None:
    assert erratum.law(erratum.ours) < erratum.tolerance
    assert erratum.law(erratum.published) > 0.1


def test_every_row_of_the_page_is_held() -> None:
    page = (Path(__file__).parent.parent / "docs" / "conventions.md").read_text()
    assert re.findall(r"^\| ([OKU]\d) \|", page, re.MULTILINE) == [erratum.row for erratum in ROWS]


def test_published_claims_hold_where_they_seem_to() -> None:
    """A hinge through the origin: there the columns are orthogonal after all, and a test there cannot see K3."""
    units = np.eye(6)
    turn = expm(hat(np.append(np.zeros(3), rng.normal(size=3))))
    constraint = np.stack([Ad_dual(turn, unit) for unit in units[:5]], axis=1)
    assert np.abs(Ad_dual(turn, units[5]) @ constraint).max() < 1e-13
