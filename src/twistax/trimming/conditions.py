"""The conditions of a trim as one vector, with derivatives in the tangent space."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..checks import listed, reals, short
from ..errors import InputError
from ..expr import Inputs
from ..linear.labels import entry, labels, needed, positions, tangent_shapes
from ..linear.linearize import around, output_shapes
from ..system.dynamics import Dynamics


class TrimConditions:
    """The residuals of a trim, as one vector.

    Args:
        params: the free parameters.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        zero: list[str],
        fixed: Mapping[str, Any],
        steady: list[str],
        params: tuple[str, ...],
    ) -> None:
        self.dynamics = dynamics
        outputs = output_shapes(dynamics)
        rates = tangent_shapes(dynamics.group)
        both = sorted(set(rates) & set(outputs))
        if both and {name.partition("[")[0] for name in (*zero, *fixed)} & set(both):
            raise InputError(f"trim: {listed(both)} are names of both states and outputs.\n  fix: rename the outputs")
        values = {**rates, **outputs}
        wanted = [*zero, *fixed, *(f"slope of {name}" for name in steady)]
        if not wanted:
            raise InputError("trim expects at least one condition, zero=, fixed= or steady=")
        for name in steady:
            entry("trim: steady", name, outputs)
        for name in (*zero, *fixed):
            entry("trim: zero, fixed", name, values)
        needed_outputs = needed("trim", [*zero, *fixed, *steady], values)
        outputs = {name: shape for name, shape in outputs.items() if name in needed_outputs}
        shapes = {**rates, **outputs, **{f"slope of {name}": shape for name, shape in outputs.items()}}
        self._rows = np.array(positions("trim: zero, fixed, steady", wanted, shapes))
        self.reads = ("rates", "outputs") if outputs else ("rates",)
        self._around = around(dynamics, tuple(outputs), bool(steady), params)
        names = [f"rate of {label}" for label in labels(rates)] + list(labels(outputs))
        names += [f"slope of {label}" for label in labels(outputs)]
        self.names = [names[row] for row in self._rows]
        targets = [np.zeros(len(entry("", name, shapes)[1])) for name in wanted]
        for k, (name, value) in enumerate(fixed.items(), len(zero)):
            targets[k] = self._target(name, value, len(targets[k]))
        self._targets = np.concatenate(targets)

    @staticmethod
    def _target(name: str, value: Any, size: int) -> np.ndarray:
        if value is None:  # what it is at the start, which `hold` puts there
            return np.full(size, np.nan)
        target = reals(f"fixed[{name!r}]", value, InputError).astype(np.float64)
        if target.size != size or not np.isfinite(target).all():
            raise InputError(f"fixed[{name!r}] expects {size} finite numbers, got {short(value)}")
        return target.reshape(-1)

    def hold(self, start: Inputs) -> None:
        """Set the targets of quantities that are fixed without a value to their present values."""
        if np.isnan(self._targets).any():
            open_ones = np.isnan(self._targets)
            self._targets[open_ones] = 0.0
            self._targets[open_ones] = self.at(start)[0][open_ones]

    def at(self, point: Inputs) -> tuple[np.ndarray, np.ndarray]:
        """The residuals, with derivatives with respect to perturbations of states, controls and free parameters."""
        value, slopes = self._around(point.t, dict(point.x), dict(point.u), dict(point.params))
        return np.asarray(value)[self._rows] - self._targets, np.asarray(slopes)[self._rows]
