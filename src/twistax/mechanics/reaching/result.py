"""The result of inverse kinematics: positions, their status, and what remains."""

from __future__ import annotations

import dataclasses
import enum
import functools
from collections import Counter
from typing import SupportsIndex

import jax
import numpy as np

from ...errors import InputError
from ...jax_inside import is_traced

#: A constraint with a larger residual is reported as violated.
_VIOLATED = 1e-5


class ReachStatus(enum.IntEnum):
    """The status of inverse kinematics for one target.

    - `REACHED`: all frames are at their targets within the tolerances, all tasks are satisfied, and all constraints
      hold.
    - `LIMIT`: the best seed ended at a local minimum of the error within the joint limits, and without some of them the
      error would decrease further; `at_limit` marks these joints.
    - `UNREACHABLE`: every seed led to a local minimum of the error, and no joint limit keeps the best one from the
      target, as where an arm is stretched. `distance` is what remains.
    - `MAX_ITERATIONS`: a seed, or the best one, was not at a local minimum after the largest number of iterations, so
      nothing is known about the target; more `iterations` decide it.
    - `INVALID_TARGET`: within a traced function, a target is not finite, or a matrix that is not a pose. Outside of it
      `reach` does not accept such a target.
    """

    REACHED = 0
    LIMIT = 1
    UNREACHABLE = 2
    MAX_ITERATIONS = 3
    INVALID_TARGET = 4


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["x", "status", "distance", "angle", "at_limit", "slope", "minima", "seeds", "constraints"],
    meta_fields=["frames", "joints", "constraint_names"],
)
@dataclasses.dataclass(frozen=True)
class ReachResult:
    """The result of `reach`, with the leading axes of the targets.

    Attributes:
        x: positions by state, "q" (..., w) and "<joint>_position" on groups, in the form that `tx.integrate` reads.
        status: (...,), the numbers of `ReachStatus`.
        distance: (..., frames), m: distance from the origin of each frame to its target.
        angle: (..., frames), rad: angle between the axes of each frame and of its target; zero for targets that are
            positions.
        at_limit: (..., n): at a local minimum the degrees of freedom that would reduce the error but are at a limit:
            those of which the multiplier $|J_i^T e| / (|J| |e|)$ is not zero. One below 1e-3 counts as zero, in float32
            one below 7e-3.
        slope: (...,): $|P J^T e| / (|J| |e|)$, with P the projection onto the directions that limits permit. It is at
            most 1e-4 at a local minimum, in float32 7e-4, and meaningless if the target is reached.
        minima: (...,): the number of seeds that led to a local minimum.
        seeds: (...,): the number of seeds that were tried.
        constraints: (..., k): residuals of the constraints, satisfied if not positive.
        frames: names of the frames, in the order of the last axis of `distance`.
        joints: the name of the joint for each degree of freedom.
        constraint_names: the name of each residual.
    """

    x: dict[str, jax.Array]
    status: jax.Array
    distance: jax.Array
    angle: jax.Array
    at_limit: jax.Array
    slope: jax.Array
    minima: jax.Array
    seeds: jax.Array
    constraints: jax.Array
    frames: tuple[str, ...]
    joints: tuple[str, ...]
    constraint_names: tuple[str, ...]

    def __repr__(self) -> str:
        if is_traced(self.status) or not isinstance(self.status, (np.ndarray, jax.Array)):
            return f"ReachResult({', '.join(self.frames)})"
        counts = Counter(ReachStatus(int(status)).name for status in np.ravel(self.status))
        statuses = ", ".join(f"{count} {name}" if np.ndim(self.status) else name for name, count in counts.items())
        distances, angles, residuals = (
            np.max(np.asarray(a), axis=tuple(range(np.ndim(a) - 1)), initial=0.0)
            for a in (self.distance, self.angle, self.constraints)
        )
        left = list[str]()
        for frame, d, angle in zip(self.frames, distances, angles, strict=True):
            turned = f" and {angle:.2g} rad" if angle > 0.0 else ""
            left.append(f"{frame!r} at most {d:.2g} m{turned} from its target")
        broken = dict[str, float]()
        for name, residual in zip(self.constraint_names, residuals, strict=True):
            if residual > _VIOLATED:
                broken[name] = max(residual, broken.get(name, 0.0))
        left += [f"constraint {name!r} violated by at most {residual:.2g}" for name, residual in broken.items()]
        return f"ReachResult({'; '.join([statuses, *left])})"

    def stopped_by(self, *index: SupportsIndex) -> tuple[str, ...]:
        """The joints that would reduce the error for one target but are at a limit, for the best seed."""
        stopped = np.asarray(self.at_limit)
        if len(index) != stopped.ndim - 1 or any(not -n <= i < n for i, n in zip(index, stopped.shape, strict=False)):
            raise InputError(f"stopped_by expects an index into {stopped.shape[:-1]}, got {index}")
        return tuple(dict.fromkeys(self.joints[i] for i in np.flatnonzero(stopped[index])))

    def broken(self, *index: SupportsIndex, tolerance: float = _VIOLATED) -> tuple[str, ...]:
        """The names of the constraints that the positions for one target violate by more than a tolerance."""
        over = np.flatnonzero(np.asarray(self.constraints[index]) > tolerance)
        return tuple(dict.fromkeys(self.constraint_names[i] for i in over))
