"""A solution as numbers, and how it moves with parameters and ends: the core's factors at it.

What a problem is solved for joins the unknowns that all stages share, each fixed by its bounds, as a first state and a
final time are. A change of them moves all the others so that the first-order conditions still hold: with K the matrix
of the conditions' derivatives,

    K_free (dv, dlam, dy, dye) = 0,   dv_fixed = what was asked for.

Source: Fiacco, Introduction to sensitivity and stability analysis in nonlinear programming (1983), theorem 3.2.1.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Hashable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..errors import TrajectoryError
from ..solver.core import Units
from ..solver.kernels import Argument, SmoothKernels
from ..solver.members import Moves
from ..solver.options import Options
from ..solver.transcription import Transcription
from .called import Row
from .core_solver import CoreSolver
from .flat import Numbers
from .shooting import Shooting
from .staged import Functions
from .start_units import StartUnits
from .transcribed import Given, Point

if TYPE_CHECKING:
    from .problem.problem import Problem

#: How often the move of a solution on a curved manifold is refined.
_REFINEMENTS = 6
#: The least second derivative of a strict minimum, and the least product of a slack and its multiplier over the
#: tolerance, both in the units of the solve.
_LEAST_CURVED, _LEAST_PRODUCT = 1e-9, 1e-3
#: What needs it.
_DOUBLE = "need double precision\n  fix: jax.config.update('jax_enable_x64', True)"


class Optimum(NamedTuple):
    """Where the solver ended; slacks are such that no product with a multiplier is zero.

    Numbers have the precision of the program around. `exact` has the bits of those in double precision that the core
    reads: nothing is differentiated by them.
    """

    z: Any  # points, controls, shared unknowns, and what it was solved for
    cost: Any
    lam: Any  # multipliers of the dynamics
    y: Any  # of inequalities
    ye: Any  # of equalities
    zl: Any  # of lower and of upper bounds
    zu: Any
    below: Any  # distances from these
    above: Any
    s: Any  # slacks of inequalities
    solved: Any  # 1, or 0: then it has no derivatives
    exact: Any

    @property
    def bound_weights(self) -> Any:
        """Multipliers over distances, of both sides."""
        return self.zl / self.below + self.zu / self.above


class Move(NamedTuple):
    """A move of a solution: of all unknowns, multipliers, and the cost; or a right side of the conditions."""

    v: Any
    lam: Any
    y: Any
    ye: Any
    cost: Any


class Asked:
    """A problem whose parameters and final states of these names are shared unknowns.

    Args:
        core: the problem's solver.
        given: what the problem is solved for as it was stated.
        units: of its unknowns, rows and objective.
    """

    def __init__(
        self, problem: Problem, core: CoreSolver, given: Given, names: Mapping[str, tuple[str, ...]], units: StartUnits
    ) -> None:
        self.staged, self.shooting = core.staged, problem.shooting
        self._part = core.staged.parts[0]
        self._numbers: Numbers = core.staged.numbers
        self._places = self._numbers.places(names["params"], names["final"])
        self._data = self._numbers.vector(given)
        self._by_node = {name: given.params[name] for name in problem.by_node.leaves}
        functions = _WithNumbers(self.shooting, self._numbers, self._places)
        kernels = functions.kernels(dict(problem.node_rows))
        phase = dataclasses.replace(self._part.phase, kernels=kernels)
        shared = core.staged.border.size + len(self._places)
        self._transcription = Transcription([phase], shared, self._data)
        stages = self._transcription.stages
        rows, equalities = sum(stages.inequalities), sum(stages.equalities)
        #: Of each array of a `Move`.
        self.sizes = Move(stages.variables, sum(stages.after), rows, equalities, 1)
        free = self.shooting.free
        self.fixed = np.append(self.staged.step(*free) == 0.0, np.ones(len(self._places), bool))
        #: Where inequalities and equalities stand among all rows.
        self._rows = [a.astype(int) for a in core.staged.split_rows(np.arange(len(self.shooting.exists)))[:2]]
        decided = self.shooting.decided & ~self.shooting.pinned
        #: Rows that ends alone decide and the core has not, and their sizes.
        self._decided = np.flatnonzero(decided).astype(np.int32)
        self._sizes_of_decided = core.row_sizes(units)[self._decided]
        #: The least product of a slack and its multiplier.
        self._least = _LEAST_PRODUCT * core.tolerance * units.cost
        own = Units(np.append(units.v, np.ones(len(self._places))), units.rows, units.equalities, units.cost)
        options = Options(curvature=_LEAST_CURVED)
        self._moves = [Moves(self._transcription, own, options, self.fixed, way) for way in (False, True)]

    # ---- points ---------------------------------------------------------------------------------------------------

    def optimum(self, row: Row, found: Mapping[str, Any], solved: Any, precision: Any) -> Optimum:
        """What a solve came to, in a precision; in double precision itself."""
        least, y, v = self._least, found["y"], found["v"]

        def off(slack: Any, multiplier: Any) -> Any:
            """Slacks off zero, as on the central path."""
            own = jnp.maximum(slack, least / jnp.maximum(multiplier, least))
            return jnp.where(jnp.isfinite(own), own, 1.0)

        def bounds(own: Any, last: float) -> Any:
            return jnp.append(own, jnp.full(len(self._places), last))

        # A row without a multiplier takes part, too, as little as counts for nothing.
        y, s = jnp.maximum(y, least / jnp.maximum(found["s"], 1.0) * 1e-6), off(found["s"], y)
        zl, zu = found["zl"], found["zu"]
        own = Optimum(
            jnp.append(found["z"], row.data[self._places]),
            found["cost"],
            found["lam"],
            y,
            found["ye"],
            bounds(zl, 0.0),
            bounds(zu, 0.0),
            bounds(off(v - row.lower, zl), 1.0),
            bounds(off(row.upper - v, zu), 1.0),
            s,
            jnp.asarray(solved, float),
            None,
        )
        weights = own.bound_weights, own.y / own.s, jnp.reshape(own.solved, 1)
        exact = jnp.concatenate([own.z, own.lam, own.y, own.ye, *weights])
        cast = jax.tree.map(lambda a: jax.lax.convert_element_type(a, precision), own)
        return cast._replace(exact=jax.lax.bitcast_convert_type(exact, np.uint32))

    def violation(self, data: Any, z: Any) -> Any:
        """The largest violation of rows that ends alone decide, in their sizes: the core has not these rows."""
        if not len(self._decided):
            return jnp.zeros(())
        numbers = self._numbers
        given = Given(numbers.params(data), numbers.final(data, 0), numbers.limits(data))
        point = self.point(jnp.append(z, jnp.zeros(len(self._places), z.dtype)))
        rows = self.shooting.values(point, given).rows[self._decided]
        violated = jnp.where(self.shooting.equality[self._decided], jnp.abs(rows), rows)
        return jnp.max(violated / jnp.asarray(self._sizes_of_decided, rows.dtype), initial=0.0)

    def point(self, z: Any) -> Point:
        """The point of z."""
        xs, us, border, _ = self._split(z, self._part.point.size)
        return Point(self._part.point.split(xs), us, border)

    def _split(self, values: Any, width: int) -> tuple[Any, Any, Any, Any]:
        """Of numbers in the order of stages those of nodes, of controls, of the border, and of what is asked."""
        own, g = self.shooting, self.staged.border.size
        body, last, border, asked = jnp.split(values, np.cumsum([own.intervals * (width + own.m), width, g]))
        body = body.reshape(own.intervals, width + own.m)
        return jnp.concatenate([body[:, :width], last[None]]), body[:, width:], border, asked

    def _joined(self, nodes: Any, us: Any, *shared: Any) -> Any:
        """The other way."""
        body = jnp.concatenate([nodes[:-1], us], axis=1)
        return jnp.concatenate([body.reshape(-1), nodes[-1], *shared])

    def moved(self, z: Any, v: Any) -> Any:
        """z after a step."""
        (xs, *others), (d, *steps) = self._split(z, self._part.point.size), self._split(v, self.shooting.n)
        found = jax.vmap(self.shooting.dynamics.group.retract)(self._part.point.split(xs), d)
        nodes = jnp.concatenate([found[n].reshape(len(xs), -1) for n in self._part.point.shapes], axis=1)
        return self._joined(nodes, *(a + b for a, b in zip(others, steps)))

    def asked_for(
        self, z: Any, params: Mapping[str, Any], initial: Mapping[str, Any], final: Mapping[str, Any], times: Any
    ) -> Any:
        """The step of all that is fixed from z to these values; those that are NaN stay. Zero elsewhere."""
        own, point = self.shooting, self.point(z)
        d, u = jnp.zeros((own.nodes, own.n)), jnp.zeros_like(point.us)
        for name, value in initial.items():
            at, here = own.dynamics.group.slices[name], point.xs[name][0]
            value = jnp.where(jnp.isnan(value), here, value)
            d = d.at[0, at].set(jnp.ravel(own.dynamics.group.factors[name].difference(here, value)))
        border = jnp.zeros_like(point.border)
        if times is not None:
            border = border.at[0].set(times - point.border[0])
        asked = self._split(z, self._part.point.size)[3]
        values = jnp.concatenate(
            [jnp.zeros(0), *(jnp.ravel(own[name]) for own in (params, final) for name in sorted(own))]
        )
        step = jnp.where(jnp.isnan(values), 0.0, values - asked)
        return jnp.where(self.fixed, self._joined(d, u, border, step), 0.0)

    # ---- the linear system ----------------------------------------------------------------------------------------

    def flattened(self, move: Move) -> Any:
        return jnp.concatenate([jnp.reshape(a, -1) for a in move])

    def split(self, flat: Any) -> Move:
        *parts, cost = jnp.split(flat, np.cumsum(self.sizes[:-1]), axis=-1)
        v, lam, y, ye = parts
        return Move(v, lam, y, ye, cost[..., 0])

    def solved(self, optimum: Optimum, side: Any) -> Any:
        """The move of an optimum for a right side, both flat; JAX differentiates it, and again."""
        matvec: Callable[[Any], Any] = functools.partial(self._conditions, optimum)
        curved = self._part.phase.kernels.retract is not None
        if side.dtype != np.float64:
            # The conditions are worth nothing in single precision. Of the equations JAX needs the solutions alone.
            if curved:
                raise TrajectoryError(f"solution: derivatives of rotations and poses {_DOUBLE}")
            matvec = lambda flat: _no_slope(optimum.z[0]) * flat  # noqa: E731

        def solve(transposed: bool, apply: Callable[[Any], Any], side: Any) -> Any:
            once = functools.partial(self._called, optimum.exact, transposed)
            found = once(side)
            if not curved:
                return found
            # Charts move with the nodes: what that changes is of the size of the mesh's error.
            return jax.lax.fori_loop(0, _REFINEMENTS, lambda _, own: own + once(side - apply(own)), found)

        ways = functools.partial(solve, False), functools.partial(solve, True)
        return jax.lax.custom_linear_solve(matvec, side, *ways)

    def _called(self, exact: Any, transposed: bool, side: Any) -> Any:
        with jax.enable_x64(True):
            double = jax.lax.convert_element_type(side, np.float64)
            if self._transcription.called_back:
                back = functools.partial(self.by_the_core, transposed)
                shape = jax.ShapeDtypeStruct(side.shape, np.dtype(float))
                found = jax.pure_callback(back, shape, exact, double, vmap_method="sequential")
            else:
                found = self._moves[transposed](jax.lax.bitcast_convert_type(exact, np.float64), double)
            return jax.lax.convert_element_type(found, side.dtype)

    def by_the_core(self, transposed: bool, exact: Any, side: Any) -> Array:
        """The same of numbers, for sides (..., entries)."""
        row = np.ascontiguousarray(exact).view(np.float64).ravel()
        return self._moves[transposed].now(row, np.reshape(side, (-1, np.shape(side)[-1]))).reshape(np.shape(side))

    def _conditions(self, own: Optimum, flat: Any) -> Any:
        """The derivative of the first-order conditions along a move: what `by_the_core` solves, for JAX."""
        move = self.split(flat)
        (gradient, c, h, e), cost = jax.jvp(
            functools.partial(self._residuals, own), (jax.tree.map(jnp.zeros_like, move),), (move,)
        )[1]
        gradient = jnp.where(self.fixed, move.v, gradient + own.bound_weights * move.v)
        return self.flattened(Move(gradient, c, h - own.s / own.y * move.y, e, move.cost - cost))

    def _residuals(self, own: Optimum, move: Move) -> tuple[tuple[Any, Any, Any, Any], Any]:
        """The Lagrangian's gradient, defects and rows after a move, and the cost."""
        z = self.moved(own.z, move.v)
        multipliers = own.lam + move.lam, own.y + move.y, own.ye + move.ye

        def lagrangian(v: Any) -> Any:
            cost, *values = self._values(z, v)
            return cost + sum(jnp.vdot(a, b) for a, b in zip(multipliers, values))

        cost, *values = self._values(z, jnp.zeros(self.sizes.v))
        return (jax.grad(lagrangian)(jnp.zeros(self.sizes.v)), *values), cost

    def _values(self, z: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        """Cost, defects and rows at z, a step away in the charts of its nodes."""
        xs, *others = self._split(z, self._part.point.size)
        d, *steps = self._split(v, self.shooting.n)
        us, border, asked = (a + b for a, b in zip(others, steps))
        data = _replaced(jnp.asarray(self._data, asked.dtype), self._places, asked)
        numbers = self._numbers
        by_node = {name: jnp.asarray(rows, data.dtype) for name, rows in self._by_node.items()}
        given = Given(numbers.params(data) | by_node, numbers.final(data, 0), numbers.limits(data))
        values = self.shooting.values(Point(self._part.point.split(xs), us, border), given, d)
        return values.cost, values.defects.reshape(-1), *(values.rows[places] for places in self._rows)


@jax.custom_jvp
def _no_slope(z: Any) -> Any:
    """One."""
    return jnp.ones_like(z)


@_no_slope.defjvp
def _refused(primals: Any, tangents: Any) -> Any:
    raise TrajectoryError(f"solution: second derivatives {_DOUBLE}")


class _WithNumbers(Functions):
    """The functions of a phase that read some of their numbers from the shared unknowns, the last of them."""

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

        def with_numbers(z: jax.Array, *others: jax.Array) -> jax.Array:
            given = [z[: len(z) - count], *others]
            given[at] = _replaced(given[at], self._places, z[len(z) - count :])
            return function(*given)

        longer = {**arguments, Argument.Z: arguments[Argument.Z] + count}
        return SmoothKernels(with_numbers, longer, order, (key, tuple(self._places)), numbers)


def _replaced(data: Any, places: Array, values: Any) -> Any:
    """Numbers, those at some places replaced. Slices and no scatter: kernels read these."""
    index, joined = np.arange(len(data)), jnp.concatenate([data, values])
    index[places] = len(data) + np.arange(len(places))
    runs = np.split(index, np.flatnonzero(np.diff(index) != 1) + 1)
    return jnp.concatenate([joined[run[0] : run[-1] + 1] for run in runs if len(run)])
