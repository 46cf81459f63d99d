"""A linearised estimation problem in stages, and its smoother: a forward Riccati recursion, and a backward pass."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve

from ..update import symmetric
from .smoother import smoother_gain


class Sensed(NamedTuple):
    """A measurement about a state: $r = H d + v$, the covariance R of v, and its weight; 0 for a missing
    measurement.
    """

    residual: jax.Array
    H: jax.Array
    R: jax.Array
    weight: jax.Array


class LinearStage(NamedTuple):
    """A stage $d_k = F d_(k-1) - e + w$ with the covariance Q of w, and measurements by name. F of the first stage is
    zero.
    """

    F: jax.Array
    e: jax.Array
    Q: jax.Array
    sensed: dict[str, Sensed]


def smoothed(stages: LinearStage, damping: jax.Array, scale: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The most probable d (k, n) and their covariances (k, n, n).

    Args:
        stages: the stages, with a leading axis of times.
        damping: damping of steps: a measurement d = 0 with the covariance scale / damping is added.
        scale: (k, n), squares of the units of d.
    """

    def forward(carry: Any, row: tuple[LinearStage, jax.Array]) -> tuple[Any, Any]:
        (F, e, Q, sensed), unit = row
        m, P = F @ carry[0] - e, symmetric(F @ carry[1] @ F.T + Q)
        prior = m, P
        for name in sensed:
            m, P = _measured(m, P, sensed[name])
        gain = damping * cho_solve((jnp.linalg.cholesky(damping * P + jnp.diag(unit)), True), P).T
        m, P = m - gain @ m, symmetric(P - gain @ P)
        return (m, P), (m, P, *prior)

    n, dtype = stages.e.shape[1], stages.e.dtype
    start = jnp.zeros(n, dtype), jnp.zeros((n, n), dtype)
    (m, P), rows = jax.lax.scan(forward, start, (stages, scale))

    def back(later: Any, row: Any) -> tuple[Any, Any]:
        m, P, prior_m, prior_P, F = row
        C = smoother_gain(P, F, prior_P)
        estimate = m + C @ (later[0] - prior_m), symmetric(P + C @ (later[1] - prior_P) @ C.T)
        return estimate, estimate

    posterior = tuple(a[:-1] for a in rows[:2])
    prior = tuple(a[1:] for a in (*rows[2:], stages.F))
    _, earlier = jax.lax.scan(back, (m, P), (*posterior, *prior), reverse=True)
    means, covariances = (jnp.concatenate([a, b[None]]) for a, b in zip(earlier, (m, P), strict=True))
    return means, covariances


def _measured(m: jax.Array, P: jax.Array, sensed: Sensed) -> tuple[jax.Array, jax.Array]:
    """The estimate after a measurement, in Joseph's form, with the information multiplied by its weight."""
    H, R, weight = sensed.H, sensed.R, sensed.weight
    # weight H P H^T + R is definite for a weight of zero too.
    gain = weight * cho_solve((jnp.linalg.cholesky(symmetric(weight * H @ P @ H.T + R)), True), H @ P).T
    keep = jnp.eye(len(P), dtype=P.dtype) - gain @ H
    spread = gain @ R @ gain.T / jnp.where(weight > 0.0, weight, 1.0)
    return m + gain @ (sensed.residual - H @ m), symmetric(keep @ P @ keep.T + spread)


def in_range(Q: jax.Array, e: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The part of e in the range of a positive semidefinite Q, and its square $e^T Q^+ e$.

    Entries have different units, so the range is computed from the correlation matrix of Q.
    """
    size = jnp.sqrt(jnp.diag(Q))
    scale = jnp.where(size > 0.0, size, 1.0)
    values, vectors = jnp.linalg.eigh(Q / jnp.outer(scale, scale))
    kept = values > 100.0 * len(Q) * float(jnp.finfo(Q.dtype).eps)
    parts = jnp.where(kept, vectors.T @ (e / scale), 0.0)
    return scale * (vectors @ parts), jnp.sum(parts**2 / jnp.where(kept, values, 1.0))
