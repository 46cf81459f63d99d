"""What a true motion keeps, and how far methods let it go."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ...groups import SO3, SpecialEuclidean
from ...integrators import Method
from ...integrators.charts import Block, Chart, Coordinates, GroupCoordinates
from ...scenes import SCENES, heavy_top, offset_tumble
from ..checks import Between, Check, Section, at_most, simulated

__all__ = [
    "KEEPING",
    "LONG",
    "Change",
    "Matrices",
    "Motion",
    "changes",
    "constant_twist",
    "free_body",
    "spatial_inertia",
    "top",
]

Array = NDArray[Any]
#: States with a leading axis to what is kept, (n,) or (n, k), and its size (n,).
Kept = Callable[[Mapping[str, Array]], tuple[Array, Array]]

#: The body of the drifts: mass, kg; centre of mass from its origin, m; inertia about it, kg m2; twist at the start.
MASS, CENTRE, INERTIA = 2.0, np.array([0.1, -0.2, 0.3]), np.diag([1.0, 2.0, 3.0])
TWIST = np.array([1.0, 0.5, -0.3, 0.4, 2.0, -0.7])
_MILLION, _DT = 1_000_000, 1e-2


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """A system, its start, what a true motion keeps by name, and its free motion for splittings."""

    name: str
    dynamics: tx.Dynamics
    start: Mapping[str, Any]
    kept: Mapping[str, Kept]
    bodies: Any = None


@dataclasses.dataclass(frozen=True)
class Change:
    """Of what is kept, since the start, after each number of steps: as it is, and over its size then."""

    absolute: Array
    relative: Array


@functools.cache
def changes(motion: Motion, method: Method, dt: float, counts: tuple[int, ...]) -> dict[str, Change]:
    """By what is kept, and by "R'R - I". Vectors and matrices by their norms. Needs JAX's x64 switch."""
    times = np.array([0, *counts]) * dt
    sol = simulated(
        motion.dynamics, dict(motion.start), t1=float(times[-1]), steps=max(counts), method=method, save_at=times
    )
    xs = {name: np.asarray(value) for name, value in sol.xs.items()}
    found = {}
    for name, kept in {**motion.kept, "R'R - I": _defect}.items():
        values, sizes = kept(xs)
        change = np.linalg.norm((values - values[0]).reshape(len(values), -1), axis=1)
        found[name] = Change(change[1:], (change / sizes)[1:])
    return found


def _defect(xs: Mapping[str, Array]) -> tuple[Array, Array]:
    R = xs["R"] if "R" in xs else xs["g"][:, :3, :3]
    return np.swapaxes(R, 1, 2) @ R - np.eye(3), np.ones(len(R))


# ---- motions --------------------------------------------------------------------------------------------------------


def spatial_inertia(m: float = MASS, c: Array = CENTRE, inertia: Array = INERTIA) -> Array:
    """(6, 6) about the body's origin, order [v; w]."""
    arm = np.asarray(tx.lie.so3.hat(c))
    return np.block([[m * np.eye(3), -m * arm], [m * arm, inertia - m * arm @ arm]])


def _of_pose(M: Array, about: Array) -> dict[str, Kept]:
    """Energy; linear momentum in the world; and both momenta, the angular one about a point.

    The size of both is that of what they are the sum of: the arm, which grows with the way, times the linear one.
    """

    def momenta(xs: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        R, mu = xs["g"][:, :3, :3], xs["V"] @ M
        p, L = (np.einsum("nij,nj->ni", R, part) for part in (mu[:, :3], mu[:, 3:]))
        return p, L, xs["g"][:, :3, 3] - about

    def energy(xs: Mapping[str, Array]) -> tuple[Array, Array]:
        values = 0.5 * np.sum(xs["V"] * (xs["V"] @ M), axis=1)
        return values, np.abs(values)

    def linear(xs: Mapping[str, Array]) -> tuple[Array, Array]:
        p, _, _ = momenta(xs)
        return p, np.linalg.norm(p, axis=1)

    def both(xs: Mapping[str, Array]) -> tuple[Array, Array]:
        p, L, arm = momenta(xs)
        size = np.linalg.norm(p, axis=1) * (1.0 + np.linalg.norm(arm, axis=1)) + np.linalg.norm(L, axis=1)
        return np.concatenate([p, L + np.cross(arm, p)], axis=1), size

    return {"energy": energy, "linear momentum": linear, "momentum": both}


def _of_rotation(J: Array, moment: float) -> dict[str, Kept]:
    """Energy, and the momentum: of a top, on which a weight acts, its vertical part alone."""

    def energy(xs: Mapping[str, Array]) -> tuple[Array, Array]:
        values = 0.5 * np.sum(xs["w"] * J * xs["w"], axis=1) + moment * xs["R"][:, 2, 2]
        return values, np.abs(values)

    def momentum(xs: Mapping[str, Array]) -> tuple[Array, Array]:
        L = np.einsum("nij,nj->ni", xs["R"], J * xs["w"])
        return (L[:, 2] if moment else L), np.linalg.norm(L, axis=1)

    return {"energy": energy, "vertical momentum" if moment else "momentum": momentum}


@functools.cache
def top(moments: tuple[float, ...] = heavy_top.INERTIA) -> Motion:
    """The heavy top of the scenes, also with other moments."""
    J, weight = np.array(moments), np.array([0.0, 0.0, heavy_top.MOMENT])
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    system = tx.System(rates={R: w, w: (tx.linalg.Cross(J * w, w) + tx.linalg.Cross(R[2], weight)) / J})
    name = f"heavy top, moments {', '.join(f'{each:g}' for each in moments)}"
    start, bodies = SCENES["heavy-top"].start, tx.FreeBody("R", "w", inertia=J)
    return Motion(name, tx.compile(system), start, _of_rotation(J, heavy_top.MOMENT), bodies)


@functools.cache
def _torque_free() -> tuple[Motion, Motion]:
    """On SO(3), and on SE(3) with a centre of mass off the origin."""
    spin, tumble, J = SCENES["euler-top"], SCENES["offset-tumble"], np.array([1.0, 2.0, 3.0])
    M = spatial_inertia(offset_tumble.MASS, offset_tumble.CENTER, offset_tumble.INERTIA)
    kept = _of_pose(M, np.asarray(tumble.start["g"])[:3, 3])
    on_rotations = tx.FreeBody("R", "w", inertia=J)
    return (
        Motion("torque-free body", spin.dynamics, spin.start, _of_rotation(J, 0.0), on_rotations),
        Motion("the same with a pose", tumble.dynamics, tumble.start, kept, tx.FreeBody("g", "V", inertia=M)),
    )


@functools.cache
def free_body() -> Motion:
    """A rigid body under no force, its centre of mass away from its origin."""
    g, V, M = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), spatial_inertia()
    dynamics = tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V))}))
    return Motion("free body", dynamics, {"g": np.eye(4), "V": TWIST}, _of_pose(M, np.zeros(3)))


@functools.cache
def constant_twist() -> Motion:
    """The same round-off at every step: the worst for matrices that nothing puts back."""
    g, xi = tx.State("g", group=tx.SE3), tx.Parameter("xi", shape=(6,), value=TWIST)
    return Motion("constant twist", tx.compile(tx.System(rates={g: xi})), {"g": np.eye(4)}, {})


# ---- a chart for comparison -----------------------------------------------------------------------------------------


class _LeftAlone(GroupCoordinates):
    """A matrix, moved by products, and never put back."""

    def settle(self, moved: Block) -> Block:
        return moved


@dataclasses.dataclass(frozen=True)
class Matrices(Chart):
    """Exponential coordinates around a stored matrix that is never put back into the group: for comparison only."""

    def for_rotation(self) -> Coordinates:
        return _LeftAlone(SO3)

    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        return _LeftAlone(group)


# ---- checks ---------------------------------------------------------------------------------------------------------

_RK4 = tx.RKMK(tx.tableaus.RK4)


def _drift(motion: Motion, chart: Chart | None) -> float:
    return changes(motion, tx.RKMK(tx.tableaus.RK4, chart), _DT, (_MILLION,))["R'R - I"].absolute[-1]


def _stored(motion: Callable[[], Motion], chart: Chart | None, what: str, expected: Between) -> Check:
    kind = "quaternion" if chart is None else "matrix that nothing puts back"
    return Check(
        f"R'R - I after a million steps, {what}", f"RK4, {kind}", lambda: _drift(motion(), chart), expected, True
    )


KEEPING = Section(
    "keeping",
    "What is kept",
    "A free body with an offset centre of mass; norms of changes since the start.",
    {
        "": [
            Check(
                "world linear momentum, 5 s, steps of 1 ms",
                "RK4",
                lambda: changes(free_body(), _RK4, 1e-3, tuple(range(50, 5001, 50)))["linear momentum"].absolute.max(),
                at_most(1e-9, "N s"),
            ),
        ],
        "A stored quaternion does not grow.": [
            _stored(free_body, None, "tumbling", at_most(1e-14)),
            _stored(constant_twist, None, "constant twist", at_most(1e-14)),
        ],
        "A matrix under a constant twist rounds alike at every step, so the drift grows with the number of steps.": [
            _stored(free_body, Matrices(), "tumbling", at_most(1e-11)),
            _stored(constant_twist, Matrices(), "constant twist", Between()),
        ],
    },
)

#: The largest relative changes over a million steps.
_BARS = {"energy": 1e-10, "vertical momentum": 1e-9, "momentum": 1e-12}


def _long(motion: Callable[[], Motion], title: str, name: str, composition: Any) -> Check:
    def measure() -> float:
        it = motion()
        method: Method = tx.Splitting(composition, it.bodies) if composition else _RK4
        counts = tuple(range(_MILLION // 100, _MILLION + 1, _MILLION // 100))
        return changes(it, method, _DT, counts)[name].relative.max()

    expected = at_most(_BARS[name]) if composition is tx.compositions.KAHAN_LI6 else Between()
    return Check(f"{title}: {name}", composition.name if composition else "RK4", measure, expected, slow=True)


LONG = Section(
    "long",
    "A million steps",
    "Steps of 10 ms: the largest relative changes of what a true motion keeps, at 100 times. The momentum of a body "
    "with a pose is both, about the start.",
    {
        "": [
            _long(motion, title, name, composition)
            for motion, title, names in (
                (top, "heavy top", ("energy", "vertical momentum")),
                (lambda: top((1.0, 1.3, 0.5)), "heavy top, three moments", ("energy", "vertical momentum")),
                (lambda: _torque_free()[0], "torque-free, SO(3)", ("energy", "momentum")),
                (lambda: _torque_free()[1], "torque-free, SE(3)", ("energy", "momentum")),
            )
            for name in names
            for composition in (*tx.compositions.ALL, None)
        ]
    },
    wide=True,
)
