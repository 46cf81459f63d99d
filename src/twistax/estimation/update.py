"""The update of an estimate by a linear, or linearised, measurement."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve, solve_triangular

from ..groups import Product
from ..system.dynamics import Arrays
from .covariance_root import triangular

#: (group, d) -> (n, n): what moves a covariance to the tangent space at x Exp(d).
Reset = Callable[[Product, jax.Array], jax.Array]


class Update(NamedTuple):
    """The estimate after a measurement.

    Attributes:
        x, P: state and covariance, unchanged if the measurement was not used.
        residual: (m,) $Log(h(x)^-1 z)$, in the tangent space of the measurement.
        S: (m, m), its covariance.
        nis: normalised innovation squared $r^T S^-1 r$, with mean m for a consistent filter.
        used: whether the measurement passed the gate.
        information: (n, n) information matrix $H^T R^-1 H$ of the measurement; not finite if R is not positive
            definite.
        log_likelihood: log-likelihood of the measurement.
    """

    x: Arrays
    P: jax.Array
    residual: jax.Array
    S: jax.Array
    nis: jax.Array
    used: jax.Array
    information: jax.Array
    log_likelihood: jax.Array


class LinearMeasurement(NamedTuple):
    """A measurement about an estimate x, $r = H d + v$, with the covariance R of v."""

    x: Arrays
    residual: jax.Array
    H: jax.Array
    R: jax.Array

    def updated(
        self, group: Product, P: jax.Array, new_P: jax.Array, d: jax.Array, root: jax.Array, limit: float | None
    ) -> Update:
        """The update from P to new_P and x Exp(d), unless it is discarded. `root` is a triangular root of S."""
        whitened = solve_triangular(root, self.residual, lower=True)
        nis = whitened @ whitened
        used = jnp.ones((), bool) if limit is None else ~(nis > limit)  # a NaN is no outlier
        new_x = group.retract(self.x, d)
        information = self.H.T @ cho_solve((jnp.linalg.cholesky(self.R), True), self.H)
        # The diagonal by a mask: kernels of matrices have no gathers along two axes.
        deviations = jnp.abs(jnp.sum(jnp.where(jnp.eye(len(root), dtype=bool), root, 0.0), axis=1))
        likelihood = -0.5 * (nis + d.dtype.type(self.residual.size) * jnp.log(2.0 * jnp.pi))
        likelihood = likelihood - jnp.sum(jnp.log(deviations))
        zero = jnp.zeros((), P.dtype)
        return Update(
            {key: jnp.where(used, new_x[key], self.x[key]) for key in self.x},
            jnp.where(used, new_P, P),
            self.residual,
            root @ root.T,
            nis,
            used,
            jnp.where(used, information, zero),
            jnp.where(used, likelihood, zero),
        )


def symmetric(P: jax.Array) -> jax.Array:
    """The symmetric matrix with this lower triangle; scalar programs do not compute the upper triangle."""
    return jnp.tril(P) + jnp.tril(P, -1).T


def linear_update(
    group: Product,
    measured: LinearMeasurement,
    P: jax.Array,
    limit: float | None,
    reset: Reset = Product.right_jacobian,
) -> Update:
    """The estimate after a measurement, in Joseph's form, with P in the tangent space at its end."""
    _, residual, H, R = measured
    root = jnp.linalg.cholesky(symmetric(H @ P @ H.T + R))
    gain = cho_solve((root, True), H @ P).T
    d = gain @ residual
    keep = jnp.eye(group.dimension, dtype=P.dtype) - gain @ H
    moved = reset(group, d)
    new_P = symmetric(moved @ (keep @ P @ keep.T + gain @ R @ gain.T) @ moved.T)
    return measured.updated(group, P, new_P, d, root, limit)


def root_update(
    group: Product,
    measured: LinearMeasurement,
    L: jax.Array,
    limit: float | None,
    reset: Reset = Product.right_jacobian,
) -> Update:
    """The same update with roots, $P = L L^T$, by one orthogonal transformation; the P of the result is the new root.

    With the transformation T on the right, $[R^(1/2), H L; 0, L] T = [S^(1/2), 0; K S^(1/2), L']$.
    """
    _, residual, H, R = measured
    m = residual.size
    above = jnp.concatenate([jnp.linalg.cholesky(R), H @ L], axis=1)
    below = jnp.concatenate([jnp.zeros((L.shape[0], m), L.dtype), L], axis=1)
    lower = triangular(jnp.concatenate([above, below], axis=0))
    root = lower[:m, :m]
    d = lower[m:, :m] @ solve_triangular(root, residual, lower=True)
    return measured.updated(group, L, reset(group, d) @ lower[m:, m:], d, root, limit)
