"""Independent oracles for the Lie nodes: points, point forces and point masses, 4x4 matrices, NumPy and SciPy alone."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from expr_cases import function_of
from scipy.linalg import expm

import twistax as tx
from oracles import skew

CASES = 48


def split(six: np.ndarray, order: tx.Order) -> tuple[np.ndarray, np.ndarray]:
    """Linear and angular part along the last axis."""
    halves = six[..., :3], six[..., 3:]
    return halves if order is tx.LINEAR_FIRST else halves[::-1]


def join(linear: np.ndarray, angular: np.ndarray, order: tx.Order) -> np.ndarray:
    return np.concatenate([linear, angular] if order is tx.LINEAR_FIRST else [angular, linear], axis=-1)


def hat(xi: np.ndarray, order: tx.Order) -> np.ndarray:
    v, w = split(xi, order)
    return np.block([[skew(w), v[:, None]], [np.zeros((1, 4))]])


def vee(X: np.ndarray, order: tx.Order) -> np.ndarray:
    """The six-vector of a matrix of se(3); fails for any other matrix."""
    np.testing.assert_allclose(X[:3, :3], -X[:3, :3].T, atol=1e-10)
    np.testing.assert_allclose(X[3], 0.0, atol=1e-10)
    return join(X[:3, 3], np.array([X[2, 1], X[0, 2], X[1, 0]]), order)


def poses(rng: np.random.Generator, size: int = CASES, angle: float = 2.0) -> np.ndarray:
    """Random poses made with SciPy."""
    return np.stack([expm(hat(rng.normal(size=6) * angle, tx.LINEAR_FIRST)) for _ in range(size)])


def total_wrench(points: np.ndarray, forces: np.ndarray, order: tx.Order) -> np.ndarray:
    """Force and torque about the origin of forces that act at points."""
    return join(forces.sum(axis=0), np.cross(points, forces).sum(axis=0), order)


def moved(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points of frame b in frame a."""
    return points @ T[:3, :3].T + T[:3, 3]


def batched_all(*exprs: tx.Expr, **values: np.ndarray) -> list[np.ndarray]:
    """The expressions over a batch of values of their leaves, in one compiled call."""
    return [np.asarray(value) for value in jax.jit(jax.vmap(function_of(*exprs)))(dict(values))]


def batched(expr: tx.Expr, **values: np.ndarray) -> np.ndarray:
    return batched_all(expr, **values)[0]


def each(function: Any, *batches: np.ndarray) -> np.ndarray:
    return np.stack([function(*entries) for entries in zip(*batches, strict=True)])


def agree(found: np.ndarray, wanted: np.ndarray, tolerance: float = 1e-12) -> None:
    assert found.shape == wanted.shape
    np.testing.assert_allclose(found, wanted, rtol=tolerance, atol=tolerance * max(1.0, float(np.abs(wanted).max())))


def sides(expr: tx.Expr, values: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The value as written and after canonicalize."""
    function = jax.jit(function_of(expr, expr.canonicalize()))
    written, simpler = function(dict(values))
    return np.asarray(written), np.asarray(simpler)
