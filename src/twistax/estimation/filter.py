"""The interface of filters: predictions, updates, and runs over records."""

from __future__ import annotations

import copy
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed, number, real_array, reals
from ..errors import InputError, ModelError, ShapeError
from ..integrators import StepControl
from ..jax_inside import is_traced
from ..linear.labels import labels, tangent_shapes
from ..progress import watching
from ..scalar.kernel_function import KernelFunction
from ..system.dynamics import Arrays, Dynamics
from ..system.inputs import Values
from .consistency import gate_limit
from .filter_run import FilterRun, Innovations
from .imu.preintegrated_navigation import PreintegratedNavigation, model_of
from .measurement import Measurement, check_definite
from .observability import observability
from .prediction.adaptive_prediction import (
    AdaptivePrediction,
    AnyPrediction,
    Estimate,
    Prediction,
    SteppedPrediction,
    method_of_tolerances,
)
from .prediction.process_noise import NoiseDiscretization
from .records import Records, Timeline, check_elements, timeline_of
from .stochastic_model import OperatingPoint
from .update import Update


class RunStages(NamedTuple):
    """The arguments of a run: times (k,), lengths hs of the intervals before them, controls, and the start."""

    timeline: Timeline
    ts: jax.Array
    hs: jax.Array
    controls: Arrays
    x0: Arrays
    P0: jax.Array
    params: Arrays


class Filter(ABC):
    """A filter for a compiled system with noise and measurements.

    Args:
        dynamics: the compiled system, or a `PreintegratedNavigation`.
        measurements: the models of the sensors, a `Measurement` each.
        method: the integration method of the mean; RKMK with RK4 by default.
        max_step: the longest step of a prediction in s; by default there is one step between two times of a run.
        rtol, atol, control: as for `ErrorStateKalman`.
        gate: a probability: a measurement is used only if its normalised innovation squared is below the chi-square
            quantile of this probability. By default all measurements are used.
        noise: the discretisation of continuous noise: `VanLoan()`, the default, or `Trapezoidal()`.
    Raises:
        ModelError: two measurements of one name, a state or control that the system does not have, a noise both in
            rates and in measurements, a gate outside of (0, 1).
    """

    def __init__(
        self,
        dynamics: Dynamics | PreintegratedNavigation,
        measurements: Iterable[Measurement],
        *,
        method: Any = None,
        max_step: float | None = None,
        rtol: Any = None,
        atol: Any = None,
        control: StepControl | None = None,
        gate: float | None = None,
        noise: NoiseDiscretization | None = None,
    ) -> None:
        adaptive = any(option is not None for option in (rtol, atol, control))
        if adaptive and isinstance(dynamics, PreintegratedNavigation):
            raise ModelError("rtol, atol and control expect None where readings are preintegrated")
        method = method_of_tolerances(method) if adaptive else method
        self.model = model_of(dynamics, measurements, method, noise)
        self.adaptive = AdaptivePrediction(self.model, rtol, atol, control) if adaptive else None
        if max_step is not None:
            number("max_step", max_step, "a positive number of s", lambda h: h > 0.0, ModelError)
        if gate is not None:
            number("gate", gate, "a probability between 0 and 1", lambda p: 0.0 < p < 1.0, ModelError)
        self.max_step, self.gate = max_step, gate
        self.limits = {name: gate_limit(gate, m.group.dimension) for name, m in self.model.measurements.items()}

    @functools.cached_property
    def in_arrays(self) -> Filter:
        """The filter with all functions as operations of JAX, from which kernels and C code are made."""
        in_arrays = copy.copy(self)
        in_arrays.model = self.model.in_arrays
        return in_arrays

    # ---- methods that define a filter --------------------------------------------------------------------------------

    #: Whether the filter has a scalar form, so that its steps can be compiled as kernels and exported to C.
    in_scalars: ClassVar[bool] = True

    @abstractmethod
    def propagated(self, point: OperatingPoint, P: jax.Array, h: jax.Array) -> Prediction:
        """The estimate h seconds later. Arguments are prepared."""

    @abstractmethod
    def corrected(self, name: str, point: OperatingPoint, P: jax.Array, z: jax.Array, limit: float | None) -> Update:
        """The estimate after a measurement, if its normalised innovation squared is below the limit."""

    def factored(self, P: jax.Array) -> jax.Array:
        """The form of the covariance that `propagated` and `corrected` use: by default the covariance itself."""
        return P

    def multiplied(self, factor: jax.Array) -> jax.Array:
        """The covariance from `factor`. They are equal, except in filters with a square root of the covariance."""
        return factor

    def _with_covariance(self, step: Any) -> Any:
        """A prediction or an update with its covariance in place of that form."""
        return type(step)(step.x, self.multiplied(step.P), *step[2:])

    @functools.cached_property
    def _propagated(self) -> Callable[[OperatingPoint, jax.Array, jax.Array], AnyPrediction]:
        """`propagated` as one kernel where it can be, by several steps with tolerances."""
        one_step: Callable[..., Prediction] = self.propagated
        if self.in_scalars:
            one_step = KernelFunction(self.in_arrays.propagated, self.model.dynamics.backend)
        adaptive = self.adaptive
        if adaptive is None:
            return one_step
        return lambda point, P, h: adaptive(one_step, point, P, self.multiplied(P), h)

    @functools.cached_property
    def _corrected(self) -> Mapping[str, Callable[[OperatingPoint, jax.Array, jax.Array], Update]]:
        """`corrected` of each measurement, where z is finite, as one kernel where it can be."""

        def correction(name: str) -> Callable[[OperatingPoint, jax.Array, jax.Array], Update]:
            of = self.in_arrays if self.in_scalars else self

            def corrected(point: OperatingPoint, P: jax.Array, z: jax.Array) -> Update:
                known = jnp.isfinite(z).all()
                safe = jnp.where(known, z, self.model.measurements[name].group.identity(z.dtype))
                update = of.corrected(name, point, P, safe, self.limits[name])
                skipped = jax.tree.map(jnp.zeros_like, update)._replace(x=point.x, P=P)
                # Selected, not branched: so a batch of filters is one kernel.
                return jax.tree.map(lambda a, b: jnp.where(known, a, b), update, skipped)

            return KernelFunction(corrected, self.model.dynamics.backend) if self.in_scalars else corrected

        return {name: correction(name) for name in self.limits}

    # ---- one step ----------------------------------------------------------------------------------------------------

    def predict(
        self, t: Any, x: Values, P: Any, h: Any, u: Values | None = None, params: Values | None = None
    ) -> AnyPrediction:
        """The estimate h seconds after t, with constant controls. Traceable.

        With tolerances the result also has `steps` and `code`, the number of a `Result`; zero is success.

        Args:
            P: (n, n) covariance in the tangent space at x; or a number or (n,) for a diagonal one.
            h: s.
        Raises: InputError, ShapeError: the errors of a call of the dynamics; another shape of P; a negative h.
        """
        length = number("h", h, "a finite number of s that is not negative", lambda h: 0.0 <= h < np.inf)
        point = self.model.prepared(t, x, u, params, True, ())
        return self._jitted_predict(point, self._covariance(P, point), jnp.asarray(length, point.t.dtype))

    def update(
        self, name: str, t: Any, x: Values, P: Any, z: Any, u: Values | None = None, params: Values | None = None
    ) -> Update:
        """The estimate after the value z of a measurement at time t; unchanged if z is not finite. Traceable.

        Raises: InputError, ShapeError: the errors of a call; an unknown measurement; a value not of its group.
        """
        known = self.model.measurements
        if name not in known:
            raise InputError(f"the filter has the measurements {listed(known, name)}, got {name!r}")
        point = self.model.prepared(t, x, u, params, False, (name,))
        value = real_array(f"update: {name!r}", z)
        if value.shape != known[name].group.shape:
            raise ShapeError(f"{name!r} expects shape {known[name].group.shape}, got {value.shape}")
        check_elements(f"update: {name!r}", known[name].group, value)
        return self._jitted_update(name, point, self._covariance(P, point), jnp.asarray(value, point.t.dtype))

    # ---- a run -------------------------------------------------------------------------------------------------------

    @watching("filter")
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
    ) -> FilterRun:
        """The estimates over records of measurements. Values, x0, P0 and params may be traced by jit, vmap and grad.

        Args:
            records: for each measurement a pair (times (k,), values (k, *shape)), with the times in any order. A row
                with a NaN is a missing measurement. Times are concrete numbers.
            x0, P0: the estimate at t0, before any measurement.
            t0: time of the initial estimate, s; by default the first time of the records and of `save_at`.
            u: controls: constants, tables such as `tx.ZeroOrderHold`, or a function of t that returns a dict. They are
                constant over each step, with their value at its midpoint. A step ends at a jump of a table.
            save_at: additional times of the estimate, in s.
        Raises:
            InputError, ShapeError: records, estimates or controls that do not fit the filter; a covariance P0 that is
                not positive semidefinite.
            EstimationError: non-finite numbers, or a covariance that is not positive semidefinite, unless traced.
        """
        stages = self.staged(records, x0, P0, t0, u, params, save_at)
        traced = self._scan(stages)
        run = self._result(stages.timeline, *traced)
        if not is_traced(traced):
            run.check()
        return run

    def explain(
        self,
        times: Mapping[str, Any],
        x0: Values,
        *,
        t0: float | None = None,
        u: Mapping[str, Any] | Callable[[Any], Mapping[str, Any]] | None = None,
        params: Values | None = None,
    ) -> str:
        """The observability of the system along a motion with measurements at given times, as text.

        The Gramian is evaluated along the motion from x0 without noise, so its rank is that of the system. It needs no
        data. `FilterRun.observability` is the Gramian of a run.

        Args:
            times: times by measurement, (k,) in s.
            x0, t0, u, params: as for `run`.
        Raises: InputError, ShapeError: the errors of `run`.
        """
        one = {name: m.group.identity(float) for name, m in self.model.measurements.items()}
        records = {
            name: (ts, np.broadcast_to(one[name], (np.size(ts), *one[name].shape)) if name in one else np.zeros(0))
            for name, ts in times.items()
        }
        stages = self.staged(records, x0, 0.0, t0, u, params, ())
        transitions, information = self._along(stages)
        names = labels(tangent_shapes(self.model.group))
        limit = 100.0 * len(names) * float(jnp.finfo(transitions.dtype).eps)
        return str(observability(np.asarray(transitions, float), np.asarray(information, float), names, limit))

    @functools.cached_property
    def _along(self) -> Callable[[RunStages], tuple[jax.Array, jax.Array]]:
        """The transition matrices and the information of measurements along the motion of the mean."""

        def one_step(point: OperatingPoint, P: jax.Array, h: jax.Array) -> Prediction:
            x, transition, _ = self.model.step(point, h)
            return Prediction(x, P, transition)

        def moved(point: OperatingPoint, h: jax.Array) -> AnyPrediction:
            one = jnp.eye(self.model.dimension, dtype=h.dtype)
            return self.adaptive(one_step, point, one, one, h) if self.adaptive else one_step(point, one, h)

        def along(ts: Any, hs: Any, present: Any, controls: Any, x0: Any, params: Any) -> Any:
            def advance(x: Arrays, row: Any) -> tuple[Arrays, Any]:
                t, h, seen, u = row
                x, _, transition, *_ = moved(OperatingPoint(t - h, x, u, params), h)
                information = jnp.zeros_like(transition)
                for name in seen:
                    _, H, R = self.model.sensitivity(name, OperatingPoint(t, x, u, params))
                    information = information + jnp.where(seen[name], H.T @ jnp.linalg.solve(R, H), 0.0)
                return x, (transition, information)

            return jax.lax.scan(advance, x0, (ts, hs, present, controls))[1]

        jitted = jax.jit(along)
        return lambda stages: jitted(
            stages.ts, stages.hs, stages.timeline.present, stages.controls, stages.x0, stages.params
        )

    def staged(
        self, records: Records, x0: Values, P0: Any, t0: Any, u: Any, params: Values | None, save_at: Any
    ) -> RunStages:
        """The arguments of a run, checked and cast."""
        first = None if t0 is None else float(number("t0", t0))
        times = reals("save_at", save_at, InputError).astype(float).reshape(-1)
        start = 0.0 if first is None else first
        point = self.model.prepared(start, x0, self._first(u, start), params, True, self.model.measurements)
        jumps = self.model.jumps(u)
        timeline = timeline_of(records, self.model.measurements, first, times, jumps, self.max_step, point.t.dtype)
        controls = self.model.stage_controls(u, timeline.ts, point.x, point.t.dtype)
        # Lengths are differences in double precision: single precision loses them where times are large.
        lengths = np.diff(timeline.ts, prepend=timeline.ts[0])
        ts, hs = (jnp.asarray(a, point.t.dtype) for a in (timeline.ts, lengths))
        return RunStages(timeline, ts, hs, controls, point.x, self._covariance(P0, point), point.params)

    def _result(
        self, timeline: Timeline, prior: AnyPrediction, post: Estimate, updates: dict[str, Update]
    ) -> FilterRun:
        innovations = {}
        total = jnp.zeros((), post.P.dtype)
        information = jnp.zeros_like(post.P)
        for name, update in updates.items():
            rows = timeline.rows[name]
            at = jax.tree.map(lambda a, rows=rows: a[rows], update)
            ts, present = jnp.asarray(timeline.ts[rows], post.P.dtype), timeline.present[name][rows]
            innovations[name] = Innovations(ts, at.residual, at.S, at.nis, at.used, present)
            total = total + jnp.sum(update.log_likelihood)
            information = information + update.information
        ts = jnp.asarray(timeline.ts, post.P.dtype)
        steps = (prior.steps, prior.code) if isinstance(prior, SteppedPrediction) else (None, None)
        return FilterRun(
            *(ts, post.x, post.P, prior.x, prior.P, prior.transition, information, innovations, total),
            *(self.model.group, *steps),
        )

    def scanned(
        self, rows: tuple[Any, ...], x0: Arrays, P0: jax.Array, params: Arrays
    ) -> tuple[AnyPrediction, Estimate, dict[str, Update]]:
        """The predictions, estimates and updates at all times. Arguments are prepared.

        Args:
            rows: of each time: itself, the interval that ends there, values, which of them are present, and controls.
        """

        def advance(carry: Estimate, row: Any) -> tuple[Estimate, Any]:
            t, h, z, seen, u = row
            before = OperatingPoint(t - h, carry.x, u, params)
            prior = self._propagated(before, carry.P, h)
            x, P, updates = prior.x, prior.P, {}
            for name in z:
                update = functools.partial(self._if_present, name, OperatingPoint(t, x, u, params), P, z[name])
                updates[name] = update(seen[name])
                x, P = updates[name].x, updates[name].P
            prior = self._with_covariance(prior)
            return Estimate(x, P), (prior, Estimate(x, self.multiplied(P)), updates)

        return jax.lax.scan(advance, Estimate(x0, self.factored(P0)), rows)[1]

    @functools.cached_property
    def _scan(self) -> Callable[..., Any]:
        jitted = jax.jit(self.scanned)

        def run(stages: RunStages) -> Any:
            timeline, ts, hs, controls, x0, P0, params = stages
            return jitted((ts, hs, timeline.values, timeline.present, controls), x0, P0, params)

        return run

    def _if_present(self, name: str, point: OperatingPoint, P: jax.Array, z: jax.Array, seen: jax.Array) -> Update:
        def skip() -> Update:
            shapes = jax.eval_shape(self._corrected[name], point, P, z)
            return jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)._replace(x=point.x, P=P)

        return jax.lax.cond(seen, lambda: self._corrected[name](point, P, z), skip)

    # ---- arguments ---------------------------------------------------------------------------------------------------

    @functools.cached_property
    def _jitted_predict(self) -> Callable[..., AnyPrediction]:
        def predict(point: OperatingPoint, P: jax.Array, h: jax.Array) -> AnyPrediction:
            return self._with_covariance(self._propagated(point, self.factored(P), h))

        return jax.jit(predict)

    @functools.cached_property
    def _jitted_update(self) -> Callable[..., Update]:
        def update(name: str, point: OperatingPoint, P: jax.Array, z: jax.Array) -> Update:
            return self._with_covariance(self._corrected[name](point, self.factored(P), z))

        return jax.jit(update, static_argnums=0)

    def _first(self, u: Any, t0: float) -> Values | None:
        """The controls at the start, for the check of their names and shapes."""
        if callable(u):
            return u(jnp.asarray(t0))
        return {name: getattr(value, "first", value) for name, value in (u or {}).items()}

    def _covariance(self, P: Any, point: OperatingPoint) -> jax.Array:
        n, dtype = self.model.dimension, point.t.dtype
        array = real_array("P", P)
        if array.shape not in ((), (n,), (n, n)):
            raise ShapeError(f"P expects a number, shape ({n},) or ({n}, {n}), got {array.shape}")
        if not is_traced(array):
            check_definite("P", np.asarray(array), n, InputError, semi=True)
        value = jnp.asarray(array, dtype)
        return value if value.ndim == 2 else jnp.diag(jnp.broadcast_to(value, (n,)))
