"""The first node of a plan: the layout of its states, and its distance from a measured state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import listed, reals, short
from ...errors import InputError, ShapeError
from ...integrators.options import need_element
from ...solver.kernels import Argument
from ...solver.prepared import PreparedSolve
from ...system import name_of
from ..transcription.staged import Staged


class FirstNode:
    """Reads measured states, and writes them into the first node of a plan.

    The states of the system precede those of continuous controls, which the solver chooses.

    Args:
        staged: the transcribed problem.
        dynamics: the system of its first phase, as users stated it.

    Attributes:
        size: the number of entries of the measured states.
        n: the number of their tangents.
    """

    def __init__(self, staged: Staged, dynamics: Any) -> None:
        part = staged.parts[0]
        point = part.point
        self.n, self._all = dynamics.group.dimension, part.shooting.n
        self.size = sum(len(point.places(state.name)) for state in dynamics.states)
        self._states = {}
        for state in dynamics.states:
            places, columns = point.places(state.name), dynamics.group.slices[state.name]
            here = slice(int(places[0]), int(places[-1]) + 1) if len(places) else slice(0, 0)
            self._states[state.name] = (here, columns, state.shape, state.group)
        self._flat = all(state.group.flat for state in dynamics.states)
        self._point, self._gap = point.size, part.phase.kernels.gap.kernels[0]

    def named(self, x: Mapping[Any, Any]) -> dict[str, Any]:
        """Traced values of all states by name. Raises InputError, ShapeError: a missing state or another shape."""
        values = {name_of(key): value for key, value in x.items()} if isinstance(x, Mapping) else {}
        if values.keys() != self._states.keys():
            raise self._incomplete(x)
        for name, (_, _, shape, _) in self._states.items():
            if np.shape(values[name]) != shape:
                raise ShapeError(f"the measured state: x[{name!r}] expects shape {shape}, got {np.shape(values[name])}")
        return values

    def read(self, x: Mapping[Any, Any]) -> Array:
        """A measured state as a point.

        Raises:
            InputError, ShapeError: a state is missing, has another shape or numbers that are not finite, or is not an
                element of its group.
        """
        if not isinstance(x, Mapping) or len(x) != len(self._states):
            raise self._incomplete(x)
        base = np.empty(self.size)
        for key, value in x.items():
            name = name_of(key)
            if name not in self._states:
                raise InputError(
                    f"the measured state: unknown state {name!r}; the states are: {listed(self._states, name)}"
                )
            places, _, shape, group = self._states[name]
            array = value if type(value) is np.ndarray and value.dtype == float else _numbers(name, value)
            if array.shape != shape:
                raise ShapeError(f"the measured state: x[{name!r}] expects shape {shape}, got {array.shape}")
            if not np.isfinite(array).all():
                raise InputError(f"the measured state: x[{name!r}] expects finite numbers, got {short(array)}")
            need_element(name, group, array, "the measured state: x")
            base[places] = array.ravel()
        return base

    def _incomplete(self, x: Any) -> InputError:
        expected = f"the measured state expects a value for every state: {listed(self._states)}"
        if not isinstance(x, Mapping):
            return InputError(f"{expected}; got {short(x)}")
        names = [name_of(key) for key in x]
        missing = [name for name in self._states if name not in names]
        return InputError(f"{expected}; got {listed(names)}" + (f", without {listed(missing)}" if missing else ""))

    def point(self, solve: PreparedSolve) -> Array:
        """A copy of the measured states of the first node."""
        return solve.z[: self.size].copy()

    def write(self, solve: PreparedSolve, base: Array) -> None:
        """Fix the measured states of the first node."""
        solve.z[: self.size] = base
        for places, columns, _, group in self._states.values():  # the coordinates of a point on a manifold are zero
            at = base[places] if group.flat else 0.0
            solve.v[columns] = solve.lower[columns] = solve.upper[columns] = at

    def difference(self, solve: PreparedSolve, base: Array) -> Array:
        """Log(x_0^-1 x) for a point x and the first node x_0 of the plan."""
        if self._flat:
            return base - solve.z[: self.size]
        target = solve.z[: self._point]
        moved = np.concatenate([base, target[self.size :]])
        arguments = {Argument.Z: np.zeros((1, self._all)), Argument.BASE: moved[None], Argument.TARGET: target[None]}
        return self._gap(1, self._all, arguments)[0, : self.n]


def _numbers(name: str, value: Any) -> Array:
    return np.asarray(reals(f"the measured state: x[{name!r}]", value, InputError), float)
