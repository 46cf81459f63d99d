"""The unscented Kalman filter on groups."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ..groups import Group
from .covariance_root import CovarianceRoot
from .filter import Filter
from .prediction.adaptive_prediction import Prediction
from .stochastic_model import OperatingPoint
from .update import LinearMeasurement, Update, linear_update, symmetric


class UnscentedKalman(Filter):
    """The unscented Kalman filter with sigma points on the group of the state.

    The 2 n sigma points are $x Exp(+- n^(1/2) l_i)$, with l_i the columns of a square root of P, and with equal
    weights. Each is propagated by a step of the method, or mapped by the measurement. A mean on a group is $y Exp(m)$,
    with y the value at x and m the mean of $Log(y^-1 y_i)$. Rates and measurements are not differentiated with respect
    to the state; the noise enters linearly, by Van Loan's method as in `ErrorStateKalman`. For a linear system the
    estimates are those of the Kalman filter.

    Args:
        dynamics: the compiled system, with `tx.Noise` in its rates.
        measurements: the models of the sensors, a `tx.Measurement` each.
        method: the integration method of the mean; RKMK with RK4 by default.
        max_step: the longest step of a prediction in s; by default there is one step between two times.
        rtol, atol, control: as for `ErrorStateKalman`; the errors are those at the mean, with the derivative of the
            step there.
        gate: a probability, as for `ErrorStateKalman`.
        noise: as for `ErrorStateKalman`.
    Raises:
        ModelError: the errors of `ErrorStateKalman`.

    Example: `tx.estimation.UnscentedKalman(dynamics, [gps]).run({"gps": (times, positions)}, x0, P0)`.

    Source: Julier, Uhlmann, Unscented filtering and nonlinear estimation, Proc. IEEE 92 (2004), eq. 12; on groups
    Brossard, Barrau, Bonnabel, A code for unscented Kalman filtering on manifolds, ICRA (2020), with other weights.
    """

    def propagated(self, point: OperatingPoint, P: jax.Array, h: jax.Array) -> Prediction:
        group = self.model.group
        root = CovarianceRoot.of(P)
        center = self.model.moved(point, h)
        points = self._points(point, root, lambda one: self.model.moved(one, h))
        mean, deviations = _around_mean(group, center, points)
        transition = root.linear_map(_by_root(deviations)).T
        Q = self.model.process_noise(point, center, transition, h)
        return Prediction(mean, symmetric(deviations.T @ deviations / len(deviations) + Q), transition)

    def corrected(self, name: str, point: OperatingPoint, P: jax.Array, z: jax.Array, limit: float | None) -> Update:
        group = self.model.measurements[name].group
        center, _, R = self.model.sensitivity(name, point)
        root = CovarianceRoot.of(P)
        mean, deviations = _around_mean(
            group, center, self._points(point, root, lambda p: self.model.measured(name, p))
        )
        slopes = _by_root(deviations)
        # What the linear map does not explain is noise too: the spread of the points about it.
        spread = symmetric(deviations.T @ deviations / len(deviations) - slopes.T @ slopes)
        residual = group.difference(mean, z)
        measured = LinearMeasurement(point.x, residual, root.linear_map(slopes).T, R + spread)
        return linear_update(self.model.group, measured, P, limit)

    def _points(self, point: OperatingPoint, root: CovarianceRoot, function: Callable[[OperatingPoint], Any]) -> Any:
        """A function at all sigma points, those of positive sign first."""
        n = self.model.dimension
        columns = jnp.sqrt(jnp.asarray(n, root.factor.dtype)) * root.matrix.T
        signed = jnp.concatenate([columns, -columns])
        return jax.vmap(lambda d: function(point.moved(x=self.model.group.retract(point.x, d))))(signed)


def _by_root(deviations: jax.Array) -> jax.Array:
    """(n, m): the mean change along each column of the root, from 2 n deviations (2 n, m)."""
    n = len(deviations) // 2
    return (deviations[:n] - deviations[n:]) / (2.0 * jnp.sqrt(jnp.asarray(n, deviations.dtype)))


def _around_mean(group: Group, center: Any, points: Any) -> tuple[Any, jax.Array]:
    """The mean of points near a center, and their deviations (k, m) from it in the tangent space there."""

    def deviations(of: Any) -> jax.Array:
        return jax.vmap(lambda point: group.difference(of, point))(points)

    mean = group.retract(center, jnp.mean(deviations(center), axis=0))
    around = deviations(mean)
    return mean, around - jnp.mean(around, axis=0)[None, :]
