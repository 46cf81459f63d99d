"""A solution, and its derivatives with respect to parameters and end values, by the core's factorisation at the
solution.

The arguments of a solve are treated as additional shared unknowns, fixed by bounds like the initial state. Under a
change of them, all other unknowns change so that the first-order conditions remain satisfied. With the Jacobian K of
the conditions,

    K_free (dv, dlam, dy, dye) = 0, with dv_fixed the change of the arguments.

Source: Fiacco, Introduction to sensitivity and stability analysis in nonlinear programming (1983), theorem 3.2.1.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Hashable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...errors import TrajectoryError
from ...solver.core import Units
from ...solver.kernels import Argument, SmoothKernels
from ...solver.members import Moves
from ...solver.options import Options
from ...solver.transcription import Transcription
from ..problem.problem import Problem
from ..start_units import StartUnits
from ..strategy.core_solver import CoreSolver
from ..transcription.iterate import Instance, Iterate
from ..transcription.jax_values import JaxValues
from ..transcription.kernels import PhaseFunctions
from ..transcription.shooting import Shooting
from ..transcription.vectors import Numbers
from .core_call import SolveInputs

#: The number of refinements of the solution's change on a curved manifold.
_REFINEMENTS = 6
#: The least second derivative of a strict minimum, and the least product of a slack and its multiplier divided by the
#: tolerance, both in the units of the solve.
_LEAST_CURVED, _LEAST_PRODUCT = 1e-9, 1e-3
#: The requirement that messages name.
_DOUBLE = "need double precision\n  fix: jax.config.update('jax_enable_x64', True)"


class Optimum(NamedTuple):
    """The optimum of a solve, in which no product of a slack and a multiplier is zero.

    Numbers have the precision of the JAX program. `exact` holds the bits of the double-precision values that the core
    reads; it is not differentiated.
    """

    z: Any  # points, controls, shared unknowns, and the arguments of the solve
    cost: Any
    lam: Any  # multipliers of the dynamics
    y: Any  # of inequalities
    ye: Any  # of equalities
    zl: Any  # multipliers of lower and upper bounds
    zu: Any
    below: Any  # distances from these bounds
    above: Any
    s: Any  # slacks of inequalities
    solved: Any  # 1 if solved; with 0 there are no derivatives
    exact: Any

    @property
    def bound_weights(self) -> Any:
        """Multipliers divided by distances, for lower and upper bounds."""
        return self.zl / self.below + self.zu / self.above


class Move(NamedTuple):
    """A change of a solution: of all unknowns, multipliers, and the cost; or a right-hand side of the linearised
    conditions.
    """

    v: Any
    lam: Any
    y: Any
    ye: Any
    cost: Any


class OptimalityConditions:
    """The first-order conditions of a problem in which the parameters and final states with these names are shared
    unknowns.

    Args:
        core: the solver of the problem.
        names: names by kind; "final_time" is present if a fixed final time is such an unknown, too.
        instance: parameters, initial and final states and limits of the original problem.
        units: units of its unknowns, rows and objective.
    """

    def __init__(
        self,
        problem: Problem,
        core: CoreSolver,
        instance: Instance,
        names: Mapping[str, tuple[str, ...]],
        units: StartUnits,
    ) -> None:
        self.staged, self.shooting = core.staged, problem.shooting
        self._jax_values = JaxValues(problem.shooting)
        self._part = core.staged.parts[0]
        self._numbers: Numbers = core.staged.numbers
        places = self._numbers.places(names["params"], names["final"])
        places = np.append(places, self._numbers.final_time[: len(names["final_time"])])
        self._places = places.astype(np.int32)  # JAX without double precision has no 64-bit integers
        self._data = self._numbers.vector(instance)
        self._by_node = {name: instance.params[name] for name in problem.by_node.leaves}
        functions = _WithNumbers(self.shooting, self._numbers, self._places)
        kernels = functions.kernels(dict(problem.node_rows))
        phase = dataclasses.replace(self._part.phase, kernels=kernels)
        shared = core.staged.border.unknowns + len(self._places)
        self._transcription = Transcription([phase], shared, self._data)
        stages = self._transcription.stages
        rows, equalities = sum(stages.inequalities), sum(stages.equalities)
        #: The shape of each array of a `Move`.
        self.sizes = Move(stages.variables, sum(stages.after), rows, equalities, 1)
        free = self.shooting.free
        self.fixed = np.append(self.staged.step(*free) == 0.0, np.ones(len(self._places), bool))
        #: The indices of inequalities and equalities among all rows.
        self._rows = [a.astype(int) for a in core.staged.split_rows(np.arange(len(self.shooting.exists)))[:2]]
        determined = self.shooting.determined & ~self.shooting.redundant
        #: Rows that depend only on fixed ends and that the core does not have, with their sizes.
        self._determined = np.flatnonzero(determined).astype(np.int32)
        self._sizes_of_decided = core.measure.row_sizes(units)[self._determined]
        #: The least product of a slack and its multiplier.
        self._least = _LEAST_PRODUCT * core.tolerance * units.cost
        with_numbers = Units(np.append(units.v, np.ones(len(self._places))), units.rows, units.equalities, units.cost)
        options = Options(curvature=_LEAST_CURVED)
        self._moves = [
            Moves(self._transcription, with_numbers, options, self.fixed, transposed) for transposed in (False, True)
        ]

    # ---- points ---------------------------------------------------------------------------------------------------

    def optimum(self, inputs: SolveInputs, result: Mapping[str, Any], solved: Any, precision: Any) -> Optimum:
        """The result of a solve in a given precision; the solve itself is in double precision."""
        least, y, v = self._least, result["y"], result["v"]

        def off(slack: Any, multiplier: Any) -> Any:
            """Slacks bounded away from zero, as on the central path."""
            positive = jnp.maximum(slack, least / jnp.maximum(multiplier, least))
            return jnp.where(jnp.isfinite(positive), positive, 1.0)

        def bounds(of_v: Any, last: float) -> Any:
            return jnp.append(of_v, jnp.full(len(self._places), last))

        # A row without a multiplier is included with a negligible weight.
        y, s = jnp.maximum(y, least / jnp.maximum(result["s"], 1.0) * 1e-6), off(result["s"], y)
        zl, zu = result["zl"], result["zu"]
        optimum = Optimum(
            jnp.append(result["z"], inputs.data[self._places]),
            result["cost"],
            result["lam"],
            y,
            result["ye"],
            bounds(zl, 0.0),
            bounds(zu, 0.0),
            bounds(off(v - inputs.lower, zl), 1.0),
            bounds(off(inputs.upper - v, zu), 1.0),
            s,
            jnp.asarray(solved, float),
            None,
        )
        weights = optimum.bound_weights, optimum.y / optimum.s, jnp.reshape(optimum.solved, 1)
        exact = jnp.concatenate([optimum.z, optimum.lam, optimum.y, optimum.ye, *weights])
        cast = jax.tree.map(lambda a: jax.lax.convert_element_type(a, precision), optimum)
        return cast._replace(exact=jax.lax.bitcast_convert_type(exact, np.uint32))

    def violation(self, data: Any, z: Any) -> Any:
        """The largest violation of rows that depend only on fixed ends, in their scales; the core does not have these
        rows.
        """
        if not len(self._determined):
            return jnp.zeros(())
        numbers = self._numbers
        instance = Instance(numbers.params(data), numbers.final(data, 0), numbers.limits(data))
        point = self.point(jnp.append(z, data[self._places]))
        rows = self._jax_values(point, instance).rows[self._determined]
        violated = jnp.where(self.shooting.equality[self._determined], jnp.abs(rows), rows)
        return jnp.max(violated / jnp.asarray(self._sizes_of_decided, rows.dtype), initial=0.0)

    def point(self, z: Any) -> Iterate:
        """The point of an array z."""
        xs, us, shared, values = self._split(z, self._part.point.size)
        return Iterate(self._part.point.split(xs), us, self._border(shared, self._changed(values)))

    def _changed(self, values: Any) -> Any:
        """The numbers for kernels with other arguments of the solve."""
        return _replaced(jnp.asarray(self._data, values.dtype), self._places, values)

    def _border(self, shared: Any, data: Any) -> Any:
        return self.shooting.border.complete(shared, self._numbers.limits(data))

    def _split(self, values: Any, width: int) -> tuple[Any, Any, Any, Any]:
        """Split an array in the order of the stages into nodes, controls, shared unknowns, and
        arguments of the solve.
        """
        count, m, g = self.shooting.intervals, self.shooting.m, self.staged.border.unknowns
        body, last, shared, numbers = jnp.split(values, np.cumsum([count * (width + m), width, g]))
        body = body.reshape(count, width + m)
        return jnp.concatenate([body[:, :width], last[None]]), body[:, width:], shared, numbers

    def _joined(self, nodes: Any, us: Any, *shared: Any) -> Any:
        body = jnp.concatenate([nodes[:-1], us], axis=1)
        return jnp.concatenate([body.reshape(-1), nodes[-1], *shared])

    def moved(self, z: Any, v: Any) -> Any:
        """The point z after a step."""
        (xs, *rest), (d, *steps) = self._split(z, self._part.point.size), self._split(v, self.shooting.n)
        states = jax.vmap(self.shooting.dynamics.group.retract)(self._part.point.split(xs), d)
        nodes = jnp.concatenate([states[n].reshape(len(xs), -1) for n in self._part.point.shapes], axis=1)
        return self._joined(nodes, *(a + b for a, b in zip(rest, steps)))

    def fixed_step(
        self,
        z: Any,
        params: Mapping[str, Any],
        initial: Mapping[str, Any],
        final: Mapping[str, Any],
        final_time: Mapping[str, Any],
    ) -> Any:
        """The step of all fixed unknowns from z to these values, zero for other unknowns; NaN values are ignored."""
        phase, point = self.shooting, self.point(z)
        d, u, shared = jnp.zeros((phase.nodes, phase.n)), jnp.zeros_like(point.us), jnp.zeros(phase.border.unknowns)
        for name, value in initial.items():
            here, group = point.xs[name][0], phase.dynamics.group
            step = group.factors[name].difference(here, jnp.where(jnp.isnan(value), here, value))
            d = d.at[0, group.slices[name]].set(jnp.ravel(step))
        numbers = self._split(z, self._part.point.size)[3]
        values = [jnp.ravel(part[name]) for part in (params, final, final_time) for name in sorted(part)]
        step = jnp.concatenate([jnp.zeros(0), *values]) - numbers
        return jnp.where(self.fixed, self._joined(d, u, shared, jnp.where(jnp.isnan(step), 0.0, step)), 0.0)

    # ---- the linear system ----------------------------------------------------------------------------------------

    def flattened(self, move: Move) -> Any:
        return jnp.concatenate([jnp.reshape(a, -1) for a in move])

    def split(self, flat: Any) -> Move:
        *parts, cost = jnp.split(flat, np.cumsum(self.sizes[:-1]), axis=-1)
        v, lam, y, ye = parts
        return Move(v, lam, y, ye, cost[..., 0])

    def solved(self, optimum: Optimum, side: Any) -> Any:
        """The change of an optimum for a right-hand side, both flat; JAX can differentiate it repeatedly."""
        matvec: Callable[[Any], Any] = functools.partial(self._conditions, optimum)
        curved = self._part.phase.kernels.retract is not None
        if side.dtype != np.float64:
            # The conditions are too inaccurate in single precision. JAX needs only the solution of the equations.
            if curved:
                raise TrajectoryError(f"solution: derivatives of rotations and poses {_DOUBLE}")
            matvec = lambda flat: _no_slope(optimum.z[0]) * flat  # noqa: E731

        def solve(transposed: bool, apply: Callable[[Any], Any], side: Any) -> Any:
            once = functools.partial(self._called, optimum.exact, transposed)
            move = once(side)
            if not curved:
                return move
            # Charts move with the nodes; the effect of this is of the order of the mesh error.
            return jax.lax.fori_loop(0, _REFINEMENTS, lambda _, move: move + once(side - apply(move)), move)

        return jax.lax.custom_linear_solve(
            matvec, side, functools.partial(solve, False), functools.partial(solve, True)
        )

    def _called(self, exact: Any, transposed: bool, side: Any) -> Any:
        with jax.enable_x64(True):
            double = jax.lax.convert_element_type(side, np.float64)
            if self._transcription.called_back:
                back = functools.partial(self.by_the_core, transposed)
                shape = jax.ShapeDtypeStruct(side.shape, np.dtype(float))
                move = jax.pure_callback(back, shape, exact, double, vmap_method="sequential")
            else:
                move = self._moves[transposed](jax.lax.bitcast_convert_type(exact, np.float64), double)
            return jax.lax.convert_element_type(move, side.dtype)

    def by_the_core(self, transposed: bool, exact: Any, side: Any) -> Array:
        """The change of an optimum for numeric right-hand sides (..., entries)."""
        row = np.ascontiguousarray(exact).view(np.float64).ravel()
        return self._moves[transposed].now(row, np.reshape(side, (-1, np.shape(side)[-1]))).reshape(np.shape(side))

    def _conditions(self, optimum: Optimum, flat: Any) -> Any:
        """The derivative of the first-order conditions along a move, in JAX: the operator that
        `by_the_core` inverts.
        """
        move = self.split(flat)
        (gradient, c, h, e), cost = jax.jvp(
            functools.partial(self._residuals, optimum), (jax.tree.map(jnp.zeros_like, move),), (move,)
        )[1]
        gradient = jnp.where(self.fixed, move.v, gradient + optimum.bound_weights * move.v)
        return self.flattened(Move(gradient, c, h - optimum.s / optimum.y * move.y, e, move.cost - cost))

    def _residuals(self, optimum: Optimum, move: Move) -> tuple[tuple[Any, Any, Any, Any], Any]:
        """The gradient of the Lagrangian, defects, rows and cost after a move."""
        z = self.moved(optimum.z, move.v)
        multipliers = optimum.lam + move.lam, optimum.y + move.y, optimum.ye + move.ye

        def lagrangian(v: Any) -> Any:
            cost, *values = self._values(z, v)
            return cost + sum(jnp.vdot(a, b) for a, b in zip(multipliers, values))

        cost, *values = self._values(z, jnp.zeros(self.sizes.v))
        return (jax.grad(lagrangian)(jnp.zeros(self.sizes.v)), *values), cost

    def _values(self, z: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        """Cost, defects and rows at z, as functions of a step in the charts of its nodes."""
        xs, *rest = self._split(z, self._part.point.size)
        d, *steps = self._split(v, self.shooting.n)
        us, shared, values = (a + b for a, b in zip(rest, steps))
        data = self._changed(values)
        numbers = self._numbers
        by_node = {name: jnp.asarray(rows, data.dtype) for name, rows in self._by_node.items()}
        instance = Instance(numbers.params(data) | by_node, numbers.final(data, 0), numbers.limits(data))
        point = Iterate(self._part.point.split(xs), us, self._border(shared, data))
        values = self._jax_values(point, instance, d)
        return values.cost, values.defects.reshape(-1), *(values.rows[places] for places in self._rows)


@jax.custom_jvp
def _no_slope(z: Any) -> Any:
    return jnp.ones_like(z)


@_no_slope.defjvp
def _refused(primals: Any, tangents: Any) -> Any:
    raise TrajectoryError(f"solution: second derivatives {_DOUBLE}")


class _WithNumbers(PhaseFunctions):
    """The functions of a phase, some of whose numbers are read from the last of the shared unknowns."""

    def __init__(self, shooting: Shooting, numbers: Numbers, places: Array) -> None:
        super().__init__(shooting, numbers)
        self._places = places

    def smooth(
        self,
        function: Callable[..., jax.Array],
        arguments: Mapping[Argument, int],
        order: int,
        key: Hashable,
        numbers: Array,
    ) -> SmoothKernels:
        count, at = len(self._places), list(arguments).index(Argument.DATA)

        def with_numbers(z: jax.Array, *rest: jax.Array) -> jax.Array:
            arrays = [z[: len(z) - count], *rest]
            arrays[at] = _replaced(arrays[at], self._places, z[len(z) - count :])
            return function(*arrays)

        longer = {**arguments, Argument.Z: arguments[Argument.Z] + count}
        return SmoothKernels(with_numbers, longer, order, (key, tuple(self._places)), numbers)


def _replaced(data: Any, places: Array, values: Any) -> Any:
    """An array with values replaced at some indices. It uses slices, because kernels cannot have scatter operations."""
    index, joined = np.arange(len(data)), jnp.concatenate([data, values])
    index[places] = len(data) + np.arange(len(places))
    runs = np.split(index, np.flatnonzero(np.diff(index) != 1) + 1)
    return jnp.concatenate([joined[run[0] : run[-1] + 1] for run in runs if len(run)])
