"""States without a group in free motion."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...groups import Euclidean
from ...groups.arrays import scale
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays
from ..charts.coordinates import Blocks, FlatCoordinates
from .motion import Flows, FreeMotion, begun, increased, name_of, value

__all__ = ["FreeParticle"]


@dataclasses.dataclass(frozen=True)
class FreeParticle(FreeMotion):
    """A point, or anything else with p' = v: two states without a group, of one shape. Free, it goes straight ahead.

    The rate of v is the acceleration; no mass is needed.

    Args:
        position, velocity: p and v, states or their names.

    Raises:
        ModelError: when integrated: states of another kind.
    """

    position: Any
    velocity: Any
    parameters = ()

    def __post_init__(self) -> None:
        for field in ("position", "velocity"):
            object.__setattr__(self, field, name_of(getattr(self, field)))

    def check(self, dynamics: Dynamics) -> None:
        groups = [dynamics.group.factors[name] for name in (self.position, self.velocity)]
        if not all(isinstance(group, Euclidean) for group in groups) or groups[0].shape != groups[1].shape:
            raise ModelError(
                f"{self!r}: expects two states without a group and of one shape, got {groups[0].name} and "
                f"{groups[1].name}.\n"
                "  fix: a rotation or a pose is that of a tx.FreeBody(pose, velocity, inertia=...)"
            )

    def rates(self, dynamics: Dynamics, x: Arrays, params: Arrays) -> Arrays:
        v = x[self.velocity]
        return {self.position: v, self.velocity: jnp.zeros_like(v)}

    def flows(self, dynamics: Dynamics, params: Arrays) -> Flows:
        group = dynamics.group.factors[self.position]
        assert isinstance(group, Euclidean)  # `check` refuses others
        return _ParticleFlows(self.position, self.velocity, FlatCoordinates(group))


@dataclasses.dataclass(frozen=True)
class _ParticleFlows(Flows):
    position: str
    velocity: str
    part: FlatCoordinates

    def enter(self, x: Arrays) -> Blocks:
        return {name: begun(self.part.enter(x[name])) for name in (self.position, self.velocity)}

    def value(self, y: Blocks) -> Arrays:
        return {name: self.part.value(value(y[name])) for name in (self.position, self.velocity)}

    def at_rest(self, y: Blocks) -> Arrays:
        p = self.part.value(value(y[self.position]))
        return {self.position: p, self.velocity: jnp.zeros_like(p)}

    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        return self._own(y) | {self.position: increased(y[self.position], scale(dt, value(y[self.velocity])))}

    def inner(self, y: Blocks, dt: jax.Array, backwards: bool) -> Blocks:
        return self._own(y)

    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        change = self.part.rate(rates[self.velocity])
        return self._own(y) | {self.velocity: increased(y[self.velocity], scale(dt, change))}

    def settle(self, y: Blocks) -> Blocks:
        return self._own(y)

    def _own(self, y: Blocks) -> Blocks:
        return {name: y[name] for name in (self.position, self.velocity)}
