"""The unknowns that all intervals share, as one vector b: the duration of each phase, then the free parameters."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...checks import listed, number, reals, short
from ...errors import ModelError, TrajectoryError
from ...expr import Control, Parameter
from ...linear.discretize import Controls
from ...linear.free_parameters import boxes_of, limits_of
from ...system import entry_names, name_of
from ...units import same_unit, seconds

#: Limits of a time whose ratio is larger than this determine the time only up to its order of magnitude.
_WIDE = 100.0 * (1.0 + 1e-9)


@dataclasses.dataclass(frozen=True, eq=False)
class Border:
    """The layout of durations and free parameters in b, and their limits.

    Attributes:
        times: the name of the duration of each phase.
        time_limits: (phases, 2), equal for a fixed duration.
        boxes: the free parameters with their limits.
    """

    times: tuple[str, ...]
    time_limits: Array
    boxes: tuple[Control, ...] = ()

    @functools.cached_property
    def limits(self) -> Array:
        """(g, 2) the limits; infinite for entries without a limit."""
        return np.concatenate([np.reshape(self.time_limits, (-1, 2)), *map(limits_of, self.boxes)])

    @property
    def size(self) -> int:
        return len(self.limits)

    @property
    def phases(self) -> int:
        return len(self.times)

    @property
    def free(self) -> Array:
        """(g,) the entries that may change."""
        return self.limits[:, 0] < self.limits[:, 1]

    @functools.cached_property
    def names(self) -> list[str]:
        """The name of every entry."""
        return [*self.times, *(entry for box in self.boxes for entry in entry_names(box.name, box.shape))]

    @functools.cached_property
    def finite(self) -> list[tuple[int, int]]:
        """(entry, side) of every finite limit."""
        there = np.isfinite(self.limits) & self.free[:, None]
        return [(int(i), int(side)) for i, side in np.argwhere(there)]

    @property
    def row_names(self) -> list[str]:
        return [f"{self.names[i]}: {('lower', 'upper')[side]} limit" for i, side in self.finite]

    @functools.cached_property
    def unknown(self) -> Array:
        """(g,) the entries that are unknowns of the solver: all but fixed durations."""
        return self.free | (np.arange(self.size) >= self.phases)

    @property
    def unknowns(self) -> int:
        return int(self.unknown.sum())

    def complete(self, unknowns: Any, limits: Any) -> Any:
        """The vector b from its unknowns and the limits (g, 2), which are the values of fixed durations."""
        of_times, xp = self.unknown[: self.phases], np if isinstance(unknowns, np.ndarray) else jnp
        places = np.cumsum(of_times) - 1
        times = [unknowns[i : i + 1] if known else limits[k, :1] for k, (i, known) in enumerate(zip(places, of_times))]
        return xp.concatenate([*times, unknowns[int(of_times.sum()) :]])

    def rows(self, b: jax.Array, limits: jax.Array) -> jax.Array:
        """The residuals of the limits, <= 0."""
        rows = [(limits[i, 0] - b[i], b[i] - limits[i, 1])[side] for i, side in self.finite]
        return jnp.stack(rows) if rows else jnp.zeros(0, b.dtype)

    def params(self, b: Any) -> dict[str, Any]:
        """The free parameters by name."""
        return Controls(self.boxes).split(b[self.phases :])

    def limited(self, times: Array, free: Any) -> Array:
        """The limits (g, 2) with other values for durations, and for free parameters by leaf or name.

        Raises:
            ModelError: as in `boxes_of`, for parameters that are not free.
            TrajectoryError: limits on other sides, or low not below high.
        """
        limits = np.concatenate([np.reshape(times, (-1, 2)), self.limits[self.phases :]])
        places = Controls(self.boxes).slices
        for name in map(name_of, free) if isinstance(free, (Mapping, list, tuple)) else ():
            if name not in places:
                raise ModelError(
                    f"solve: free names {name!r}; the problem leaves free: {listed(places, name)}\n"
                    "  fix: declare the parameter in free= of the problem"
                )
        for box in boxes_of(free, [Parameter(box.name, box.shape) for box in self.boxes], ()):
            part = slice(*(self.phases + np.array([places[box.name].start, places[box.name].stop])))
            other = limits_of(box)
            if (np.isfinite(other) != np.isfinite(limits[part])).any():
                raise TrajectoryError(
                    f"solve: free[{box.name!r}] must have limits on the sides where the problem has them, "
                    f"got {short((box.min, box.max))} for {limits[part].tolist()}"
                )
            if (other[:, 0] >= other[:, 1]).any():
                raise TrajectoryError(
                    f"solve: free[{box.name!r}] expects low < high.\n  fix: pass a fixed value in params="
                )
            limits[part] = other
        return limits

    def start(self, durations: Array, params: Mapping[str, Array], guess: Mapping[str, Array], limits: Array) -> Array:
        """The initial b, within limits (g, 2): guesses, else the admissible values nearest to the parameters' values.

        Raises:
            TrajectoryError: a guess outside its limits.
        """
        parts = [np.ravel(durations)]
        places = Controls(self.boxes).slices
        for box in self.boxes:
            value = np.ravel(guess.get(box.name, params[box.name])).astype(float)
            parts.append(np.clip(value, *limits[self.phases :][places[box.name]].T))
            if box.name in guess and (value != parts[-1]).any():
                raise TrajectoryError(f"guess[{box.name!r}] must be within its limits, got {short(guess[box.name])}")
        return np.concatenate(parts)


def times_of(final_time: Any, guess: Any) -> tuple[tuple[float, float], float]:
    """The limits of a final time, from a number or (low, high), and its initial guess.

    Raises:
        TrajectoryError: invalid times.
        InputError: a unit other than s.
    """
    for name, value in (("final_time", final_time), ("final_time_guess", guess)):
        same_unit(name, value, seconds)
    if final_time is None:
        raise TrajectoryError("final_time expects a number in s, or limits (low, high) of a free final time, got None")
    limits = reals("final_time", final_time, TrajectoryError)
    if limits.shape not in ((), (2,)):
        raise TrajectoryError(f"final_time expects a number or (low, high), got {final_time!r}")
    low, high = np.broadcast_to(limits, 2).tolist()
    if not (0.0 < low <= high < np.inf):
        raise TrajectoryError(f"final_time must be positive, finite and low <= high, got {final_time!r}")
    if guess is None:
        guess = 0.5 * (low + high) if high <= _WIDE * low else math.sqrt(low) * math.sqrt(high)
    number("final_time_guess", guess, f"from {low:g} to {high:g}", lambda t: low <= t <= high, TrajectoryError)
    return (low, high), float(guess)
