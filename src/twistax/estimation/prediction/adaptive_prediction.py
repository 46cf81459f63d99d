"""Predictions by steps of a length that tolerances choose."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import instance
from ...errors import ModelError
from ...groups import Product
from ...integrators import RKMK, Result, StepControl, VectorField
from ...integrators.charts.coordinates import Blocks
from ...integrators.loop.checkpointed import take_steps
from ...integrators.options import tolerances_of
from ...integrators.step_control import ErrorHistory, Tolerances
from ...integrators.tableaus import TSIT5
from ...scalar.kernel_function import KernelFunction
from ...system.dynamics import Arrays
from ..stochastic_model import OperatingPoint, StochasticModel
from ..update import symmetric

#: The default of the steps in one prediction. Reverse mode stores the lengths of as many.
_MAX_STEPS = 256


class Estimate(NamedTuple):
    """The estimate $x_true = x Exp(d)$: states x by name, and the covariance P (n, n) of d, in squares of its units."""

    x: Arrays
    P: jax.Array


class Prediction(NamedTuple):
    """The estimate x, P before a measurement, and the transition matrix Phi (n, n) of errors, $d(t + h) = Phi d(t)$."""

    x: Arrays
    P: jax.Array
    transition: jax.Array


class SteppedPrediction(NamedTuple):
    """A `Prediction` by tolerances: also the number of accepted steps, and the number `code` of the `Result`.

    The code is zero if the end was reached; x, P and Phi are NaN if not.
    """

    x: Arrays
    P: jax.Array
    transition: jax.Array
    steps: jax.Array
    code: jax.Array


AnyPrediction: TypeAlias = Prediction | SteppedPrediction


class _Search(NamedTuple):
    """The carry of the search for step lengths, on a clock that starts with the prediction."""

    t: jax.Array
    h: jax.Array
    x: Arrays
    P: jax.Array
    errors: ErrorHistory
    rejected: jax.Array
    tried: jax.Array
    accepted: jax.Array
    ends: jax.Array  # (max_steps,) of the accepted steps
    code: jax.Array


def method_of_tolerances(method: Any) -> RKMK:
    """The method, by default of TSIT5. Raises ModelError for a method without an embedded solution."""
    if isinstance(method, RKMK) and not method.tableau.is_pair:
        raise ModelError(
            f"rtol needs a method with an embedded solution, got {method.name}.\n"
            "  fix: method=tx.RKMK(tx.tableaus.TSIT5), or max_step=... in place of rtol"
        )
    return RKMK(TSIT5) if method is None else method


class AdaptivePrediction:
    """The division of predictions into steps, each with an error of the mean and of standard deviations within
    tolerances.

    With e the difference of the step from its embedded solution and $E = de/dd$ its derivative with respect to the
    error d of the estimate, the mean is in error by e, and the standard deviations by the roots of the diagonal of
    $E P E^T$. The root mean square of each, in units of `atol + rtol * size`, must be at most one, with the size of the
    state, or of the standard deviation.

    A first pass finds the lengths. The filter predicts by these lengths in a second one, which is differentiable; the
    lengths are constants in derivatives, as in `tx.integrate`.
    """

    def __init__(self, model: StochasticModel, rtol: Any, atol: Any, control: StepControl | None) -> None:
        instance("control", control, StepControl | None, "tx.StepControl(...)", ModelError)
        self.control = StepControl(max_steps=_MAX_STEPS) if control is None else control
        self.model = model
        self.tolerances = functools.partial(tolerances_of, model.dynamics, rtol, atol)
        self.tolerances(jnp.result_type(float))  # invalid ones are errors here
        self._attempt = KernelFunction(functools.partial(_attempted, model.in_arrays), model.dynamics.backend)

    def __call__(
        self, predict: Callable[..., Prediction], point: OperatingPoint, form: jax.Array, P: jax.Array, h: jax.Array
    ) -> SteppedPrediction:
        """The prediction over h seconds by several steps of `predict`, with the covariance P in its form there."""
        search = self._search(*jax.lax.stop_gradient((point, P, h)))
        numbers = jnp.arange(self.control.max_steps)
        ends = jnp.where(numbers < search.accepted, search.ends / jnp.where(h > 0.0, h, 1.0), 1.0)
        ends = jax.lax.stop_gradient(ends)
        begins = jnp.concatenate([jnp.zeros_like(ends[:1]), ends[:-1]])

        def step(before: tuple[Arrays, jax.Array, jax.Array], share: tuple[jax.Array, jax.Array]) -> Any:
            x, form, transition = before
            begin, end = share
            after = predict(point.moved(t=point.t + begin * h, x=x), form, (end - begin) * h)
            return after.x, after.P, after.transition @ transition

        start = point.x, form, jnp.eye(self.model.dimension, dtype=form.dtype)
        end, _ = take_steps(step, start, (begins, ends), search.accepted, self.control.max_steps, False)
        x, P, transition = jax.tree.map(lambda a: jnp.where(search.code == 0, a, jnp.nan), end)
        return SteppedPrediction(x, P, transition, steps=search.accepted, code=search.code)

    def _search(self, point: OperatingPoint, P: jax.Array, length: jax.Array) -> _Search:
        """The ends of the steps, in s from the start."""
        tolerances = jax.tree.map(jnp.asarray, self.tolerances(np.dtype(length.dtype)))
        zero, number = jnp.zeros((), int), jnp.zeros_like(length)
        finite = jnp.stack([jnp.isfinite(a).all() for a in jax.tree.leaves((point, P))]).all()
        code = jnp.where(finite, zero, Result.NON_FINITE.value)
        ends = jnp.zeros(self.control.max_steps, length.dtype)
        errors, rejected = ErrorHistory(number, number), jnp.asarray(False)
        start = _Search(number, length, point.x, P, errors, rejected, zero, zero, ends, code)

        def going(search: _Search) -> jax.Array:
            return (search.t < length) & (search.code == 0) & (search.tried < self.control.max_steps)

        search: _Search = jax.lax.while_loop(going, functools.partial(self._try, tolerances, point, length), start)
        short = (search.t < length) & (search.code == 0)
        return _Search(*search[:-1], jnp.where(short, Result.MAX_STEPS.value, search.code))

    def _try(self, tolerances: Tolerances, point: OperatingPoint, length: jax.Array, search: _Search) -> _Search:
        """One step of the search, accepted or rejected."""
        control, order = self.control, self.model.method.error_order
        end, h, planned, least = control.length(search.t, search.h, length)
        # The clock of the prediction starts at zero, where its resolution says nothing.
        least = jnp.maximum(least, 8.0 * float(jnp.finfo(h.dtype).eps) * length)
        cut, h = h < planned, end - search.t
        x, P, square = self._attempt(tolerances, point.moved(t=point.t + search.t, x=search.x), search.P, h)
        finite = jnp.isfinite(square)
        square = jnp.where(finite, square, jnp.inf)
        good = square <= 1.0
        growth, errors = control.grown(square, search.errors, search.rejected, order)
        # A step cut short at the end says little against the longer one that was planned.
        longer = jnp.maximum(h * growth, jnp.where(cut & ~search.rejected, planned, 0.0))
        shorter = h * control.shrunk(square, order)
        failed = ~good & ((shorter < least) | (h <= least))
        trouble = jnp.where(finite, Result.STEP_TOO_SMALL.value, Result.NON_FINITE.value)
        old = search.t, search.x, search.P, search.errors
        t, x, P, errors = jax.tree.map(lambda a, b: jnp.where(good, a, b), (end, x, P, errors), old)
        return _Search(
            t=t,
            h=jnp.where(good, longer, shorter),
            x=x,
            P=P,
            errors=errors,
            rejected=~good,
            tried=search.tried + 1,
            accepted=search.accepted + good.astype(int),
            # A step that is rejected leaves a number that a later one overwrites.
            ends=search.ends.at[search.accepted].set(end),
            code=jnp.where(failed, trouble, search.code),
        )


def _attempted(
    model: StochasticModel, tolerances: Tolerances, point: OperatingPoint, P: jax.Array, h: jax.Array
) -> tuple[Arrays, jax.Array, jax.Array]:
    """The mean and the covariance after one step, without noise, and the square of the error in units of the allowed
    one.
    """
    method, group, n = model.method, model.group, model.dimension
    field = VectorField(model.dynamics, lambda _: point.u, point.params)
    local = method.coordinates(model.dynamics)

    def moved(d: jax.Array) -> tuple[jax.Array, Any]:
        y = local.enter(group.retract(point.x, d))
        step = method.attempt(field, point.t, y, method.rate(field, point.t, y), h, tolerances)
        x = local.value(step.y)
        end = group.difference(jax.lax.stop_gradient(x), x)
        return jnp.concatenate([end, group.join(local.tangent(step.errors[0]))]), (y, step.y, step.errors, x)

    slopes, (before, after, errors, x) = jax.jacfwd(moved, has_aux=True)(jnp.zeros(n, h.dtype))
    transition, of_error = slopes[:n], slopes[n:]
    P = symmetric(P)
    deviations, errors_of_deviations = (_deviations(group, M, P) for M in (transition, of_error))
    square = tolerances.square(local, errors, before, after)
    square = jnp.maximum(square, tolerances.mean_square_of_deviations(errors_of_deviations, deviations))
    return x, symmetric(transition @ P @ transition.T), square


def _deviations(group: Product, M: jax.Array, P: jax.Array) -> Blocks:
    """The roots of the diagonal of $M P M^T$, by state."""
    roots = jnp.sqrt(jnp.maximum(jnp.sum((M @ P) * M, axis=1), 0.0))
    return {name: (group.factors[name].to_linear_first(roots[part]),) for name, part in group.slices.items()}
