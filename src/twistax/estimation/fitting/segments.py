"""A segment of a record: its end, and the likelihood of its measurements with derivatives."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular

from ...expr import leaves_of
from ...linear.discretize import value_and_jacobian
from ...scalar.kernel_function import KernelFunction
from ...system.dynamics import Arrays
from ..error_state_kalman import ErrorStateKalman
from ..smoothers.robust_losses import RobustLoss
from ..stochastic_model import OperatingPoint
from .experiment import RecordRows


class Innovation(NamedTuple):
    """Residuals (k, m) of a measurement, their covariances (k, m, m), and which of them are present (k,)."""

    residual: jax.Array
    S: jax.Array
    present: jax.Array


class Likelihood(NamedTuple):
    """The negative log-likelihood, and the sum of normalised squares in it.

    Attributes:
        cost, squares: $1/2 sum (rho(s) + log det S + m log 2 pi)$ and $sum s$, where $s = e^T S^-1 e$ and rho(s) = s
            without a robust loss.
    """

    cost: jax.Array
    squares: jax.Array


class LinearizedSegment(NamedTuple):
    """A segment linearised about its initial state x and the parameters; the tangent is z = [d; theta], (q,).

    Attributes:
        end: the final state.
        slope: (n, q), the derivative of the final state with respect to z.
        likelihood: the likelihood of its measurements.
        gradient, information: (q,), (q, q), derivatives of the cost; the information is Fisher's.
    """

    end: Arrays
    slope: jax.Array
    likelihood: Likelihood
    gradient: jax.Array
    information: jax.Array


class Segments:
    """The likelihood of segments of records, as a function of their initial states and of free parameters.

    Without noise in the rates, a segment is simulated from its initial state, and the covariance S of a residual e is
    that of the measurement: the output error method. With noise, e and S are the innovations of the error-state filter:
    the filter error method. A residual with a robust loss is multiplied by its weight in the gradient and in the
    information, as in iteratively reweighted least squares.

    Source: Maine, Iliff, Identification of dynamic systems, NASA RP-1138 (1985), sec. 7 and 8; Huber, Robust
    statistics (1981), sec. 7.8.
    """

    def __init__(
        self,
        kalman: ErrorStateKalman,
        free: dict[str, tuple[slice, tuple[int, ...]]],
        losses: Mapping[str, RobustLoss],
    ) -> None:
        self.kalman, self.model, self.free, self.losses = kalman, kalman.model, free, losses
        backend, group = self.model.dynamics.backend, self.model.group
        self._row = KernelFunction(self._moved, backend)
        self._retracted = KernelFunction[Arrays](group.retract, backend)
        self._difference = KernelFunction[jax.Array](group.difference, backend)
        self.varying = {name: self._varies(name) for name in self.model.measurements}

    def _varies(self, name: str) -> bool:
        """Whether the covariance of a residual depends on states or free parameters."""
        measurement = self.model.measurements[name]
        if self.model.process or measurement.noises:
            return True
        leaves = () if measurement.covariance is None else leaves_of(measurement.covariance)
        states = [state.name for state in self.model.dynamics.states]
        return any(leaf.name in self.free or leaf.name in states for leaf in leaves)

    def simulated(
        self, x: Arrays, theta: jax.Array, rows: RecordRows, params: Arrays, P0: jax.Array | None = None
    ) -> tuple[Arrays, dict[str, Innovation]]:
        """The end of a segment and its innovations. P0 is the initial covariance of a filter; zero by default."""
        free = {name: theta[part].reshape(shape) for name, (part, shape) in self.free.items()}
        values = {**params, **free}
        if self.model.process:
            n = self.model.dimension
            start = jnp.zeros((n, n), theta.dtype) if P0 is None else P0
            _, post, updates = self.kalman.scanned((*rows[:2], *rows[3:], rows.controls), x, start, values)
            end = {name: states[-1] for name, states in post.x.items()}
            sensed = {name: (update.residual, update.S) for name, update in updates.items()}
        else:

            def moved(x: Arrays, row: Any) -> Any:
                return self._row(x, RecordRows(*row), values)

            end, sensed = jax.lax.scan(moved, x, tuple(rows))
        return end, {name: self._innovation(*sensed[name], rows.present[name]) for name in sensed}

    def _moved(
        self, x: Arrays, row: RecordRows, params: Arrays
    ) -> tuple[Arrays, dict[str, tuple[jax.Array, jax.Array]]]:
        """The state after a row, with residuals and their covariances."""
        model, sensed = self.model.in_arrays, {}
        x = model.moved(OperatingPoint(row.ts - row.hs, x, row.controls, params), row.hs)
        for name, z in row.values.items():
            value, _, R = model.sensitivity(name, OperatingPoint(row.ts, x, row.controls, params))
            sensed[name] = self.model.measurements[name].group.difference(value, z), R
        return x, sensed

    def _innovation(self, residual: jax.Array, S: jax.Array, present: jax.Array) -> Innovation:
        one = jnp.eye(S.shape[-1], dtype=S.dtype)
        return Innovation(
            jnp.where(present[:, None], residual, 0.0), jnp.where(present[:, None, None], S, one), present
        )

    def linearized(
        self, x: Arrays, theta: jax.Array, rows: RecordRows, params: Arrays, P0: jax.Array | None = None
    ) -> LinearizedSegment:
        """A segment, with the derivatives of its likelihood."""
        n = self.model.dimension

        def moved(z: jax.Array) -> Any:
            end, sensed = self.simulated(self._retracted(x, z[:n]), theta + z[n:], rows, params, P0)
            fixed = jax.tree.map(jax.lax.stop_gradient, end)
            slopes = {name: one[:2] if self.varying[name] else one[:1] for name, one in sensed.items()}
            return (self._difference(fixed, end), slopes), (end, sensed)

        z = jnp.zeros(n + theta.size, theta.dtype)
        (slope, slopes), (end, sensed) = jax.jacfwd(moved, has_aux=True)(z)
        gradient, information = jnp.zeros_like(z), jnp.zeros((z.size, z.size), z.dtype)
        for name, one in sensed.items():
            derivatives = functools.partial(_derivatives, self.losses.get(name))
            g, N = jax.vmap(derivatives)(one.residual, one.S, *slopes[name])
            gradient = gradient + jnp.sum(jnp.where(one.present[:, None], g, 0.0), axis=0)
            information = information + jnp.sum(jnp.where(one.present[:, None, None], N, 0.0), axis=0)
        likelihood = _summed([_likelihood(self.losses.get(name), one) for name, one in sensed.items()])
        return LinearizedSegment(end, slope, likelihood, gradient, information)


def gap_and_slopes(group: Any, end: Arrays, start: Arrays) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The gap $Log(start^-1 end)$, (n,), and its derivatives with respect to the start and the end, (n, n)."""
    n = group.dimension

    def gap(z: jax.Array) -> jax.Array:
        return group.difference(group.retract(start, z[:n]), group.retract(end, z[n:]))

    value, slopes = value_and_jacobian(gap, jnp.zeros(2 * n, next(iter(end.values())).dtype))
    return value, slopes[:, :n], slopes[:, n:]


def _likelihood(loss: RobustLoss | None, one: Innovation) -> Likelihood:
    def of_row(e: jax.Array, S: jax.Array) -> tuple[jax.Array, jax.Array]:
        root = jnp.linalg.cholesky(S)
        whitened = solve_triangular(root, e, lower=True)
        squares = whitened @ whitened
        cost = squares if loss is None else loss.cost(squares)
        return 0.5 * (cost + e.size * jnp.log(2.0 * jnp.pi)) + jnp.sum(jnp.log(jnp.diag(root))), squares

    costs, squares = jax.vmap(of_row)(one.residual, one.S)
    return Likelihood(jnp.sum(jnp.where(one.present, costs, 0.0)), jnp.sum(squares))


def _summed(parts: list[Likelihood]) -> Likelihood:
    return jax.tree.map(lambda *a: sum(a[1:], a[0]), *parts)


def _derivatives(
    loss: RobustLoss | None, e: jax.Array, S: jax.Array, by_e: jax.Array, by_S: jax.Array | None = None
) -> Any:
    """The gradient of $1/2 (rho(e^T S^-1 e) + log det S)$ and Fisher's information, by slopes (m, q) and (m, m, q).

    Source: Maine, Iliff, Identification of dynamic systems, NASA RP-1138 (1985); with the derivatives of S Gupta,
    Mehra, Computational aspects of maximum likelihood estimation, IEEE TAC 19 (1974), eq. 31.
    """
    root = jnp.linalg.cholesky(S)
    w, A = (solve_triangular(root, a, lower=True) for a in (e, by_e))
    weight = jnp.ones((), e.dtype) if loss is None else loss.weight(w @ w)
    gradient, information = weight * (A.T @ w), weight * (A.T @ A)
    if by_S is None:
        return gradient, information
    half = jax.vmap(lambda a: solve_triangular(root, a, lower=True), 2, 2)(by_S)
    B = jax.vmap(lambda a: solve_triangular(root, a.T, lower=True), 2, 2)(half)
    gradient = gradient + 0.5 * (jnp.einsum("iiq->q", B) - weight * jnp.einsum("i,ijq,j->q", w, B, w))
    return gradient, information + 0.5 * jnp.einsum("ijp,ijq->pq", B, B)
