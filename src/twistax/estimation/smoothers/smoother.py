"""Smoothers for a filter's run, on groups: over the whole run, or with a fixed lag."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ...checks import whole
from ...errors import InputError
from ...groups import Product
from ...system.dynamics import Arrays


class Smoothed(NamedTuple):
    """States and covariances that use all measurements of a run, including those of later times.

    Attributes:
        ts: (k,) times in s.
        xs: states by name, (k, *shape).
        P: (k, n, n) covariances of d in $x_true = x Exp(d)$.
    """

    ts: jax.Array
    xs: Arrays
    P: jax.Array


@dataclasses.dataclass(frozen=True)
class RauchTungStriebel:
    """The fixed-interval smoother: one backward pass over a filter's run.

    With the estimate (x, P) after the measurements at a time, the prediction (y, M) from it and the smoothed estimate
    (s, N) of the next time,

        $C = P Phi^T M^-1, e = Log(y^-1 s), d = C e,$
        $x_s = x Exp(d), P_s = J_r(d) (P + C (J_r(e)^-1 N J_r(e)^-T - M) C^T) J_r(d)^T$.

    The Jacobians transform covariances to the tangent space at the smoothed estimate; on $R^m$ they are identities.
    Directions in which M is singular, such as a known constant, have zero gain. Traceable.

    Raises: nothing; values that are not finite propagate.

    Source: Rauch, Tung, Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA J. 3 (1965); on groups
    Bourmaud et al., Continuous-discrete extended Kalman filter on matrix Lie groups, JMIV 51 (2015).
    """

    def smooth(
        self, group: Product, ts: jax.Array, post: tuple[Arrays, jax.Array], prior: tuple[Arrays, jax.Array, jax.Array]
    ) -> Smoothed:
        """The smoothed states from the estimates `post`, (x, P), and predictions `prior`, (x, P, Phi), at times
        (k,).
        """
        xs, Ps = post
        last = {name: x[-1] for name, x in xs.items()}, Ps[-1]
        head, tail = jax.tree.map(lambda a: a[:-1], (xs, Ps)), jax.tree.map(lambda a: a[1:], prior)

        def back(later: Any, row: Any) -> tuple[Any, Any]:
            estimate = backward(group, later, row)
            return estimate, estimate

        _, rows = jax.lax.scan(back, last, (*head, *tail), reverse=True)
        xs, Ps = jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), rows, last)
        return Smoothed(ts, xs, Ps)


@dataclasses.dataclass(frozen=True)
class FixedLagSmoother:
    """The fixed-lag smoother: the mean of a state given the measurements up to `lag` times later, $E[x_k | z_0, ...,
    z_(k + lag)]$.

    An online estimator can compute it. It performs the steps of `RauchTungStriebel` from each time back over `lag`
    intervals. Traceable.

    Attributes:
        lag: the number of later times of the run, 1 or more, dimensionless.
    Raises: InputError for an invalid lag.

    Source: Anderson, Moore, Optimal Filtering (1979), sec. 7.3, which gives the same numbers.
    """

    lag: int

    def __post_init__(self) -> None:
        whole("FixedLagSmoother: lag", self.lag, 1, InputError)

    def smooth(
        self, group: Product, ts: jax.Array, post: tuple[Arrays, jax.Array], prior: tuple[Arrays, jax.Array, jax.Array]
    ) -> Smoothed:
        """The smoothed states from the estimates `post`, (x, P), and predictions `prior`, (x, P, Phi), at times
        (k,).
        """
        count = ts.shape[0]

        def at(k: jax.Array) -> Any:
            row = lambda tree, i: jax.tree.map(lambda a: a[i], tree)  # noqa: E731

            def back(later: Any, j: jax.Array) -> tuple[Any, None]:
                inside = k + j + 1 < count
                following = jnp.minimum(k + j + 1, count - 1)
                earlier = backward(group, later, (*row(post, following - 1), *row(prior, following)))
                return jax.tree.map(lambda a, b: jnp.where(inside, a, b), earlier, later), None

            start = row(post, jnp.minimum(k + self.lag, count - 1))
            return jax.lax.scan(back, start, jnp.arange(self.lag), reverse=True)[0]

        return Smoothed(ts, *jax.lax.map(at, jnp.arange(count)))


def backward(group: Product, later: tuple[Arrays, jax.Array], row: Any) -> tuple[Arrays, jax.Array]:
    """The smoothed estimate at a time from that at the next time, `later`, with the row (x, P, y, M, Phi)."""
    s, N = later
    x, P, y, M, transition = row
    C = smoother_gain(P, transition, M)
    e = group.difference(y, s)
    d = C @ e
    moved = group.right_jacobian_inv(e)
    reset = group.right_jacobian(d)
    smoothed = reset @ (P + C @ (moved @ N @ moved.T - M) @ C.T) @ reset.T
    return group.retract(x, d), 0.5 * (smoothed + smoothed.T)


def smoother_gain(P: jax.Array, transition: jax.Array, M: jax.Array) -> jax.Array:
    """The gain $P Phi^T M^+$ for a positive semidefinite M whose entries have different units."""
    size = jnp.sqrt(jnp.diag(M))
    scale = jnp.where(size > 0.0, size, 1.0)
    inverse = jnp.linalg.pinv(M / jnp.outer(scale, scale), hermitian=True)
    return ((P @ transition.T) / scale[None, :]) @ inverse / scale[None, :]
