"""Derivatives of an optimum with respect to the arguments of the solve, by the implicit function theorem; see
`optimum.py`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import listed, real_array, reals, short
from ...errors import InputError, ShapeError, TrajectoryError
from ...jax_inside import in_double, is_traced, quick_compile
from ...system import name_of
from ..hessians.options import by_updates
from ..problem.problem import Problem
from ..strategy.accuracy import MESH
from ..strategy.core_solver import CoreSolver
from ..strategy.status import Status
from ..transcription.iterate import Instance
from .core_call import CoreCall, SolveInputs
from .optimum import Move, OptimalityConditions, Optimum

#: The round-off of a row, in units of machine precision times its size.
_ROUNDING = 100.0


class Solution(NamedTuple):
    """An optimum as JAX arrays: objective as stated, states and controls by name, final time, free parameters.

    `solved` is 1 for an optimum. Otherwise `solved` is 0, the arrays are the last iterate, and derivatives are NaN.
    """

    cost: jax.Array
    xs: dict[str, jax.Array]
    us: dict[str, jax.Array]
    final_time: jax.Array
    free: dict[str, jax.Array]
    solved: jax.Array


class _Theta(NamedTuple):
    """The arguments of a call of `solution`, without omitted ones."""

    params: dict[str, Any]
    initial: dict[str, Any]
    final: dict[str, Any]
    final_time: dict[str, Any]  # {} or {"final_time": number}


def solution(
    problem: Problem,
    *,
    guess: Any = None,
    warm: Any = None,
    tolerance: float = 1e-8,
    max_iterations: int = 1000,
    mesh_tolerance: float = MESH,
) -> Callable[..., Solution]:
    """The optimum as a function of parameters and end values, which JAX can differentiate.

    `f = tx.trajectory.solution(problem)`; `f(params=..., initial=..., final=..., final_time=...)` takes the arguments
    of `problem.solve`, all optional, and returns a `Solution`. `jax.grad`, `jax.jacfwd`, `jax.jacrev`, `jax.vmap` and
    `jax.jit` apply to it. A fixed final time is an argument, too. Derivatives with respect to poses and rotations are
    those of the entries of their matrices, for curves on the group, as `group.retract` makes them.

    The first call solves the problem as stated, with `problem.solve`. Every later call is one call of the solver's
    core, which starts at that optimum, in its scales, and computes in double precision whatever `jax_enable_x64` is.
    Inside `jit` and `vmap` it is one operation, and threads of XLA compute the members of a batch in parallel. Outside
    of these, the mesh is checked as in `problem.solve`, and if the core finds no optimum `problem.solve` is called.

    The objective is differentiable wherever the optimum is regular. The trajectory is differentiable at a strict
    minimum where the set of active limits does not change (strict complementarity).

    Args:
        guess, warm: for the solve of the original problem, as in `problem.solve`.
        max_iterations, mesh_tolerance: as in `problem.solve`. Under `jit` and `vmap` the mesh is that of the original
            problem, which is checked once.
        tolerance: as in `problem.solve`; derivatives are no more accurate than the solution.

    Raises:
        TrajectoryError: a problem of several phases; when called: the problem was not solved, or a derivative is
            required at a result that is not a strict minimum. Under `jit` and `vmap`, `solved` is 0 or derivatives are
            NaN in these cases; an error is raised there only for functions without a native form, such as those with
            host callbacks.
    """
    if not getattr(problem, "alone", False):
        phases = len(getattr(problem, "parts", ()))
        got = f"a list of phases, {phases}" if phases else type(problem).__name__
        raise TrajectoryError(f"solution expects a tx.trajectory.Problem of one phase, got {got}")
    if by_updates(problem.parts):  # derivatives need exact second derivatives
        problem = problem.with_phases([{"hessian": None}])
    options = {"guess": guess, "warm": warm, "max_iterations": max_iterations, "mesh_tolerance": mesh_tolerance}
    return _Differentiable(problem, options, tolerance)


class _Reference(NamedTuple):
    """The problem that was solved, with explicit or implicit steps, and the core call that starts at its solution."""

    problem: Problem
    core: CoreSolver
    instance: Instance
    call: CoreCall
    coarse: str  # the message about its mesh if that is too coarse

    def need_compiled(self) -> None:
        """Raise TrajectoryError if an XLA program cannot solve it."""
        self.call.need_compiled()
        if self.coarse:
            raise TrajectoryError(f"solution: the problem was not solved. {self.coarse}")


class _Differentiable:
    """See `solution`."""

    def __init__(self, problem: Problem, options: dict[str, Any], tolerance: float) -> None:
        self._problem, self._options, self._tolerance = problem, options, float(tolerance)
        self._of: dict[tuple[tuple[str, ...], ...], _SolutionFor] = {}

    def __call__(
        self,
        *,
        params: Mapping[str, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
        final: Mapping[Any, Any] | None = None,
        final_time: Any = None,
    ) -> Solution:
        times = {} if final_time is None else {"final_time": _numbers("solution: final_time", final_time)}
        theta = _Theta(_by_name("params", params), _by_name("initial", initial), _by_name("final", final), times)
        if final_time is not None and self._problem.border.free[0]:
            raise TrajectoryError(
                f"solution: the final time is free in the problem, so it is not an argument; got {short(final_time)}"
            )
        names = tuple(
            tuple(sorted(part)) for part in (theta.params, theta.final, theta.final_time)
        )  # in the form of JAX's keys
        if names not in self._of:
            self._of[names] = _SolutionFor(self._reference, self._options, names)
        return self._of[names](theta)

    @functools.cached_property
    def _reference(self) -> _Reference:
        problem, options = self._problem, self._options
        with in_double():
            result = problem.solve(**options, tolerance=self._tolerance)
            problem = result.problem
            started = problem.started(options["guess"])
            core = problem.core(self._tolerance, started.point, started.instance)
            start = result.warm.point if result.solved else started.point
            call = CoreCall(problem, core, start, started.instance, options["max_iterations"])
        return _Reference(
            problem, core, started.instance, call, result.message if result.status is Status.COARSE else ""
        )


class _SolutionFor:
    """The solution as a function of the parameters, final states and final time with these names."""

    def __init__(self, reference: _Reference, options: dict[str, Any], names: tuple[tuple[str, ...], ...]) -> None:
        self._problem, self._reference, self._options, self._names = reference.problem, reference, options, names
        # Compiler options belong only to the outermost program; nested programs have none.
        self._alone = jax.jit(self._tangent, compiler_options=quick_compile(1), keep_unused=True)
        self._within = jax.jit(self._tangent)
        self._shown = jax.jit(self._solution)
        optimum = jax.custom_jvp(self._optimum)
        optimum.defjvp(self._jvp)
        self._differentiable: Callable[[_Theta], Optimum] = optimum

    def __call__(self, theta: _Theta) -> Solution:
        self._check(theta)
        return self._shown(self._differentiable(theta))

    def _check(self, theta: _Theta) -> None:
        """Raise InputError, or the error of `problem.solve`, if an argument does not fit the problem."""
        problem, states = self._problem, {state.name: state for state in self._problem.dynamics.states}
        shapes = {name: np.shape(value) for name, value in problem.params.items()}
        of_states = {name: state.shape for name, state in states.items()}
        for name in theta.params:
            if name in problem.by_node.leaves:
                raise TrajectoryError(
                    f"solution: params names {name!r}, which has a value for each node and cannot be an argument.\n"
                    "  fix: pass its values to the problem, params={...}"
                )
        for what, known in (("params", shapes), ("initial", of_states), ("final", of_states)):
            for name, value in getattr(theta, what).items():
                if name not in known:
                    raise InputError(f"solution: {what} names {name!r}; the problem has {listed(list(known), name)}")
                if jnp.shape(value) != known[name]:
                    raise ShapeError(f"solution: {what}[{name!r}] expects shape {known[name]}, got {jnp.shape(value)}")
        for what, fixed in (("initial", problem.ends.initial_fixed), ("final", problem.ends.final_fixed)):
            for name in getattr(theta, what):
                if not np.any(fixed[name]):
                    raise TrajectoryError(
                        f"solution: {what}[{name!r}] must fix the entries that the problem fixes: it fixes none.\n"
                        "  fix: pass a value for it to the problem"
                    )

    def _solution(self, optimum: Optimum) -> Solution:
        problem, point = self._problem, self._conditions.point(optimum.z)
        controls = problem.shooting.local.controls.split(point.us)
        xs, us = problem.seen(point.xs, controls)
        return Solution(
            problem.objective.sign * optimum.cost,
            xs,
            us,
            point.border[0],
            problem.border.params(point.border),
            optimum.solved,
        )

    @functools.cached_property
    def _conditions(self) -> OptimalityConditions:
        """The conditions of the problem with these names among its unknowns; its kernels compile once."""
        _, core, instance, call, _ = self._reference
        with in_double():
            names = dict(zip(("params", "final", "final_time"), self._names))
            return OptimalityConditions(self._problem, core, instance, names, call.units)

    # ---- the solve ----------------------------------------------------------------------------------------------

    def _inputs(self, theta: _Theta, start: Any = None) -> SolveInputs:
        values = jax.tree.map(lambda a: jax.lax.convert_element_type(a, np.float64), theta)
        time = values.final_time.get("final_time")
        return self._reference.call.inputs(values.params, values.initial, values.final, time, start)

    def _optimum(self, theta: _Theta) -> Optimum:
        call, precision = self._reference.call, jnp.result_type(float)
        if not is_traced(theta):
            with in_double():
                inputs, result = self._solved(theta)
                return self._conditions.optimum(inputs, call.solves.split(result), 1.0, precision)
        self._reference.need_compiled()
        with jax.enable_x64(True):
            inputs = self._inputs(theta)
            traced = call.solves.split(call.solves(jnp.concatenate(inputs)))
            data, z = (jax.lax.convert_element_type(a, precision) for a in (inputs.data, traced["z"]))
        # The kernels of a program have its precision.
        least = _ROUNDING * float(jnp.finfo(precision).eps)
        holds = self._conditions.violation(data, z) <= max(self._reference.core.tolerance, least)
        holds &= self._is_meant(theta)
        with jax.enable_x64(True):
            return self._conditions.optimum(inputs, traced, call.is_solved(traced) & holds, precision)

    def _is_meant(self, theta: _Theta) -> Any:
        """Whether all values are finite and the duration is positive; free entries of ends are ignored."""
        ends, known = self._problem.ends, [jnp.isfinite(value).all() for value in jax.tree.leaves(theta.params)]
        for values, fixed in ((theta.initial, ends.initial_fixed), (theta.final, ends.final_fixed)):
            known += [jnp.where(fixed[name], jnp.isfinite(value), True).all() for name, value in values.items()]
        known += [jnp.isfinite(time) & (time > 0.0) for time in theta.final_time.values()]
        return jnp.stack([jnp.asarray(True), *known]).all()

    def _solved(self, theta: _Theta) -> tuple[SolveInputs, jax.Array]:
        """The solve for numeric arguments, and its inputs."""
        call, numbers = self._reference.call, jax.tree.map(np.asarray, theta)
        values: Any = {name: getattr(numbers, name) or None for name in ("params", "initial", "final")}
        values |= numbers.final_time
        started, tolerance = self._problem.started(**values), self._reference.core.tolerance
        core = self._problem.core(tolerance, started.point, started.instance)  # the solver of this thread
        inputs = self._inputs(theta)
        result = call.solves.now(np.asarray(jnp.concatenate(inputs)))
        judged = call.judged(core, call.solves.split(result), started.instance, self._options["mesh_tolerance"])
        if judged is not Status.SOLVED:
            options = {**self._options, "guess": None, "warm": None}
            searched = self._problem.solve(**values, **options, tolerance=tolerance)
            if not searched.solved:
                raise TrajectoryError(f"solution: the problem was not solved. {searched.message}")
            inputs = self._inputs(theta, core.staged.flat(searched.warm.point))
            result = call.solves.now(np.asarray(jnp.concatenate(inputs)))
        return inputs, jnp.asarray(result)

    # ---- derivatives ---------------------------------------------------------------------------------------------

    def _jvp(self, primals: tuple[_Theta], of_primals: tuple[_Theta]) -> tuple[Optimum, Optimum]:
        (theta,), (tangents,) = primals, of_primals
        optimum = self._differentiable(theta)
        if not is_traced(optimum):
            with in_double():
                self._conditions.by_the_core(False, optimum.exact, np.zeros(sum(self._conditions.sizes)))
        tangent = self._within if is_traced((theta, tangents, optimum)) else self._alone
        none = np.zeros(optimum.exact.shape, jax.dtypes.float0)
        return optimum, tangent(theta, tangents, optimum)._replace(exact=none)

    def _tangent(self, theta: _Theta, tangents: _Theta, optimum: Optimum) -> Optimum:
        """The change of the optimum along a change of the arguments."""
        conditions, known = self._conditions, jnp.where(optimum.solved > 0.0, 1.0, jnp.nan)
        tangents = jax.tree.map(lambda a: known * a, tangents)  # also if an argument is NaN

        def fixed(theta: _Theta) -> Any:
            return conditions.fixed_step(optimum.z, *theta)

        step = jax.jvp(fixed, (theta,), (tangents,))[1]
        side = Move(step, *(jnp.zeros(size) for size in conditions.sizes[1:]))
        move = conditions.split(conditions.solved(optimum, conditions.flattened(side)))
        z = jax.jvp(lambda v: conditions.moved(optimum.z, v), (jnp.zeros_like(move.v),), (move.v,))[1]
        # Products of slacks and multipliers are constant.
        return Optimum(
            z,
            move.cost,
            move.lam,
            move.y,
            move.ye,
            -optimum.zl / optimum.below * move.v,
            optimum.zu / optimum.above * move.v,
            move.v,
            -move.v,
            -optimum.s / optimum.y * move.y,
            jnp.zeros(()),
            None,
        )


def _by_name(what: str, values: Any) -> dict[str, jax.Array]:
    if values is not None and not isinstance(values, Mapping):
        raise InputError(f"solution: {what} expects a dict from leaves to values, got {short(values)}")
    return {name_of(key): _numbers(f"solution: {what}[{name_of(key)!r}]", a) for key, a in (values or {}).items()}


def _numbers(place: str, value: Any) -> jax.Array:
    """Arrays from numbers; traced values are not changed."""
    if is_traced(value):
        return jnp.asarray(real_array(place, value), float)
    return jnp.asarray(reals(place, value, InputError, free=True), float)
