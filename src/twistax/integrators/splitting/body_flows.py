"""The flows of a free body. Its momenta stand still in the world, and are stored there."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from ...groups import Group, SpecialEuclidean, quaternions
from ...groups.components import Components, add, scale, vector
from ...lowering.dynamics import Arrays
from ..charts import Ambient
from ..charts.stored import tightened
from ..charts.whole import Blocks
from .inertia import CenteredInertia, Inertia
from .motion import Flows
from .spin import arrays, conjugate
from .sums import Sum, begun, increased, value

__all__ = ["AttitudeFlows", "PoseFlows"]

Map = Callable[[Components], Components]


class AttitudeFlows(Flows):
    """A body that turns about the origin of its frame. Stored: (q,) and the sum of momentum in world axes.

    Args:
        names: of the attitude, and of its velocity or momentum.
        group: of the attitude.
        own: the inertia.
        into, out: from the second state, or its rate at rest, to momenta in body axes, and back.
    """

    def __init__(self, names: tuple[str, str], group: Group, own: Inertia, into: Map, out: Map) -> None:
        self.position, self.velocity = names
        self.group, self.spin, self.into, self.out = group, own.spin, into, out
        self.part = Ambient().coordinates(group)

    def enter(self, x: Arrays) -> Blocks:
        pose = self.part.enter(x[self.position])
        momenta = self.into(self.part.rate(x[self.velocity]))
        return {self.position: self._to_center(pose), self.velocity: begun(_turned(pose[:4], momenta))}

    def value(self, y: Blocks) -> Arrays:
        pose, momenta = y[self.position], value(y[self.velocity])
        own = self.out(_turned(conjugate(pose[:4]), momenta))
        return {self.position: self.part.value(self._from_center(pose)), self.velocity: self._array(own)}

    def at_rest(self, y: Blocks) -> Arrays:
        pose = self.part.value(self._from_center(y[self.position]))
        return {self.position: pose, self.velocity: jnp.zeros(self.group.dimension, pose.dtype)}

    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        pose, momenta = y[self.position], value(y[self.velocity])
        q = self.spin.symmetric(pose[:4], momenta[:3], dt)
        return {self.position: (*q, *self._carried(pose[4:], momenta, dt)), self.velocity: y[self.velocity]}

    def inner(self, y: Blocks, dt: jax.Array) -> Blocks:
        return self._by_others(y, dt, backwards=False)

    def inner_backwards(self, y: Blocks, dt: jax.Array) -> Blocks:
        return self._by_others(y, dt, backwards=True)

    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        pose, momenta = y[self.position], y[self.velocity]
        force = _turned(pose[:4], self.into(self.part.rate(rates[self.velocity])))
        return {self.position: pose, self.velocity: increased(momenta, scale(dt, force))}

    def settle(self, y: Blocks) -> Blocks:
        pose = y[self.position]
        return {self.position: (*tightened(pose[:4]), *pose[4:]), self.velocity: y[self.velocity]}

    def _by_others(self, y: Blocks, dt: jax.Array, backwards: bool) -> Blocks:
        pose, momenta = y[self.position], y[self.velocity]
        q = self.spin.others_flow(pose[:4], momenta[:3], dt, backwards)
        return {self.position: (*q, *pose[4:]), self.velocity: momenta}

    def _array(self, own: Components) -> jax.Array:
        return vector(own)

    def _to_center(self, pose: Components) -> Components:
        return pose

    def _from_center(self, stored: Components) -> Components:
        return stored

    def _carried(self, center: Sum, momenta: Components, dt: jax.Array) -> Sum:
        return center


class PoseFlows(AttitudeFlows):
    """A body that also moves. Stored: q and the sum of the centre of mass; that of L about the centre of mass and of p.

    Momenta and the centre of mass are in world axes.
    """

    def __init__(
        self, names: tuple[str, str], group: SpecialEuclidean, own: CenteredInertia, into: Map, out: Map
    ) -> None:
        super().__init__(names, group, own, into, out)
        self.mass, self.center, self.order = own.mass, own.center, group.order

    def _array(self, own: Components) -> jax.Array:
        return self.order.from_linear_first(vector(own))

    def _to_center(self, pose: Components) -> Components:
        return (*pose[:4], *begun(add(pose[4:], self._arm(pose))))

    def _from_center(self, stored: Components) -> Components:
        return (*stored[:4], *add(value(stored[4:]), scale(-1.0, self._arm(stored))))

    def _carried(self, center: Sum, momenta: Components, dt: jax.Array) -> Sum:
        return increased(center, scale(dt / self.mass, momenta[3:]))

    def _arm(self, pose: Components) -> Components:
        """From the origin of the frame to the centre of mass, in world axes."""
        return quaternions.rotate(pose[:4], arrays(self.center, pose[0]))


def _turned(q: Components, vectors: Components) -> Components:
    """Every three numbers turned by q."""
    parts = [quaternions.rotate(q, vectors[i : i + 3]) for i in range(0, len(vectors), 3)]
    return tuple(number for part in parts for number in part)
