"""What a million steps do to a rotation: quaternions put back to length one, and matrices that are left alone.

`python -m twistax.report.drift` prints how far R'R - I, momentum and energy have gone after 1e3 to 1e6 steps. Exit
status 1 if R'R - I is above its bar.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from ..expr import Parameter, State
from ..groups import SE3, SO3, SpecialEuclidean
from ..integrators import RKMK, integrate
from ..integrators.charts import Chart
from ..integrators.charts.coordinates import Block, Coordinates, GroupCoordinates
from ..integrators.tableaus import RK4
from ..lowering import Dynamics, compile
from ..system import System
from .conservation import TWIST, free_body, invariants
from .machine import machine

__all__ = ["BARS", "COUNTS", "Course", "Matrices", "courses", "main", "slope"]

#: The largest |R'R - I|, by how the rotation is stored; for matrices on the free body.
BARS = {"quaternion": 1e-14, "matrix": 1e-11}

#: The motion that makes the same rounding errors at every step: the worst for matrices, which are not judged on it.
CONSTANT = "constant twist"

#: Steps after which to look.
COUNTS = (1_000, 10_000, 100_000, 1_000_000)

_DT = 1e-2  # s


class _LeftAlone(GroupCoordinates):
    """A matrix, moved by products, and never put back."""

    def settle(self, moved: Block) -> Block:
        return moved


@dataclass(frozen=True)
class Matrices(Chart):
    """Exponential coordinates around a stored matrix that is never put back into the group: for comparison only."""

    def for_rotation(self) -> Coordinates:
        return _LeftAlone(SO3)

    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        return _LeftAlone(group)


@dataclass(frozen=True)
class Course:
    """One flight, looked at after each of some numbers of steps.

    Attributes:
        motion, stored: what flies, and how its rotation is stored.
        defect: |R'R - I|.
        linear, angular, energy: changes of the momenta in the world (N s, N m s) and of the energy (J) since the start,
            None for a motion that keeps none of them.
    """

    motion: str
    stored: str
    defect: NDArray[Any]
    linear: NDArray[Any] | None = None
    angular: NDArray[Any] | None = None
    energy: NDArray[Any] | None = None


def courses(counts: tuple[int, ...] = COUNTS) -> list[Course]:
    """A free body that tumbles, and a constant twist, for which round-off adds up most. Needs JAX's x64 switch."""
    g, xi = State("g", group=SE3), Parameter("xi", shape=(6,), value=TWIST)
    charts = {"quaternion": None, "matrix": Matrices()}
    constant = compile(System(rates={g: xi}))
    found = [
        Course("constant twist", kind, _defects(_flown(constant, chart, counts))) for kind, chart in charts.items()
    ]
    for kind, chart in charts.items():
        xs = _flown(free_body(), chart, counts)
        changes = (_changes(kept) for kept in invariants(xs["g"], xs["V"]))
        found.append(Course("free body", kind, _defects(xs), *changes))
    return found


def slope(counts: Any, values: Any) -> float:
    """The p of values ~ counts^p; values of zero count as one unit in the last place of one."""
    values = np.maximum(np.asarray(values), np.finfo(np.float64).eps)
    return float(np.polyfit(np.log(np.asarray(counts)), np.log(values), 1)[0])


def _flown(dynamics: Dynamics, chart: Chart | None, counts: tuple[int, ...]) -> dict[str, jax.Array]:
    """The states at the start and after each number of steps."""
    start = {name: value for name, value in {"g": np.eye(4), "V": TWIST}.items() if name in dynamics.group.factors}
    times = np.array([0, *counts]) * _DT
    return integrate(dynamics, start, t1=times[-1], dt=_DT, method=RKMK(RK4, chart), save_at=times).xs


def _defects(xs: dict[str, jax.Array]) -> NDArray[Any]:
    R = np.asarray(xs["g"])[1:, :3, :3]
    return np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))


def _changes(kept: NDArray[Any]) -> NDArray[Any]:
    """The largest change of an entry since the start, after each number of steps."""
    return np.abs(kept[1:] - kept[0]).reshape(len(kept) - 1, -1).max(axis=1)


def _print(label: str, counts: tuple[int, ...], values: NDArray[Any]) -> None:
    columns = "".join(f"{value:>11.1e}" for value in values)
    print(f"{label:<42}{columns}{slope(counts, values):>8.2f}")


def main() -> int:
    """Prints the tables; exit status 1 if a defect is above its bar."""
    jax.config.update("jax_enable_x64", True)
    print(machine())
    print(f"RKMK4, dt = {_DT:g} s, float64; p: what is shown grows as steps^p")
    print(f"{'after so many steps':<42}{''.join(f'{count:>11,}' for count in COUNTS)}{'p':>8}")
    found = courses()
    for course in found:
        _print(f"R'R - I, {course.motion}, {course.stored}", COUNTS, course.defect)
    for course in found:
        changes = {"linear (N s)": course.linear, "angular (N m s)": course.angular, "energy (J)": course.energy}
        for name, values in changes.items():
            if values is not None:
                _print(f"{name}, {course.motion}, {course.stored}", COUNTS, values)
    print("angular momentum is about the world's origin, from which the body flies away: its change grows with both")
    print(f"bars for R'R - I: quaternion {BARS['quaternion']:g}, matrix {BARS['matrix']:g} on the free body;")
    print("a constant twist rounds alike at every step, so that a matrix left alone drifts as fast as it can (shown)")
    judged = [course for course in found if course.stored == "quaternion" or course.motion != CONSTANT]
    good = all(course.defect.max() < BARS[course.stored] for course in judged)
    print("all bars hold" if good else "A BAR IS MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
