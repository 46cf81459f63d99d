"""The Rauch-Tung-Striebel smoother on groups."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..groups import Product
from ..system.dynamics import Arrays


class Smoothed(NamedTuple):
    """States and covariances that use all measurements of a run, including later ones.

    Attributes:
        ts: (k,) times in s.
        xs: states by name, (k, *shape).
        P: (k, n, n) covariances of d in $x_true = x Exp(d)$.
    """

    ts: jax.Array
    xs: Arrays
    P: jax.Array


class RauchTungStriebel:
    """The fixed-interval smoother: one pass backwards over a run of a filter.

    With the estimate (x, P) after the measurements at a time, the prediction (y, M) from it and the smoothed estimate
    (s, N) of the next time,

        $C = P Phi^T M^-1, e = Log(y^-1 s), d = C e,$
        $x_s = x Exp(d), P_s = J_r(d) (P + C (J_r(e)^-1 N J_r(e)^-T - M) C^T) J_r(d)^T$.

    The Jacobians transform covariances to the tangent space at their estimate; on $R^m$ they are
    identities. Directions in which M is singular, such as a known constant, have no gain. Traceable.

    Raises: nothing; numbers that are not finite are propagated.

    Source: Rauch, Tung, Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA J. 3 (1965); on groups
    Bourmaud et al., Continuous-discrete extended Kalman filter on matrix Lie groups, JMIV 51 (2015).
    """

    def smooth(
        self, group: Product, ts: jax.Array, post: tuple[Arrays, jax.Array], prior: tuple[Arrays, jax.Array, jax.Array]
    ) -> Smoothed:
        """The smoothed states of the estimates `post`, (x, P), and predictions `prior`, (x, P, Phi), at times (k,)."""
        xs, Ps = post

        def back(later: Any, row: Any) -> tuple[Any, Any]:
            s, N = later
            x, P, y, M, transition = row
            C = _over(P @ transition.T, M)
            e = group.difference(y, s)
            d = C @ e
            moved = group.right_jacobian_inv(e)
            reset = group.right_jacobian(d)
            smoothed = reset @ (P + C @ (moved @ N @ moved.T - M) @ C.T) @ reset.T
            estimate = group.retract(x, d), 0.5 * (smoothed + smoothed.T)
            return estimate, estimate

        last = {name: x[-1] for name, x in xs.items()}, Ps[-1]
        head, tail = jax.tree.map(lambda a: a[:-1], (xs, Ps)), jax.tree.map(lambda a: a[1:], prior)
        _, rows = jax.lax.scan(back, last, (*head, *tail), reverse=True)
        xs, Ps = jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), rows, last)
        return Smoothed(ts, xs, Ps)


def _over(A: jax.Array, M: jax.Array) -> jax.Array:
    """A M^+ for a positive semidefinite M, whose rows have units of their own."""
    size = jnp.sqrt(jnp.diag(M))
    scale = jnp.where(size > 0.0, size, 1.0)
    inverse = jnp.linalg.pinv(M / jnp.outer(scale, scale), hermitian=True)
    return (A / scale[None, :]) @ inverse / scale[None, :]
