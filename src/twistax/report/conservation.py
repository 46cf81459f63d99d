"""What a flight keeps that physics keeps: momentum and energy of a free body, and the group.

`python -m twistax.report.conservation` prints a table. Exit status 1 if its bar is missed. For long flights see
`twistax.report.drift`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..expr import Constant, State
from ..expr.lie import AdjointDual
from ..expr.solve import Solve
from ..groups import SE3, so3
from ..integrators import RKMK, integrate
from ..integrators.tableaus import EULER, HEUN, RK4
from ..lowering import Dynamics, compile
from ..system import System

__all__ = ["DRIFT_BAR", "drifts", "invariants", "main"]

DRIFT_BAR = 1e-9
"""The largest change of the world linear momentum in 5 s with RK4 at 1 ms, in N s."""

MASS = 2.0  # kg
CENTRE = np.array([0.1, -0.2, 0.3])  # m, from the body's origin
INERTIA = np.diag([1.0, 2.0, 3.0])  # kg m^2, about the centre of mass
TWIST = np.array([1.0, 0.5, -0.3, 0.4, 2.0, -0.7])  # m/s, rad/s


@dataclass(frozen=True)
class Drift:
    """Largest changes over a flight: linear (N s) and angular (N m s) momentum in the world, energy (J), and defect."""

    method: str
    dt: float
    linear: float
    angular: float
    energy: float
    defect: float


def spatial_inertia() -> np.ndarray:
    """(6, 6) about the body's origin, order [v; w]."""
    c = np.asarray(so3.hat(CENTRE))
    return np.block([[MASS * np.eye(3), -MASS * c], [MASS * c, INERTIA - MASS * c @ c]])


def free_body() -> Dynamics:
    """A rigid body under no force, its centre of mass away from its origin."""
    g, V, M = State("g", group=SE3), State("V", shape=(6,)), Constant(spatial_inertia())
    return compile(System(rates={g: V, V: Solve(M, -AdjointDual(V, M @ V))}))


def drifts(steps_per_second: tuple[int, ...] = (100, 1000), seconds: float = 5.0) -> list[Drift]:
    """One row for every tableau and step. Needs JAX's x64 switch."""
    dynamics = free_body()
    ts = np.linspace(0.0, seconds, 101)
    rows = []
    for tableau in (EULER, HEUN, RK4):
        for rate in steps_per_second:
            start = {"g": np.eye(4), "V": TWIST}
            sol = integrate(dynamics, start, t1=seconds, dt=1.0 / rate, method=RKMK(tableau), save_at=ts)
            linear, angular, energy = map(_change, invariants(sol.xs["g"], sol.xs["V"]))
            rows.append(Drift(tableau.name, 1.0 / rate, linear, angular, energy, _largest_defect(sol.xs["g"])))
    return rows


def invariants(g: ArrayLike, V: ArrayLike) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """What a free body keeps: linear (n, 3) and angular momentum (n, 3) in the world, about its origin; energy (n,)."""
    g, V = np.asarray(g), np.asarray(V)
    R, p, momentum = g[:, :3, :3], g[:, :3, 3], V @ spatial_inertia()
    linear = np.einsum("nij,nj->ni", R, momentum[:, :3])
    angular = np.einsum("nij,nj->ni", R, momentum[:, 3:]) + np.cross(p, linear)
    return linear, angular, 0.5 * np.sum(V * momentum, axis=1)


def _change(values: np.ndarray) -> float:
    return float(np.abs(values - values[0]).max())


def _largest_defect(poses: jax.Array) -> float:
    return float(jnp.max(jax.vmap(SE3.defect)(poses)))


def main() -> int:
    """Prints the table; exit status 1 if the bar is missed."""
    jax.config.update("jax_enable_x64", True)
    print("A free body, centre of mass off its origin, translating and spinning: largest changes in 5 s")
    print(f"{'method':<8}{'dt (s)':>8}{'linear (N s)':>15}{'angular (N m s)':>17}{'energy (J)':>13}{'R^T R - I':>12}")
    rows = drifts()
    for row in rows:
        print(
            f"{row.method:<8}{row.dt:>8g}{row.linear:>15.1e}{row.angular:>17.1e}{row.energy:>13.1e}{row.defect:>12.1e}"
        )
    judged = next(row for row in rows if row.method == "RK4" and row.dt == 1e-3)
    print(f"bar for RK4 at 0.001 s: linear momentum {DRIFT_BAR:g} N s")
    held = judged.linear < DRIFT_BAR
    print("the bar holds" if held else "THE BAR IS MISSED")
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
