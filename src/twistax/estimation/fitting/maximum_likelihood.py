"""Maximum likelihood of parameters from records, by multiple shooting."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterable, Mapping
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import listed, real_array, reals, short, whole
from ...errors import EstimationError, InputError, ModelError, ShapeError
from ...expr import Leaf, Parameter, leaves_of
from ...jax_inside import is_traced
from ...linear.discretize import Controls
from ...linear.free_parameters import boxes_of, limits_of
from ...progress import watched
from ...system import name_of
from ...system.dynamics import Dynamics, need_compiled
from ...system.inputs import Values
from ..error_state_kalman import ErrorStateKalman
from ..measurement import Measurement, check_definite
from ..prediction.process_noise import NoiseDiscretization
from ..smoothers.robust_losses import RobustLoss, checked_losses
from .experiment import SegmentedData, experiments_of, segmented, staged
from .multiple_shooting import Prior, ShootingSteps, scaled_eigenvalues, solved
from .parameter_estimate import ParameterEstimate
from .search import FitState, ShootingSearch
from .segments import Segments


class _KalmanInParts(ErrorStateKalman):
    """The filter with several kernels in each step: the derivatives of parts are small enough to be kernels too."""

    in_scalars = False


class MaximumLikelihood:
    """The parameters of a system for which the measurements are most likely. `tx.fit` makes one and runs it.

    Without `tx.Noise` in the rates, the parameters and the initial state determine the motion, and the only errors are
    those of the measurements. This is the output error method,

        $min 1/2 sum_k (e_k^T R^-1 e_k + log det R), e_k = Log(h(x_k)^-1 z_k)$.

    With noise in the rates, e and its covariance S are the innovations of `ErrorStateKalman`. This is the filter error
    method, in which densities and covariances may be free parameters, too. Initial states of experiments are also
    unknown, with or without a prior covariance; with noise in the rates, the initial covariance is that of the filter.

    The record of an experiment is divided into segments. First, the initial state of each segment is fitted to its
    measurements, with constant parameters. Then Gauss-Newton steps change parameters and initial states together and
    close the gaps between segments: multiple shooting. So the states follow the data while the parameters are still
    inaccurate; a simulation from the start of the record would diverge from it. With noise in the rates, the filter
    follows the data, and there is only one segment.

    Args:
        dynamics: the compiled system; time is in s.
        measurements: the models of the sensors.
        free: the unknown parameters, by leaf or name: a list, or a dict from them to limits (low, high), numbers or
            arrays; None for no limit.
        priors: by parameter a pair of its expected value and its covariance: a number, one for each entry, or a matrix.
        losses: by measurement a `RobustLoss` rho, such as `HuberLoss()`, for records with outliers: $rho(e^T R^-1 e)$
            in place of $e^T R^-1 e$, the default. Not supported with noise in the rates, because outliers change the
            state of the filter.
        method, max_step, noise: as for `ErrorStateKalman`.
        segments: the number of segments of each record. By default at most 12, such that a segment has at least eight
            rows, and two for each entry of the state.
        max_iterations: the largest number of steps.
    Raises:
        ModelError: the errors of `ErrorStateKalman`; free or priors with a parameter that is unknown or a constant of
            the compiled system; no free parameter; losses of unknown measurements, of measurements whose covariance is
            free, or with noise in the rates.
        ShapeError, InputError: limits or priors of the wrong shape, or priors that are not positive definite.

    Example: `MaximumLikelihood(dynamics, [angle], free=["length"]).run(Experiment({"angle": (ts, qs)}, x0))`.

    Source: Maine, Iliff, Identification of dynamic systems, NASA RP-1138 (1985); Ljung, System Identification: Theory
    for the User (1999), sec. 7.4; Bock, Randwertproblemmethoden zur Parameteridentifizierung (1987).
    """

    def __init__(
        self,
        dynamics: Dynamics,
        measurements: Iterable[Measurement],
        free: Any,
        *,
        priors: Mapping[Any, Any] | None = None,
        losses: Mapping[str, RobustLoss] | None = None,
        method: Any = None,
        max_step: float | None = None,
        noise: NoiseDiscretization | None = None,
        segments: int | None = None,
        max_iterations: int = 200,
    ) -> None:
        need_compiled("fit", dynamics)
        self.kalman = _KalmanInParts(dynamics, measurements, method=method, max_step=max_step, noise=noise)
        model = self.kalman.model
        if not model.measurements:
            raise ModelError("fit expects measurements=[tx.Measurement(...), ...], got none")
        self.free: dict[str, Parameter] = {leaf.name: leaf for leaf in model.noisy.system.parameters}
        self.boxes = boxes_of(free, self.free.values(), dynamics.baked)
        if not self.boxes:
            raise ModelError(f"fit expects free parameters, of {listed(self.free)}.\n  fix: free=[...]")
        self.free = {box.name: self.free[box.name] for box in self.boxes}
        places = Controls(self.boxes).slices
        self.size = sum(prod(box.shape) for box in self.boxes)
        robust = self._losses(losses)
        shooting = Segments(self.kalman, {box.name: (places[box.name], box.shape) for box in self.boxes}, robust)
        self.places, self.shooting = places, ShootingSteps(shooting)
        if segments is not None:
            whole("segments", segments, 1, ModelError)
            if segments > 1 and model.process:
                raise ModelError("fit expects segments=1 with noise in the rates")
        self.segments, self.max_iterations = segments, whole("max_iterations", max_iterations, 1, ModelError)
        self.prior = self._prior(priors or {})

    def _losses(self, losses: Mapping[str, RobustLoss] | None) -> dict[str, RobustLoss]:
        """The losses, checked."""
        model = self.kalman.model
        robust = checked_losses(losses, model.measurements)
        if robust and model.process:
            raise ModelError(
                "fit expects no losses with noise in the rates: the filter follows outliers.\n"
                "  fix: replace the outliers in the records by NaN"
            )
        for name in robust:
            measurement = model.measurements[name]
            errors = [measurement.covariance, *(noise.density for noise in measurement.noises)]
            leaves = leaves_of(*(expr for expr in errors if expr is not None))
            if unknown := [leaf.name for leaf in leaves if leaf.name in self.free]:
                raise ModelError(
                    f"fit expects a known covariance of {name!r}, which has a loss, but {unknown[0]!r} is free: with "
                    "a loss the squares of outliers count less than the determinant of the covariance.\n"
                    f"  fix: a value for {unknown[0]!r}, or no loss for {name!r}"
                )
        return robust

    def _prior(self, priors: Mapping[Any, Any]) -> tuple[np.ndarray, np.ndarray]:
        """The expected values and the information of priors."""
        mean, information = np.zeros(self.size), np.zeros((self.size, self.size))
        for key, pair in priors.items():
            name = name_of(key)
            if name not in self.free:
                raise ModelError(f"priors names {name!r}, but the free parameters are {listed(self.free, name)}")
            if not isinstance(pair, (tuple, list)) or len(pair) != 2:
                raise InputError(f"priors[{name!r}] expects a pair (value, covariance), got {short(pair)}")
            part, shape = self.places[name], self.free[name].shape
            value, covariance = (reals(f"priors[{name!r}]", one, InputError).astype(float) for one in pair)
            count = prod(shape)
            if value.shape != shape or covariance.shape not in ((), (count,), (count, count)):
                raise ShapeError(
                    f"priors[{name!r}] expects a value of shape {shape} and a covariance of (), ({count},) or "
                    f"({count}, {count}), got {value.shape} and {covariance.shape}"
                )
            check_definite(f"priors[{name!r}]", covariance, count, InputError)
            matrix = covariance if covariance.ndim == 2 else np.diag(np.broadcast_to(covariance, (count,)))
            mean[part], information[part, part] = value.reshape(-1), np.linalg.inv(matrix)
        return mean, information

    def run(self, data: Any, params: Values | None = None) -> ParameterEstimate:
        """The maximum-likelihood parameters. Values of records may be traced by jit and vmap.

        Args:
            data: an `Experiment`, or a list of them.
            params: values of parameters; initial values of free ones. By default their declared values, or the middle
                of their limits.
        Raises:
            InputError, ShapeError: experiments and parameters that do not fit the system.
            EstimationError: steps that do not converge, or numbers that are not finite; not raised for traced values.
        """
        values = self._values(params or {})
        with watched("fit"):
            shots = self._cut(*staged(self.kalman, experiments_of(data), values, self.segments))
            dtype = shots.rows.ts.dtype
            limits = jnp.asarray(np.concatenate([limits_of(box) for box in self.boxes]).T, dtype)
            mean, information = (jnp.asarray(part, dtype) for part in self.prior)
            prior = Prior(mean, information, limits)
            start = jnp.concatenate([jnp.asarray(values[box.name], dtype).reshape(-1) for box in self.boxes])
            estimate: ParameterEstimate = self._solve(shots, jnp.clip(start, *limits), prior)
        if not is_traced(estimate.cost):
            self._check(estimate)
        return estimate

    def _values(self, params: Values) -> dict[str, Any]:
        """The values of parameters, initial ones for free parameters."""
        values = {name_of(key): value for key, value in params.items()}
        for box in self.boxes:
            value, leaf = values.get(box.name), self.free[box.name]
            if value is None:
                value = leaf.value
            if value is None and box.min is not None and box.max is not None:
                value = 0.5 * (np.asarray(box.min) + np.asarray(box.max))
            if value is None:
                raise InputError(f"fit expects an initial value for {box.name!r}.\n  fix: pass it in params={{...}}")
            array = real_array(f"params[{box.name!r}]", value)
            if array.shape != leaf.shape:
                raise ShapeError(f"params[{box.name!r}] expects shape {leaf.shape}, got {array.shape}")
            values[box.name] = array
        return values

    def _check(self, estimate: ParameterEstimate) -> None:
        if not estimate.converged:
            raise EstimationError(
                f"the fit is {estimate.result}.\n"
                "  fix: pass other initial values in params=..., limits of free parameters, priors, or more segments"
            )
        if names := estimate.names_on_bounds:
            warnings.warn(
                f"the fit is on a bound of {', '.join(names)}: the data fit better with a value beyond it",
                RuntimeWarning,
                stacklevel=3,
            )

    # ---- iterations --------------------------------------------------------------------------------------------------

    @functools.cached_property
    def _cut(self) -> Callable[..., SegmentedData]:
        # One program: operations of JAX one by one compile one by one.
        return jax.jit(functools.partial(segmented, self.kalman), static_argnums=(1, 2))

    @functools.cached_property
    def _solve(self) -> Callable[..., ParameterEstimate]:
        return jax.jit(self._solved)

    def _solved(self, data: SegmentedData, theta: jax.Array, prior: Prior) -> ParameterEstimate:
        tolerance = jnp.asarray(np.sqrt(float(jnp.finfo(theta.dtype).eps)), theta.dtype)
        last = ShootingSearch(self.shooting, data, prior, tolerance, self.max_iterations).run(theta)
        return self._judged(last, data, prior)

    def _judged(self, last: FitState, data: SegmentedData, prior: Prior) -> ParameterEstimate:
        """The estimate, with its measures from one simulation of each experiment."""
        unknowns = last.unknowns
        problem = self.shooting.condensed(unknowns, last.segments, data, prior)
        free = self.shooting.free(problem, unknowns, data, prior)
        gain = 0.5 * problem.gradient @ solved(problem, free, jnp.zeros_like(unknowns.theta[0]))
        p = self.size
        counts = [
            jnp.sum(present) * self.kalman.model.measurements[name].group.dimension
            for name, present in data.rows.present.items()
        ]
        return ParameterEstimate(
            params={box.name: unknowns.theta[self.places[box.name]].reshape(box.shape) for box in self.boxes},
            x0={name: x[:, 0] for name, x in unknowns.starts.items()},
            information=_less_starts(problem.of_data, free[:-p]),
            prior_information=prior.information,
            cost=problem.cost,
            squares=problem.likelihood.squares,
            residuals=sum(counts[1:], counts[0]),
            gain=gain,
            on_bound=~free[-p:],
            iterations=last.iterations,
            shapes=tuple((box.name, box.shape) for box in self.boxes),
        )


def _less_starts(N: jax.Array, unknown: jax.Array) -> jax.Array:
    """The information about parameters, with unknown initial states eliminated: $N_pp - N_ps N_ss^+ N_sp$."""
    s = unknown.size
    values, vectors, scale = scaled_eigenvalues(N[:s, :s], unknown)
    small = values <= 1e4 * float(jnp.finfo(N.dtype).eps)
    half = jnp.where(small, 0.0, 1.0 / jnp.sqrt(jnp.where(small, 1.0, values)))
    part = (half[:, None] * vectors.T * scale[None, :]) @ N[:s, s:]
    reduced = N[s:, s:] - part.T @ part
    return 0.5 * (reduced + reduced.T)


def fit(
    dynamics: Dynamics,
    data: Any,
    free: Any,
    *,
    measurements: Iterable[Measurement],
    params: Values | None = None,
    priors: Mapping[Any, Any] | None = None,
    **options: Any,
) -> ParameterEstimate:
    """Fit parameters to measured data by maximum likelihood, with their covariance.

    Data of the same shapes compile once: the `MaximumLikelihood` of these arguments is cached with the dynamics.

    It minimises $1/2 sum_k (e_k^T S_k^-1 e_k + log det S_k)$, see `tx.estimation.MaximumLikelihood`.

    Args:
        dynamics: the compiled system.
        data: a `tx.estimation.Experiment`, or a list of them.
        free, measurements, priors, options: as for `tx.estimation.MaximumLikelihood`.
        params: values of parameters in their units; initial values of free ones.
    Raises:
        ModelError, InputError, ShapeError: arguments that do not fit the system.
        EstimationError: steps that do not converge, numbers that are not finite.

    Warns: RuntimeWarning for an estimate on a bound.

    Example: `tx.fit(dynamics, experiment, free={"length": (0.1, 2.0)}, measurements=[angle]).explain()`.

    Source: Maine, Iliff, Identification of dynamic systems, NASA RP-1138 (1985).
    """
    need_compiled("fit", dynamics)
    sensors = (measurements,) if isinstance(measurements, Measurement) else tuple(measurements)
    key = ("fit", sensors, _key(free), _key(priors), _key(options))
    make = lambda: MaximumLikelihood(dynamics, sensors, free, priors=priors, **options)  # noqa: E731
    estimator: MaximumLikelihood = dynamics.functions.loops.get(key, make)
    return estimator.run(data, params)


def _key(value: Any) -> Any:
    """A hashable key for options in a cache: names and numbers by value, other objects by identity."""
    if isinstance(value, Mapping):
        return tuple((name_of(key), _key(entry)) for key, entry in value.items())
    if isinstance(value, (tuple, list)):
        return tuple(map(_key, value))
    if isinstance(value, (np.ndarray, jax.Array)):
        return value.shape, np.asarray(value).tobytes()
    return value.name if isinstance(value, Leaf) else value
