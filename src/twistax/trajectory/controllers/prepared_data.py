"""The data of a controller's next solve: parameters, boundary values, durations and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import listed, reals, short
from ...errors import InputError, ShapeError
from ...solver.prepared import PreparedSolve
from ...system import name_of
from ..problem.start import by_phase
from ..transcription.iterate import Instance
from ..transcription.staged import Staged
from .plan_controls import PlanControl


class PreparedData:
    """Data that are set between two solves, written in place into the memory of the solver.

    Args:
        problem: the problem.
        staged: the transcribed problem.
        solve: the prepared solve.
        controls: the controls of each phase.
        instance: the data of the first solve.

    Attributes:
        params: values of the parameters by name.
        numbers: all data as one vector.
    """

    def __init__(
        self,
        problem: Any,
        staged: Staged,
        solve: PreparedSolve,
        controls: Sequence[Mapping[str, PlanControl]],
        instance: Instance,
    ) -> None:
        self._problem, self._staged, self._solve, self._controls = problem, staged, solve, controls
        self.params, self.numbers = dict(instance.params), np.array(staged.numbers.vector(instance))
        staged.transcription.set_data(self.numbers)

    def saved(self) -> tuple[dict[str, Array], Array]:
        """What `load` continues from."""
        return dict(self.params), self.numbers.copy()

    def load(self, saved: tuple[dict[str, Array], Array]) -> None:
        """Continue with the data of another controller of this problem."""
        self.params, self.numbers[:] = saved
        self._staged.transcription.set_data(self.numbers)

    def set_numbers(self, params: Any, final: Any, final_time: Any) -> None:
        """Set parameters, final states and durations; None keeps the present ones."""
        if params is not None:
            self._set_params(params)
        if final is not None:
            self._set_final(final)
        if final_time is not None:
            self._set_times(final_time)
        self._staged.transcription.set_data(self.numbers)

    def _set_params(self, params: Mapping[Any, Any]) -> None:
        if not isinstance(params, Mapping):
            raise InputError(f"prepare: params must be a dict from parameters to values, got {short(params)}")
        by_nodes = [part.by_node for part in self._problem.parts]
        changed = set[int]()
        for key, value in params.items():
            name = name_of(key)
            if name not in self.params:
                raise InputError(f"unknown key {name!r} in params; expected: {listed(self.params, name)}")
            phase = next((k for k, by_node in enumerate(by_nodes) if name in by_node.leaves), None)
            if phase is not None:
                self.params[name] = by_nodes[phase].values(name, value)
                changed.add(phase)
                continue
            array = reals(f"params[{name!r}]", value, InputError)
            if array.shape != np.shape(self.params[name]):
                raise ShapeError(f"params[{name!r}] expects shape {np.shape(self.params[name])}, got {array.shape}")
            if not np.isfinite(array).all():
                raise InputError(f"params[{name!r}] expects finite numbers, got {short(array)}")
            self.params[name] = array
            self.numbers[self._staged.numbers.places([name], [])] = array.ravel()
        for part in self._problem.parts:
            part.check_weights(self.params)
        for phase in changed:
            rows = by_nodes[phase].rows(self.params).ravel()
            begin, _ = self._staged.numbers.node_rows(phase)
            self.numbers[begin : begin + rows.size] = rows

    def _set_final(self, final: Mapping[Any, Any]) -> None:
        for number, part, values in self._of_phases("final", final):
            for name, value in part.filled(part.other_ends(None, values).final).items():
                self.numbers[self._staged.numbers.places([], [name], number)] = np.ravel(value)

    def _set_times(self, final_time: Any) -> None:
        solve, border, numbers = self._solve, self._staged.border, self._staged.numbers
        for number, part, values in self._of_phases("final_time", final_time):
            limits, _ = part.other_times(values, None)
            self.numbers[numbers.duration_places[number]] = limits
            if border.unknown[number]:
                place = int(border.unknown[:number].sum()) - border.unknowns  # from the end of z and v
                solve.lower[place], solve.upper[place] = limits
                solve.z[place] = solve.v[place] = np.clip(solve.z[place], *limits)

    def set_limits(self, limits: Mapping[Any, Any]) -> None:
        """Set the limits of controls."""
        for number, _, values in self._of_phases("limits", limits):
            for key, sides in values.items():
                self._limit(self._controls[number], name_of(key), sides)

    def _of_phases(self, what: str, values: Any) -> list[tuple[int, Any, Any]]:
        """(number, phase, value) of each phase that has a value."""
        of_phases = by_phase(self._problem, f"prepare: {what}", values)
        triples = zip(range(len(of_phases)), self._problem.parts, of_phases)
        return [triple for triple in triples if triple[2] is not None]

    def _limit(self, controls: Mapping[str, PlanControl], name: str, sides: Any) -> None:
        if name not in controls:
            raise InputError(f"limits names {name!r}; the controls are: {listed(controls, name)}")
        shape, columns = controls[name].shape, controls[name].columns
        if not isinstance(sides, (tuple, list)) or len(sides) != 2:
            raise InputError(f"limits[{name!r}] expects (low, high), got {short(sides)}")
        every = (len(columns), *shape)
        low, high = (reals(f"limits[{name!r}]", side, InputError) for side in sides)
        for side in (low, high):
            if side.shape not in ((), shape, every):
                raise ShapeError(f"limits[{name!r}] expects shape {shape} or {every}, got {side.shape}")
        if not (low <= high).all():
            raise InputError(f"limits[{name!r}] expects low <= high, got {short(low)} and {short(high)}")
        for bound, side in ((self._solve.lower, low), (self._solve.upper, high)):
            bound[columns] = np.broadcast_to(side, every).reshape(len(columns), -1)


def load(solve: PreparedSolve, staged: Staged, start: Any) -> None:
    """Write a warm start into the memory of the solver."""
    solve.z[:] = z = staged.flat(start.point)
    solve.v[:] = staged.coordinates(z)
    solve.lam[:] = staged.unpadded(start.dynamics)
    solve.y[:], solve.ye[:], solve.zl[:], solve.zu[:] = staged.split_rows(np.asarray(start.rows))
    solve.s[:] = 0.0  # the residuals of its rows
