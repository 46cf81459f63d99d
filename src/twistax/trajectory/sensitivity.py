"""Derivatives of an optimum by what it was solved for, through the implicit function theorem.

At an optimum with displacement z = 0 of the unknowns, multipliers y of the dynamics, w of the rows, and slacks s, the
conditions grad_z L = 0, F = 0, c = 0, g + s = 0, s w = mu hold for all arguments theta. So along a change of theta

    K (dz, dy, dw) = -(d/dtheta)(grad_z L, F, c, g) . dtheta,

with K the matrix of the last Newton step, which the Riccati recursion factors. On groups K is exact but for the error
of the mesh, as an interval is differentiated in coordinates about a node that stays; refinement with the derivative of
the conditions themselves takes that out.
Source: Fiacco, Introduction to sensitivity and stability analysis in nonlinear programming (1983), theorem 3.2.1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import real_array, reals, short
from ..errors import InputError, TrajectoryError
from ..jax_inside import is_in_last_thread, is_traced
from ..precision import in_double
from ..system import name_of
from .accuracy import MESH
from .first_order import FirstOrder, in_units
from .iterate import Scales
from .riccati import Factors, Rows, Stages, factorize, refined
from .transcribed import Given, Point, Step, jitted

if TYPE_CHECKING:
    from .problem import Problem

#: How often the change of an optimum is refined.
_REFINEMENTS = 6
#: The least second derivative of a strict minimum, scaled.
_LEAST_CURVED = 1e-9


class Solution(NamedTuple):
    """An optimum as JAX arrays: objective as stated, states and controls by name, final time, free parameters."""

    cost: jax.Array
    xs: dict[str, jax.Array]
    us: dict[str, jax.Array]
    final_time: jax.Array
    free: dict[str, jax.Array]


class _Theta(NamedTuple):
    """What was asked for; entries that were not are missing."""

    params: dict[str, Any]
    initial: dict[str, Any]
    final: dict[str, Any]
    final_time: dict[str, Any]  # {} or {"final_time": number}


class _Optimum(NamedTuple):
    """Where the solver ended; multipliers and slacks in the problem's units."""

    point: Point
    cost: Any
    dynamics: Any
    rows: Any
    slack: Any
    scales: Scales


class _Moved(NamedTuple):
    """How unknowns and multipliers change, scaled."""

    step: Step
    dynamics: Any
    rows: Rows


class _Residuals(NamedTuple):
    """What the conditions leave: the Lagrangian's gradient, defects and rows, scaled."""

    gradient: Step
    defects: Any
    rows: Any


def solution(
    problem: Problem,
    *,
    guess: Any = None,
    warm: Any = None,
    tolerance: float = 1e-8,
    max_iterations: int = 1000,
    mesh_tolerance: float = MESH,
) -> Callable[..., Solution]:
    """The optimum as a function of parameters and ends that JAX differentiates.

    `f = tx.trajectory.solution(problem)`, then `f(params=..., initial=..., final=..., final_time=...)` takes what
    `problem.solve` does, all optional, and gives a `Solution`. `jax.grad`, `jax.jacfwd`, `jax.jacrev`, `jax.vmap` and
    `jax.jit` apply. A fixed final time is an argument as well. Derivatives by poses and rotations are by the entries of
    their matrices, to be used along curves on the group, as `group.retract` makes them.

    The objective has a derivative wherever the optimum is regular; the trajectory where no limit is about to become
    active or inactive (strict complementarity), and where it is a strict minimum.

    Args:
        guess, warm, max_iterations, mesh_tolerance: as in `problem.solve`.
        tolerance: likewise; derivatives are no more exact than the solution.

    Raises:
        TrajectoryError: in double precision alone (`jax_enable_x64`); a problem of phases; when called: the problem was
            not solved, or what was found is no strict minimum and is to be differentiated.
    """
    if jnp.result_type(float) != np.float64:
        raise TrajectoryError(
            "solution: derivatives need double precision\n  fix: jax.config.update('jax_enable_x64', True)"
        )
    if len(getattr(problem, "parts", ())) != 1:
        raise TrajectoryError(f"solution expects a tx.trajectory.Problem of one phase, got {type(problem).__name__}")
    options = {"guess": guess, "warm": warm, "max_iterations": max_iterations, "mesh_tolerance": mesh_tolerance}
    return _Differentiable(problem, options, tolerance)


class _Differentiable:
    """See `solution`."""

    def __init__(self, problem: Problem, options: dict[str, Any], tolerance: float) -> None:
        self._problem, self._options, self._tolerance = problem, options, tolerance
        with in_double():
            self._own = jax.device_put(problem.given(problem.ends, problem.params, problem.border.limits))
        # Options of the compiler belong to the outermost program alone: within another one these have none.
        self._alone = jitted(self._factors), jitted(self._tangent)
        self._within = jax.jit(self._factors), jax.jit(self._tangent)
        optimum = jax.custom_jvp(self._optimum)
        optimum.defjvp(self._jvp)
        self._found: Callable[[_Theta], _Optimum] = optimum

    def __call__(
        self,
        *,
        params: Mapping[str, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
        final: Mapping[Any, Any] | None = None,
        final_time: Any = None,
    ) -> Solution:
        times = {} if final_time is None else {"final_time": _double("solution: final_time", final_time)}
        theta = _Theta(_named("params", params), _named("initial", initial), _named("final", final), times)
        if final_time is not None and self._problem.border.free[0]:
            raise TrajectoryError(f"solution: the final time is free, and no argument; got {short(final_time)}")
        found = self._found(theta)
        held = self._problem.shooting.local.controls.split(found.point.us)
        return Solution(
            self._problem.objective.sign * found.cost,
            {s.name: found.point.xs[s.name] for s in self._problem.reduced.states},
            self._problem.restated.us(found.point.xs, held),
            found.point.border[0],
            self._problem.border.params(found.point.border),
        )

    # ---- the solve ----------------------------------------------------------------------------------------------

    def _optimum(self, theta: _Theta) -> _Optimum:
        if not is_traced(theta):
            return jax.tree.map(jnp.asarray, self._solved(theta))
        shooting, border = self._problem.shooting, self._problem.border
        array = lambda *shape: jax.ShapeDtypeStruct(shape, np.dtype(float))  # noqa: E731
        rows, free = len(shooting.exists), shooting.free
        shapes = _Optimum(
            Point(
                {s.name: array(shooting.nodes, *s.shape) for s in self._problem.dynamics.states},
                array(shooting.intervals, shooting.m),
                array(border.size),
            ),
            array(),
            array(shooting.intervals, shooting.n),
            array(rows),
            array(rows),
            Scales(array(*free.d.shape), array(*free.u.shape), array(border.size), array(rows), array()),
        )
        return jax.pure_callback(self._solved_within, shapes, theta, vmap_method="sequential")

    def _solved_within(self, theta: _Theta) -> _Optimum:
        """The same, called back."""
        if is_in_last_thread():
            raise TrajectoryError(
                "solution: under jit the solve calls XLA from within XLA. Where a process may use one processor it has "
                "one thread, and would wait for ever.\n  fix: set NPROC=2 in the environment before JAX starts, or "
                "leave jit out"
            )
        return self._solved(theta)

    def _solved(self, theta: _Theta) -> _Optimum:
        """The solve itself, of numbers."""
        own: _Theta = jax.tree.map(np.asarray, theta)
        asked: Any = {name: getattr(own, name) or None for name in ("params", "initial", "final")}
        result = self._problem.solve(**self._options, **asked, **own.final_time, tolerance=self._tolerance)
        if not result.solved:
            raise TrajectoryError(f"solution: the problem was not solved. {result.message}")
        warm = result.warm
        found = _Optimum(
            warm.point,
            np.asarray(self._problem.objective.sign * result.cost),
            warm.dynamics,
            warm.rows,
            result.slacks,
            warm.scales,
        )
        return jax.tree.map(np.asarray, found)

    # ---- its derivatives ----------------------------------------------------------------------------------------

    def _jvp(self, primals: tuple[_Theta], tangents: tuple[_Theta]) -> tuple[_Optimum, _Optimum]:
        (theta,), (along,) = primals, tangents
        found = self._found(theta)
        factored, _ = self._within if is_traced(theta) else self._alone
        _, changed = self._within if is_traced((theta, along)) else self._alone
        stages, factors = factored(found, theta)
        tangent = changed(theta, along, found, stages, factors)
        if not is_traced(factors.exist):
            _strict(np.asarray(factors.exist))
            return found, tangent
        # What is raised within a compiled function ends it; its result is used, or JAX would leave it out.
        exist = jax.lax.stop_gradient(jnp.asarray(factors.exist, float))
        one = jax.pure_callback(_strict, jax.ShapeDtypeStruct((), np.dtype(float)), exist, vmap_method="sequential")
        return found, jax.tree.map(lambda a: a * one, tangent)

    def _given(self, found: _Optimum, theta: _Theta) -> tuple[Point, Given]:
        """The optimum's point and arguments as functions of what was asked for."""
        point = found.point
        given = self._own
        put = lambda value, otherwise: jnp.where(jnp.isnan(value), otherwise, value)  # noqa: E731
        xs = {n: a.at[0].set(put(theta.initial[n], a[0])) if n in theta.initial else a for n, a in point.xs.items()}
        final = given.final | {n: put(value, given.final[n]) for n, value in theta.final.items()}
        border = point.border.at[0].set(theta.final_time.get("final_time", point.border[0]))
        return Point(xs, point.us, border), given._replace(params=given.params | theta.params, final=final)

    def _factors(self, found: _Optimum, theta: _Theta) -> tuple[Stages, Factors]:
        """The matrix of the last Newton step, factored."""
        conditions, scales, zero = FirstOrder(self._problem.shooting), found.scales, jnp.zeros(())
        point, given = self._given(found, theta)
        y, w = conditions.multipliers(found.dynamics, found.rows, scales)
        weights = conditions.weights(conditions.softness(found.slack / scales.rows, w))
        slopes = conditions.derivatives(point, y, w, given, scales)
        stages = Stages(slopes, weights, zero, conditions.free_start)
        factors = factorize(stages)
        # What is zero may be above it by rounding: a strict minimum is one with a little less on the diagonal, too.
        strict = factorize(stages._replace(damping=zero - _LEAST_CURVED))
        return stages, factors._replace(exist=factors.exist & strict.exist)

    def _tangent(self, theta: _Theta, along: _Theta, found: _Optimum, stages: Stages, factors: Factors) -> _Optimum:
        """How the optimum moves along a change of what was asked for."""
        shooting, scales = self._problem.shooting, found.scales
        conditions = FirstOrder(shooting)

        def residuals(theta: _Theta, moved: _Moved) -> tuple[_Residuals, Any, Any]:
            """Of the conditions, after the unknowns and multipliers moved; the objective and the point with them."""
            base, given = self._given(found, theta)
            point = shooting.move(base, in_units(moved.step, scales))
            y, w = conditions.multipliers(found.dynamics, found.rows, scales)
            y, w = y + moved.dynamics, w + conditions.join(moved.rows)
            values = conditions.values(point, given, scales)
            gradient = conditions.lagrangian(conditions.derivatives(point, y, w, given, scales), y, w)
            return _Residuals(gradient, values.defects, values.rows), values.cost * scales.cost, point

        def change(along: _Theta, moved: _Moved) -> tuple[_Residuals, Any, Any]:
            found: tuple[_Residuals, Any, Any] = jax.jvp(residuals, (theta, still), (along, moved))[1]
            return found

        def refine(_: Any, carry: tuple[_Moved, Any, Any]) -> tuple[_Moved, Any, Any]:
            """The next move, the one that it was made of, and what that one leaves and changes."""
            moved = carry[0]
            changed = change(along, moved)
            left = changed[0]
            gradient, rows = left.gradient, conditions.split(jnp.where(jnp.asarray(shooting.exists), left.rows, 0.0))
            nothing = jnp.zeros((shooting.intervals, len(gradient.border)))
            pushed = stages.slopes._replace(
                gradient=jnp.concatenate([gradient.d[:-1], gradient.u, nothing], axis=1),
                end_gradient=jnp.concatenate([gradient.d[-1], gradient.border]),
            )
            # A slack takes up what its multiplier changes; an equality holds.
            taken = jax.tree.map(lambda r, grown, own: r - grown * own, rows, moved.rows, softness)
            own = refined(stages._replace(slopes=pushed), factors, left.defects, taken)
            return jax.tree.map(jnp.add, moved, _Moved(own.step, own.dynamics, own.rows)), moved, changed

        _, w = conditions.multipliers(found.dynamics, found.rows, scales)
        softness = conditions.split(conditions.softness(found.slack / scales.rows, w))
        still = _Moved(
            Step(*(jnp.zeros(np.shape(a)) for a in shooting.free)),
            jnp.zeros_like(found.dynamics),
            jax.tree.map(jnp.zeros_like, softness),
        )
        # One loop body in place of two programs: what the last round moves on to is not used.
        none = _Residuals(still.step, still.dynamics, jnp.zeros_like(found.rows)), jnp.zeros_like(found.cost)
        begin = still, still, (*none, jax.tree.map(jnp.zeros_like, found.point))
        _, moved, (left, cost, point) = jax.lax.fori_loop(0, _REFINEMENTS + 1, refine, begin)
        # Multipliers and slacks move too, for derivatives of derivatives; scales are a matter of numbers alone.
        return _Optimum(
            point,
            cost,
            moved.dynamics * scales.cost / scales.d[1:],
            conditions.join(moved.rows) * scales.cost / scales.rows,
            jnp.where(conditions.inequality, -left.rows * scales.rows, 0.0),
            jax.tree.map(jnp.zeros_like, scales),
        )


def _strict(exist: Any) -> np.ndarray:
    """1, or TrajectoryError where the factors do not exist."""
    if not np.all(exist):
        raise TrajectoryError("solution: the trajectory is no strict minimum, and has no derivative")
    return np.ones(())


def _named(what: str, given: Any) -> dict[str, jax.Array]:
    """Values by name."""
    if given is not None and not isinstance(given, Mapping):
        raise InputError(f"solution: {what} expects a dict from leaves to values, got {short(given)}")
    return {name_of(key): _double(f"solution: {what}[{name_of(key)!r}]", own) for key, own in (given or {}).items()}


def _double(place: str, value: Any) -> jax.Array:
    """Numbers, traced ones as they are."""
    if is_traced(value):
        return jnp.asarray(real_array(place, value), float)
    return jnp.asarray(reals(place, value, InputError, free=True), float)
