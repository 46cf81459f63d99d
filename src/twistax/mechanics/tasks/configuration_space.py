"""The positions of a mechanism as arrays: their limits, steps along velocities, and random positions."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...checks import listed
from ...errors import ModelError
from ...expr import Concat, Constant, Expr, Stack, State
from ...expr.lie import Compose, SE3Exp, SO3Exp
from ...groups import SE3, SO3
from ...system.lower import lower
from ..kinematic_tree import KinematicTree

Arrays = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class CoordinateLimits:
    """Bounds of the coordinates of the position vector (w,), infinite for no limit."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    @classmethod
    def of(cls, owner: str, mechanism: KinematicTree, width: int) -> CoordinateLimits:
        """The limits of the joints. A mimic joint limits the joint that it follows, through its ratio."""
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
            raise ModelError(
                f"{owner}: the limits of {listed(empty)} and of the joints that mimic it contradict each other"
            )
        return cls(lower, upper)


class ConfigurationSpace:
    """The positions of a mechanism without loop constraints.

    Args:
        owner: the name in messages.
    Attributes:
        states, names: the states of the positions, and their names.
        width: the number of coordinates in q.
        coordinates: for each degree of freedom the coordinate that it changes, -1 for joints on groups.
        joints: the name of the joint for each degree of freedom.
        limits: limits of the coordinates.
    Raises: ModelError for a mechanism with loop constraints, for joints on other groups than SO(3) and SE(3), and for
    limits that contradict each other.
    """

    def __init__(self, owner: str, mechanism: KinematicTree) -> None:
        if mechanism.loops:
            raise ModelError(
                f"{owner} does not support loop constraints: {listed(loop.name for loop in mechanism.loops)}.\n"
                "  fix: replace(loops=()) if they may be violated"
            )
        unsupported = [s.link.joint for s in mechanism.segments if s.link.joint.group not in (None, SO3, SE3)]
        if unsupported:
            raise ModelError(f"{owner} supports joints on SO(3) and SE(3), got {listed(unsupported)} on other groups")
        self.owner, self.mechanism = owner, mechanism
        q = mechanism.q
        self.states: list[State] = [q] if isinstance(q, State) else list(q.values())
        self.names = [state.name for state in self.states]
        self.width = next((state.shape[0] for state in self.states if state.name == "q"), 0)
        self.coordinates = np.full(mechanism.dofs, -1)
        for segment in mechanism.segments:
            if segment.coordinates is not None:
                self.coordinates[list(segment.freedoms)] = np.arange(self.width)[segment.coordinates]
        leaders = {i: s.link.joint.name for s in reversed(mechanism.segments) for i in s.freedoms}
        self.joints = tuple(leaders[i] for i in range(mechanism.dofs))
        self.limits = CoordinateLimits.of(owner, mechanism, self.width)

    @property
    def vector(self) -> Expr:
        """The coordinates q (w,). Raises ModelError if all joints are on groups."""
        if not self.width:
            raise ModelError(f"{self.owner} expects a joint with coordinates, got only joints on groups")
        return next(state for state in self.states if state.name == "q")

    @property
    def coordinate_rates(self) -> Expr:
        """The matrix S (w, n) with $q' = S qd$."""
        mechanism, zero = self.mechanism, np.zeros(self.width)
        columns: list[Expr] = [Constant(zero)] * mechanism.dofs
        places = mechanism.positions(self.owner, None)
        for segment, place in zip(mechanism.segments, places, strict=True):
            if segment.coordinates is None or segment.link.mimic is not None:
                continue
            at = segment.coordinates
            for k, i in enumerate(segment.freedoms):
                rate = segment.link.joint.rate(place, Constant(np.eye(len(segment.freedoms))[k]))
                columns[i] = Concat(np.zeros(at.start), rate, np.zeros(self.width - at.stop))
        return Stack(*columns).T

    @functools.cached_property
    def _step(self) -> Any:
        step = State("step", (self.mechanism.dofs,))
        places = self.mechanism.positions(self.owner, None)
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
        return lower(moved)

    def after(self, x: Arrays, step: jax.Array) -> Arrays:
        """The positions after a step (n,) of the velocities."""
        return dict(self._step(0.0, {**x, "step": step}))

    def moved(self, x: Arrays, step: jax.Array) -> Arrays:
        """The positions after a step (n,) of the velocities, clipped to the limits."""
        after = self.after(x, step)
        if self.width:
            dtype = after["q"].dtype
            after["q"] = jnp.clip(after["q"], self.limits.lower.astype(dtype), self.limits.upper.astype(dtype))
        return after

    def margins(self, x: Arrays, dtype: Any) -> tuple[jax.Array, jax.Array]:
        """The distances of each degree of freedom (n,) from its lower and its upper limit; infinite without limits."""
        flat = self.coordinates
        q = jnp.append(x["q"], jnp.zeros(1, dtype))[flat] if self.width else jnp.zeros(len(flat), dtype)
        lower, upper = (
            (np.append(bound, end)[flat] if self.width else np.full(len(flat), end)).astype(dtype)
            for bound, end in ((self.limits.lower, -np.inf), (self.limits.upper, np.inf))
        )
        return q - lower, jnp.asarray(upper) - q

    def free(self, x: Arrays, slope: jax.Array) -> jax.Array:
        """The degrees of freedom (n,) that may follow a descent direction: those that are not at a limit that blocks
        it.
        """
        above, below = self.margins(x, slope.dtype)
        return ((above > 0.0) | (slope > 0.0)) & ((below > 0.0) | (slope < 0.0))

    def to_middle(self, x: Arrays, at_limit: jax.Array) -> jax.Array:
        """The step (n,) by at most pi to the middle of the range, of those degrees of freedom that are at a limit."""
        above, below = self.margins(x, next(iter(x.values())).dtype)
        return jnp.where(at_limit, 0.5 * jnp.clip(below - above, -2.0 * np.pi, 2.0 * np.pi), 0.0)

    def random(self, rng: np.random.Generator, count: int) -> Arrays:
        """Random positions (count, ...) within the limits. Without limits, angles are within one turn, and elements
        near the identity.
        """
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
