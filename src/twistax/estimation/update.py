"""The update of an estimate by a linear, or linearised, measurement."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..groups import Product
from ..system.dynamics import Arrays


class Update(NamedTuple):
    """The estimate after a measurement.

    Attributes:
        x, P: state and covariance, unchanged where the measurement was not used.
        residual: (m,) $Log(h(x)^-1 z)$, in the tangent space of the measurement.
        S: (m, m), its covariance.
        nis: normalised innovation squared $r^T S^-1 r$, of mean m for a consistent filter.
        used: whether it passed the gate.
        information: (n, n) $H^T R^-1 H$, the information matrix of the measurement.
        log_likelihood: of the measurement.
    """

    x: Arrays
    P: jax.Array
    residual: jax.Array
    S: jax.Array
    nis: jax.Array
    used: jax.Array
    information: jax.Array
    log_likelihood: jax.Array


def symmetric(P: jax.Array) -> jax.Array:
    """The symmetric part."""
    return 0.5 * (P + P.T)


def linear_update(
    group: Product,
    x: Arrays,
    P: jax.Array,
    residual: jax.Array,
    H: jax.Array,
    R: jax.Array,
    limit: float | None,
    reset: Callable[[Product, jax.Array], jax.Array] = Product.right_jacobian,
) -> Update:
    """The estimate after a measurement with $r = H d + v$, in Joseph's form, with P in the tangent space at its end."""
    S = symmetric(H @ P @ H.T + R)
    factor = jnp.linalg.cholesky(S)
    gain = jax.scipy.linalg.cho_solve((factor, True), H @ P).T
    whitened = jax.scipy.linalg.solve_triangular(factor, residual, lower=True)
    nis = whitened @ whitened
    used = jnp.ones((), bool) if limit is None else nis <= limit
    d = gain @ residual
    keep = jnp.eye(group.dimension, dtype=P.dtype) - gain @ H
    moved = reset(group, d)
    new_P = symmetric(moved @ (keep @ P @ keep.T + gain @ R @ gain.T) @ moved.T)
    new_x = group.retract(x, d)
    information = H.T @ jnp.linalg.solve(R, H)
    likelihood = -0.5 * (nis + residual.size * jnp.log(2.0 * jnp.pi)) - jnp.sum(jnp.log(jnp.diag(factor)))
    zero = jnp.zeros((), P.dtype)
    return Update(
        {key: jnp.where(used, new_x[key], x[key]) for key in x},
        jnp.where(used, new_P, P),
        residual,
        S,
        nis,
        used,
        jnp.where(used, information, zero),
        jnp.where(used, likelihood, zero),
    )
