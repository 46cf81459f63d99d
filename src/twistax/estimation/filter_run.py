"""The result of a filter run: estimates, innovations, and consistency and observability tests."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed, real_array
from ..errors import EstimationError, InputError, ShapeError
from ..groups import Product
from ..integrators import Result
from ..linear.labels import labels, tangent_shapes
from ..progress import watching
from ..system.dynamics import Arrays
from .consistency import Consistency, consistency
from .observability import Observability, observability
from .smoothers.smoother import FixedLagSmoother, RauchTungStriebel, Smoothed


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Innovations:
    """The innovations of one measurement over a run, a row for each record.

    Attributes:
        ts: (k,) times in s.
        residual: (k, m) $Log(h^-1 z)$; zero for a missing record.
        S: (k, m, m), their covariances.
        nis: (k,) normalised innovation squared $r^T S^-1 r$; for a consistent linear filter it has the chi-square
            distribution with mean m.
        used: (k,) whether the record was present and passed the gate.
        present: (k,) whether the record was present.
    """

    ts: jax.Array
    residual: jax.Array
    S: jax.Array
    nis: jax.Array
    used: jax.Array
    present: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FilterRun:
    """The estimates of a filter over records. A pytree; `jax.vmap` over runs adds a leading axis to its arrays.

    Attributes:
        ts: (k,) times in s.
        xs: states by name, (k, *shape), after the measurements of each time.
        P: (k, n, n), their covariances in the tangent space.
        prior_xs, prior_P: the same before the measurements.
        transitions: (k, n, n), the transition matrices of errors from the previous time.
        information: (k, n, n) $H^T R^-1 H$ of the measurements used.
        innovations: by measurement, its `Innovations`.
        log_likelihood: log-likelihood of all measurements used.
        group: the group of the state.
        steps: (k,) accepted steps of the prediction before each time, with tolerances, else None.
        codes: (k,) numbers of the `Result` of each prediction, zero where it reached its end; None without tolerances.
    """

    ts: jax.Array
    xs: Arrays
    P: jax.Array
    prior_xs: Arrays
    prior_P: jax.Array
    transitions: jax.Array
    information: jax.Array
    innovations: dict[str, Innovations]
    log_likelihood: jax.Array
    group: Product = dataclasses.field(metadata={"static": True})
    steps: jax.Array | None = None
    codes: jax.Array | None = None

    @property
    def result(self) -> str:
        """The status: "successful", or the failure with its time: a prediction that cannot meet its tolerances,
        non-finite numbers, or a covariance that is not positive semidefinite.
        """
        if self.codes is not None and (codes := np.asarray(self.codes)).any():
            first = Result(codes[tuple(np.argwhere(codes)[0])])
            return f"stopped in the prediction {self._first(codes != 0)}, {first}"
        P = np.asarray(self.P, float)
        finite = np.isfinite(P).all(axis=(-2, -1))
        for x in self.xs.values():
            values = np.asarray(x)
            finite &= np.isfinite(values).reshape(*finite.shape, -1).all(axis=-1)
        prior = np.isfinite(np.asarray(self.prior_P)).all(axis=(-2, -1))
        definite = np.isfinite(np.asarray(self.information)).all(axis=(-2, -1)) | ~prior
        if not definite.all():
            return f"covariance of a measurement not positive definite {self._first(~definite)}"
        if not finite.all():
            return f"not finite {self._first(~finite)}"
        size = np.sqrt(np.clip(np.diagonal(P, axis1=-2, axis2=-1), 0.0, None))
        scale = np.where(size > 0.0, size, 1.0)
        least = np.linalg.eigvalsh(P / (scale[..., :, None] * scale[..., None, :]))[..., 0]
        room = 16.0 * P.shape[-1] * float(jnp.finfo(self.P.dtype).eps)
        if (least < -room).any():
            return f"covariance not positive {self._first(least < -room)}"
        return "successful"

    def _first(self, failed: np.ndarray) -> str:
        """The time, and among several runs the run, of the first failure."""
        *run, _ = row = np.argwhere(failed)[0]
        of_run = f" of run {', '.join(map(str, run))}" if run else ""
        return f"at t = {np.asarray(self.ts)[tuple(row)]:g} s{of_run}"

    def check(self) -> None:
        """Raise EstimationError unless the run was successful."""
        if (result := self.result) != "successful":
            raise EstimationError(
                f"the run of the filter is {result}.\n"
                "  fix: use shorter steps (max_step=...), or with tolerances looser ones or more steps "
                "(control=tx.StepControl(max_steps=...)), other units, or a larger covariance of noise and measurements"
            )

    def deviations(self) -> Arrays:
        """Standard deviations of the tangents by state, (k, dimension): roots of the diagonal of P."""
        root = jnp.sqrt(jnp.diagonal(self.P, axis1=-2, axis2=-1))
        return {name: root[..., part] for name, part in self.group.slices.items()}

    @watching("errors")
    def errors(self, truth: Mapping[str, Any]) -> jax.Array:
        """The errors $Log(x^-1 x_true)$, (k, n), of true states by name at the times of the run.

        Raises: InputError, ShapeError for states of other names or shapes.
        """
        for name, x in self.xs.items():
            if name not in truth:
                raise InputError(f"truth needs the state {name!r}, got {listed(truth)}")
            if (shape := real_array(f"truth[{name!r}]", truth[name]).shape) != x.shape:
                raise ShapeError(f"truth[{name!r}] expects shape {x.shape}, got {shape}")
        states = {name: jnp.asarray(truth[name], x.dtype) for name, x in self.xs.items()}
        difference = self.group.difference
        for _ in range(self.ts.ndim):
            difference = jax.vmap(difference)
        return difference(self.xs, states)

    @watching("errors")
    def nees(self, truth: Mapping[str, Any]) -> jax.Array:
        """The normalised estimation error squared (NEES) $e^T P^-1 e$, (k,), with mean n for a consistent covariance.

        Raises: InputError, ShapeError: the errors of `errors`.
        """
        errors = self.errors(truth)
        return jnp.sum(errors * jnp.linalg.solve(self.P, errors[..., None])[..., 0], axis=-1)

    def consistency(self, truth: Mapping[str, Any], *, level: float = 0.95, tolerance: float = 0.25) -> Consistency:
        """The consistency test of the covariance with true states; UNDECIDED for one run. See `consistency`.

        Raises: EstimationError where a run failed, which has no errors to count. InputError, ShapeError as `errors`.
        """
        self.check()
        return consistency(np.asarray(self.nees(truth)), self.group.dimension, level=level, tolerance=tolerance)

    def innovation_consistency(self, name: str, *, level: float = 0.95, tolerance: float = 0.25) -> Consistency:
        """The consistency test with the innovations of one measurement, which needs no true states.

        Raises: InputError for an unknown measurement. EstimationError where a run failed.
        """
        self.check()
        if name not in self.innovations:
            raise InputError(f"the run has the measurements {listed(self.innovations, name)}, got {name!r}")
        rows = self.innovations[name]
        nis = np.where(np.asarray(rows.present), np.asarray(rows.nis), np.nan)
        return consistency(nis, rows.residual.shape[-1], level=level, tolerance=tolerance)

    @watching("smooth")
    def smooth(self, smoother: RauchTungStriebel | FixedLagSmoother | None = None) -> Smoothed:
        """Estimates that also use later measurements, by default all of them, by `RauchTungStriebel()`. Traceable."""
        prior = (self.prior_xs, self.prior_P, self.transitions)
        return _smoothed(smoother or RauchTungStriebel(), self.group, self.ts, (self.xs, self.P), prior)

    @watching("observe")
    def observability(self, *, tolerance: float | None = None) -> Observability:
        """The observability Gramian of the measurements along the run, with the unobservable directions at its start.

        The matrices are evaluated at the estimates, which change with each measurement. So the rank of a filter may be
        higher than that of the system; evaluated at true states, it is that of the system.

        Args:
            tolerance: eigenvalues of the scaled Gramian below this value, relative to the largest, count as zero; by
                default 100 n times the machine epsilon.
        Raises: InputError for several runs at once.
        """
        if self.ts.ndim != 1:
            raise InputError("observability expects one run.\n  fix: jax.tree.map(lambda a: a[0], run)")
        limit = 100.0 * self.group.dimension * float(jnp.finfo(self.P.dtype).eps) if tolerance is None else tolerance
        names = labels(tangent_shapes(self.group))
        return observability(np.asarray(self.transitions, float), np.asarray(self.information, float), names, limit)

    def explain(self) -> str:
        """The result, the innovations of each measurement and the observability, as text."""
        lines = [f"result: {self.result}", f"log-likelihood: {float(self.log_likelihood):.6g}"]
        for name, rows in self.innovations.items():
            present, used = int(np.sum(rows.present)), int(np.sum(rows.used))
            nis = float(np.sum(np.where(rows.present, rows.nis, 0.0))) / max(present, 1)
            missing = f", {rows.present.size - present} missing" if present < rows.present.size else ""
            gated = f", {present - used} gated" if used < present else ""
            lines.append(
                f"{name}: {present} records{missing}{gated}, mean NIS {nis:.3g} for {rows.residual.shape[-1]} "
                "degrees of freedom"
            )
        return "\n".join([*lines, str(self.observability())])


@functools.partial(jax.jit, static_argnums=(0, 1))
def _smoothed(smoother: RauchTungStriebel | FixedLagSmoother, group: Product, ts: Any, post: Any, prior: Any) -> Any:
    """The smoothed states of a run or of runs along leading axes; equal smoothers of equal groups compile once."""
    smooth = functools.partial(smoother.smooth, group)
    for _ in range(ts.ndim - 1):
        smooth = jax.vmap(smooth)
    return smooth(ts, post, prior)
