"""Joints and bodies against references made of points: reciprocity, power and changes of frame, on random cases.

`python -m twistax.report.mechanics` prints the table.

The motions of the joints are written out by hand and moved as 4x4 matrices; wrenches are forces that act at points;
bodies are clouds of point masses, summed one by one. An error is the largest entry of the difference, relative to the
largest entry of the reference where that is above 1.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from ..expr import Constant, Expr, State, leaves_of
from ..expr.lie import SE3Adjoint, SE3AdjointDual
from ..groups import LINEAR_FIRST
from ..lowering import lower
from ..mechanics import SpatialInertia, joints, power
from .references import Values, bracket_matrix, conjugate, hat, total, total_in_a

__all__ = ["BAR", "Row", "main", "mechanics"]

BAR = 1e-13
"""The largest error allowed."""

_SEED = 20240608
_POINTS = 5

#: One joint of each kind, and its motion subspace written out; the oblique axes have length 3.
_JOINTS: tuple[tuple[joints.Joint, np.ndarray], ...] = (
    (joints.Revolute("hinge", axis=(0.0, 0.0, 1.0)), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]).T),
    (joints.Revolute("oblique", axis=(1.0, -2.0, 2.0)), np.array([[0.0, 0.0, 0.0, 1.0, -2.0, 2.0]]).T / 3.0),
    (joints.Prismatic("slide", axis=(2.0, 2.0, 1.0)), np.array([[2.0, 2.0, 1.0, 0.0, 0.0, 0.0]]).T / 3.0),
    (joints.Spherical("ball"), np.vstack([np.zeros((3, 3)), np.eye(3)])),
    (joints.Free("free"), np.eye(6)),
    (joints.Fixed("weld"), np.zeros((6, 0))),
)

_T, _R = State("T", shape=(4, 4)), State("pose", shape=(4, 4))
_F, _V, _tau, _rate = (State(name, shape=(6,)) for name in ("F", "V", "tau", "rate"))
_q, _gravity = State("q"), State("gravity", shape=(3,))


@dataclass(frozen=True)
class Row:
    """One line of the table: the worst case of one statement."""

    statement: str
    cases: int
    worst: float

    @property
    def holds(self) -> bool:
        return self.worst <= BAR


@dataclass(frozen=True)
class _Check:
    """What the package computes, and the same computed without it from the values of one case."""

    statement: str
    expression: Expr
    reference: Callable[[Values], np.ndarray]


# ---- joints -------------------------------------------------------------------------------------------------------


def _first(vector: Expr, count: int) -> Expr:
    return vector[:count] if count else Constant(np.zeros(0))


def _moved_motions(H: np.ndarray, z: Values) -> np.ndarray:
    columns = [conjugate(LINEAR_FIRST, z["T"], column) for column in H.T]
    return np.stack(columns, axis=1) if columns else H


def _virtual_work(H: np.ndarray, z: Values) -> np.ndarray:
    """The work of the forces at the points for a unit of each motion."""
    return np.array([np.sum(z["forces"] * _velocities(column, z["points"])) for column in H.T])


def _joint_checks(joint: joints.Joint, H: np.ndarray) -> Iterator[_Check]:
    k, moved = H.shape[1], joint.screws_in(_T)
    F_a = SE3AdjointDual(_T) @ _F
    yield _Check("Ad_T H = (T h^ T^-1)^v", moved.motion_subspace, partial(_moved_motions, H))
    yield _Check("h*^T H = I", moved.actuation_basis.T @ moved.motion_subspace, lambda z: np.eye(k))
    yield _Check(
        "reciprocity: H^T H-bar* = 0",
        moved.motion_subspace.T @ moved.constraint_basis,
        lambda z: np.zeros((k, 6 - k)),
    )
    yield _Check("reaction: H^T (F - h* H^T F) = 0", moved.actuation(moved.reaction(F_a)), lambda z: np.zeros(k))
    yield _Check("H^T F = virtual work at points", moved.actuation(F_a), partial(_virtual_work, H))
    yield _Check(
        "power of an actuator = tau . q'",
        power(moved.wrench(_first(_tau, k)), moved.motion_subspace @ _first(_rate, k)),
        lambda z: np.asarray(z["tau"][:k] @ z["rate"][:k]),
    )
    if k == 1:
        yield _Check(
            "T_pc of a hinge, of a slide",
            joint.placement(_q * np.ones(1)),
            # One of the parts of the motion is zero, so that the other is the way or the turn itself.
            lambda z: _pose(z["q"] * H[:3, 0], z["q"] * H[3:, 0]),
        )


# ---- bodies -------------------------------------------------------------------------------------------------------


def _body(suffix: str) -> SpatialInertia:
    return SpatialInertia(
        mass=State(f"m{suffix}"),
        center_of_mass=State(f"c{suffix}", shape=(3,)),
        inertia=State(f"I{suffix}", shape=(3, 3)),
    )


def _sums(points: np.ndarray, masses: np.ndarray, suffix: str) -> dict[str, np.ndarray]:
    """Mass, centre of mass, and inertia about it of a cloud."""
    m = masses.sum()
    c = masses @ points / m
    arms = points - c
    tensor = sum(mass * ((r @ r) * np.eye(3) - np.outer(r, r)) for mass, r in zip(masses, arms, strict=True))
    return {f"m{suffix}": np.asarray(m), f"c{suffix}": c, f"I{suffix}": np.asarray(tensor)}


def _velocities(xi: np.ndarray, points: np.ndarray) -> np.ndarray:
    """What a twist does to points: X [r; 1]."""
    return points @ hat(xi, LINEAR_FIRST)[:3, :3].T + xi[:3]


def _mass_matrix(points: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """Entry (i, j): the sum over the points of mass times the velocities that unit twists i and j give it."""
    unit = np.stack([_velocities(xi, points) for xi in np.eye(6)])
    return np.einsum("p,ipx,jpx->ij", masses, unit, unit)


def _moved_points(z: Values, which: str = "") -> np.ndarray:
    return z[f"points{which}"] @ z["T"][:3, :3].T + z["T"][:3, 3]


def _momentum(z: Values) -> np.ndarray:
    return total(z["points"], z["masses"][:, None] * _velocities(z["V"], z["points"]), LINEAR_FIRST)


def _kinetic_energy(z: Values) -> np.ndarray:
    return np.asarray(0.5 * z["masses"] @ np.sum(_velocities(z["V"], z["points"]) ** 2, axis=1))


def _both(z: Values) -> np.ndarray:
    points = np.concatenate([_moved_points(z), z["points2"]])
    return _mass_matrix(points, np.concatenate([z["masses"], z["masses2"]]))


def _acceleration(z: Values) -> np.ndarray:
    carried = bracket_matrix(LINEAR_FIRST, z["V"]).T @ _momentum(z)
    return np.linalg.solve(_mass_matrix(z["points"], z["masses"]), z["F"] + carried)


def _weight(z: Values) -> np.ndarray:
    return total(z["points"], z["masses"][:, None] * (z["pose"][:3, :3].T @ z["gravity"]), LINEAR_FIRST)


def _body_checks() -> Iterator[_Check]:
    body, other = _body(""), _body("2")
    moved = body.in_frame(_T)
    yield _Check("M", body.matrix, lambda z: _mass_matrix(z["points"], z["masses"]))
    yield _Check("M in another frame", moved.matrix, lambda z: _mass_matrix(_moved_points(z), z["masses"]))
    yield _Check("M of two bodies in one frame", (moved + other).matrix, _both)
    yield _Check("momentum", body.momentum(_V), _momentum)
    yield _Check(
        "momentum in another frame",
        moved.momentum(SE3Adjoint(_T) @ _V),
        lambda z: total_in_a(
            LINEAR_FIRST, z["T"], z["points"], z["masses"][:, None] * _velocities(z["V"], z["points"])
        ),
    )
    yield _Check("kinetic energy", body.kinetic_energy(_V), _kinetic_energy)
    yield _Check("kinetic energy in another frame", moved.kinetic_energy(SE3Adjoint(_T) @ _V), _kinetic_energy)
    yield _Check("weight", body.weight(_R, _gravity), _weight)
    yield _Check("acceleration", body.acceleration(_V, _F), _acceleration)
    yield _Check(
        "power of forces at points",
        power(SE3AdjointDual(_T) @ _F, SE3Adjoint(_T) @ _V),
        lambda z: np.asarray(np.sum(z["forces"] * _velocities(z["V"], z["points"]))),
    )


def _checks() -> list[_Check]:
    return [check for joint, H in _JOINTS for check in _joint_checks(joint, H)] + list(_body_checks())


# ---- the cases and the table --------------------------------------------------------------------------------------


def _pose(position: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """A pose by SciPy's quaternions, orthonormal to the last digit or two."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), position
    return T


def _cases(cases: int) -> list[dict[str, np.ndarray]]:
    rng = np.random.default_rng(_SEED)
    found = []
    for _ in range(cases):
        points, points2, forces = rng.normal(size=(3, _POINTS, 3))
        masses, masses2 = rng.uniform(0.5, 2.0, size=(2, _POINTS))
        z = {"points": points, "points2": points2, "forces": forces, "masses": masses, "masses2": masses2}
        z |= {name: _pose(*rng.normal(size=(2, 3))) for name in ("T", "pose")}
        z |= {name: rng.normal(size=6) for name in ("V", "tau", "rate")}
        z |= {"F": total(points, forces, LINEAR_FIRST), "q": np.asarray(rng.uniform(-6.0, 6.0))}
        z |= {"gravity": rng.normal(size=3)} | _sums(points, masses, "") | _sums(points2, masses2, "2")
        found.append(z)
    return found


def mechanics(cases: int = 200) -> list[Row]:
    """The worst case of every statement over all joints or bodies, of the simplified expressions.

    Needs JAX's x64 switch; the command line turns it on.

    Raises:
        RuntimeError: x64 is off.
    """
    if jax.numpy.zeros(()).dtype != np.float64:
        raise RuntimeError("mechanics is measured in float64; fix: jax.config.update('jax_enable_x64', True) before")
    checks, values = _checks(), _cases(cases)
    function = lower([check.expression.canonicalize() for check in checks])
    names = {leaf.name for leaf in leaves_of(*(check.expression for check in checks))}
    x = {name: np.stack([z[name] for z in values]) for name in names & values[0].keys()}
    computed = jax.jit(jax.vmap(partial(function, 0.0)))(x)
    worst: dict[str, float] = {}
    for check, results in zip(checks, computed, strict=True):
        for z, got in zip(values, np.asarray(results), strict=True):
            exact = check.reference(z)
            size = max(1.0, float(np.max(np.abs(exact), initial=0.0)))
            error = float(np.max(np.abs(got - exact), initial=0.0)) / size
            worst[check.statement] = max(worst.get(check.statement, 0.0), error)
    return [Row(statement, cases, error) for statement, error in worst.items()]


def main() -> int:
    """Prints the table; exit status 1 if a figure is above the bar."""
    jax.config.update("jax_enable_x64", True)
    rows = mechanics()
    print(f"worst error of {rows[0].cases} random cases, relative to the reference where that is above 1; bar {BAR:g}")
    print(f"{'joints and bodies':<40}{'worst':>9}")
    for row in rows:
        print(f"{row.statement:<40}{row.worst:>9.1e}{'' if row.holds else '  ABOVE THE BAR'}")
    return 0 if all(row.holds for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
