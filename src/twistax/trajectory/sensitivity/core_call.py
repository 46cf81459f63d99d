"""The solve of a problem of one phase as one call of the core inside a JAX program.

It starts at the optimum of the original problem, in the units of that optimum, with the new values inserted. These
values do not change the program: parameters, final states and a fixed final time are numeric arguments of kernels, and
initial states are bounds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...errors import TrajectoryError
from ...solver.core import CoreSolution, CoreStatus, Units
from ...solver.members import MEASURES, Solves
from ...solver.options import Options
from ..problem.problem import Problem
from ..strategy.core_solver import CoreSolver
from ..strategy.measure import COST
from ..strategy.status import Status
from ..transcription.iterate import Instance, Iterate


class SolveInputs(NamedTuple):
    """The inputs of a solve: numbers for kernels, the start, its coordinates, and their bounds."""

    data: Any
    z: Any
    v: Any
    lower: Any
    upper: Any


class CoreCall:
    """The solve of a problem as one call of the core.

    Args:
        start: the start of every solve, whose units are used.
        instance: parameters, initial and final states and limits of the original problem.
    """

    def __init__(
        self, problem: Problem, core: CoreSolver, start: Iterate, instance: Instance, max_iterations: int
    ) -> None:
        self._problem, self._tolerance = problem, core.tolerance
        self.units = units = core.units(start, instance)
        self._staged = staged = core.staged.alone(instance)  # a copy, which later solves of the problem do not change
        numbers = staged.numbers.vector(instance)
        z = staged.flat(start)
        v = staged.coordinates(z)
        self._base = SolveInputs(numbers, z, v, *staged.limits(v, instance))
        self.solves = Solves(
            staged.transcription,
            Units(units.v, units.rows, units.equalities, COST * units.cost),
            Options(**core.options(max_iterations)),
            core.largest_step,
            len(numbers),
        )

    def need_compiled(self) -> None:
        """Raise TrajectoryError if an XLA program would have to call Python."""
        if names := self._staged.transcription.called_back:
            raise TrajectoryError(
                "solution: under jit and vmap functions of the problem must have a native form. "
                f"JAX executes the {' and the '.join(names)}, as it does functions with host callbacks.\n"
                "  fix: call it outside of jit and vmap, or state the problem without such functions"
            )

    def inputs(
        self,
        params: Mapping[str, Any],
        initial: Mapping[str, Any],
        final: Mapping[str, Any],
        final_time: Any,
        start: Array | None = None,
    ) -> SolveInputs:
        """The inputs of a solve for these values; NaN entries keep their original values.

        Args:
            start: the array z of another start.
        """
        staged, phase = self._staged, self._problem.shooting
        data, z, v, lower, upper = map(jnp.asarray, self._base)
        if start is not None:  # bounds are those of coordinates, which depend on this start
            z, (of_points, of_variables) = jnp.asarray(start), staged.plain
            v = v.at[of_variables].set(z[of_points])
        for values, places in ((params, lambda n: ([n], [])), (final, lambda n: ([], [n]))):
            for name, value in values.items():
                is_fixed = values is params or self._problem.ends.final_fixed[name].all()
                data = _put(data, staged.numbers.places(*places(name)), value, is_fixed)
        part, group = staged.parts[0], phase.dynamics.group
        for name, value in initial.items():
            is_fixed = self._problem.ends.initial_fixed[name].all()  # of tangents
            z = _put(z, part.point.places(name), value, is_fixed)
            if group.factors[name].flat:
                columns = np.arange(phase.n)[group.slices[name]]
                fixed = ~phase.free.d[0][columns]
                v = _put(v, columns, value, is_fixed)
                at = columns[fixed]
                lower, upper = lower.at[at].set(v[at]), upper.at[at].set(v[at])
        if final_time is not None:
            final_time = jnp.where(final_time > 0.0, final_time, jnp.nan)  # the error is that of `problem.solve`
            data = data.at[staged.numbers.final_time].set(final_time)
        return SolveInputs(data, z, v, lower, upper)

    def judged(self, core: CoreSolver, values: Mapping[str, Any], instance: Instance, mesh_tolerance: float) -> Status:
        """The status of a result as in `problem.solve`, checked by the solver of this thread."""
        numbers = {name: float(values[name]) for name in MEASURES}
        arrays = {name: np.asarray(a) for name, a in values.items() if name not in MEASURES}
        status = CoreStatus(int(numbers.pop("status")))
        core.staged.set_instance(instance)
        result = CoreSolution(status=status, **arrays, statistics=numbers, log=np.zeros((0, 10)))
        outcome = core.measure.outcome(result, self.units, instance)
        if core.measure.violated_at_once(outcome.point, instance, self.units) > core.tolerance:
            return Status.INFEASIBLE
        return core.judge.judged(outcome, instance, mesh_tolerance, core.tolerance).status

    def is_solved(self, values: Mapping[str, Any]) -> Any:
        """Whether it is solved according to the core, which does not have the rows that fixed ends determine."""
        most = jnp.maximum(COST * values["error"], values["violation"])
        is_close = values["excess"] <= self._tolerance * values["worth"]
        return (values["status"] == CoreStatus.SOLVED.value) | ((most <= self._tolerance) & is_close)


def _put(array: Any, places: Array, value: Any, is_fixed: Any) -> Any:
    """The array with new values at these indices; NaN entries of free ends are ignored."""
    flat = jnp.ravel(jnp.asarray(value, float))
    return array.at[places].set(jnp.where(jnp.isnan(flat) & (not is_fixed), array[places], flat))
