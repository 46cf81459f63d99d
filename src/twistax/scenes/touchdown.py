"""How well a powered descent was flown: misses at the pad and limits along the way."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

import twistax as tx

from .powered_descent import Array, Limit

__all__ = ["Flight", "Miss", "Reach", "held", "reaches", "sampled"]


@dataclasses.dataclass(frozen=True)
class Flight:
    """Samples of a flight of the powered-descent system.

    Attributes:
        ts: (n,) times, s.
        xs: states by name, leading axis n.
        us: controls by name at those times, leading axis n.
        outputs: outputs of the system by name, (n,).
    """

    ts: Array
    xs: dict[str, Array]
    us: dict[str, Array]
    outputs: dict[str, Array]

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


def held(us: dict[str, Array], edges: Array, ts: Array) -> dict[str, Array]:
    """The controls at some times; each is held from one edge to the next. At an edge, the one that begins there."""
    number = np.clip(np.searchsorted(edges, ts, side="right") - 1, 0, len(edges) - 2)
    return {name: values[number] for name, values in us.items()}


def sampled(dynamics: Any, ts: Array, xs: dict[str, Array], us: dict[str, Array]) -> Flight:
    """A flight from samples of states and controls; the outputs are evaluated along it."""
    outputs = jax.jit(jax.vmap(dynamics.outputs))(ts, xs, us)
    return Flight(ts, xs, us, {name: np.asarray(values) for name, values in outputs.items()})


@dataclasses.dataclass(frozen=True)
class Miss:
    """How far the end of a flight is from standing still on the pad, upright; the heading is free.

    Attributes:
        position, velocity: m and m/s, in any direction.
        angle: from the vertical, deg.
    """

    position: float
    velocity: float
    angle: float

    @staticmethod
    def of(flight: Flight) -> Miss:
        """The miss at the last sample."""
        return Miss(
            float(np.linalg.norm(flight.position[-1])),
            float(np.linalg.norm(flight.velocity[-1])),
            float(np.rad2deg(flight.outputs["tilt"][-1])),
        )

    def within(self, other: Miss) -> bool:
        """Whether no part is larger than the other's; not a number is never within."""
        mine, bars = dataclasses.astuple(self), dataclasses.astuple(other)
        return all(value <= bar for value, bar in zip(mine, bars))


@dataclasses.dataclass(frozen=True)
class Reach:
    """How near a flight comes to a limit.

    Attributes:
        limit: the limit.
        value, time: the value nearest to it, in its unit, and when, s.
        margin: how far that is inside, in its unit; negative where it is exceeded.
    """

    limit: Limit
    value: float
    time: float
    margin: float

    @property
    def excess(self) -> float:
        """How far the limit is exceeded, relative to what is allowed for numerical reasons; above 1 is a violation."""
        return max(-self.margin, 0.0) / self.limit.slack


def reaches(flight: Flight, limits: Sequence[Limit]) -> list[Reach]:
    """How near a flight comes to every limit."""
    found = []
    for limit in limits:
        values = flight.outputs[limit.output]
        margins = limit.margin(values)
        worst = int(np.argmin(margins))
        found.append(Reach(limit, float(values[worst]) * limit.factor, float(flight.ts[worst]), float(margins[worst])))
    return found
