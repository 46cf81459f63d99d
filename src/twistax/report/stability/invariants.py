"""Drift of energy, momentum and orthonormality; and bodies with extreme inertias, masses and positions."""

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
from ...mechanics import SpatialInertia
from ...mechanics.flight import numbers
from ...scenes import SCENES, free_bodies, heavy_top, offset_tumble
from ...scenes.free_rotation import SymmetricBody
from ...scenes.scene import about, placed, rotation_angle
from ..harness.expected import Expected, at_most, between, either, ends, simulated
from ..harness.measurement import MeasuredCase, Section, quick
from ..harness.rows import plain

Array = NDArray[Any]

#: The body of the drifts, and its twist at the start.
_BODY = SpatialInertia(mass=2.0, center_of_mass=(0.1, -0.2, 0.3), inertia=np.diag([1.0, 2.0, 3.0]))
_TWIST = np.array([1.0, 0.5, -0.3, 0.4, 2.0, -0.7])
_MILLION = 1_000_000
_RK4, _DOP853 = tx.RKMK(tx.tableaus.RK4), tx.RKMK(tx.tableaus.DOP853)


@dataclasses.dataclass(frozen=True, eq=False)
class MovingBody:
    """A body whose invariants are watched."""

    dynamics: tx.Dynamics
    start: Mapping[str, Any]
    inertia: Array | None = None  # (6, 6), order [v; w]; None where nothing but the group is of interest
    moment: float = 0.0  # of a weight on its third axis, N m
    bodies: Any = None  # its free motion, for splittings

    def invariants(self, xs: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """The invariants of states with a leading axis, (n, ...), and their sizes (n,), by name.

        With a weight these are the energy and the vertical angular momentum; without one also the linear momentum, and
        the angular momentum about the first position. Its size is that of its summands: the lever arm, which grows with
        the distance, times the linear momentum.
        """
        R = xs["R"] if "R" in xs else xs["g"][:, :3, :3]
        invariants = {"R'R - I": (np.swapaxes(R, 1, 2) @ R - np.eye(3), np.ones(len(R)))}
        if self.inertia is None:
            return invariants
        V = xs["V"] if "V" in xs else np.pad(xs["w"], ((0, 0), (3, 0)))
        arm = xs["g"][:, :3, 3] - xs["g"][0, :3, 3] if "g" in xs else np.zeros((len(R), 3))
        mu = V @ self.inertia
        p, L = (np.einsum("nij,nj->ni", R, part) for part in (mu[:, :3], mu[:, 3:]))
        linear, angular, length = np.linalg.norm((p, L, arm), axis=-1)
        energy, both = 0.5 * np.sum(V * mu, axis=1) + self.moment * R[:, 2, 2], np.hstack([p, L + np.cross(arm, p)])
        invariants |= {"energy": (energy, np.abs(energy)), "vertical momentum": (L[:, 2], angular)}
        return invariants | {"linear momentum": (p, linear), "momentum": (both, linear * (1.0 + length) + angular)}


class Change(NamedTuple):
    """How far an invariant is from its start after each number of steps: absolute, and relative to its size then."""

    absolute: Array
    relative: Array


@functools.cache
def changes(motion: MovingBody, method: Method, dt: float, counts: tuple[int, ...]) -> dict[str, Change]:
    """The changes of each invariant by its name; of vectors and matrices their norms. Needs JAX's x64 switch."""
    times = np.array([0, *counts]) * dt
    options: dict[str, Any] = {"t1": float(times[-1]), "steps": max(counts), "method": method, "save_at": times}
    sol = simulated(motion.dynamics, motion.start, **options)
    result = {}
    for name, (values, sizes) in motion.invariants({name: np.asarray(value) for name, value in sol.xs.items()}).items():
        change = np.linalg.norm((values - values[0]).reshape(len(values), -1), axis=1)[1:]
        # What is zero throughout has no size.
        result[name] = Change(change, np.divide(change, sizes[1:], out=np.zeros(len(change)), where=sizes[1:] > 0.0))
    return result


def _of_rotation(system: tx.System, scene: str, J: Array, moment: float = 0.0) -> MovingBody:
    inertia = np.diag([0.0, 0.0, 0.0, *J])
    return MovingBody(tx.compile(system), SCENES[scene].start, inertia, moment, tx.FreeBody("R", "w", inertia=J))


@functools.cache
def top(moments: tuple[float, ...] = heavy_top.INERTIA) -> MovingBody:
    """The heavy top of the scenes, also with other moments."""
    return _of_rotation(heavy_top.system(moments), "heavy-top", np.array(moments), heavy_top.MOMENT)


@functools.cache
def _spin() -> MovingBody:
    return _of_rotation(SCENES["euler-top"].system, "euler-top", np.array([1.0, 2.0, 3.0]))


@functools.cache
def tumble() -> MovingBody:
    """A torque-free body on SE(3), its centre of mass off the origin."""
    scene, M = SCENES["offset-tumble"], numbers(offset_tumble.BODY)
    return MovingBody(scene.dynamics, scene.start, M, bodies=tx.FreeBody("g", "V", inertia=M))


@functools.cache
def free_body() -> MovingBody:
    """A rigid body under no force, its centre of mass away from its origin."""
    M = numbers(_BODY.matrix)
    return MovingBody(tx.compile(offset_tumble.system(M)), {"g": np.eye(4), "V": _TWIST}, M)


@functools.cache
def constant_twist() -> MovingBody:
    """A pose under a constant twist, whose round-off is the same at every step: the worst case for drift."""
    g, xi = tx.State("g", group=tx.SE3), tx.Parameter("xi", shape=(6,), value=_TWIST)
    return MovingBody(tx.compile(tx.System(rates={g: xi})), {"g": np.eye(4)})


class _LeftAlone(GroupCoordinates):
    """A rotation matrix that is multiplied and never orthonormalised."""

    def settle(self, moved: Block) -> Block:
        return moved


@dataclasses.dataclass(frozen=True)
class Matrices(Chart):
    """Exponential coordinates around a stored matrix that is never put back into the group: for comparison only."""

    def for_rotation(self) -> Coordinates:
        return _LeftAlone(SO3)

    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        return _LeftAlone(group)


def _absolute(name: str, motion: Any, method: Method, dt: float, counts: tuple[int, ...], at: Any = ...) -> float:
    """The largest change of an invariant after the numbers of steps, or after one of them."""
    return float(np.max(changes(motion(), method, dt, counts)[name].absolute[at]))


def _drift(motion: Any, chart: Chart | None, expected: Expected, note: str = "") -> MeasuredCase:
    what = f"R'R - I after a million steps, {'tumbling' if motion is free_body else 'constant twist'}{note}"
    by = f"RK4, {'quaternion' if chart is None else 'matrix without projection'}"
    run = motion, tx.RKMK(tx.tableaus.RK4, chart), 1e-2, (_MILLION,)
    return quick(what, by, expected, _absolute, "R'R - I", *run, slow=True)


_TIMES = tuple(range(50, 5001, 50))
_LINEAR = _absolute, "linear momentum", free_body, _RK4, 1e-3, _TIMES

KEEPING: Section = [
    quick("world linear momentum, 5 s, steps of 1 ms", "RK4", at_most(1e-9, "N s"), *_LINEAR),
    "A stored quaternion does not grow.",
    _drift(free_body, None, at_most(1e-14)),
    _drift(constant_twist, None, at_most(1e-14)),
    "A matrix under a constant twist rounds alike at every step, so the drift grows with the number of steps.",
    _drift(free_body, Matrices(), at_most(1e-11)),
    _drift(constant_twist, Matrices(), between(), ": for comparison only, known to miss 1e-11"),
]

#: The largest relative changes.
_BARS = {"energy": 1e-10, "vertical momentum": 1e-9, "momentum": 1e-12}
_HUNDREDTHS = tuple(range(_MILLION // 100, _MILLION + 1, _MILLION // 100))


def _largest(motion: Callable[[], MovingBody], composition: Any, name: str) -> float:
    it = motion()
    method = tx.Splitting(composition, it.bodies) if composition else _RK4
    return float(changes(it, method, 1e-2, _HUNDREDTHS)[name].relative.max())


def _keeps(title: str, name: str, motion: Any, composition: Any) -> MeasuredCase:
    expected = at_most(_BARS[name]) if composition is tx.compositions.KAHAN_LI6 else between()
    by = composition.name if composition else "RK4"
    return quick(f"{title}: {name}", by, expected, _largest, motion, composition, name, slow=True)


LONG: Section = [
    _keeps(title, name, motion, composition)
    for motion, title, momentum in (
        (top, "heavy top", "vertical momentum"),
        (functools.partial(top, (1.0, 1.3, 0.5)), "heavy top, three moments", "vertical momentum"),
        (_spin, "torque-free, SO(3)", "momentum"),
        (tumble, "torque-free, SE(3)", "momentum"),
    )
    for name in ("energy", momentum)
    for composition in (*tx.compositions.ALL, None)
]

_FEW, _MANY = (1_000, 10_000), (100_000, _MILLION)
_SPLITTING = tx.Splitting(tx.compositions.KAHAN_LI8, tx.FreeBody("R", "w", inertia=heavy_top.INERTIA))
_BY = {_RK4: "RK4", _DOP853: "DOP853", _SPLITTING: "Kahan-Li 8 splitting"}


def _runs(
    motion: Any, name: str, method: Method, dt: float, *bars: float, unit: str = "", slow: bool = True
) -> Section:
    """Measurements after each number of steps; the bars are for up to 1e4 and up to 1e6 steps."""
    what, by = f"{name}, {motion.__name__.replace('_', ' ').replace('top', 'heavy top')}", _BY[method]
    return [
        quick(
            f"{what}, {plain(float(count))} steps",
            by,
            at_most(bar, unit),
            *(_absolute, name, motion, method, dt, counts, place),
            slow=slow or counts is _MANY,
            place=(f"{what}, {by}", float(count)),
        )
        for counts, bar in zip((_FEW, _MANY), bars, strict=True)
        for place, count in enumerate(counts)
    ]


LONG_RUNS: Section = [
    "A quaternion put back to length one in every step cannot drift, even where every step rounds alike.",
    *_runs(constant_twist, "R'R - I", _RK4, 1e-2, 1e-14, 1e-14),
    "A method without structure loses energy in every step: the drift is linear, and that of its order.",
    *_runs(free_body, "energy", _RK4, 1e-2, 5e-7, 5e-5, unit="J"),
    "The same for momentum, which lives in the body's axes here.",
    *_runs(free_body, "linear momentum", _RK4, 1e-2, 1e-5, 1e-3, unit="N s"),
    "Short steps lose little, in every one of them.",
    *_runs(top, "energy", _RK4, 1e-3, 1e-11, 1e-9, unit="J", slow=False),
    "At order eight the drift of a million steps is near round-off.",
    *_runs(top, "energy", _DOP853, 1e-2, 5e-13, 5e-11, unit="J", slow=False),
    "A symplectic method has no drift of its own; what grows is round-off, some 1e-16 J a step.",
    *_runs(top, "energy", _SPLITTING, 1e-2, 2e-11, 2e-9, unit="J"),
    "Momenta are stored in world axes: what no torque changes stays to the last bit or two.",
    *_runs(top, "vertical momentum", _SPLITTING, 1e-2, 1e-14, 1e-14, unit="N m s"),
    "The group is kept as by every method here.",
    *_runs(top, "R'R - I", _SPLITTING, 1e-2, 1e-14, 1e-14),
]

_TUMBLE = SCENES["offset-tumble"]
_START = about((1.0, 0.0, 0.0), 0.6)
_NEEDLE, _FLYWHEEL = (1.0, 1e-12, (0.3, 0.2, 2.0)), (1e-12, 1.0, (1e-9, 0.0, 3e-12))
_TIGHT = at_most(1e-9, "rad")


@functools.cache
def _spinner(differences: bool) -> tx.Dynamics:
    """A free body with moments that are a parameter; J w x w as it is, or with the differences of moments in front."""
    R, w, J = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Parameter("J", shape=(3,))
    torque = tx.Concat((J[1] - J[2]) * w[1] * w[2], (J[2] - J[0]) * w[2] * w[0], (J[0] - J[1]) * w[0] * w[1])
    return tx.compile(tx.System(rates={R: w, w: torque / J}) if differences else free_bodies.system(J))


def _spun(transverse: float, axial: float, w: tuple[float, float, float], differences: bool = False) -> float:
    """The error of a symmetric body after 10 s, rad."""
    body = SymmetricBody(transverse, axial, _START, np.array(w))
    start, params = {"R": _START, "w": body.rate}, {"J": body.inertia}
    sol = simulated(_spinner(differences), start, t1=10.0, params=params, rtol=1e-11, method=_DOP853)
    return rotation_angle(body.at(10.0)[0], np.asarray(sol.xs["R"][-1]))


_tumbler = functools.cache(lambda: tx.compile(offset_tumble.system(tx.Parameter("M", shape=(6, 6)))))


def _tumbled(mass: float, offset: float) -> tuple[float, float]:
    """The errors of rotation, rad, and position, m, of the scene offset-tumble with another mass and place."""
    shift, M = placed(np.zeros((3, 3)), 3 * (offset,)) - np.diag([0.0, 0.0, 0.0, 1.0]), numbers(offset_tumble.BODY)
    start, params = {**_TUMBLE.start, "g": _TUMBLE.start["g"] + shift}, {"M": mass / offset_tumble.MASS * M}
    sol = simulated(_tumbler(), start, t1=_TUMBLE.duration, params=params, dt=0.02, method=_DOP853)
    exact, end = _TUMBLE.end["g"] + shift, np.asarray(sol.xs["g"][-1])
    return rotation_angle(exact[:3, :3], end[:3, :3]), float(np.linalg.norm(exact[:3, 3] - end[:3, 3]))


_worst = lambda mass: max(_tumbled(mass, 0.0))  # noqa: E731
_BY_MASS, _NEAR = "kg, equal steps of 0.02 s", at_most(1e-11, "rad or m")
_THIN = "a needle: moments 1, 1 and 1e-12 kg m2, torque ((J1 - J2) w1 w2, ..), rtol 1e-11"
_FLAT = "a flywheel: moments 1e-12, 1e-12 and 1 kg m2, rtol 1e-11"
_FAR = "a body 1.7e9 m from the origin"

EXTREMES: Section = [
    "With the differences of moments in front, the ratio enters as a factor alone.",
    quick(_THIN, "DOP853", _TIGHT, _spun, *_NEEDLE, differences=True),
    "J1 w1 w2 - J2 w2 w1 leaves round-off of 1e-17 N m where products are fused, 1e-5 rad/s2 for a needle. "
    "The integration sees the noise, and runs out of steps rather than go wrong.",
    quick("the same needle, torque J w x w", "DOP853", either(_TIGHT, ends(tx.Result.MAX_STEPS)), _spun, *_NEEDLE),
    "The ratio makes rates of 1e-12 rad/s into a nutation of 3 rad/s; no true body is so flat.",
    quick(_FLAT, "DOP853", _TIGHT, _spun, *_FLYWHEEL),
    "The motion of a free body does not depend on its mass, and no tolerance or threshold here does.",
    *(
        quick(f"mass {plain(mass)} {_BY_MASS}", "DOP853", _NEAR, _worst, mass, slow=True)
        for mass in (1e-9, 1e-3, 1e3, 1e12)
    ),
    "The rotation does not feel where the body is.",
    quick(f"rotation of {_FAR}", "DOP853", at_most(1e-11, "rad"), lambda: _tumbled(2.0, 1e9)[0], slow=True),
    "A double resolves 1e-7 m there; round-off of 500 steps adds up.",
    quick(f"position of {_FAR}, 500 steps", "DOP853", at_most(3e-5, "m"), lambda: _tumbled(2.0, 1e9)[1], slow=True),
]
