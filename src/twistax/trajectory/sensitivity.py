"""Derivatives of an optimum by what it was solved for, through the implicit function theorem; see `optimum.py`."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed, real_array, reals, short
from ..errors import InputError, TrajectoryError
from ..jax_inside import is_in_last_thread, is_traced
from ..precision import in_double
from ..system import name_of
from .accuracy import MESH
from .optimum import Asked, Move, Optimum
from .transcribed import jitted

if TYPE_CHECKING:
    from .problem import Problem


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
        self._problem, self._options, self._tolerance = problem, options, float(tolerance)
        self._of: dict[tuple[tuple[str, ...], ...], _Named] = {}

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
        names = tuple(sorted(theta.params)), tuple(sorted(theta.final))  # as JAX has the keys of a dict
        if names not in self._of:
            # Kernels for these names are made with the first solve, which refuses those that are not there.
            self._of[names] = _Named(self._problem, self._options, self._tolerance, names)
        return self._of[names](theta)


class _Named:
    """The same for parameters and final states of these names."""

    def __init__(
        self, problem: Problem, options: dict[str, Any], tolerance: float, names: tuple[tuple[str, ...], ...]
    ) -> None:
        self._problem, self._options, self._tolerance, self._names = problem, options, tolerance, names
        # Options of the compiler belong to the outermost program alone: within another one these have none.
        self._alone, self._within = jitted(self._tangent), jax.jit(self._tangent)
        self._shown = jax.jit(self._solution)
        optimum = jax.custom_jvp(self._optimum)
        optimum.defjvp(self._jvp)
        self._found: Callable[[_Theta], Optimum] = optimum

    def __call__(self, theta: _Theta) -> Solution:
        return self._shown(self._found(theta))

    def _solution(self, found: Optimum) -> Solution:
        problem, point = self._problem, self._asked.point(found.z)
        held = problem.shooting.local.controls.split(point.us)
        return Solution(
            problem.objective.sign * found.cost,
            {s.name: point.xs[s.name] for s in problem.reduced.states},
            problem.restated.us(point.xs, held),
            point.border[0],
            problem.border.params(point.border),
        )

    @functools.cached_property
    def _asked(self) -> Asked:
        """The problem with these names among its unknowns; its kernels compile once."""
        params, final = self._names
        for what, names, known in (
            ("params", params, self._problem.params),
            ("final", final, [state.name for state in self._problem.dynamics.states]),
        ):
            for name in names:
                if name not in known:
                    raise InputError(f"solution: {what} names {name!r}; the problem has {listed(known, name)}")
        with in_double():
            started = self._problem.started()
            core = self._problem._core(self._tolerance, started.point, started.given)
            return Asked(self._problem, core, started.given, {"params": params, "final": final})

    # ---- the solve ----------------------------------------------------------------------------------------------

    def _optimum(self, theta: _Theta) -> Optimum:
        if not is_traced(theta):
            return jax.tree.map(jnp.asarray, self._solved(theta))
        return jax.pure_callback(self._solved_within, self._asked.shapes, theta, vmap_method="sequential")

    def _solved_within(self, theta: _Theta) -> Optimum:
        """The same, called back."""
        if is_in_last_thread():
            raise TrajectoryError(
                "solution: under jit the solve calls XLA from within XLA. Where a process may use one processor it has "
                "one thread, and would wait for ever.\n  fix: set NPROC=2 in the environment before JAX starts, or "
                "leave jit out"
            )
        return self._solved(theta)

    def _solved(self, theta: _Theta) -> Optimum:
        """The solve itself, of numbers."""
        own: _Theta = jax.tree.map(np.asarray, theta)
        asked: Any = {name: getattr(own, name) or None for name in ("params", "initial", "final")}
        result = self._problem.solve(**self._options, **asked, **own.final_time, tolerance=self._tolerance)
        if not result.solved:
            raise TrajectoryError(f"solution: the problem was not solved. {result.message}")
        with in_double():
            given = self._problem.started(**asked, **own.final_time).given
            found = self._asked.optimum(result, given, self._problem.objective.sign)
        return jax.tree.map(lambda a: np.asarray(a, float), found)

    # ---- its derivatives ----------------------------------------------------------------------------------------

    def _jvp(self, primals: tuple[_Theta], tangents: tuple[_Theta]) -> tuple[Optimum, Optimum]:
        (theta,), (along,) = primals, tangents
        found = self._found(theta)
        if not is_traced(found):  # under jit the callback raises
            with in_double():
                self._asked.by_the_core(False, found, np.zeros((0, sum(self._asked.sizes))))
        tangent = self._within if is_traced((theta, along, found)) else self._alone
        return found, tangent(theta, along, found)

    def _tangent(self, theta: _Theta, along: _Theta, found: Optimum) -> Optimum:
        """How the optimum moves along a change of what was asked for."""
        asked = self._asked

        def fixed(theta: _Theta) -> Any:
            times = theta.final_time.get("final_time")
            return asked.asked_for(found.z, theta.params, theta.initial, theta.final, times)

        step = jax.jvp(fixed, (theta,), (along,))[1]
        side = Move(step, *(jnp.zeros(size) for size in asked.sizes[1:]))
        move = asked.split(asked.solved(found, asked.flattened(side)))
        z = jax.jvp(lambda v: asked.moved(found.z, v), (jnp.zeros_like(move.v),), (move.v,))[1]
        # Products of slacks and multipliers stay.
        return Optimum(
            z,
            move.cost,
            move.lam,
            move.y,
            move.ye,
            -found.zl / found.below * move.v,
            found.zu / found.above * move.v,
            move.v,
            -move.v,
            -found.s / found.y * move.y,
            jax.tree.map(jnp.zeros_like, found.units),
        )


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
