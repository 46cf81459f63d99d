"""A double integrator of least energy, solved exactly."""

import functools
from typing import Any

import numpy as np
from trajectory_systems import double_integrator

import twistax as tx

NODES, TIME = 11, 2.0
STEP = TIME / (NODES - 1)
dynamics = functools.cache(lambda: tx.compile(double_integrator()))


def leaves() -> tuple[Any, Any, Any]:
    p, v = dynamics().states
    (u,) = dynamics().controls
    return p, v, u


def reached() -> np.ndarray:
    """(nodes, 2, 1 + intervals): p and v at the nodes by the first velocity and held controls, from p = 0."""
    found = np.zeros((NODES, 2, NODES))
    found[0, 1, 0] = 1.0
    for k in range(NODES - 1):
        found[k + 1] = np.array([[1.0, STEP], [0.0, 1.0]]) @ found[k]
        found[k + 1, :, 1 + k] += [0.5 * STEP**2, STEP]
    return found


def least_energy(rows: np.ndarray, values: Any) -> float:
    """The least integral of u^2 over first velocities and held controls with rows @ [v0, u] = values."""
    weight = np.diag([0.0, *[2.0 * STEP] * (NODES - 1)])
    matrix = np.block([[weight, rows.T], [rows, np.zeros((len(rows),) * 2)]])
    z = np.linalg.solve(matrix, [*np.zeros(NODES), *values])[:NODES]
    return float(STEP * z[1:] @ z[1:])


def farthest(budget: float) -> float:
    """The largest c . u with h u . u <= budget."""
    c = reached()[-1, 0, 1:]
    return float(np.sqrt(budget / STEP) * np.linalg.norm(c))
