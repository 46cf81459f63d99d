"""Trim: a state, controls and parameters at which selected rates vanish and selected outputs have target values."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import number, short
from ..errors import InputError, TrajectoryError
from ..expr import Inputs
from ..jax_inside import in_double
from ..linear.linearize import Linearization, linearize
from ..progress import watched
from ..system.dynamics import Dynamics, need_compiled
from ..system.inputs import Values
from ..units import same_unit, seconds
from .conditions import TrimConditions
from .unknowns import Unknowns

#: Rounds of least squares, each in the chart about the last round's end.
_ROUNDS = 8
#: A step, by shares of the unknowns' scales, after which no further round is taken.
_SETTLED = 1e-9
#: How near to a bound, by shares of the unknown's scale, counts as at it.
_AT_BOUND = 1e-6
#: How far an unknown is moved, by shares of its scale, to see what its conditions really change by: far beyond
#: round-off, near enough for a curve to be straight.
_PROBE = 1e-5
#: Singular values, by shares of the largest, below which a direction is not determined.
_RANK = 1e-9


@dataclasses.dataclass(frozen=True)
class Trim:
    """The result of `trim`.

    Attributes:
        t, x, u, params: the point, as arguments of the dynamics; `params` contains the passed and the free parameters.
        trimmed: whether `measure` is at most the tolerance.
        measure: the largest residual of a condition, divided by its change when every unknown changes by its scale;
            dimensionless. The change is computed both from derivatives and from differences over 1e-5 of the scales;
            the smaller one is used, so that a very large derivative at a single point does not hide a residual.
        residuals: by name, "rate of V[3]", "airspeed", "slope of alpha": the residual of every condition, in its unit.
        unknowns: values of the free quantities by name; for a group-valued state, the sum of its steps from the start.
        saturated: for each unknown at a bound, by name, that bound.
        undetermined: the unknowns that may change together without changing any condition, to first order.
        evaluations: the number of evaluations of the conditions.
        dynamics: the compiled system.
    """

    t: float
    x: dict[str, np.ndarray]
    u: dict[str, np.ndarray]
    params: dict[str, np.ndarray]
    trimmed: bool
    measure: float
    residuals: dict[str, float]
    unknowns: dict[str, float]
    saturated: dict[str, float]
    undetermined: tuple[str, ...]
    evaluations: int
    dynamics: Dynamics = dataclasses.field(repr=False)

    def linearize(self, outputs: Iterable[str] = ()) -> Linearization:
        """The linearisation about this point by `tx.trajectory.linearize`, in double precision."""
        with in_double():
            return linearize(self.dynamics, self.t, self.x, self.u, self.params, outputs=outputs)

    def __str__(self) -> str:
        lines = [f"{'TRIMMED' if self.trimmed else 'NOT TRIMMED'}: {self.measure:.1e} of the unknowns' scales is left"]
        lines += [f"  {name} = {value:.8g}" for name, value in self.unknowns.items()]
        lines += [f"  {name} stands at its bound {value:g}" for name, value in self.saturated.items()]
        if self.undetermined:
            lines.append(f"  not determined by the conditions: {', '.join(self.undetermined)}")
        if not self.trimmed:
            largest = sorted(self.residuals.items(), key=lambda item: -abs(item[1]))[:8]
            lines += [f"  {name} is {value:.3g} off" for name, value in largest if value]
        return "\n".join(lines)


def trim(
    dynamics: Dynamics,
    x: Values,
    u: Values | None = None,
    params: Values | None = None,
    *,
    free: Iterable[str] | Mapping[str, Any],
    fixed: Iterable[str] | Mapping[str, Any] = (),
    zero: Iterable[str] = (),
    steady: Iterable[str] = (),
    t: float = 0.0,
    tolerance: float = 1e-9,
    throw: bool = True,
) -> Trim:
    """Find a point near the initial one at which a system is in equilibrium, or in a specified steady motion.

    The quantities in `free` are unknowns, all others are constant. Names refer to whole leaves, "V", or to entries,
    "V[3]", "V[3:6]", in row-major order. For a pose or rotation, entries are those of its body perturbation, so "g[4]"
    is the rotation about the body's y axis. Bounds of states and controls are respected.

    The bounded nonlinear least-squares problem of all conditions is solved by SciPy's trust-region-reflective method in
    the tangent space, in double precision, with exact derivatives. Conditions and unknowns are scaled, so the result
    does not depend on units: the scale of an unknown is its leaf's `scale`, else its size, at least 1, or half the
    distance of its bounds if that is less. A system is compiled once for each set of outputs, with or without their
    derivatives; other values do not recompile.

    Args:
        x, u, params: the initial point, with the values of all quantities that are not free.
        free: unknown states, controls and parameters: a list, or a dict with bounds, {"throttle": (0.0, 1.0)}, which
            replace those of the leaf; None, also for a single side, keeps the bound of the leaf.
        fixed: outputs with their target values, {"airspeed": 120.0}, and states with target values of their rates. In a
            list of names, or with None, the target is the initial value.
        zero: states whose rates vanish, and outputs that vanish.
        steady: outputs that are constant along the motion, with constant controls: $d/dt y(t, x(t), u, p) = 0$.
        t: the time, s.
        tolerance: tolerance of `measure`.
        throw: whether to raise an error if the conditions cannot be satisfied; False returns the best point.
    Raises:
        InputError: an unknown name, no unknowns, no conditions, a value of another shape, bounds that contradict each
            other or that belong to a group.
        TrajectoryError: no trim was found; the message names violated conditions and unknowns at bounds. Also for
            conditions or derivatives that are not finite.
        ModelError: the system is not compiled.

    Source: Branch, Coleman, Li, A subspace, interior, and conjugate gradient method for large-scale bound-constrained
    minimization problems, SIAM J. Sci. Comput. 21 (1999), for the least squares.
    """
    need_compiled("trim", dynamics)
    number("tolerance", tolerance, "a positive number", lambda v: 0.0 < v < np.inf)
    same_unit("trim: t", t, seconds)
    number("trim: t", t)
    sought = _mapping("free", free)
    named = {str(name).partition("[")[0] for name in sought}
    parameters = tuple(leaf.name for leaf in dynamics.parameters if leaf.name in named)
    with watched("trim"), in_double():
        conditions = TrimConditions(
            dynamics, _names("zero", zero), _mapping("fixed", fixed), _names("steady", steady), parameters
        )
        inputs = dynamics.functions.prepare(t, x, u, params, reads=conditions.reads)
        start = _doubled(inputs)
        unknowns = Unknowns(dynamics, start, sought, parameters)
        conditions.hold(start)
        solution = _solve(conditions, unknowns, start)
    solution = dataclasses.replace(solution, trimmed=solution.measure <= tolerance)
    if throw and not solution.trimmed:
        raise TrajectoryError(
            f"trim: no point satisfies the conditions.\n{solution}\n"
            "  fix: free more quantities, remove conditions, or use another initial point"
        )
    return solution


def _names(place: str, names: Any) -> list[str]:
    if isinstance(names, str):
        return [names]
    sequence = list(names) if isinstance(names, Iterable) else [names]
    for name in sequence:
        if not isinstance(name, str):
            raise InputError(f"trim: {place} expects names such as ['V', 'V[3]'], got {short(name)}")
    return sequence


def _mapping(place: str, value: Any) -> dict[str, Any]:
    return dict(value) if isinstance(value, Mapping) else dict.fromkeys(_names(place, value))


def _doubled(inputs: Inputs) -> Inputs:
    """The values in double precision. Raises InputError for what is not finite."""

    def doubled(values: Mapping[str, Any]) -> dict[str, jax.Array]:
        for name, value in values.items():
            if not np.isfinite(value).all():
                raise InputError(f"trim: {name!r} expects finite numbers, got {short(value)}")
        return {name: jnp.asarray(value, jnp.float64) for name, value in values.items()}

    t = jnp.asarray(inputs.t, jnp.float64)
    return Inputs(t, doubled(inputs.x), doubled(inputs.u), doubled(inputs.params), jnp.float64)


def _solve(conditions: TrimConditions, unknowns: Unknowns, start: Inputs) -> Trim:
    """Least squares in the chart about the start, then about its end, until the unknowns converge."""
    now = unknowns.values(start)
    point = unknowns.moved(start, np.clip(now, unknowns.lower, unknowns.upper) - now)
    _need_finite(conditions, *conditions.at(point), "at the start")
    turned, evaluations = np.zeros(len(now)), 0
    for k in range(_ROUNDS):
        step, counted = _round(conditions, unknowns, point, unknowns.scales(point, reach=k == 0))
        point = unknowns.moved(point, step)
        last = _to_bounds(conditions, unknowns, point)
        point, step = unknowns.moved(point, last), step + last
        turned, evaluations = turned + step, evaluations + counted
        if np.abs(step / unknowns.scales(point)[unknowns.columns]).max() < _SETTLED:
            break
    return _judged(conditions, unknowns, point, turned, evaluations)


def _round(conditions: TrimConditions, unknowns: Unknowns, about: Inputs, every: np.ndarray) -> tuple[np.ndarray, int]:
    """The solution of the least squares in the chart about a point, and the number of evaluations."""
    from scipy.optimize import least_squares

    now = unknowns.values(about)
    scales, change = every[unknowns.columns], _changes(conditions.at(about)[1], unknowns.columns, every)
    rows = np.where(change > 0.0, change, 1.0)

    @functools.lru_cache(maxsize=2)  # SciPy asks for values and derivatives one after the other
    def at(z: bytes) -> tuple[np.ndarray, np.ndarray]:
        step = np.frombuffer(z) * scales
        value, slopes = conditions.at(unknowns.moved(about, step))
        return value / rows, unknowns.in_chart(slopes, step) * scales / rows[:, None]

    def derivatives(z: np.ndarray) -> np.ndarray:
        value, slopes = at(z.tobytes())
        _need_finite(conditions, value, slopes, "on the way")
        return slopes

    result = least_squares(
        lambda z: at(z.tobytes())[0],
        np.zeros(len(now)),
        derivatives,
        # A point that was moved to a bound may be beyond it by round-off.
        bounds=(np.minimum((unknowns.lower - now) / scales, 0.0), np.maximum((unknowns.upper - now) / scales, 0.0)),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    return result.x * scales, result.nfev


def _to_bounds(conditions: TrimConditions, unknowns: Unknowns, point: Inputs) -> np.ndarray:
    """A step that moves unknowns near a bound onto it, if that reduces the residual: interior iterations never reach
    it.
    """
    now, scales = unknowns.values(point), unknowns.scales(point)
    near = _AT_BOUND * scales[unknowns.columns]
    step = np.where(np.abs(unknowns.lower - now) <= near, unknowns.lower - now, 0.0)
    step = np.where(np.abs(unknowns.upper - now) <= near, unknowns.upper - now, step)
    if not step.any():
        return step
    value, slopes = conditions.at(point)
    change = _changes(slopes, unknowns.columns, scales)
    rows = np.where(change > 0.0, change, 1.0)
    left = [np.linalg.norm(entry / rows) for entry in (value, conditions.at(unknowns.moved(point, step))[0])]
    return step if left[1] < left[0] else np.zeros(len(now))


def _judged(
    conditions: TrimConditions, unknowns: Unknowns, point: Inputs, turned: np.ndarray, evaluations: int
) -> Trim:
    """The result with its measures."""
    value, slopes = conditions.at(point)
    every = unknowns.scales(point)
    seen, counted = _seen(conditions, unknowns, point, value, every)
    change = _changes(slopes, unknowns.columns, every)
    change = np.minimum(change, _changes(seen, unknowns.columns, every))
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(value == 0.0, 0.0, np.abs(value) / change)
    final, scales = unknowns.values(point), every[unknowns.columns]
    saturated = {
        name: bound
        for side in (unknowns.lower, unknowns.upper)
        for name, v, bound, scale in zip(unknowns.names, final, side.tolist(), scales)
        if abs(v - bound) <= _AT_BOUND * scale
    }
    shown = np.where(unknowns.on_group, turned, final)
    scaled = slopes[:, unknowns.columns] * scales / np.where(change > 0.0, change, 1.0)[:, None]
    x, u, params = ({name: np.asarray(v) for name, v in values.items()} for values in (point.x, point.u, point.params))
    return Trim(
        t=float(point.t),
        x=x,
        u=u,
        params=params,
        trimmed=False,
        measure=float(shares.max()),
        residuals=dict(zip(conditions.names, value.tolist())),
        unknowns=dict(zip(unknowns.names, shown.tolist())),
        saturated=saturated,
        undetermined=tuple(name for name, free in zip(unknowns.names, _undetermined(scaled)) if free),
        evaluations=evaluations + counted,
        dynamics=conditions.dynamics,
    )


def _seen(
    conditions: TrimConditions, unknowns: Unknowns, point: Inputs, value: np.ndarray, scales: np.ndarray
) -> tuple[np.ndarray, int]:
    """Derivatives of the conditions by finite differences, the smaller of both sides, and the number of evaluations.

    A side beyond a bound, or where the conditions are not finite, is not counted.
    """
    slopes, counted = np.full((len(value), len(scales)), np.inf), 0
    for k, reach in enumerate(_PROBE * scales):
        for step in (reach, -reach):
            if not unknowns.allows(point, k, step):
                continue
            full = np.zeros(len(scales))
            full[k] = step
            moved, counted = conditions.at(unknowns.perturbed(point, full))[0], counted + 1
            change = np.abs(moved - value) / reach
            slopes[:, k] = np.where(np.isfinite(change), np.minimum(slopes[:, k], change), slopes[:, k])
    return np.where(np.isfinite(slopes), slopes, 0.0), counted


def _need_finite(conditions: TrimConditions, value: np.ndarray, slopes: np.ndarray, where: str) -> None:
    fine = np.isfinite(value) & np.isfinite(slopes).all(axis=1)
    if not fine.all():
        names = ", ".join(name for name, ok in zip(conditions.names, fine) if not ok)
        raise TrajectoryError(f"trim: {where} these are not finite, or have no finite derivatives: {names}")


def _changes(slopes: np.ndarray, columns: list[int], scales: np.ndarray) -> np.ndarray:
    """The change of each condition if every unknown changes by its scale; if that is zero, if everything does."""
    by_unknowns = np.abs(slopes[:, columns]) @ scales[columns]
    return np.where(by_unknowns > 0.0, by_unknowns, np.abs(slopes) @ scales)


def _undetermined(slopes: np.ndarray) -> np.ndarray:
    """The unknowns that take part in a direction along which no condition changes, by scaled derivatives."""
    _, sizes, directions = np.linalg.svd(slopes)
    rank = int((sizes > _RANK * sizes.max(initial=0.0)).sum())
    return np.abs(directions[rank:]).max(axis=0, initial=0.0) > 1e-3
