"""The controls of a plan: their positions in an iterate, and their values at the first node."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..transcription.staged import Staged


@dataclasses.dataclass(frozen=True)
class PlanControl:
    """A control of a phase. A piecewise constant control has a value for each interval, a continuous one for each node.

    Attributes:
        shape: of a value.
        points, columns: (values, entries) the indices of its entries in the core's z and v.
    """

    shape: tuple[int, ...]
    points: Array
    columns: Array


def plan_controls(staged: Staged, number: int, phase: Any) -> dict[str, PlanControl]:
    """The controls of a phase as users stated them, by name."""
    stages, part, group = staged.transcription.stages, staged.parts[number], phase.dynamics.group
    first, first_point = stages.first[part.stages], stages.first_point[part.stages]
    names = {control.name for control in phase.phase.dynamics.controls}
    controls = {}
    for control in phase.continuous.controls:
        name = control.name
        if name not in names:
            continue
        if name in phase.continuous.smooth:
            points, here = part.point.places(name), group.slices[name]
            columns = np.arange(here.start, here.stop)
            places = first_point[:, None] + points, first[:, None] + columns
        else:
            here = part.shooting.local.controls.slices[name]
            columns = np.arange(here.start, here.stop)
            places = first_point[:-1, None] + part.point.size + columns, first[:-1, None] + part.shooting.n + columns
        controls[name] = PlanControl(control.shape, *places)
    return controls


class FirstControls:
    """The controls that a controller applies: the first value of each control of the first phase.

    Attributes:
        shapes: by name.
        points, columns: the indices of all their entries in the core's z and v.
        of_each: for each control its first index in z, in v, and the number of its entries.
    """

    def __init__(self, controls: Mapping[str, PlanControl]) -> None:
        self.shapes = {name: control.shape for name, control in controls.items()}
        none = np.zeros(0, int)
        self.points = np.concatenate([none, *(control.points[0] for control in controls.values())])
        self.columns = np.concatenate([none, *(control.columns[0] for control in controls.values())])
        firsts = [(control.points[0], control.columns[0]) for control in controls.values()]
        self.of_each = [(int(a[0]), int(b[0]), len(a)) if len(a) else (0, 0, 0) for a, b in firsts]
        self._ends = np.cumsum([control.columns.shape[1] for control in controls.values()])[:-1]

    def named(self, values: Array, *more: int) -> dict[str, Array]:
        """Values (entries, *more) of all controls by name, (*shape, *more)."""
        parts = np.split(values, self._ends) if self.shapes else []
        return {name: part.reshape((*shape, *more)) for (name, shape), part in zip(self.shapes.items(), parts)}
