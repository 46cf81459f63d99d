"""Square roots of covariances, which may be singular and whose entries have different units."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp


class CovarianceRoot(NamedTuple):
    """A square root of a positive semidefinite P: `scale` times the triangular `factor` of its correlation matrix.

    Deviations that are zero remain zero; a round-off is added to the correlations, so the factor is never singular.
    """

    scale: jax.Array
    factor: jax.Array

    @classmethod
    def of(cls, P: jax.Array) -> CovarianceRoot:
        n = len(P)
        positive = jnp.diag(P) > 0.0
        scale = jnp.where(positive, jnp.sqrt(jnp.where(positive, jnp.diag(P), 1.0)), 0.0)
        safe = jnp.where(positive, scale, 1.0)
        eye = jnp.eye(n, dtype=P.dtype)
        correlations = P / jnp.outer(safe, safe) + jnp.diag(jnp.where(positive, 0.0, 1.0).astype(P.dtype))
        return cls(scale, jnp.linalg.cholesky(correlations + n * float(jnp.finfo(P.dtype).eps) * eye))

    @property
    def matrix(self) -> jax.Array:
        """The matrix L with $L L^T = P$."""
        return self.scale[:, None] * self.factor

    def linear_map(self, slopes: jax.Array) -> jax.Array:
        """The transpose H^T of the linear map with $H L = slopes^T$; zero for known states."""
        safe = jnp.where(self.scale > 0.0, self.scale, 1.0)
        return jax.scipy.linalg.solve_triangular(self.factor, slopes, lower=True, trans=1) / safe[:, None]


def triangular(wide: jax.Array) -> jax.Array:
    """The lower triangular L (n, n) with $L L^T = A A^T$ for a wide A (n, m), without squares of its entries."""
    return jnp.linalg.qr(wide.T, mode="r").T
