"""References that no formula of the package enters: 4x4 matrices, commutators, forces at points, SciPy's `expm`.

Twists are in the order given; T = T_ab maps coordinates of frame b to frame a.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.linalg import expm

from ..groups import Order

__all__ = [
    "Values",
    "bracket_matrix",
    "commutator",
    "conjugate",
    "hat",
    "join",
    "mean_exponential",
    "skew",
    "total",
    "total_in_a",
    "vee",
]

#: The leaves of one case, by name.
Values = Mapping[str, np.ndarray]


def skew(w: np.ndarray) -> np.ndarray:
    """[w]x (3, 3)."""
    x, y, z = w
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def join(v: np.ndarray, w: np.ndarray, order: Order) -> np.ndarray:
    """The six-vector of a linear and an angular part."""
    return np.concatenate([v, w] if order.linear_leads else [w, v])


def hat(xi: np.ndarray, order: Order) -> np.ndarray:
    """xi^ = [[w]x v; 0 0] (4, 4)."""
    v, w = (xi[:3], xi[3:]) if order.linear_leads else (xi[3:], xi[:3])
    return np.block([[skew(w), v[:, None]], [np.zeros((1, 4))]])


def vee(X: np.ndarray, order: Order) -> np.ndarray:
    """The inverse of `hat`."""
    return join(X[:3, 3], np.array([X[2, 1], X[0, 2], X[1, 0]]), order)


def commutator(order: Order, xi: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """(X Y - Y X)^v of X = xi^, Y = eta^."""
    X, Y = hat(xi, order), hat(eta, order)
    return vee(X @ Y - Y @ X, order)


def bracket_matrix(order: Order, xi: np.ndarray) -> np.ndarray:
    """The matrix (6, 6) of eta -> [xi, eta]."""
    return np.stack([commutator(order, xi, unit) for unit in np.eye(6)], axis=1)


def conjugate(order: Order, T: np.ndarray, xi: np.ndarray) -> np.ndarray:
    """(T xi^ T^-1)^v."""
    return vee(T @ hat(xi, order) @ np.linalg.inv(T), order)


def total(points: np.ndarray, forces: np.ndarray, order: Order) -> np.ndarray:
    """Force and torque about the origin of forces that act at points."""
    return join(forces.sum(axis=0), np.cross(points, forces).sum(axis=0), order)


def total_in_a(order: Order, T: np.ndarray, points: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """The same of points and forces given in frame b, about the origin of a, in its axes."""
    return total(points @ T[:3, :3].T + T[:3, 3], forces @ T[:3, :3].T, order)


def mean_exponential(M: np.ndarray) -> np.ndarray:
    """The integral of expm(s M) over s from 0 to 1, as a block of one larger exponential."""
    n = len(M)
    return expm(np.block([[M, np.eye(n)], [np.zeros((n, 2 * n))]]))[:n, n:]
