"""What a true motion keeps, and how far methods let it go."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ...groups import SO3, SpecialEuclidean
from ...integrators import Method
from ...integrators.charts import Block, Chart, Coordinates, GroupCoordinates
from ...scenes import SCENES, heavy_top, offset_tumble
from ...scenes.scene import cross_matrix
from ..checks import Check, Expected, Section, at_most, between, simulated

Array = NDArray[Any]

#: The body of the drifts: mass, kg; centre of mass from its origin, m; inertia about it, kg m2; twist at the start.
MASS, CENTRE, INERTIA = 2.0, np.array([0.1, -0.2, 0.3]), np.diag([1.0, 2.0, 3.0])
TWIST = np.array([1.0, 0.5, -0.3, 0.4, 2.0, -0.7])
_MILLION, _DT = 1_000_000, 1e-2


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """A body that moves.

    Attributes:
        inertia: (6, 6), order [v; w]; None where nothing but the group is of interest.
        moment: of a weight on its third axis, N m.
        bodies: its free motion, for splittings.
    """

    dynamics: tx.Dynamics
    start: Mapping[str, Any]
    inertia: Array | None = None
    moment: float = 0.0
    bodies: Any = None

    def kept(self, xs: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """What a true motion keeps of states with a leading axis, (n, ...), and its size (n,), by name.

        Under a weight that is the energy and the vertical momentum; else also the linear momentum, and both, about the
        first position. Their size is that of what they are the sum of: the arm, which grows with the way, times the
        linear one.
        """
        R = xs["R"] if "R" in xs else xs["g"][:, :3, :3]
        found = {"R'R - I": (np.swapaxes(R, 1, 2) @ R - np.eye(3), np.ones(len(R)))}
        if self.inertia is None:
            return found
        V = xs["V"] if "V" in xs else np.pad(xs["w"], ((0, 0), (3, 0)))
        arm = xs["g"][:, :3, 3] - xs["g"][0, :3, 3] if "g" in xs else np.zeros((len(R), 3))
        mu = V @ self.inertia
        p, L = (np.einsum("nij,nj->ni", R, part) for part in (mu[:, :3], mu[:, 3:]))
        linear, angular, length = np.linalg.norm((p, L, arm), axis=-1)
        energy, both = 0.5 * np.sum(V * mu, axis=1) + self.moment * R[:, 2, 2], np.hstack([p, L + np.cross(arm, p)])
        found |= {"energy": (energy, np.abs(energy)), "vertical momentum": (L[:, 2], angular)}
        return found | {"linear momentum": (p, linear), "momentum": (both, linear * (1.0 + length) + angular)}


class Change(NamedTuple):
    """Of what is kept, since the start, after each number of steps: as it is, and over its size then."""

    absolute: Array
    relative: Array


@functools.cache
def changes(motion: Motion, method: Method, dt: float, counts: tuple[int, ...]) -> dict[str, Change]:
    """By what is kept. Vectors and matrices by their norms. Needs JAX's x64 switch."""
    times = np.array([0, *counts]) * dt
    options: dict[str, Any] = {"t1": float(times[-1]), "steps": max(counts), "method": method, "save_at": times}
    sol = simulated(motion.dynamics, motion.start, **options)
    found = {}
    for name, (values, sizes) in motion.kept({name: np.asarray(value) for name, value in sol.xs.items()}).items():
        change = np.linalg.norm((values - values[0]).reshape(len(values), -1), axis=1)[1:]
        # What is zero throughout has no size.
        found[name] = Change(change, np.divide(change, sizes[1:], out=np.zeros(len(change)), where=sizes[1:] > 0.0))
    return found


# ---- motions --------------------------------------------------------------------------------------------------------


def spatial_inertia(m: float = MASS, c: Array = CENTRE, inertia: Array = INERTIA) -> Array:
    """(6, 6) about the body's origin, order [v; w]."""
    arm = cross_matrix(c)
    return np.block([[m * np.eye(3), -m * arm], [m * arm, inertia - m * arm @ arm]])


def _of_rotation(dynamics: tx.Dynamics, start: Mapping[str, Any], J: Array, moment: float = 0.0) -> Motion:
    inertia = spatial_inertia(0.0, np.zeros(3), np.diag(J))
    return Motion(dynamics, start, inertia, moment, tx.FreeBody("R", "w", inertia=J))


@functools.cache
def top(moments: tuple[float, ...] = heavy_top.INERTIA) -> Motion:
    """The heavy top of the scenes, also with other moments."""
    J, weight = np.array(moments), np.array([0.0, 0.0, heavy_top.MOMENT])
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    system = tx.System(rates={R: w, w: (tx.linalg.Cross(J * w, w) + tx.linalg.Cross(R[2], weight)) / J})
    return _of_rotation(tx.compile(system), SCENES["heavy-top"].start, J, heavy_top.MOMENT)


@functools.cache
def _spin() -> Motion:
    """A torque-free body on SO(3)."""
    return _of_rotation(SCENES["euler-top"].dynamics, SCENES["euler-top"].start, np.array([1.0, 2.0, 3.0]))


@functools.cache
def tumble() -> Motion:
    """A torque-free body on SE(3), its centre of mass off the origin."""
    scene, M = SCENES["offset-tumble"], spatial_inertia(offset_tumble.MASS, offset_tumble.CENTER, offset_tumble.INERTIA)
    return Motion(scene.dynamics, scene.start, M, bodies=tx.FreeBody("g", "V", inertia=M))


@functools.cache
def free_body() -> Motion:
    """A rigid body under no force, its centre of mass away from its origin."""
    g, V, M = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), spatial_inertia()
    dynamics = tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V))}))
    return Motion(dynamics, {"g": np.eye(4), "V": TWIST}, M)


@functools.cache
def constant_twist() -> Motion:
    """The same round-off at every step: the worst for matrices that nothing puts back."""
    g, xi = tx.State("g", group=tx.SE3), tx.Parameter("xi", shape=(6,), value=TWIST)
    return Motion(tx.compile(tx.System(rates={g: xi})), {"g": np.eye(4)})


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


def _momentum() -> float:
    counts = tuple(range(50, 5001, 50))
    return float(changes(free_body(), _RK4, 1e-3, counts)["linear momentum"].absolute.max())


def _drift(motion: Callable[[], Motion], chart: Chart | None, bar: float) -> Check:
    what = f"R'R - I after a million steps, {'tumbling' if motion is free_body else 'constant twist'}"
    by = f"RK4, {'quaternion' if chart is None else 'matrix that nothing puts back'}"
    method = tx.RKMK(tx.tableaus.RK4, chart)
    measure = lambda: changes(motion(), method, _DT, (_MILLION,))["R'R - I"].absolute[-1]  # noqa: E731
    return Check(what, by, measure, at_most(bar), slow=True)


KEEPING = Section(
    "keeping",
    [
        Check("world linear momentum, 5 s, steps of 1 ms", "RK4", _momentum, at_most(1e-9, "N s")),
        "A stored quaternion does not grow.",
        _drift(free_body, None, 1e-14),
        _drift(constant_twist, None, 1e-14),
        "A matrix under a constant twist rounds alike at every step, so the drift grows with the number of steps.",
        _drift(free_body, Matrices(), 1e-11),
        _drift(constant_twist, Matrices(), 1e-11),
    ],
)

#: The largest relative changes over a million steps.
_BARS = {"energy": 1e-10, "vertical momentum": 1e-9, "momentum": 1e-12}


def _long(motion: Callable[[], Motion], title: str, name: str, composition: Any) -> Check:
    def measure() -> float:
        it = motion()
        method: Method = tx.Splitting(composition, it.bodies) if composition else _RK4
        counts = tuple(range(_MILLION // 100, _MILLION + 1, _MILLION // 100))
        return float(changes(it, method, _DT, counts)[name].relative.max())

    expected: Expected = at_most(_BARS[name]) if composition is tx.compositions.KAHAN_LI6 else between()
    return Check(f"{title}: {name}", composition.name if composition else "RK4", measure, expected, slow=True)


LONG = Section(
    "long",
    [
        _long(motion, title, name, composition)
        for motion, title, momentum in (
            (top, "heavy top", "vertical momentum"),
            (functools.partial(top, (1.0, 1.3, 0.5)), "heavy top, three moments", "vertical momentum"),
            (_spin, "torque-free, SO(3)", "momentum"),
            (tumble, "torque-free, SE(3)", "momentum"),
        )
        for name in ("energy", momentum)
        for composition in (*tx.compositions.ALL, None)
    ],
    wide=True,
)
