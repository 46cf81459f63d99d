"""The task errors of frames as functions of arrays: errors, their Jacobian, steps of the joints, and limits.

With the pose [R p] of a frame and its target [R_d p_d] the error is

    e = [p_d - p; l Log(R^T R_d)]        e' = -J qd,  J = [J_v; l J_w]

with J_v in the axes of the base and J_w in those of the frame; the second row holds to first order in the error, and
for the gradient of |e|^2 it is exact: Log(R^T R_d) is an eigenvector of the Jacobian that is left out.

Source: K. Lynch, F. Park, Modern Robotics (2017), section 6.2, for the error of a pose.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...checks import listed
from ...errors import ModelError
from ...expr import Concat, Expr, State, Vstack
from ...expr.lie import Compose, SE3Exp, SO3Exp, SO3Log
from ...groups import SE3, SO3
from ...system.lower import lower
from ..algorithms.jacobians import ALIGNED, BODY, frame_jacobian
from ..kinematic_tree import KinematicTree

Arrays = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class CoordinateLimits:
    """Bounds of the coordinates of the position vector (w,): infinite where there are none."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    @classmethod
    def of(cls, mechanism: KinematicTree, width: int) -> CoordinateLimits:
        """Those of the joints; a follower's are those of its leader, through the ratio."""
        lower, upper = np.full(width, -np.inf), np.full(width, np.inf)
        for segment in mechanism.segments:
            drive, mimic, at = segment.link.drive, segment.link.mimic, segment.coordinates
            if at is None:
                continue
            ends = [-np.inf if drive.lower is None else drive.lower, np.inf if drive.upper is None else drive.upper]
            if mimic is not None and mimic.ratio:
                ends = sorted((end - mimic.offset) / mimic.ratio for end in ends)
            lower[at], upper[at] = np.maximum(lower[at], ends[0]), np.minimum(upper[at], ends[1])
        empty = [
            s.link.joint.name for s in mechanism.segments if s.coordinates and np.any((lower > upper)[s.coordinates])
        ]
        if empty:
            raise ModelError(f"reach: the limits of {listed(empty)} and of what follows exclude each other")
        return cls(lower, upper)


class Tasks:
    """The errors of frames of a mechanism.

    Args:
        mechanism: without closures.
        shapes: by frame (4, 4) for a pose, (3,) for a position.
        length: l, m.
    Attributes:
        names: of the states of the positions.
        width: the number of coordinates in q.
        coordinates: for each freedom the coordinate that it moves, -1 on groups.
        limits: of the coordinates.
        ends: for each row of the error whether it is of a position.
    Raises: ModelError for frames that are not known; a mechanism with closures, or joints on other groups.
    """

    def __init__(self, mechanism: KinematicTree, shapes: Mapping[str, tuple[int, ...]], length: float) -> None:
        if mechanism.loops:
            raise ModelError(
                f"reach does not keep closures: {listed(loop.name for loop in mechanism.loops)}.\n"
                "  fix: replace(loops=()) where they may open"
            )
        unsupported = [s.link.joint for s in mechanism.segments if s.link.joint.group not in (None, SO3, SE3)]
        if unsupported:
            raise ModelError(f"reach moves joints on SO(3) and SE(3), got {listed(unsupported)} on other groups")
        self.mechanism, self.shapes, self.length = mechanism, dict(shapes), length
        q = mechanism.q
        self.states: list[State] = [q] if isinstance(q, State) else list(q.values())
        self.names = [state.name for state in self.states]
        self.width = next((state.shape[0] for state in self.states if state.name == "q"), 0)
        self.coordinates = np.full(mechanism.dofs, -1)
        for segment in mechanism.segments:
            if segment.coordinates is not None:
                self.coordinates[list(segment.freedoms)] = np.arange(self.width)[segment.coordinates]
        self.limits = CoordinateLimits.of(mechanism, self.width)
        self.ends = np.concatenate([[True] * 3 + [False] * (3 * (shape == (4, 4))) for shape in shapes.values()])
        self._errors, self._steps = self._lowered()

    def _lowered(self) -> tuple[Any, Any]:
        """Functions of the positions: errors and Jacobian, and positions after a step."""
        errors: list[Expr] = []
        rows: list[Expr] = []
        for frame, shape in self.shapes.items():
            T, target = self.mechanism.pose(frame), State(f"target of {frame}", shape)
            pose = shape == (4, 4)
            errors.append((target[:3, 3] if pose else target) - T[:3, 3])
            rows.append(frame_jacobian(self.mechanism, frame, axes=ALIGNED)[:3])
            if pose:
                errors.append(self.length * SO3Log(T[:3, :3].T @ target[:3, :3]))
                rows.append(self.length * frame_jacobian(self.mechanism, frame, axes=BODY)[3:])
        step = State("step", (self.mechanism.dofs,))
        places = self.mechanism.positions("reach", None)
        moved, vector = dict[str, Expr](), dict[int, Expr]()
        for segment, place in zip(self.mechanism.segments, places, strict=True):
            if segment.link.mimic is not None or not segment.freedoms:
                continue
            joint, d = segment.link.joint, step[segment.freedoms[0] : segment.freedoms[-1] + 1]
            if joint.group is None:
                assert segment.coordinates is not None
                vector[segment.coordinates.start] = place + joint.rate(place, d)
            else:
                exp = SO3Exp if joint.group == SO3 else SE3Exp
                moved[f"{joint.name}_position"] = Compose(place, exp(d))
        if vector:
            moved["q"] = Concat(*(vector[i] for i in sorted(vector)))
        return lower([Concat(*errors), Vstack(*rows)]), lower(moved)

    def errors(self, x: Arrays, targets: Arrays) -> tuple[jax.Array, jax.Array]:
        """The errors (m,) and the Jacobian J (m, n): their rate is -J qd."""
        e, J = self._errors(0.0, {**x, **{f"target of {frame}": T for frame, T in targets.items()}})
        return e, J

    def moved(self, x: Arrays, step: jax.Array) -> Arrays:
        """The positions after a step (n,) of the velocities, within limits."""
        after = dict(self._steps(0.0, {**x, "step": step}))
        if self.width:
            dtype = after["q"].dtype
            after["q"] = jnp.clip(after["q"], self.limits.lower.astype(dtype), self.limits.upper.astype(dtype))
        return after

    def free(self, x: Arrays, slope: jax.Array) -> jax.Array:
        """Which freedoms (n,) may follow the direction of descent: those not at a limit beyond which it points."""
        if not self.width:
            return jnp.ones(self.mechanism.dofs, dtype=bool)
        dtype, flat = slope.dtype, self.coordinates
        lower, upper = (
            np.append(bound, end)[flat] for bound, end in ((self.limits.lower, -1.0), (self.limits.upper, 1.0))
        )
        at = jnp.append(x["q"], jnp.zeros(1, dtype=dtype))[flat]  # zero between -1 and 1 for what is on a group
        above = (at > lower.astype(dtype)) | (slope > 0.0)
        return above & ((at < upper.astype(dtype)) | (slope < 0.0))

    def random(self, rng: np.random.Generator, count: int) -> Arrays:
        """Positions (count, ...) within the limits; without limits angles of one turn, and elements about the unit."""
        from scipy.spatial.transform import Rotation

        x = dict[str, Any]()
        for state in self.states:
            if state.name == "q":
                low = np.where(np.isfinite(self.limits.lower), self.limits.lower, np.minimum(-np.pi, self.limits.upper))
                high = np.where(np.isfinite(self.limits.upper), self.limits.upper, np.maximum(np.pi, low))
                x["q"] = rng.uniform(low, high, size=(count, self.width))
            else:
                element = np.tile(np.eye(state.shape[0]), (count, 1, 1))
                element[:, :3, :3] = Rotation.from_quat(rng.normal(size=(count, 4))).as_matrix()
                if state.shape == (4, 4):
                    element[:, :3, 3] = rng.normal(size=(count, 3))
                x[state.name] = element
        return x
