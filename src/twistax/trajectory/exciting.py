"""Exciting trajectories: motions within limits that are optimal for the identification of a mechanism's parameters."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..checks import instance, listed, number, whole
from ..errors import ModelError
from ..expr import Concat, Constant, Cos, Expr, Parameter, Sin, State, Time, substitute
from ..expr.functions.function import Function
from ..mechanics.identification.base_parameters import identifiable_combinations
from ..mechanics.identification.fourier_motion import fourier_motion, fourier_rows, frequencies
from ..mechanics.identification.identify import noise_of
from ..mechanics.identification.regressor import DRIVE
from ..mechanics.identification.stacked_regressor import StackedRegressor
from ..mechanics.mechanism import Mechanism
from ..progress import watching
from ..scalar.fast import part_of_package
from ..system import System
from ..system.dynamics import compile as compiled
from ..system.lower import lower
from .hessians.options import QuasiNewton
from .problem.problem import Problem
from .problem.statement import Minimize

Array = NDArray[np.float64]
#: The number of nodes per period of the fastest harmonic, the number of random motions that are tried, and the fraction
#: of the limits that these use.
_NODES, _TRIED, _PART = 10, 20, 0.9


@watching("exciting_problem")
def exciting_problem(
    mechanism: Mechanism,
    *,
    period: float,
    harmonics: int = 5,
    links: Collection[str] | None = None,
    drives: Collection[str] = (),
    noise: Any = None,
    size: tuple[float, float] | None = None,
    nodes: int | None = None,
    seed: int = 0,
) -> Problem:
    """The problem of the optimal periodic motion for the identification of a mechanism's parameters.

    Joints follow Fourier series, see `tx.mechanics.fourier_motion`, and start and end at rest. Let $Y_b$ be the
    regressor of the base parameters, scaled by their sizes as in `tx.mechanics.identify`, and K the number of samples
    at equal distances. The average information matrix of a sample is

        $F = 1 / K sum Y_b^T Sigma^-1 Y_b$, and the problem minimises $1 / 2 log(tr F^-1 / r)$,

    the logarithm of the root mean square of the r standard deviations. The standard deviations are the Cramer-Rao bound
    of one sample; for N samples they are smaller by the factor $1 / sqrt(N)$. The sum of the inverse eigenvalues of F
    is at least the inverse of the smallest eigenvalue, and at most r times that. Limits of position, speed and motors
    hold at the nodes; `solve(between=1e-3)` also imposes them between nodes.

    The unknowns are the Parameter "coefficients" (n, 2 N + 1). The guess is the best of 20 random motions. Optima are
    local, and second derivatives are quasi-Newton approximations: a hundred iterations achieve most of the improvement.

    Source: J. Swevers, C. Ganseman, D. Tukel, J. De Schutter, H. Van Brussel, Optimal Robot Excitation and
    Identification, IEEE Transactions on Robotics and Automation 13 (1997).

    Args:
        mechanism: a tree whose joints all have motors and numbers as positions. Each joint has limits of its position,
            or of its speed; a joint without a speed limit also needs a limit of its motor's speed.
        period: s, positive.
        harmonics: the number N of harmonics of the period, at least 2.
        links, drives: the links and drives whose parameters are unknown, as in `tx.mechanics.identify`.
        noise: standard deviation of the joint forces, () or (n,), in N or N m; 1 by default.
        size: (kg, m) of typical bodies, as in `tx.mechanics.identify`.
        nodes: the number of nodes, at which limits are imposed and samples taken; 10 N + 1 by default.
        seed: seed of the random motions.
    Returns: a `Problem`. The motion of its result is `fourier_motion(result.params["coefficients"], period, times)`.
    Raises:
        ModelError: a joint on a group, without limits or without a motor; a mechanism with loops or without a moving
            joint; unknown links or drives; parameters whose size is not known.
        InputError: a noise or a size that is not positive.

    Example: `exciting_problem(arm, period=10.0).solve(max_iterations=100)`
    """
    owner = "exciting_problem"
    number(f"{owner}: period", period, "a positive number", lambda x: 0.0 < x < np.inf, ModelError)
    whole(f"{owner}: harmonics", harmonics, 2, ModelError)
    count = _NODES * harmonics if nodes is None else whole(f"{owner}: nodes", nodes, 4 * harmonics, ModelError) - 1
    center, amplitude, speed = _room(mechanism)
    sigma = noise_of(owner, noise, mechanism.dofs)
    sigma = np.ones(mechanism.dofs) if sigma is None else sigma
    times: Array = np.arange(count, dtype=np.float64) * (period / count)
    loss = _deviation(mechanism, links, drives, size, sigma, period, times)
    best, value = _guess(loss, center, amplitude, speed, (period, harmonics, times), seed)
    coefficients = Parameter("coefficients", best.shape, value=best)
    level = Parameter("logarithm of the deviation", value=value)
    w, t = frequencies(period, harmonics), Time()
    q, qd, qdd = (coefficients @ r for r in fourier_rows(w, Sin(t * w), Cos(t * w), Constant(np.ones(1)), Concat))
    still = State("still")  # a system needs a state
    dynamics = compiled(System(rates={still: 0.0 * still}, constraints=_limits(mechanism, q, qd, qdd)))
    return Problem(
        dynamics,
        Minimize(level),
        nodes=count + 1,
        final_time=period,
        initial=[{still: 0.0}, qd == np.zeros(mechanism.dofs), qdd == np.zeros(mechanism.dofs)],
        at={1: [Function(loss, shape=(), name="deviation")(coefficients) <= level]},
        free=[coefficients, level],
        hessian=QuasiNewton(),
        substeps=1,
    )


def _deviation(
    mechanism: Mechanism,
    links: Collection[str] | None,
    drives: Collection[str],
    size: Any,
    sigma: Array,
    period: float,
    times: Array,
) -> Callable[[Any], jax.Array]:
    """The logarithm of the root mean square standard deviation as a function of coefficients (n, 2 N + 1)."""
    owner, stacked = "exciting_problem", StackedRegressor.of(mechanism, DRIVE)
    unknown = np.flatnonzero(stacked.unknown(owner, links, drives))
    names = [stacked.names[i] for i in unknown]
    base = identifiable_combinations(stacked.random_matrix({})[:, unknown], names)
    columns = unknown[list(base.columns)]
    scales = stacked.scales(*stacked.typical(owner, stacked.values({}), size))[columns]
    entries = stacked.regressor.matrix[:, columns.tolist()] * (scales / sigma[:, None])
    regressor = part_of_package(lambda x: lower(entries)(0.0, x))

    def deviation(coefficients: jax.Array) -> jax.Array:
        w = frequencies(period, coefficients.shape[1] // 2)
        s, c, one = np.sin(times[:, None] * w), np.cos(times[:, None] * w), np.ones((len(times), 1))
        rows = np.stack(fourier_rows(w, s, c, one, lambda *x: np.concatenate(x, axis=1)), axis=1)

        def add(F: jax.Array, row: jax.Array) -> tuple[jax.Array, None]:
            q, qd, qdd = row @ coefficients.T
            Y = regressor({"q": q, "qd": qd, "qdd": qdd})
            return F + Y.T @ Y / len(times), None

        F, _ = jax.lax.scan(add, jnp.zeros((base.rank, base.rank), coefficients.dtype), jnp.asarray(rows))
        return 0.5 * jnp.log(jnp.trace(jnp.linalg.inv(F)) / base.rank)

    # Forward derivatives with respect to many coefficients cost as much as the reverse derivative here.
    result = jax.custom_jvp(deviation)

    @result.defjvp
    def _(point: Any, tangent: Any) -> Any:
        value, slope = jax.value_and_grad(deviation)(point[0])
        return value, jnp.vdot(slope, tangent[0])

    return result


def _room(mechanism: Mechanism) -> tuple[Array, Array, Array]:
    """The middle position, the amplitude and the speed limit of each joint; infinite without a limit."""
    owner, n = "exciting_problem", mechanism.dofs
    instance(f"{owner}: mechanism", mechanism, Mechanism, "a Mechanism", ModelError)
    if not isinstance(mechanism.q, State) or not n:
        raise ModelError(
            f"{owner} expects moving joints whose positions are numbers, got {mechanism!r}.\n"
            "  fix: lock({joint: position}) of free and spherical joints"
        )
    if still := [joint for joint in mechanism.joints if joint not in mechanism.driven]:
        raise ModelError(f"{owner} expects a motor for each joint, got none for {listed(still)}")
    limits = (mechanism.q.min, mechanism.q.max, mechanism.qd.max, mechanism.motors(mechanism.joints).max)
    low, high, speed, effort = (np.full(n, np.inf) if limit is None else np.asarray(limit) for limit in limits)
    bounded = np.isfinite(low) & np.isfinite(high)
    open_ended = ~np.isfinite(speed) & ~(bounded & np.isfinite(effort))
    if open_ended.any():
        raise ModelError(
            f"{owner}: no limit of position or speed for "
            f"{listed([j for j, is_open in zip(mechanism.joints, open_ended) if is_open])}, "
            "so no motion is optimal.\n"
            "  fix: pass Drive(speed=...), or Drive(lower=..., upper=..., effort=...)"
        )
    low, high = np.where(bounded, (low, high), 0.0)
    return 0.5 * (low + high), np.where(bounded, 0.5 * (high - low), np.inf), speed


def _limits(mechanism: Mechanism, q: Expr, qd: Expr, qdd: Expr) -> dict[str, Any]:
    """The limits of positions, speeds and motors along a motion."""
    system = mechanism.inverse_system(controls=mechanism.joints)
    exchange = {system.controls[0].key(): qdd, mechanism.q.key(): q, mechanism.qd.key(): qd}
    rows = {name: substitute(row, exchange) for name, row in system.constraints.items()}
    for leaf, value in ((mechanism.q, q), (mechanism.qd, qd)):
        for side, bound, sign in (("least", leaf.min, -1.0), ("most", leaf.max, 1.0)):
            limit = np.full(leaf.shape, np.inf) if bound is None else np.asarray(bound)
            if places := np.flatnonzero(np.isfinite(limit)).tolist():
                rows[f"{leaf.name} {side}"] = sign * value[places] <= sign * limit[places]
    return rows


def _guess(
    loss: Callable[[Any], jax.Array], center: Array, amplitude: Array, speed: Array, series: Any, seed: int
) -> tuple[Array, float]:
    """The coefficients of the best of several random motions within limits of position and speed, and its objective."""
    period, harmonics, times = series
    rng, deviation, k = np.random.default_rng(seed), jax.jit(loss), np.arange(1.0, harmonics + 1.0)
    tried = list[tuple[float, Array]]()
    for _ in range(_TRIED):
        a, b = rng.normal(size=(2, len(center), harmonics))
        a -= a.mean(axis=1, keepdims=True)  # at rest at both ends, without acceleration
        b -= np.outer(b @ k, k) / (k @ k)
        C = np.column_stack([0.0 * center, a, b])
        motion = fourier_motion(C, period, times)
        room = np.minimum(amplitude / np.abs(motion["q"]).max(axis=0), speed / np.abs(motion["qd"]).max(axis=0))
        C = _PART * room[:, None] * C
        C[:, 0] = center
        with jax.enable_x64(True):
            value = float(deviation(C))
        tried.append((value if np.isfinite(value) else np.inf, C))
    value, C = min(tried, key=lambda pair: pair[0])
    return C, value
