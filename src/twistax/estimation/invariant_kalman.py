"""The invariant extended Kalman filter, and a test of its assumption that the system is group-affine."""

from __future__ import annotations

import dataclasses
import enum
import itertools
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import ModelError
from ..groups import Product
from ..integrators import StepControl
from ..system.dynamics import Arrays, Dynamics, need_compiled
from ..system.inputs import Values
from .error_state_kalman import ErrorStateKalman
from .imu.preintegrated_navigation import PreintegratedNavigation
from .measurement import Measurement
from .prediction.process_noise import NoiseDiscretization


class Invariance(enum.Enum):
    """The choice between left-invariant and right-invariant errors of an invariant filter.

    LEFT: $x_true = x Exp(e)$, for measurements in world axes, such as a position. RIGHT: $x_true = Exp(e) x$, for
        measurements in body axes, such as the direction of a landmark.
    """

    LEFT = "left"
    RIGHT = "right"


class InvariantKalman(ErrorStateKalman):
    """The invariant extended Kalman filter: the error-state filter without a reset of the covariance.

    For a group-affine system the transition matrix of the invariant error e does not depend on the estimate, and the
    error is propagated exactly for any size of e. So the covariance of e is not transformed when the estimate is
    corrected: $P = (I
    - K H) P (I - K H)^T + K R K^T$ in the tangent space of e.

    `run.P` and P0 are those of right perturbations, $x_true = x Exp(d)$, as in all filters here. With LEFT, e equals d.
    With RIGHT, $e = Ad_x d$ has the covariance $Ad_x P Ad_x^T$; the reset of P by $Ad_Exp(-d)$ keeps this covariance
    constant. To first order both filters agree; they differ by the square of the correction.

    Use one state on `tx.ExtendedPose` for attitude, velocity and position; as three states they are not group-affine.

    Args:
        dynamics, measurements, method, max_step, rtol, atol, control, gate, noise: as for `ErrorStateKalman`.
        invariance: `Invariance.LEFT` or `Invariance.RIGHT`.
    Raises:
        ModelError: the errors of `ErrorStateKalman`.

    Example: `tx.estimation.InvariantKalman(dynamics, [gps]).affinity()` tests whether the system is group-affine.

    Source: Barrau, Bonnabel, The invariant extended Kalman filter as a stable observer, IEEE TAC 62 (2017), eq. 14 to
    22.
    """

    def __init__(
        self,
        dynamics: Dynamics | PreintegratedNavigation,
        measurements: Iterable[Measurement],
        *,
        invariance: Invariance = Invariance.LEFT,
        method: Any = None,
        max_step: float | None = None,
        rtol: Any = None,
        atol: Any = None,
        control: StepControl | None = None,
        gate: float | None = None,
        noise: NoiseDiscretization | None = None,
    ) -> None:
        if not isinstance(invariance, Invariance):
            raise ModelError(f"invariance expects Invariance.LEFT or Invariance.RIGHT, got {invariance!r}")
        reset = _unmoved if invariance is Invariance.LEFT else _transported
        steps: dict[str, Any] = {"max_step": max_step, "rtol": rtol, "atol": atol, "control": control}
        super().__init__(dynamics, measurements, method=method, gate=gate, noise=noise, reset=reset, **steps)
        self.invariance = invariance

    def affinity(self, u: Values | None = None, params: Values | None = None, *, seed: int = 0) -> GroupAffinity:
        """The test whether the system is group-affine, by `group_affinity`."""
        return group_affinity(self.model.dynamics, u, params, seed=seed)


def _unmoved(group: Product, d: jax.Array) -> jax.Array:
    return jnp.eye(group.dimension, dtype=d.dtype)


def _transported(group: Product, d: jax.Array) -> jax.Array:
    return group.Ad(group.exp(-d))


@dataclasses.dataclass(frozen=True)
class GroupAffinity:
    """The result of `group_affinity`: whether the rates of a system are group-affine.

    Attributes:
        affine: whether they are group-affine, to round-off.
        defect: $max |f(a b) - f(b) - Ad_b^-1 (f(a) - f(e))| / max |f|$, dimensionless.
        fixed: the smallest set of vector-valued states that must be constant to make the other rates group-affine, such
            as biases; empty if `affine`, None if there is no such set.
    """

    affine: bool
    defect: float
    fixed: tuple[str, ...] | None

    def __str__(self) -> str:
        if self.affine:
            return f"group-affine (defect {self.defect:.1e}): the transition of errors does not depend on the estimate"
        rest = "" if self.fixed is None else f"; with {', '.join(self.fixed)} constant the rest is group-affine"
        return f"not group-affine (defect {self.defect:.1e}){rest}"


def group_affinity(
    dynamics: Dynamics, u: Values | None = None, params: Values | None = None, *, seed: int = 0
) -> GroupAffinity:
    """Test whether the rates f of a system are group-affine.

    For all states a and b they satisfy $f(a b) = f(b) + Ad_b^-1 (f(a) - f(e))$, e the neutral element and f body
    velocities. This holds if and only if the rates of the errors $a^-1 b$ depend on the errors alone. It is evaluated
    at random states, and at random controls if none are passed, so it is a test and not a proof.

    Args:
        u: controls, in their units.
        params: parameter values; those with default values are optional.
        seed: seed of the random states.
    Raises: ModelError, InputError: the errors of a call of the dynamics.

    Example: `print(tx.estimation.group_affinity(dynamics))`.

    Source: Barrau, Bonnabel, The invariant extended Kalman filter as a stable observer, IEEE TAC 62 (2017), theorem 1,
    here for body velocities.
    """
    need_compiled("group_affinity", dynamics)
    rng = np.random.default_rng(seed)
    controls = {leaf.name: rng.normal(size=leaf.shape) for leaf in dynamics.controls} | dict(u or {})
    states = [_drawn(dynamics.group, rng) for _ in range(3)]

    def defect(fixed: tuple[str, ...]) -> float:
        return _defect(dynamics, states, fixed, controls, params)

    with_all = defect(())
    limit = 1e4 * float(jnp.finfo(jnp.result_type(float)).eps)
    if with_all < limit:
        return GroupAffinity(True, with_all, ())
    flat = [name for name, group in dynamics.group.factors.items() if group.flat]
    for size in range(1, min(len(flat), len(dynamics.group.factors) - 1) + 1):
        for fixed in itertools.combinations(flat, size):
            if defect(fixed) < limit:
                return GroupAffinity(False, with_all, fixed)
    return GroupAffinity(False, with_all, None)


def _drawn(group: Product, rng: np.random.Generator) -> Arrays:
    return group.exp(jnp.asarray(rng.normal(size=group.dimension)))


def _defect(
    dynamics: Dynamics, states: list[Arrays], fixed: tuple[str, ...], u: dict[str, Any], params: Values | None
) -> float:
    """The largest violation of the equation by rates of states that are not fixed, over the largest rate."""
    group = dynamics.group
    a, b, constant = states
    constants = {name: constant[name] for name in fixed}
    entries = np.concatenate(
        [np.arange(part.start, part.stop) for name, part in group.slices.items() if name not in fixed]
    )

    def rates(x: Arrays) -> jax.Array:
        values = dynamics(0.0, {**x, **constants}, u, params)
        return group.join({name: jnp.ravel(value) for name, value in values.items()})

    at_a, at_b, at_e = rates(a), rates(b), rates(group.identity())
    violation = rates(group.compose(a, b)) - at_b - group.Ad(group.inverse(b)) @ (at_a - at_e)
    size = max(float(jnp.max(jnp.abs(value))) for value in (at_a, at_b, at_e))
    return float(jnp.max(jnp.abs(violation[entries]))) / (size or 1.0)
