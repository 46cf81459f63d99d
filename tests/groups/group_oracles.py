"""Independent oracles for the groups: every group as a group of matrices, written with NumPy and SciPy alone."""

import numpy as np
from scipy.linalg import block_diag, expm

import twistax as tx
from oracles import skew
from registered import concrete_classes
from twistax.groups import (
    ANGULAR_FIRST,
    SE3,
    SO3,
    Euclidean,
    Group,
    Product,
    SpecialEuclidean,
    SpecialOrthogonal,
)
from twistax.groups.power import GroupPower

#: Every class of groups of the package, as it makes examples of itself, and products of all kinds.
CLASSES = concrete_classes(Group)
GROUPS = [
    *(group for cls in CLASSES for group in cls.examples()),
    Product({"z": SE3, "mass": Euclidean(), "a": SO3, "grid": Euclidean((2, 2))}),
    Product({"pair": Product({"y": SO3, "x": SE3.with_order(ANGULAR_FIRST)}), "b": Euclidean((2,))}),
]


def translation(a):
    """The matrix that translates R^m by a, less the identity."""
    result = np.zeros((a.size + 1, a.size + 1))
    result[:-1, -1] = a.ravel()
    return result


def hat(group, xi):
    """The tangent as a matrix of the Lie algebra."""
    xi = np.asarray(xi)
    if isinstance(group, SpecialOrthogonal):
        return skew(xi)
    if isinstance(group, SpecialEuclidean):
        v, w = (xi[3:], xi[:3]) if group.order == ANGULAR_FIRST else (xi[:3], xi[3:])
        return np.block([[skew(w), v[:, None]], [np.zeros((1, 4))]])
    if isinstance(group, tx.ExtendedPose):
        columns = xi[3:].reshape(-1, 3).T
        return np.block([[skew(xi[:3]), columns], [np.zeros((columns.shape[1], 3 + columns.shape[1]))]])
    if isinstance(group, Euclidean):
        return translation(xi)
    if isinstance(group, GroupPower):
        return block_diag(*(hat(group.group, row) for row in xi.reshape(group.count, -1)))
    if not isinstance(group, Product):
        raise NotImplementedError(f"write hat and represent of {group.name} here, independently of the group")
    blocks, start = [], 0
    for factor in group.factors.values():
        blocks.append(hat(factor, xi[start : start + factor.dimension]))
        start += factor.dimension
    return block_diag(*blocks)


def represent(group, g):
    """The element as a matrix."""
    if isinstance(group, Euclidean):
        return translation(np.asarray(g)) + np.eye(group.dimension + 1)
    if isinstance(group, Product):
        return block_diag(*(represent(factor, g[name]) for name, factor in group.factors.items()))
    if isinstance(group, GroupPower):
        return block_diag(*(represent(group.group, row) for row in g))
    return np.asarray(g)


def basis(group):
    return [hat(group, unit) for unit in np.eye(group.dimension)]


def coordinates(group, X):
    """The tangent whose matrix is X; fails if X lies outside the algebra."""
    columns = np.stack([element.ravel() for element in basis(group)], axis=1)
    xi, *_ = np.linalg.lstsq(columns, X.ravel(), rcond=None)
    np.testing.assert_allclose(hat(group, xi), X, atol=1e-11 * (1.0 + np.abs(X).max()))
    return xi


def ad(group, xi):
    """The matrix of the commutator."""
    X = hat(group, xi)
    return np.stack([coordinates(group, X @ E - E @ X) for E in basis(group)], axis=1)


def right_jacobian(group, xi):
    """sum_k (-ad)^k / (k+1)!, as the upper right block of an exponential."""
    n = group.dimension
    stacked = np.block([[-ad(group, xi), np.eye(n)], [np.zeros((n, 2 * n))]])
    return expm(stacked)[:n, n:]
