"""The quality of a landing whose controls are replayed: errors at the pad, and margins to the limits."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from .powered_descent import Array, Limit

#: Samples of an interval between nodes; an RKMK method takes as many steps there.
SAMPLES = 40


@dataclasses.dataclass(frozen=True)
class Descent:
    """Samples of a descent of the powered-descent system, all with a leading axis n."""

    ts: Array  # times, s
    xs: dict[str, Array]  # states by name
    us: dict[str, Array]  # controls by name
    outputs: dict[str, Array]  # of the system, by name

    @property
    def position(self) -> Array:
        """Position in the world, (n, 3), m."""
        return self.xs["g"][:, :3, 3]

    @property
    def rotation(self) -> Array:
        """Rotation from body to world, (n, 3, 3)."""
        return self.xs["g"][:, :3, :3]

    @property
    def velocity(self) -> Array:
        """Velocity in the world frame, (n, 3), m/s."""
        return np.einsum("kij,kj->ki", self.rotation, self.xs["V"][:, :3])

    @property
    def thrust(self) -> Array:
        """Thrust in the world frame, (n, 3), N."""
        return np.einsum("kij,kj->ki", self.rotation, self.us["T"])


def replayed(result: Any, method: Any) -> Descent:
    """The controls of a `TrajectoryResult` replayed from the start, each constant over its interval. See its `replay`.

    Raises:
        IntegrationError: the descent did not reach its end.
    """
    replay = result.replay(method, steps=SAMPLES)
    return _with_outputs(result, replay.ts, replay.xs, replay.us)


def planned(result: Any) -> Descent:
    """The nodes of a `TrajectoryResult`, each with the control of the next interval, the last one with that of the
    previous interval.
    """
    us = {name: np.concatenate([values, values[-1:]]) for name, values in result.us.items()}
    return _with_outputs(result, result.ts, result.xs, us)


def _with_outputs(result: Any, ts: Array, xs: dict[str, Array], us: dict[str, Array]) -> Descent:
    outputs = _outputs(result.problem.dynamics)(ts, xs, us)
    return Descent(ts, xs, us, {name: np.asarray(values) for name, values in outputs.items()})


@functools.lru_cache(maxsize=4)
def _outputs(dynamics: Any) -> Callable[..., Any]:
    """The outputs of many samples, compiled once for a system."""
    return jax.jit(jax.vmap(dynamics.outputs))


@dataclasses.dataclass(frozen=True)
class Miss:
    """The error at the end of a descent with respect to rest on the pad, upright; the heading is free."""

    position: float  # m, in any direction
    velocity: float  # m/s, in any direction
    angle: float  # from the vertical, deg

    @staticmethod
    def of(descent: Descent) -> Miss:
        """The miss at the last sample."""
        return Miss(
            float(np.linalg.norm(descent.position[-1])),
            float(np.linalg.norm(descent.velocity[-1])),
            float(np.rad2deg(descent.outputs["tilt"][-1])),
        )

    def within(self, other: Miss) -> bool:
        """Whether no part exceeds that of another; NaN always exceeds."""
        mine, bars = dataclasses.astuple(self), dataclasses.astuple(other)
        return all(value <= bar for value, bar in zip(mine, bars))


#: A landing counts if the controls, replayed, miss by no more than this.
ALLOWED = Miss(position=0.5, velocity=0.1, angle=0.5)


@dataclasses.dataclass(frozen=True)
class Reach:
    """The smallest margin of a descent to a limit."""

    limit: Limit
    value: float  # nearest to it, in its unit
    time: float  # when, s
    margin: float  # how far that is inside, in its unit; negative where it is exceeded

    @property
    def holds(self) -> bool:
        """Whether the limit holds within its tolerance. False for NaN."""
        return self.margin >= -self.limit.slack


def reaches(descent: Descent, limits: Sequence[Limit]) -> list[Reach]:
    """The smallest margin of a descent to every limit."""
    reached = []
    for limit in limits:
        values = descent.outputs[limit.output]
        margins = limit.margin(values)
        worst = int(np.argmin(margins))
        reached.append(
            Reach(limit, float(values[worst]) * limit.factor, float(descent.ts[worst]), float(margins[worst]))
        )
    return reached
