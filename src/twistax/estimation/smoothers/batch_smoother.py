"""Batch smoother: the most probable states over all times, by Gauss-Newton and Levenberg-Marquardt steps."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve

from ...checks import listed, number, whole
from ...errors import EstimationError, InputError, ModelError, ShapeError
from ...groups import Product
from ...jax_inside import is_traced
from ...progress import watching
from ...system.dynamics import Arrays, Dynamics
from ...system.inputs import Values
from ..error_state_kalman import ErrorStateKalman
from ..filter import RunStages
from ..imu.preintegrated_navigation import PreintegratedNavigation
from ..measurement import Measurement
from ..records import Records
from ..stochastic_model import OperatingPoint
from .levenberg_marquardt import levenberg_marquardt
from .linear_stages import LinearStage, Sensed, in_range, smoothed
from .robust_losses import RobustLoss, checked_losses


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BatchEstimate:
    """The most probable states over a record. A pytree.

    Attributes:
        ts: (k,) times in s.
        xs: states by name, (k, *shape).
        P: (k, n, n), covariances of d in $x_true = x Exp(d)$, from the problem linearised about the states.
        cost: half the sum of losses of all residuals.
        weights: by measurement, (k,) weights $rho'(s)$ of the records; 0 for missing ones.
        iterations: the number of steps that were tried.
        step: the root mean square of the last change of the states, in standard deviations.
        converged: whether `step` is below the tolerance.
    """

    ts: jax.Array
    xs: Arrays
    P: jax.Array
    cost: jax.Array
    weights: Arrays
    iterations: jax.Array
    step: jax.Array
    converged: jax.Array

    @property
    def result(self) -> str:
        """ "successful", or the cause of the failure."""
        if not np.isfinite(np.asarray(self.cost)).all():
            return "not finite"
        if not np.asarray(self.converged).all():
            worst = float(np.max(self.step))
            return f"not converged after {int(np.max(self.iterations))} steps, the last of {worst:.2g} deviations"
        return "successful"


class _Data(NamedTuple):
    """What is the same in all iterations: that of `RunStages`, and by measurement its values and which exist."""

    ts: jax.Array
    hs: jax.Array
    controls: Arrays
    x0: Arrays
    P0: jax.Array
    params: Arrays
    values: dict[str, jax.Array]
    present: dict[str, jax.Array]

    def at(self, x: Arrays, t: jax.Array, u: Any) -> OperatingPoint:
        return OperatingPoint(t, x, u, self.params)


class BatchSmoother:
    """The states at all times that maximise the posterior density of nonlinear dynamics and measurements.

    With the prediction f over an interval, the covariance Q of its noise, and residuals r of measurements, the smoother
    minimises

        $1/2 d_0^T P_0^-1 d_0 + 1/2 sum_k d_k^T Q^-1 d_k + 1/2 sum rho(r^T R^-1 r)$,

    where d_0 is the difference of the first state from its estimate, and d_k that of a state from its prediction.

    A Gauss-Newton step is the smoother of the linearised problem: a Riccati recursion over the stages, whose cost is
    linear in their number. No covariance is inverted, so states without noise are supported; they satisfy their
    dynamics at each iterate. A step that increases the cost is repeated with Levenberg-Marquardt damping. The first
    iterate is that of `ErrorStateKalman` and `RauchTungStriebel`.

    Args:
        dynamics, measurements, method, max_step: as for `ErrorStateKalman`.
        losses: by measurement a `RobustLoss`; by default squares.
        max_iterations: the largest number of steps.
        tolerance: the size of the last step in standard deviations; by default the square root of the machine epsilon.
    Raises:
        ModelError: the errors of `ErrorStateKalman`; an object that is not a loss, or a loss of an unknown measurement.

    Example: `tx.estimation.BatchSmoother(dynamics, [gps]).run({"gps": (times, positions)}, x0, P0).xs`.

    Source: Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM J. Optim. 4 (1994); for damped steps
    Sarkka, Svensson, Levenberg-Marquardt and line-search extended Kalman smoothers, ICASSP (2020).
    """

    def __init__(
        self,
        dynamics: Dynamics | PreintegratedNavigation,
        measurements: Iterable[Measurement],
        *,
        losses: Mapping[str, RobustLoss] | None = None,
        method: Any = None,
        max_step: float | None = None,
        max_iterations: int = 50,
        tolerance: float | None = None,
    ) -> None:
        self.kalman = ErrorStateKalman(dynamics, measurements, method=method, max_step=max_step)
        self.model = self.kalman.model
        self.losses = checked_losses(losses, self.model.measurements)
        whole("max_iterations", max_iterations, 1, ModelError)
        if tolerance is not None:
            number("tolerance", tolerance, "a positive number", lambda size: size > 0.0, ModelError)
        self.max_iterations, self.tolerance = max_iterations, tolerance

    @watching("smooth")
    def run(
        self,
        records: Records,
        x0: Values,
        P0: Any,
        *,
        t0: float | None = None,
        u: Mapping[str, Any] | Callable[[Any], Mapping[str, Any]] | None = None,
        params: Values | None = None,
        save_at: Any = (),
        guess: Mapping[str, Any] | None = None,
    ) -> BatchEstimate:
        """The most probable states over records. Arguments are those of a filter's run.

        Args:
            guess: initial states by name at all times, (k, *shape); by default the smoothed states of a filter.
        Raises:
            InputError, ShapeError, EstimationError: the errors of a filter's run; a guess of the wrong shape;
                iterations that do not converge, unless values are traced.
        """
        stages = self.kalman.staged(records, x0, P0, t0, u, params, save_at)
        if guess is None:
            run = self.kalman.run(records, x0, P0, t0=t0, u=u, params=params, save_at=save_at)
            first = run.smooth().xs
        else:
            first = self._guess(guess, stages)
        data = _Data(*stages[1:], stages.timeline.values, stages.timeline.present)
        xs, P, cost, weights, last = self._solve(first, data)
        rows = stages.timeline.rows
        by_record = {name: weights[name][rows[name]] for name in weights}
        estimate = BatchEstimate(stages.ts, xs, P, cost, by_record, last.iterations, last.step, last.done)
        if not is_traced(cost) and (result := estimate.result) != "successful":
            raise EstimationError(
                f"the batch smoother is {result}.\n"
                "  fix: pass another guess=..., a larger max_iterations=..., or robust losses"
            )
        return estimate

    def _guess(self, guess: Mapping[str, Any], stages: RunStages) -> Arrays:
        states = {}
        for name, x in stages.x0.items():
            if name not in guess:
                raise InputError(f"guess needs the state {name!r}, got {listed(guess)}")
            states[name] = jnp.asarray(guess[name], x.dtype)
            if states[name].shape != (len(stages.ts), *x.shape):
                raise ShapeError(
                    f"guess[{name!r}] expects shape {(len(stages.ts), *x.shape)}, got {states[name].shape}"
                )
        return states

    @functools.cached_property
    def _solve(self) -> Callable[..., Any]:
        return jax.jit(self._solved)

    def _solved(self, xs: Arrays, data: _Data) -> Any:
        dtype, size = data.P0.dtype, (len(data.ts), self.model.dimension)
        round_off = float(jnp.finfo(dtype).eps)
        tolerance = np.sqrt(round_off) if self.tolerance is None else self.tolerance
        zero, still = jnp.zeros((), dtype), jnp.zeros(size, dtype)
        _, P = smoothed(self._linearized(data, xs)[0], zero, still + 1.0)
        variances = jnp.diagonal(P, axis1=1, axis2=2)
        scale = jnp.where(variances > 0.0, variances, 1.0)

        def tried(xs: Arrays, damping: jax.Array) -> tuple[Arrays, jax.Array, jax.Array]:
            stages, Qs = self._linearized(data, xs)
            d, _ = smoothed(stages, damping, scale)
            # Both costs with the covariances of this iterate, whose derivatives a Gauss-Newton step leaves out.
            Rs = {name: sensed.R for name, sensed in stages.sensed.items()}
            (_, before), (new, after) = (self._moved(data, Qs, Rs, xs, by) for by in (still, d))
            step = jnp.sqrt(jnp.max(jnp.mean(d * d / scale, axis=1)))
            return new, after <= before * (1.0 + 16.0 * round_off), step

        def settled(xs: Arrays) -> tuple[Arrays, jax.Array, LinearStage]:
            """The states as those without noise obey the dynamics, their cost and the stages about them."""
            stages, Qs = self._linearized(data, xs)
            return *self._moved(data, Qs, {name: one.R for name, one in stages.sensed.items()}, xs, still), stages

        last = levenberg_marquardt(settled(xs)[0], tried, zero + tolerance, self.max_iterations)
        xs, cost, stages = settled(last.value)
        _, P = smoothed(stages, zero, scale)
        return xs, P, cost, {name: sensed.weight for name, sensed in stages.sensed.items()}, last

    def _linearized(self, data: _Data, xs: Arrays) -> tuple[LinearStage, jax.Array]:
        """All stages about the states, the prior first, and the covariances of their noise about the predictions."""
        group, n = self.model.group, self.model.dimension

        def stage(x: Arrays, following: Arrays, t: Any, h: Any, u: Any) -> Any:
            y, transition, Q = self.model.step(data.at(x, t - h, u), h)
            return *_about(group, y, following, transition, Q), Q

        before, after = jax.tree.map(lambda a: a[:-1], xs), jax.tree.map(lambda a: a[1:], xs)
        ts, hs, controls = jax.tree.map(lambda a: a[1:], data[:3])
        rest = jax.vmap(stage)(before, after, ts, hs, controls)
        nothing = jnp.zeros((n, n), data.P0.dtype)
        first = *_about(group, data.x0, jax.tree.map(lambda a: a[0], xs), nothing, data.P0), data.P0
        F, e, Q, Qs = (jnp.concatenate([a[None], b]) for a, b in zip(first, rest, strict=True))
        return LinearStage(F, e, Q, {name: self._sensed(name, data, xs) for name in data.values}), Qs

    def _sensed(self, name: str, data: _Data, xs: Arrays) -> Sensed:
        """A measurement about the states at all times."""

        def one(t: Any, x: Arrays, u: Arrays, z: Any) -> tuple[jax.Array, ...]:
            value, H, R = self.model.sensitivity(name, data.at(x, t, u))
            return self.model.measurements[name].group.difference(value, z), H, R

        residual, H, R = jax.vmap(one)(data.ts, xs, data.controls, data.values[name])
        weight, _ = self._loss(name, data, residual, R)
        return Sensed(residual, H, R, weight)

    def _loss(self, name: str, data: _Data, residual: jax.Array, R: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The weights and losses of residuals at all times, (k,); zero where the record is missing."""
        s = jax.vmap(lambda r, R: r @ cho_solve((jnp.linalg.cholesky(R), True), r))(residual, R)
        loss, seen = self.losses.get(name), data.present[name]
        weight, cost = (jnp.ones_like(s), s) if loss is None else (loss.weight(s), loss.cost(s))
        return jnp.where(seen, weight, 0.0), jnp.where(seen, cost, 0.0)

    def _moved(
        self, data: _Data, Qs: jax.Array, Rs: dict[str, jax.Array], xs: Arrays, d: jax.Array
    ) -> tuple[Arrays, jax.Array]:
        """The states x Exp(d), of which parts without noise obey the dynamics, and the cost with these covariances."""
        group = self.model.group
        targets = jax.vmap(group.retract)(xs, d)

        def reached(y: Arrays, target: Arrays, Q: jax.Array) -> tuple[Arrays, jax.Array]:
            w, cost = in_range(Q, group.difference(y, target))
            return group.retract(y, w), cost

        def advance(x: Arrays, row: Any) -> tuple[Arrays, Any]:
            target, t, h, u, Q = row
            x, cost = reached(self.model.moved(data.at(x, t - h, u), h), target, Q)
            return x, (x, cost)

        rows = (targets, *data[:3], Qs)
        first, prior = reached(data.x0, jax.tree.map(lambda a: a[0], targets), Qs[0])
        _, (later, costs) = jax.lax.scan(advance, first, jax.tree.map(lambda a: a[1:], rows))
        moved = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, later)
        total = prior + jnp.sum(costs)
        for name, R in Rs.items():
            measured = jax.vmap(lambda t, x, u, name=name: self.model.measured(name, data.at(x, t, u)))
            difference = jax.vmap(self.model.measurements[name].group.difference)
            residual = difference(measured(data.ts, moved, data.controls), data.values[name])
            total = total + jnp.sum(self._loss(name, data, residual, R)[1])
        return moved, 0.5 * total


def _about(
    group: Product, y: Arrays, x: Arrays, transition: jax.Array, Q: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """F, e and the covariance of $d_k = F d_(k-1) - e + w$ about a state x that the prediction y misses by e."""
    e = group.difference(y, x)
    moved = group.right_jacobian(e)
    return group.Ad(group.exp(-e)) @ transition, e, moved @ Q @ moved.T
